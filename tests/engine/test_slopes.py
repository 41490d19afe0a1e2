"""Slopes written from kernels' source: against differences, and what has none goes another way."""

import linecache
import math
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numba import njit

from dmptm_ctrl.contract import Effect, Parameter
from dmptm_ctrl.effects import CATALOGUE, register
from dmptm_ctrl.effects.stribeck import Stribeck, stribeck_law
from dmptm_ctrl.simulate import (
    compose,
    core,
    row_step_core,
    sensitivity,
    simulate_with_sensitivities,
)
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.slope_chains import CHAINS, deciding_fields, effect_slopes
from dmptm_ctrl.simulate.slope_text import NoSlopes
from dmptm_ctrl.simulate.slopes import Library

DT = 1e-3  # s
ULP = 1.0 + np.finfo(float).eps
ROUNDINGS = 8.0  # of its arguments, by which two texts of a kernel may differ
NAMES = {name: getattr(math, name) for name in ("sin", "cos", "exp", "log", "sqrt", "floor")}
# Largest values of motion that are tried: V, rad, rad/s, N·m, s
SIZES = {"u": 10.0, "theta": 7.0, "omega": 3.0, "mesh": 50.0, "age": 5.0, "t": 8.0}
SMOOTH = {name: effect for name, effect in CATALOGUE.items() if effect.site in CHAINS}


def between(low, high, count=997):
    """Numbers that are no closer to a corner by chance than differences reach."""
    return st.integers(0, count).map(lambda k: low + (high - low) * (k + 0.37) / (count + 1))


def plain(function):
    """Kernel as Python has it."""
    return getattr(function, "py_func", function)


def written(library, slopes):
    """Function of the text that is written."""
    names = NAMES | {"njit": lambda f: f}
    exec(library.text(), names)
    return names[slopes.name]


def rows(result):
    return np.atleast_1d(np.array(result, float))


def agree(f, found, slope, x, step, rounded=0.0):
    """Whether a slope is that of a function at x, or the function has a corner near.

    `rounded` is what a rounding of its arguments makes of the function.
    """
    ahead, back, here = (rows(f(x + s)) for s in (step, -step, 0.0))
    np.testing.assert_allclose(here, found, rtol=1e-10, atol=1e-10 + ROUNDINGS * rounded)
    forward, backward = (ahead - here) / step, (here - back) / step
    size = np.abs(forward) + np.abs(backward)
    rounding = 1e-14 * (np.abs(here) + np.abs(x) * size + 1.0) / step
    curved = np.abs(forward - backward) > 1e-3 * size + 10.0 * rounding
    if not curved.any():
        both = 0.5 * (forward + backward)
        np.testing.assert_allclose(slope, both, rtol=1e-4, atol=np.max(10.0 * rounding))


@pytest.mark.parametrize("effect", SMOOTH.values(), ids=SMOOTH)
@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_kernels_of_the_catalogue(effect, data):
    library, kernel, chain = Library(), plain(effect.kernel), CHAINS[effect.site]
    slopes = effect_slopes(effect, library)
    function, args = written(library, slopes), chain.args.split(", ")
    place = {}
    for name in args:
        if name in ("side", "body"):
            place[name] = data.draw(st.integers(0, 1 if name == "side" else 2))
        else:
            size = SIZES[name.split("_")[0]]
            place[name] = data.draw(between(0.01 if name in ("age", "t") else -size, size))
    numbers = [
        data.draw(st.sampled_from(p.bank) if p.bank else between(p.low, min(p.high, 1e3)))
        for p in effect.parameters
    ]
    kept = ([*numbers[:1], *numbers], 1) if slopes.looked_in else ()
    c, e, q, places, looked, sure = function(*place.values(), effect.values(*numbers), *kept)
    assume(sure)
    outputs = len(c)

    def called(**instead):
        return rows(kernel(*(place | instead).values(), effect.values(*numbers)))

    # a table over the time in a short period is so steep that a rounding of the time shows
    floats = {name: x for name, x in place.items() if isinstance(x, float)}
    shifts = (np.max(np.abs(called(**{n: x * ULP}) - called())) for n, x in floats.items())
    rounded = max(shifts, default=0.0)
    for k, name in enumerate(chain.motion):
        step = 1e-6 * SIZES[name.split("_")[0]]
        motion = np.array(e).reshape(outputs, -1)[:, k]
        agree(lambda x, name=name: called(**{name: x}), c, motion, place[name], step, rounded)
    own = np.zeros((outputs, len(numbers)))
    for k, (_, at) in enumerate(slopes.fields):
        own[:, at] += np.array(q).reshape(outputs, -1)[:, k]
    for k, at in enumerate(places):
        own[:, at] += np.array(looked).reshape(outputs, -1)[:, k]
    for k, p in enumerate(effect.parameters):
        if k in deciding_fields(effect):
            continue

        def moved(x, k=k):
            return kernel(*place.values(), effect.values(*numbers[:k], x, *numbers[k + 1 :]))

        agree(moved, c, own[:, k], numbers[k], 1e-5 * p.step, rounded)


LAW = (30.0, 20.0, 0.05, 8.0, 28.0, 19.0, 0.04, 9.0, 1.0)


@settings(max_examples=100, deadline=None)
@given(
    v=between(-0.5, 0.5),
    more=between(-0.01, 0.01),
    bristle=between(-40.0, 40.0),
    level=between(0.5, 1.5),
    distance=between(1e-5, 1e-2),
)
def test_presliding(v, more, bristle, level, distance):
    """Of a record by name, and of one by place."""
    motion = ("v", "v_mid", "force", "mobility", "scale", "added", "bristle")
    library, records = Library(), {"law": Stribeck._fields, "bristles": ("a", "b", "c")}
    still = [("law", "exponent")]
    slopes = library.of(core.preslide, motion, records, still=still)
    args = {"v": v, "v_mid": v + more, "force": 12.0, "mobility": 1e-4, "h": 1.25e-4}
    args |= {"law": stribeck_law(*LAW), "scale": level, "added": 1.5}
    args |= {"bristles": (distance, 0.3, 2e-4), "bristle": bristle}
    c, e, q, _, _, sure = written(library, slopes)(*args.values())
    assume(sure)
    f = plain(core.preslide)
    steps = {"v": 1e-6, "v_mid": 1e-6, "mobility": 1e-8}
    for k, name in enumerate(motion):
        agree(
            lambda x, name=name: f(*(args | {name: x}).values()),
            *(c, np.array(e).reshape(2, -1)[:, k], args[name], steps.get(name, 1e-5)),
        )
    for k, (record, at) in enumerate(slopes.fields):

        def moved(x, record=record, at=at):
            parts = [*args[record]]
            parts[at] = x
            whole = Stribeck(*parts) if record == "law" else tuple(parts)
            return f(*(args | {record: whole}).values())

        value = args[record][at]
        agree(moved, c, np.array(q).reshape(2, -1)[:, k], value, 1e-6 * abs(value))


@pytest.mark.parametrize(
    ("function", "motion", "values"),
    [
        (core.aged, ("age", "v", "slip"), (0.3, -0.02, 1e-3, 1e-3)),
        (row_step_core.lagged, ("aim", "tau", "kept"), (1.2, 3e-3, -0.4, 1.25e-4)),
        (row_step_core.toothed, ("x", "k_a", "z_3", "phi_r"), (0.7, 3e4, 20.0, 0.3)),
    ],
)
def test_what_the_loops_know_themselves(function, motion, values):
    library, f = Library(), plain(function)
    slopes = library.of(function, motion, {})
    names = f.__code__.co_varnames[: f.__code__.co_argcount]
    args = dict(zip(names, values, strict=True))
    c, e, _, _, _, sure = written(library, slopes)(*values)
    assert sure
    for k, name in enumerate(motion):
        slope = np.array(e).reshape(len(c), -1)[:, k]
        x = args[name]
        agree(lambda x, name=name: f(*(args | {name: x}).values()), c, slope, x, 1e-6 * abs(x))


def looping(u, t, side, p):
    while u > 1.0:
        u -= p.step
    return u


def spoken(u, t, side, p):
    return u + p.table.sum()


def unfinished(u, t, side, p):
    if u > 0.0:
        return u


def absent(u, t, side, p):
    return u + p.nothing


def endless(u, t, side, p):
    return endless(u, t, side, p)


NOT_COVERED = [looping, spoken, unfinished, absent, endless, lambda u, t, side, p: u, abs]


@pytest.mark.parametrize("function", NOT_COVERED)
def test_says_what_it_does_not_cover(function):
    with pytest.raises(NoSlopes):
        Library().of(function, ["u"], {"p": ["step", "table"]})


def test_no_branch_is_sure_on_a_corner():
    for name, u, sure in (("drive_dead_band", 0.1, False), ("drive_dead_band", 0.2, True)):
        library, effect = Library(), CATALOGUE[name]
        function = written(library, effect_slopes(effect, library))
        assert function(u, 0.0, 0, effect.values(0.1))[5] == sure


class Spring(NamedTuple):
    stiffness: float


def own(kernel):
    return Effect(
        name="own_spring",
        site="load",
        kernel=kernel,
        parameters=(Parameter("stiffness", "N·m/rad", 0.0, 1e3, 1.0),),
        values=Spring,
        location="",
        source="",
        depends_on=("theta_L",),
        reveals="",
    )


@pytest.fixture
def taken_back():
    yield
    CATALOGUE.pop("own_spring", None)


SOURCE = "def cubic(angle, speed, now, q):\n    return -q.stiffness * angle**3\n"


@pytest.mark.parametrize("kept", [True, False])
@pytest.mark.usefixtures("taken_back")
def test_a_user_s_effect_goes_along_where_its_source_is_kept(kept):
    """Names of arguments are the user's; without its source each change is a run of its own."""
    names = {}
    file = f"<cell {kept}>"
    if kept:
        linecache.cache[file] = (len(SOURCE), None, SOURCE.splitlines(keepends=True), file)
    exec(compile(SOURCE, file, "exec"), names)
    register(own(njit(names["cubic"])))
    model = Model().with_effect("own_spring", stiffness=3.0)
    arrays = model.arrays()
    place = sensitivity._place(model, "own_spring.stiffness", arrays[2])
    way = sensitivity._way(arrays, [place])
    assert way is (sensitivity._by_kernels if kept else None)
    assert ("def cubic_slopes_" in compose.source()) == kept


def side_by_side(model, names, monkeypatch, u):
    """Derivatives along a run, and of whole runs by lanes; and where both exist."""
    time = DT * np.arange(u.shape[1])
    places = [sensitivity._place(model, name, model.arrays()[2]) for name in names]
    assert sensitivity._way(model.arrays(), places) is sensitivity._by_kernels
    found = simulate_with_sensitivities(model, time, u, names)
    with monkeypatch.context() as patched:
        patched.setattr(sensitivity, "_way", lambda *_: None)
        other = simulate_with_sensitivities(model, time, u, names)
    steps = np.array([place.step for place in places])
    scale = np.ptp(other.outputs, axis=1)
    size = np.sqrt(np.mean(other.derivatives**2, axis=2))
    apart = np.sqrt(np.mean((found.derivatives - other.derivatives) ** 2, axis=2))
    rounding = 1e-11 * scale / steps[:, None]  # of whole runs, whose differences `other` are
    assert np.all(apart < 2e-3 * size + rounding), (names, apart / size)
    assert found.exists.mean() > 0.99


TOGETHER = {
    "drives": (
        {
            "drive_offset": {"left": 0.05, "right": -0.03},
            "torque_constant_mismatch": {"error": 0.1},
            "drive_dead_band": {"width": 0.02},
            "drive_saturation": {"inverse_limit": 1.3},
            "current_lag": {"time_constant": 0.002},
            "drive_delay": {"delay": 0.00213},
        },
        ("drive_offset.left", "torque_constant_mismatch.error", "drive_dead_band.width"),
        ("drive_saturation.inverse_limit", "current_lag.time_constant", "drive_delay.delay"),
    ),
    "motors and meshes": (
        {
            "cogging": {"left_cosine": 0.01, "right_sine": 0.01, "order": 24.0},
            "back_emf": {"damping": 4e-4},
            "pinion_runout": {"left_cosine": 2e-4, "right_sine": 1e-4},
            "ring_gear_eccentricity": {"cosine": 2e-4},
            "mesh_error": {"left_sine": 3e-5},
            "backlash_variation": {"cosine": 2e-4, "apart_sine": 1e-4},
        },
        ("cogging.order", "back_emf.damping", "pinion_runout.right_sine", "k_a", "phi_r"),
        ("ring_gear_eccentricity.cosine", "mesh_error.left_sine", "backlash_variation.apart_sine"),
    ),
    "frictions and loads": (
        {
            "thermal_drift": {"rise": 0.3, "ring_extra": 0.1, "time_constant": 0.7},
            "load_dependent_friction": {"coefficient": 0.05},
            "local_spot": {"height": 4.0, "place": 0.01, "width": 0.06},
            "position_dependent_friction": {"cosine": 2.0, "sine": 1.0, "order": 2.0},
            "unbalance": {"cosine": 5.0, "sine": 3.0},
            "quadratic_drag": {"coefficient": 9.0},
        },
        ("thermal_drift.rise", "thermal_drift.time_constant", "local_spot.width", "TLc_plus"),
        ("load_dependent_friction.coefficient", "position_dependent_friction.order", "gap_l"),
    ),
    "soft reducers that slip": (
        {
            "reducer_compliance": {"compliance": 3e-5, "damping": 0.05},
            "presliding": {"reducer_distance": 1e-3, "ring_distance": 2e-4, "damping": 0.2},
            "thermal_drift": {"rise": 0.3, "ring_extra": 0.1, "time_constant": 0.7},
        },
        ("reducer_compliance.damping", "presliding.ring_distance"),
        ("thermal_drift.rise", "presliding.viscous_at_once"),
        ("TLs_plus", "J_m"),
    ),
    "soft reducers that age": (
        {
            "reducer_compliance": {"compliance": 3e-5, "damping": 0.05},
            "unknown_breakaway": {"rise": 4.0, "time": 0.01, "slip": 2e-4},
            "load_dependent_friction": {"coefficient": 0.05},
        },
        ("unknown_breakaway.time", "TLs_plus"),
        ("unknown_breakaway.slip", "J_m"),
    ),
}


@pytest.mark.parametrize("case", TOGETHER)
def test_effects_together_agree_with_whole_runs(case, monkeypatch):
    """What one effect gives is what the next one takes, and slopes with it."""
    effects, *several = TOGETHER[case]
    model = Model().with_values(k_a=4e3, phi_r=0.4)
    for name, values in effects.items():
        model = model.with_effect(name, **values)
    time = DT * np.arange(301)
    u = 0.9 * np.sin(2 * np.pi * 4.0 * time) + np.array([[0.25], [-0.25]])
    for names in several:
        side_by_side(model, names, monkeypatch, u)
