"""exp, log, power, sin and cos as short branch-free code, and kernels that use them.

The library's functions are calls: they stop a loop from being vectorised over lanes and cost
as much as the rest of a kernel. These are the textbook reductions (Cody & Waite, Software
Manual for the Elementary Functions, 1980) with Taylor polynomials on the reduced interval;
a test holds them to a few units in the last place. The physics stays as it is written:
:func:`hosted` compiles the same kernel with other names for exp, pow, sin and cos.
"""

import math
from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.core.dispatcher import Dispatcher
from numba.extending import intrinsic
from numba.np.arrayobj import make_array

# A zero's sign is nothing, so x + 0 is x. No a·b + c rounded once but where the text says so: where
# the compiler does it by itself depends on what else it compiles, so that a run with code from the
# disk would be another one than with the same code just compiled, to the last bit, and after the
# next bounce not only there.
FAST = {"nsz"}
_KINDS = {"d": types.float64, "l": types.int64, "B": types.uint8}
OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "nogil": True,
    "forceinline": True,
    "fastmath": FAST,
}
# of what compiled code alone calls: a wrapper for Python is more to compile than a kernel
INNER: dict[str, Any] = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}


def cached(signature: Any = None, **options: Any) -> Callable[[Callable], Any]:
    """Compile with ``numba.njit`` and keep the result on disk, where there is a place to write."""

    def compiled(function: Callable) -> Any:
        try:
            return njit(signature, cache=True, **options)(function)
        except RuntimeError:  # installed read-only, no home: compiled anew in each process
            return njit(signature, **options)(function)

    return compiled


_ROUND = 1.5 * 2.0**52  # adding it rounds to a whole number, in the low bits of the sum
_LOG2_E = 1.4426950408889634
_LN2_HIGH = 0.6931471803691238  # 33 bits of ln 2: its multiples up to 2^20 are exact
_LN2_LOW = 1.9082149292705877e-10
_LEAST, _MOST = -708.0, 709.0  # beyond, a double under- or overflows
_EXP_LEAST, _EXP_MOST = math.exp(_LEAST), math.exp(_MOST)
_ONE_BITS = 1023 << 52
_ROUND_BITS = 0x4338000000000000
_ROOT_HALF_BITS = 0x3FE6A09E667F3BCD  # of the least factor beside a power of two

_TWO_OVER_PI = 0.6366197723675814
_QUARTER_1 = 1.5707963109016418  # π/2 in parts of 25, 29 and 53 bits
_QUARTER_2 = 1.5893254712295857e-08
_QUARTER_3 = 6.123233995736766e-17


def _bits(typingctx, x):
    """Bits of a double as an integer."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], context.get_value_type(types.int64))

    return types.int64(types.float64), codegen


def _double(typingctx, bits):
    """Double of the given bits."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], context.get_value_type(types.float64))

    return types.float64(types.int64), codegen


def _fused(typingctx, a, b, c):
    """a·b + c, rounded once; one instruction of most CPUs."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), codegen


# numba passes the typing context by itself
bits: Callable[[float], int] = intrinsic(_bits)  # type: ignore[assignment]
double: Callable[[int], float] = intrinsic(_double)  # type: ignore[assignment]
fused: Callable[[float, float, float], float] = intrinsic(_fused)  # type: ignore[assignment]


def _wide(typingctx):
    """Nothing but a mark on the function that calls it: prefer 512-bit vectors."""

    def codegen(context, builder, signature, args):
        # a set of strings; its `add` knows only attributes without a value
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.none(), codegen


wide: Callable[[], None] = intrinsic(_wide)  # type: ignore[assignment]


def _borrowed(typingctx, array):
    """Array whose references nobody counts."""

    def codegen(context, builder, signature, args):
        made = make_array(signature.return_type)
        given, lent = made(context, builder, args[0]), made(context, builder)
        for name in ("parent", "nitems", "itemsize", "data", "shape", "strides"):
            setattr(lent, name, getattr(given, name))
        lent.meminfo = cgutils.get_null_value(lent.meminfo.type)
        return lent._getvalue()

    return array(array), codegen


def _arrays_at(typingctx, table, kinds):
    """Where arrays are whose addresses a table has, as a tuple; a letter says what is in each."""
    types_ = [types.CPointer(_KINDS[letter]) for letter in kinds.literal_value]

    def codegen(context, builder, signature, args):
        items = [
            builder.inttoptr(
                builder.load(builder.gep(args[0], [context.get_constant(types.intp, i)])),
                context.get_value_type(kind),
            )
            for i, kind in enumerate(types_)
        ]
        return context.make_tuple(builder, signature.return_type, items)

    return types.Tuple(types_)(table, kinds), codegen


def _spread(typingctx, array, count, first):
    """So many numbers of a pointer, as a tuple."""

    def codegen(context, builder, signature, args):
        data = builder.gep(args[0], [args[2]])
        items = [
            builder.load(builder.gep(data, [context.get_constant(types.intp, i)]))
            for i in range(count.literal_value)
        ]
        return context.make_tuple(builder, signature.return_type, items)

    return types.UniTuple(types.float64, count.literal_value)(array, count, types.intp), codegen


def _gather(typingctx, array, items, first):
    """Write a tuple of doubles behind a pointer."""

    def codegen(context, builder, signature, args):
        data = builder.gep(args[0], [args[2]])
        for i, item in enumerate(cgutils.unpack_tuple(builder, args[1])):
            builder.store(item, builder.gep(data, [context.get_constant(types.intp, i)]))
        return context.get_dummy_value()

    doubles = types.UniTuple(types.float64, len(items))
    return types.none(array, doubles, types.intp), codegen


def _called_at(typingctx, address, given):
    """Call the function of an address with a tuple, of arrays with where their numbers are."""

    def codegen(context, builder, signature, args):
        items = [
            make_array(kind)(context, builder, one).data if isinstance(kind, types.Array) else one
            for kind, one in zip(given, cgutils.unpack_tuple(builder, args[1]), strict=True)
        ]
        # as numba calls a function: first where to put its result and an exception, of which
        # there is none
        slots = [cgutils.alloca_once(builder, ir.IntType(8).as_pointer()) for _ in range(2)]
        called = ir.FunctionType(ir.IntType(32), [one.type for one in (*slots, *items)])
        builder.call(builder.inttoptr(args[0], called.as_pointer()), [*slots, *items])
        return context.get_dummy_value()

    return types.none(types.int64, given), codegen


def _behind(typingctx, array, count):
    """What follows so many numbers of what a pointer points to."""

    def codegen(context, builder, signature, args):
        return builder.gep(args[0], [args[1]])

    return array(array, types.intp), codegen


behind: Callable[[Any, int], Any] = intrinsic(_behind)  # type: ignore[assignment]
called_at: Callable[[Any, tuple[Any, ...]], None] = intrinsic(_called_at)  # type: ignore[assignment]
arrays_at: Any = intrinsic(prefer_literal=True)(_arrays_at)
spread: Any = intrinsic(prefer_literal=True)(_spread)
gather: Callable[..., None] = intrinsic(_gather)

# The caller keeps the array for as long as it is lent: it is an argument, for one that is made in
# the function itself is freed after its last use, which lending it may be. Each function that is
# given an array counts itself among its users, and off again, which as atomic operations takes as
# long as one of the loops over lanes.
borrowed: Callable[[Any], Any] = intrinsic(_borrowed)  # type: ignore[assignment]


@njit(**OPTIONS)
def exp(x):
    """Exponential; held at its value for −708 and 709 beyond, so never subnormal or infinite."""
    shifted = fused(x, _LOG2_E, _ROUND)
    whole = shifted - _ROUND
    r = fused(-whole, _LN2_LOW, fused(-whole, _LN2_HIGH, x))
    r2 = r * r
    r4 = r2 * r2
    low = fused(r2, fused(r, 1.0 / 6.0, 0.5), r)
    middle = fused(r2, fused(r, 1.0 / 5040.0, 1.0 / 720.0), fused(r, 1.0 / 120.0, 1.0 / 24.0))
    high = fused(r, 1.0 / 362880.0, 1.0 / 40320.0)
    high = fused(r2, fused(r, 1.0 / 39916800.0, 1.0 / 3628800.0), high)
    beyond_1 = fused(r4 * r4, fused(r4, 1.0 / 479001600.0, high), fused(r4, middle, low))
    power = double((bits(shifted) << 52) + _ONE_BITS)
    value = fused(power, beyond_1, power)
    if x < _LEAST:
        value = _EXP_LEAST
    if x > _MOST:
        value = _EXP_MOST
    return value


@njit(**OPTIONS)
def log(x):
    """Natural logarithm of a number that is positive and not subnormal; about −709 of zero."""
    whole = (bits(x) - _ROOT_HALF_BITS) >> 52
    factor = double(bits(x) - (whole << 52))
    s = (factor - 1.0) / (factor + 1.0)
    z = s * s
    z2 = z * z
    low = fused(z2, fused(z, 2.0 / 9.0, 2.0 / 7.0), fused(z, 2.0 / 5.0, 2.0 / 3.0))
    high = fused(z2, fused(z, 2.0 / 17.0, 2.0 / 15.0), fused(z, 2.0 / 13.0, 2.0 / 11.0))
    high = fused(z2 * z2, 2.0 / 19.0, high)
    power = double(_ROUND_BITS + whole) - _ROUND
    part = fused(power, _LN2_LOW, s * z * fused(z2 * z2, high, low))
    return fused(power, _LN2_HIGH, fused(2.0, s, part))


@njit(**OPTIONS)
def power(x, y):
    """Power of a number that is not below zero; -0.0 counts as zero."""
    return exp(y * log(abs(x)))


@njit(**OPTIONS)
def _quarters(x):
    """Quarter turns in x, as bits, and what is left of it."""
    shifted = fused(x, _TWO_OVER_PI, _ROUND)
    whole = shifted - _ROUND
    r = fused(-whole, _QUARTER_2, fused(-whole, _QUARTER_1, x))
    r = fused(-whole, _QUARTER_3, r)
    return bits(shifted), r


@njit(**OPTIONS)
def _sine(r):
    r2 = r * r
    r4 = r2 * r2
    low = fused(r2, 1.0 / 120.0, -1.0 / 6.0)
    middle = fused(r2, 1.0 / 362880.0, -1.0 / 5040.0)
    high = fused(r2, 1.0 / 6227020800.0, -1.0 / 39916800.0)
    high = fused(r4, -1.0 / 1307674368000.0, high)
    return fused(r * r2, fused(r4, fused(r4, high, middle), low), r)


@njit(**OPTIONS)
def _cosine(r):
    r2 = r * r
    r4 = r2 * r2
    low = fused(r2, 1.0 / 24.0, -0.5)
    middle = fused(r2, 1.0 / 40320.0, -1.0 / 720.0)
    high = fused(r2, 1.0 / 479001600.0, -1.0 / 3628800.0)
    top = fused(r2, 1.0 / 20922789888000.0, -1.0 / 87178291200.0)
    return fused(r2, fused(r4, fused(r4, fused(r4, top, high), middle), low), 1.0)


@njit(**OPTIONS)
def sin(x):
    """Sine, good to rounding of x up to 10^8 rad."""
    quarters, r = _quarters(x)
    value = _cosine(r) if quarters & 1 else _sine(r)
    return -value if quarters & 2 else value


@njit(**OPTIONS)
def cos(x):
    """Cosine, good to rounding of x up to 10^8 rad."""
    quarters, r = _quarters(x)
    value = _sine(r) if quarters & 1 else _cosine(r)
    return -value if (quarters + 1) & 2 else value


COMPILED = isinstance(exp, Dispatcher)  # false where numba is switched off
if not COMPILED:
    wide = type(None)  # nothing to mark

    def borrowed(array):
        """Nothing is counted."""
        return array

    def arrays_at(table, kinds):
        """Arrays of a table."""
        return tuple(table)

    def behind(array, count):
        """What follows so many numbers."""
        return array[count:]

    def called_at(function, given):
        """Call a function."""
        function(*given)

    def spread(array, count, first):
        """So many numbers of an array."""
        return tuple(array[first : first + count])

    def gather(array, items, first):
        """Write a tuple to an array."""
        array[first : first + len(items)] = items


@cache
def address_of(callback: Any) -> Any:
    """Address of what `compiled_callback` gave, for `called_at`."""
    if not COMPILED:
        return callback
    (made,) = callback.overloads.values()
    return made.library.get_pointer_to_function(made.fndesc.llvm_func_name)


def table_of(*arrays: Any) -> Any:
    """Table of arrays as `arrays_at` takes it; they are not kept."""
    if not COMPILED:
        return arrays
    return np.array([a.__array_interface__["data"][0] for a in arrays], np.int64)


def compiled_callback(
    signature: Any, function: Callable[..., None], *, cache: bool = False, **options: Any
) -> Any:
    """Compile what compiled loops are given to call; `cache` it where there is a place."""
    if not COMPILED:
        return function
    made: Any = cached if cache else njit
    return made(signature, **options, **INNER)(function)


_INSTEAD: dict[Any, Any] = {math.exp: exp, math.pow: power, math.sin: sin, math.cos: cos}


@cache
def hosted(
    kernel: Callable[..., Any], *instead: tuple[Callable[..., Any], Callable[..., Any]]
) -> Callable[..., Any]:
    """Return a kernel compiled inline with this module's functions.

    Kernels that it calls are treated alike, of pairs `instead` the second for the first. It can be
    called from compiled code only. A kernel that is not numba's, or numba switched off, gives the
    kernel itself.
    """
    if not isinstance(kernel, Dispatcher):
        return kernel
    function = kernel.py_func
    names = dict(function.__globals__)
    for name in function.__code__.co_names:
        found = names.get(name)
        if isinstance(found, Dispatcher):
            names[name] = hosted(dict(instead).get(found, found), *instead)
        elif callable(found) and found in _INSTEAD:
            names[name] = _INSTEAD[found]
    return njit(**OPTIONS, **INNER)(_copy(function, names))


def _copy(function: FunctionType, names: dict[str, Any]) -> FunctionType:
    """Return a function that finds other things under the names of its module."""
    return FunctionType(
        function.__code__, names, function.__name__, function.__defaults__, function.__closure__
    )


@cache
def called(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the same kernel, not inline: many of which few are in use compile faster so."""
    inline = hosted(kernel)
    if inline is kernel:
        return kernel
    options = {**OPTIONS, **INNER, "forceinline": False}
    function = inline.py_func  # type: ignore[attr-defined]
    return njit(**options)(_copy(function, function.__globals__))
