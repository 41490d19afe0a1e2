"""C made from Python functions, compiled and compared with the functions themselves."""

import ctypes
import inspect
import math

import numpy as np
import pytest
from tests.export.native import c_function, compile_c, needs_compiler

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import CATALOGUE, backlash, presliding, stribeck
from dmptm_ctrl.export.tracer import NotScalar
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE

DRAWS = 300
KERNELS = {e.name: e for e in (*CATALOGUE.values(), *(c.effect for c in PLACED_CATALOGUE.values()))}
SIDES = {"side": (0, 1), "body": (0, 1, 2)}
POSITIVE = ("inertia", "age")
OTHER = {
    "gap_position": (backlash.gap_position, backlash.Backlash),
    "mesh_torque": (backlash.mesh_torque, backlash.Backlash),
    "impact_step": (backlash.impact_step, backlash.Backlash),
    "sliding_torque": (stribeck.sliding_torque, stribeck.Stribeck),
    "viscous_torque": (stribeck.viscous_torque, stribeck.Stribeck),
    "build_up_distance": (presliding.build_up_distance, stribeck.Stribeck),
    "bristle_lag": (presliding.bristle_lag, stribeck.Stribeck),
}


def runner(folder, function, known=None, fields=()):
    """C's version of a function, called as (numbers, parameters) -> results."""
    records = {"p": fields} if fields else {}
    text = c_function(function, "f", known=known, records=records)
    call = compile_c(folder, "f", text).f
    pointer = ctypes.POINTER(ctypes.c_double)
    call.restype = None
    call.argtypes = [pointer, pointer, *[pointer] * bool(fields)]

    def run(numbers, parameters=()):
        out = np.full(8, np.nan)
        arrays = [np.array([*row, 0.0], float) for row in (numbers, parameters)]
        given = [arrays[0], out, *arrays[1 : 1 + bool(fields)]]
        call(*(a.ctypes.data_as(pointer) for a in given))
        return out

    return run


def plain(function):
    return getattr(function, "py_func", function)


def parameters_of(effect: Effect, rng):
    """Plausible numbers; of those that choose between laws, any."""
    if effect.values is backlash.Backlash:
        return rng.uniform([1e3, 0.1, 0.01, 0.0], [1e4, 20.0, 1.0, 0.05])
    found = []
    for p in effect.parameters:
        low = p.low if math.isfinite(p.low) else -50.0
        high = p.high if math.isfinite(p.high) else low + 50.0
        found.append(rng.choice(p.bank) if len(p.bank) > 1 else rng.uniform(low, high))
    return found


def places(function):
    names = list(inspect.signature(plain(function)).parameters)
    found = [{}]
    for name in names:
        if name in SIDES:
            found = [{**one, name: k} for one in found for k in SIDES[name]]
    return names, found


def compare(folder, function, fields, draw, rng):
    names, where = places(function)
    differing = 0
    for known in where:
        run = runner(folder, function, known, fields)
        free = [n for n in names if n not in known and n != "p"]
        for _ in range(DRAWS):
            values, p = rng.uniform(-2.0, 2.0, len(free)), draw()
            values[[n in POSITIVE for n in free]] *= np.sign(values[[n in POSITIVE for n in free]])
            arguments = {**known, **dict(zip(free, values, strict=True))}
            expected = plain(function)(**{n: arguments.get(n, p) for n in names})
            expected = np.atleast_1d(expected).astype(float)
            found = run(values, p)[: expected.size]
            scale = 1e-14 * np.abs(expected).max()
            np.testing.assert_allclose(found, expected, rtol=1e-14, atol=scale)
            differing += np.abs(expected).max() > 0
    assert differing > 0  # the premise: the kernel does something


@needs_compiler
@pytest.mark.parametrize("name", KERNELS)
def test_kernels_of_effects(name, tmp_path):
    effect, rng = KERNELS[name], np.random.default_rng(3)
    fields = effect.values._fields
    compare(
        tmp_path, effect.kernel, fields, lambda: effect.values(*parameters_of(effect, rng)), rng
    )


@needs_compiler
@pytest.mark.parametrize("name", OTHER)
def test_kernels_that_the_loop_calls_by_itself(name, tmp_path):
    (function, record), rng = OTHER[name], np.random.default_rng(4)

    def draw():
        if record is backlash.Backlash:
            return record(*rng.uniform([1e3, 0.1, 0.01, 0.0], [1e4, 20.0, 1.0, 0.5]))
        return record(*rng.uniform(0.1, 3.0, len(record._fields)))

    if name in ("build_up_distance", "bristle_lag"):
        names = list(inspect.signature(plain(function)).parameters)
        run = runner(tmp_path, function, fields=record._fields)
        for _ in range(DRAWS):
            values, p = rng.uniform(0.1, 2.0, len(names) - 1), draw()
            expected = plain(function)(*values, p)
            np.testing.assert_allclose(run(values, p)[0], expected, rtol=1e-14)
        return
    compare(tmp_path, function, record._fields, draw, rng)


def swapped(a, b):
    for k in range(9):
        a, b = b, a + k * b
        if b > 1e3:
            b = 1e-3 * b
    return a, b


def early(x, y):
    if x > 0.5:
        if y > 0.0:
            return 1.0 + y
        x = x - 1.0
    elif y < -1.0:
        return 3.0
    return x * y


def logic(x, y):
    inside = -1.0 < x < 1.0 and (y > 0.0 or helper(x, y) > 0.25)
    return (2.0 if inside else 3.0), 1.0 if not inside else x


def helper(x, y):
    if y < -1.5:
        return 0.0
    return abs(x) ** 1.5 + x**2 + x**0


def whole(x, y):
    k = int(abs(x) * 10.0)
    last = math.floor(y * 4.0)
    total = 0
    for i in range(12):
        total += (i + k) % 5 if last > i - 4 else min(i, k)
    return total / 7, last % 3


@needs_compiler
@pytest.mark.parametrize("function", [swapped, early, logic, whole], ids=lambda f: f.__name__)
def test_loops_branches_and_whole_numbers(function, tmp_path):
    run, rng = runner(tmp_path, function), np.random.default_rng(6)
    seen = set()
    for x, y in rng.uniform(-2.0, 2.0, (DRAWS, 2)):
        expected = np.atleast_1d(function(x, y)).astype(float)
        found = run((x, y))[: expected.size]
        np.testing.assert_allclose(found, expected, rtol=1e-14)
        seen.add(round(float(expected[0]), 9))
    assert len(seen) > (1 if function is logic else 10)


def endless(x):
    while x > 1.0:
        x = 0.5 * x
    return x


def lost(x):
    if x > 0.0:
        y = 1.0
    return y


@pytest.mark.parametrize(
    ("function", "message"),
    [(endless, "cannot follow a While"), (lost, "y has no value on every way")],
)
def test_more_than_scalar_arithmetic_is_refused(function, message):
    with pytest.raises(NotScalar, match=message):
        c_function(function, "f")
