"""Arguments of public functions against their annotations, refused in one sentence."""

import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import wraps
from inspect import Parameter, Signature, signature
from math import inf
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin

import numpy as np
from numpy.typing import ArrayLike

_NUMBERS = {float: Real, int: Integral}
_LISTS = (Sequence, Iterable)
_SAID: dict[Any, str] = {
    float: "a number",
    int: "a whole number",
    bool: "True or False",
    str: "a text",
    os.PathLike: "a path",
}
_SAID |= {Sequence: "a sequence", Iterable: "a sequence", dict: "a dict"}
_SAID |= {ArrayLike: "an array", Callable: "a function"}
_ARRAY = {*get_args(ArrayLike)}
# parameters of a size, whichever function has them
_POSITIVE = {"sample_time", "duration", "period", "periods", "runs", "substeps", "every"}
_FINITE = {"kp", "ki", "preload", "bias_l", "bias_r", "theta_L", "amplitude", "offset", "rms"}
# (given, wanted) -> how the one makes the other
_MAKES = {
    ("Drive", "Model"): "Model(drive) makes one",
    ("Drive", "StateSpace"): "three_dof(drive) or nine_dof(drive) makes one",
    ("Model", "StateSpace"): "linearize(model) makes one",
    ("RigModel", "StateSpace"): "linearize(model) makes one",
    ("Rig", "StateSpace"): "linearize(rig) makes one",
    ("Rig", "RigModel"): "read_model(file) makes one of a rig file",
    ("Model", "Drive"): "model.drive is one",
    ("Loop", "Controller"): "Controller(kp, ki, limit, preload=...) makes one from gains",
    ("PiTuning", "Controller"): "Controller(kp, ki, limit, preload=...) makes one from gains",
}
_Class = TypeVar("_Class", bound=type)


def refusing(cls: _Class) -> _Class:
    """Let a class refuse, in one sentence, what its fields' annotations do not name."""
    make = "__new__" if issubclass(cls, tuple) else "__init__"
    made, wanted = getattr(cls, make), signature(cls)

    @wraps(made)
    def build(first: Any, *args: Any, **options: Any) -> Any:
        refuse_wrong_call(cls.__name__, wanted, args, options)
        return made(first, *args, **options)

    setattr(cls, make, build)
    return cls


def refuse_wrong_call(
    name: str, wanted: Signature, args: Sequence[Any], options: Mapping[str, Any]
) -> None:
    """Compare a call's arguments with what a function's signature and annotations name.

    TypeError for arguments that the signature does not take; or for one of another kind: which,
    what it must be, what it is. ValueError for a number that is none, or of no possible size.
    """
    try:
        wanted.bind_partial(*args, **options)  # an unknown name before one that is missing
        given = wanted.bind(*args, **options)
    except TypeError as error:
        raise TypeError(f"{name}: {error}; it takes {', '.join(wanted.parameters)}") from None
    for key, value in given.arguments.items():
        parameter = given.signature.parameters[key]
        if parameter.kind is Parameter.VAR_KEYWORD or value is parameter.default:
            continue
        kinds = _kinds(parameter.annotation)
        if not any(_fits(value, kind) for kind in kinds):
            right = " or ".join(dict.fromkeys(_said(k) for k in kinds if k is not NoneType))
            what = _a(type(value).__name__)
            if isinstance(value, dict):
                held = dict.fromkeys(type(entry).__name__ for entry in value.values())
                what += f" of {' and '.join(held)}" if held else ""
            pairs = [(type(value).__name__, getattr(k, "__name__", "")) for k in kinds]
            hint = next((f"; {_MAKES[pair]}" for pair in pairs if pair in _MAKES), "")
            raise TypeError(f"{name}: {key} must be {right}, not {what}{hint}")
        if isinstance(value, Real) and value != value:
            raise ValueError(f"{name}: {key} is NaN; it must be a number")
        if key in _POSITIVE and isinstance(value, Real) and not 0.0 < float(value) < inf:
            raise ValueError(f"{name}: {key} is {value:g}; it must be more than 0 and finite")
        if key in _FINITE and isinstance(value, Real) and abs(float(value)) == inf:
            raise ValueError(f"{name}: {key} is {value:g}; it must be finite")
        if key == "limit" and isinstance(value, Real) and value <= 0:
            raise ValueError(f"{name}: limit is {value:g}; it must be more than 0")
        if key == "seed" and value < 0:
            raise ValueError(f"{name}: seed is {value}; it must be 0 or more")


def _kinds(annotation: Any) -> tuple[Any, ...]:
    """Return what an annotation allows, with an array as one of them."""
    kinds = get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    if set(kinds) >= _ARRAY:
        kinds = (ArrayLike, *(k for k in kinds if k not in _ARRAY))
    return kinds


def _fits(value: Any, kind: Any) -> bool:
    origin = get_origin(kind) or kind
    if kind is ArrayLike:
        inner = value[0] if isinstance(value, list | tuple) and value else 0.0
        plain = isinstance(value, Real | Iterable) and not isinstance(value, str | dict)
        return plain and (inner is value or _fits(inner, kind))
    if origin is Literal:
        return value in get_args(kind)
    if origin in _NUMBERS:
        return isinstance(value, _NUMBERS[origin]) or (
            isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf"
        )
    if origin in _LISTS:
        listed: Any = value if isinstance(value, list | tuple) else ()
        if isinstance(value, np.ndarray) and value.ndim:  # all of one kind
            listed = value[:1]
        each = _kinds(get_args(kind)[0])
        inside = all(any(_fits(x, k) for k in each) for x in listed)
        return inside and isinstance(value, Iterable) and not isinstance(value, str | Mapping)
    if origin is dict:
        each = _kinds(get_args(kind)[1])
        return isinstance(value, dict) and all(
            any(_fits(x, k) for k in each) for x in value.values()
        )
    if origin is bool:
        return isinstance(value, bool | np.bool_ | Integral)
    if origin is Any or not isinstance(origin, type):
        return True  # what a name in quotes and `Any` leave open
    return isinstance(value, origin)


def _said(kind: Any) -> str:
    origin = get_origin(kind) or kind
    if origin in (*_LISTS, dict):
        each = " or ".join(k.__name__ for k in _kinds(get_args(kind)[-1]) if k is not Any)
        return _SAID[origin] + (f" of {each}" if each else "")
    if origin is Literal:
        return " or ".join(map(repr, get_args(kind)))
    return _SAID.get(kind) or _SAID.get(origin) or _a(origin.__name__)


def _a(name: str) -> str:
    return f"{'an' if name[0].lower() in 'aeiou' else 'a'} {name}"
