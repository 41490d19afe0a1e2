"""What is left of a calculation once its known numbers are put in: scalars, branches, loops.

One description for all printers. Values are Python numbers, or expressions over names. Kinds
of values are "real", "wide", "int" and "bool". A wide number is a double in every program: angles
far from zero, time and integrals lose in a float what the rest of the program needs.
"""

import math
import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

REAL, WIDE, INT, BOOL = "real", "wide", "int", "bool"


@dataclass(frozen=True)
class Name:
    """A scalar variable; `counts` where it is a whole number that is never negative."""

    id: str
    kind: str = REAL
    counts: bool = False


@dataclass(frozen=True)
class Array:
    """A row of numbers that is read at a place known only when the program runs."""

    id: str
    size: int
    values: tuple[float, ...] | None = None  # of a constant table
    fields: tuple[str, ...] = ()  # names of the elements, where it stands for a NamedTuple


@dataclass(frozen=True)
class Item:
    """An element of an array."""

    array: Array
    index: Any
    kind: str = REAL


@dataclass(frozen=True)
class Op:
    """An operation; `op` is its sign, or the name of a function of one or two arguments."""

    op: str
    args: tuple[Any, ...]
    kind: str = REAL


@dataclass
class Assign:
    """Give a name its value, or only declare it where that is None; `declare` if it is new."""

    name: Name
    value: Any
    declare: bool = True


@dataclass
class Store:
    """Put a value into an array."""

    array: Array
    index: Any
    value: Any


@dataclass
class If:
    """Either, or."""

    condition: Any
    body: list[Any]
    orelse: list[Any]


@dataclass
class For:
    """Repeat `count` times, counted by `name` from 0."""

    name: Name
    count: Any
    body: list[Any]


@dataclass(frozen=True)
class Port:
    """An input or output: name, unit, what it is."""

    name: str
    unit: str
    text: str
    kind: str = REAL


@dataclass
class Program:
    """A step that is called once per sample time."""

    name: str
    inputs: list[Port]
    outputs: list[Port]
    results: list[Any]  # value of each output after the step
    state: list[tuple[Name, Any]]  # scalars kept, and what they start from
    body: list[Any]
    after: list[tuple[Name, Any]]  # what the state becomes at the end of the step
    # kept, and what all elements start from
    arrays: list[tuple[Array, float]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # comment lines for the head

    def tables(self) -> list[Array]:
        """Return the constant tables that the program reads."""
        found = {}
        after = [value for _, value in self.after]
        for value in (*values_of(self.body), *self.results, *after):
            for part in walk(value):
                if isinstance(part, Item) and part.array.values is not None:
                    found[part.array.id] = part.array
        return list(found.values())


def kind_of(value: Any) -> str:
    """Kind of a value."""
    if isinstance(value, bool):
        return BOOL
    if isinstance(value, int):
        return INT
    return REAL if isinstance(value, float) else value.kind


def known(value: Any) -> bool:
    """Whether a value is a number."""
    return isinstance(value, int | float)


def walk(value: Any) -> Iterator[Any]:
    """Iterate over an expression and its parts."""
    yield value
    if isinstance(value, Op):
        for part in value.args:
            yield from walk(part)
    elif isinstance(value, Item):
        yield from walk(value.index)


def values_of(block: list[Any]) -> Iterator[Any]:
    """Iterate over the expressions of a block, those inside its branches and loops included."""
    for item in block:
        if isinstance(item, Assign):
            if item.value is not None:
                yield item.value
        elif isinstance(item, Store):
            yield from (item.index, item.value)
        elif isinstance(item, If):
            yield item.condition
            yield from values_of(item.body)
            yield from values_of(item.orelse)
        else:
            yield item.count
            yield from values_of(item.body)


_FOLDED: dict[str, Callable[..., Any]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "<": operator.lt,
    "<=": operator.le, ">": operator.gt, ">=": operator.ge, "==": operator.eq,
    "!=": operator.ne, "and": lambda a, b: a and b, "or": lambda a, b: a or b,
    "not": operator.not_, "neg": operator.neg, "min": min, "max": max, "abs": abs,
    "exp": math.exp, "log": math.log, "sin": math.sin, "cos": math.cos, "tan": math.tan,
    "sqrt": math.sqrt, "tanh": math.tanh, "floor": math.floor, "trunc": int, "real": float,
    "pow": operator.pow, "mod": operator.mod, "wide": float,
}  # fmt: skip
FUNCTIONS = ("exp", "log", "sin", "cos", "tan", "sqrt", "tanh", "floor")
_COMPARED = ("<", "<=", ">", ">=", "==", "!=")
_OF_ITS_ARGUMENTS = ("+", "-", "*", "neg", "min", "max", "abs", "mod")
_LOGIC = (*_COMPARED, "and", "or", "not")
FOREVER = 2**62  # an index is always below


def make(op: str, *args: Any) -> Any:
    """Return an operation's result: a number where it can be computed, else an expression."""
    if op == "/":
        return _quotient(*args)
    if all(known(a) for a in args):
        return _FOLDED[op](*args)
    if op in ("real", "wide"):
        return _as_real(op, args[0])
    simple = _simple(op, *args)
    if simple is not None:
        return simple
    if op in _LOGIC:
        kind = BOOL
    elif op in ("floor", "trunc"):
        kind = INT
    elif op in _OF_ITS_ARGUMENTS:
        kind = widest(args)
    else:
        kind = REAL
    if kind in (REAL, WIDE) or (op in _COMPARED and widest(args) in (REAL, WIDE)):
        to = "wide" if widest(args) == WIDE else "real"
        args = tuple(make(to, a) if kind_of(a) == INT else a for a in args)
        kind = widest(args) if op in _OF_ITS_ARGUMENTS else kind
    return Op(op, args, kind)


def widest(values: Iterable[Any]) -> str:
    """Kind of a sum of values."""
    kinds = {kind_of(value) for value in values}
    return next(kind for kind in (WIDE, REAL, INT, BOOL) if kind in kinds)


def _as_real(to: str, value: Any) -> Any:
    """Return a value that is no whole number; a count is wide, for a float soon skips some."""
    kind = kind_of(value)
    if kind == WIDE or (kind == REAL and to == "real"):
        return value
    wide = to == "wide" or (isinstance(value, Name) and value.counts)
    wide = wide or (isinstance(value, Op) and kind_of(value.args[0]) == WIDE)
    return Op("real", (value,), WIDE if wide else REAL)


def _quotient(a: Any, b: Any) -> Any:
    a, b = make("real", a), make("real", b)
    if known(a) and known(b):
        if b == 0.0:
            return math.nan if a == 0.0 or math.isnan(a) else math.copysign(math.inf, a)
        return a / b
    if b == 1.0 or (known(a) and a == 0.0):
        return a
    return Op("/", (a, b), widest((a, b)))


def _simple(op: str, a: Any, b: Any = None) -> Any:
    """Result of an operation with a neutral element; None if it has none."""
    if op == "+":
        return b if _is(a, 0) else a if _is(b, 0) else None
    if op == "-":
        if _is(a, 0):
            return make("neg", b)
        return a if _is(b, 0) else 0.0 if a == b and kind_of(a) in (REAL, WIDE) else None
    if op == "*":
        if _is(a, 0) or _is(b, 0):
            return 0 if kind_of(a) == kind_of(b) == INT else 0.0
        return b if _is(a, 1) else a if _is(b, 1) else None
    if op == "mod" and _is(b, 1):
        return 0
    if op in ("min", "max"):
        beyond = math.inf if op == "min" else -math.inf
        return a if known(b) and b == beyond else b if known(a) and a == beyond else None
    if op == "neg" and isinstance(a, Op) and a.op == "neg":
        return a.args[0]
    if op in ("and", "or"):
        neutral = op == "and"
        for one, other in ((a, b), (b, a)):
            if known(one):
                return other if bool(one) is neutral else not neutral
    if op == "<" and isinstance(a, Name) and a.counts and known(b) and b <= 0:
        return False
    if op == "<" and known(b) and b >= FOREVER and kind_of(a) == INT:
        return True
    return None


def _is(value: Any, number: int) -> bool:
    return known(value) and not isinstance(value, bool) and value == number


def prune(program: Program) -> Program:
    """Return the program without what no output depends on."""
    live, arrays = _names(program.results)
    before = -1
    while before != len(live) + len(arrays):
        before = len(live) + len(arrays)
        needed = [*_needed(program.body, [], live, arrays)]
        needed += [value for name, value in program.after if name.id in live]
        for found, into in zip(_names(needed), (live, arrays), strict=True):
            into |= found
    return replace(
        program,
        state=[(name, first) for name, first in program.state if name.id in live],
        body=_pruned(program.body, live, arrays),
        after=[(name, value) for name, value in program.after if name.id in live],
        arrays=[(a, first) for a, first in program.arrays if a.id in arrays],
    )


def _needed(block: list[Any], around: list[Any], live: set[str], arrays: set[str]) -> Iterator[Any]:
    """Expressions on which live names depend, the conditions `around` them included."""
    for item in block:
        if isinstance(item, Assign):
            if item.name.id in live and item.value is not None:
                yield from (item.value, *around)
        elif isinstance(item, Store):
            if item.array.id in arrays:
                yield from (item.index, item.value, *around)
        elif isinstance(item, If):
            for side in (item.body, item.orelse):
                yield from _needed(side, [*around, item.condition], live, arrays)
        else:
            yield from _needed(item.body, [*around, item.count], live, arrays)


def _names(values: Iterable[Any]) -> tuple[set[str], set[str]]:
    """Names, and arrays, that occur in expressions."""
    parts = [part for value in values for part in walk(value)]
    return (
        {part.id for part in parts if isinstance(part, Name)},
        {part.array.id for part in parts if isinstance(part, Item)},
    )


def _pruned(block: list[Any], read: set[str], arrays: set[str]) -> list[Any]:
    kept: list[Any] = []
    for item in block:
        if isinstance(item, Assign):
            if item.name.id in read:
                kept.append(item)
        elif isinstance(item, Store):
            if item.array.id in arrays:
                kept.append(item)
        elif isinstance(item, If):
            body, orelse = (_pruned(b, read, arrays) for b in (item.body, item.orelse))
            if not body and orelse:
                body, orelse = orelse, body
                item = If(make("not", item.condition), body, orelse)
            if body:
                kept.append(If(item.condition, body, orelse))
        else:
            body = _pruned(item.body, read, arrays)
            if body:
                kept.append(For(item.name, item.count, body))
    return kept


_PLAIN = {
    "−": "-", "←": "<-", "·": "*", "×": "x", "²": "^2", "±": "+-", "θ": "theta", "ω": "omega",
    "*/": "* /", "/*": "/ *", "(*": "( *", "*)": "* )",
}  # fmt: skip


def ascii_text(text: str) -> str:
    """Text of a comment as compilers and PLCs of any age read it: one line that ends no comment."""
    for sign, plain in _PLAIN.items():
        text = text.replace(sign, plain)
    plain = text.encode("ascii", "replace").decode()
    return "".join(c if c.isprintable() else " " for c in plain)
