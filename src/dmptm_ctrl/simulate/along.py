"""Kernels along recorded signals: torques, friction and inputs sample by sample."""

from functools import cache
from types import ModuleType

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import lookup
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.loading import key_of, load
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import Floats
from dmptm_ctrl.simulate.rig_model import Placed, value_row

# site -> arguments of the kernel, results
_CALLS = {
    "drive": ("a[i], t[i], {told}", "out[i]"),
    "motor": ("0.0, a[i], b[i], t[i], {told}", "out[i]"),
    "load": ("a[i], b[i], t[i]", "out[i]"),
    "friction": ("a[i], b[i], t[i], c[i], {told}", "more[i], out[i]"),
}
_TEXT = """\
from numba import njit
from dmptm_ctrl.simulate.elementary import FAST, hosted

kernel, Values = hosted(EFFECTS[0].kernel), EFFECTS[0].values


@njit(cache=True, error_model="numpy", nogil=True, fastmath=FAST)
def along(a, b, c, t, p, out, more):
    values = Values({values})
    for i in range(out.size):
        {results} = kernel({arguments}, values)
"""


@cache
def _loop(effect: Effect, told: int) -> ModuleType:
    arguments, results = _CALLS[effect.site]
    values = ", ".join(f"p[{k}]" for k in range(len(effect.parameters)))
    text = _TEXT.format(values=values, results=results, arguments=arguments.format(told=told))
    key = key_of(text, (elementary, lookup), (effect,))
    return load(f"along_{key}", text, EFFECTS=(effect,))


def _run(placed: Placed, a: Floats, b: Floats, c: Floats, t: Floats) -> tuple[Floats, Floats]:
    chain = PLACED_CATALOGUE[placed.name]
    out, more = np.empty_like(a, float), np.empty_like(a, float)
    rows = (np.ascontiguousarray(x, np.float64) for x in (a, b, c, t))
    _loop(chain.effect, chain.told).along(*rows, value_row(placed), out, more)
    return out, more


def torque_along(placed: Placed, theta: Floats, omega: Floats, t: Floats) -> Floats:
    """Torque [N·m] of an effect on a body that moves as given, (n,)."""
    return _run(placed, theta, omega, omega, t)[0]


def friction_along(
    placed: Placed, theta: Floats, omega: Floats, t: Floats, load: Floats
) -> tuple[Floats, Floats]:
    """Factor on the declared friction and magnitude [N·m] added by an effect, (n,) each.

    `load` is what presses on the bearings of the body [N·m].
    """
    added, factor = _run(placed, theta, omega, load, t)
    return factor, added


def drive_along(placed: Placed, u: Floats, t: Floats) -> Floats:
    """Signal of an input after an effect on it, (n,)."""
    return _run(placed, u, u, u, t)[0]


@cached(error_model="numpy")
def law_along(omega, row, out):
    """Friction of a declared law along a speed, signed against the motion."""
    law = stribeck_law(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])
    for i in range(omega.size):
        way = 1.0 if omega[i] > 0.0 else -1.0
        out[i] = way * sliding_torque(omega[i], way, law) if omega[i] != 0.0 else 0.0


@cached(error_model="numpy")
def bristle_along(travel, level, distance, out):
    """Dahl's friction along a motion: `level` is the signed sliding friction."""
    state = 0.0
    for i in range(travel.size):
        decay = np.exp(-abs(travel[i]) / distance)
        state = level[i] + (state - level[i]) * decay
        out[i] = state
