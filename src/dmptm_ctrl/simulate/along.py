"""Kernels along recorded signals: what effects and friction do, sample by sample.

Samples do not wait for each other, so that each effect acts on all of them in one loop. Only
what builds up or lags is carried from one to the next.
"""

from collections.abc import Iterable, Sequence
from functools import cache
from types import ModuleType
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import lookup, presliding, stribeck
from dmptm_ctrl.simulate import elementary, step
from dmptm_ctrl.simulate.generate import compiled
from dmptm_ctrl.simulate.loading import key_of, load
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import Floats, Ints, Plant
from dmptm_ctrl.simulate.rig_model import Placed, value_row

# site -> what its kernel does to the rows `out` and `more`, of rows a to d in its arguments' order
_CALLS = {
    "amplifier": "out[i] = kernel(a[i], b[i], side, values)",
    "lag": "r = kernel(a[i], side, values); out[i] = r[0]; more[i] += r[1]",
    "motor": "out[i] += kernel(a[i], b[i], c[i], d[i], side, values)",
    "load": "out[i] += kernel(a[i], b[i], c[i], values)",
    "mesh": "r = kernel(a[i], b[i], c[i], d[i], side, values); out[i] += r[0]; more[i] += r[2]",
    "stiffness": "r = kernel(a[i], b[i], c[i], d[i], side, values); out[i] += r[3]",
    "friction": "r = kernel(a[i], b[i], c[i], d[i], side, values); out[i] *= r[0]; more[i] += r[1]",
    "sensor": "out[i], more[i] = kernel(a[i], b[i], c[i], values)",
}
_HEAD = """\
from numba import njit
from dmptm_ctrl.effects import lookup, stribeck
from dmptm_ctrl.simulate.elementary import FAST, hosted
"""
_EFFECT = """
# to add what all knots of a table give is vector code, to fetch one by its number is not
kernel = hosted(EFFECTS[0].kernel, (lookup.looked_up, lookup.summed))
Values = EFFECTS[0].values


@njit
def along(a, b, c, d, side, p, out, more):
    values = Values({values})
    for i in range(out.size):
        {call}
"""
_SIGNALS = """
from dmptm_ctrl.effects import presliding
from dmptm_ctrl.simulate import step
from dmptm_ctrl.simulate.elementary import exp

stribeck_law = stribeck.stribeck_law
sliding_torque, viscous_torque = hosted(stribeck.sliding_torque), hosted(stribeck.viscous_torque)
build_up_distance = hosted(presliding.build_up_distance)
lag = hosted(step.lagged)


@njit
def slide(omega, law, out):
    for i in range(omega.size):
        way = 1.0 if omega[i] > 0.0 else -1.0
        out[i] = way * sliding_torque(omega[i], way, law)


@njit
def law_along(omega, p, out):
    # the power takes longest; an exponent of 1 needs none, and the compiler leaves it out
    if p[8] == 1.0:
        slide(omega, stribeck_law(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], 1.0), out)
    else:
        slide(omega, stribeck_law(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8]), out)


@njit
def built_up(omega, travel, begins, distance, share, p, level):
    law = stribeck_law(p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8])
    force, part = 0.0, 0
    for i in range(omega.size):
        way = 1.0 if omega[i] > 0.0 else -1.0
        once = way * share * viscous_torque(omega[i], way, law)
        sliding, moved = level[i] - once, travel[i]
        if part < begins.size and i == begins[part]:
            force, moved = 0.0, 0.0
            part += 1
        if moved != 0.0:
            goal = abs(sliding) if moved > 0.0 else -abs(sliding)
            over = build_up_distance(distance, goal, law)
            force = goal + (force - goal) * exp(-abs(moved) / over)
        level[i] = force + once


@njit
def stops(x, half, out):
    for k in range(half.size):
        state = 0.0
        for i in range(1, x.size):
            state = min(half[k], max(-half[k], state + (x[i] - x[i - 1])))
            out[i, k] = state


@njit
def lagged(aim, tau, dt, before, out):
    state = before
    if (tau == tau[0]).all():  # an exponential is taken once
        time = tau[0]
        for i in range(out.size):
            out[i], state = lag(state, aim[i], time, dt)
    else:
        for i in range(out.size):
            out[i], state = lag(state, aim[i], tau[i], dt)
"""
_MODULES = (elementary, lookup, presliding, step, stribeck)


class Acting(NamedTuple):
    """An effect at a place, with its numbers there."""

    effect: Effect
    side: int  # side or body that the kernel takes
    values: Floats  # parameters as the kernel takes them


def acting_of(placed: Placed) -> Acting:
    """Return an effect of a rig with its numbers."""
    entry = PLACED_CATALOGUE[placed.name]
    return Acting(entry.effect, entry.side, value_row(placed))


def acting_in(plant: Plant) -> dict[tuple[str, int], list[Acting]]:
    """Return the effects in use by site and part of a plant; the sites that kernels act at."""
    found: dict[tuple[str, int], list[Acting]] = {}
    flags = plant.on.tolist()
    for effect, part, side, flag, first in plant.places:
        if flags[flag]:
            row = plant.values[first : first + len(effect.parameters)]
            found.setdefault((effect.site, part), []).append(Acting(effect, side, row))
    return found


@cache
def _loop(effect: Effect, call: str) -> ModuleType:
    values = ", ".join(f"p[{k}]" for k in range(len(effect.parameters)))
    call = _CALLS[call].replace("; ", "\n        ")
    text = compiled(_HEAD + _EFFECT.format(values=values, call=call), "along")
    return load(f"along_{key_of(text, _MODULES, (effect,))}", text, EFFECTS=(effect,))


@cache
def _signals() -> ModuleType:
    text = compiled(_HEAD + _SIGNALS, "law_along", "built_up", "stops", "lagged")
    return load(f"along_{key_of(text, _MODULES, ())}", text)


_LOOPS: dict[tuple[int, str], tuple[Effect, ModuleType]] = {}  # effects are long to compare


def _run(
    effects: Iterable[Acting], rows: Sequence[Floats], out: Floats, more: Floats, asked: str = ""
) -> None:
    a, b, c, d = (*rows, rows[0], rows[0], rows[0])[:4]
    for effect, side, values in effects:
        known = _LOOPS.get((id(effect), asked))
        if known is None:
            loop = effect, _loop(effect, asked or effect.site)
            known = _LOOPS.setdefault((id(effect), asked), loop)
        known[1].along(a, b, c, d, side, values, out, more)


def signal_along(effects: Iterable[Acting], u: Floats, t: Floats) -> Floats:
    """Signal of an input after effects on it, (n,)."""
    for one in effects:
        out = np.empty_like(u)
        _run([one], (u, t), out, out)
        u = out
    return u


def lag_along(effects: Iterable[Acting], u: Floats) -> tuple[Floats, Floats]:
    """What an input relaxes to by effects on it, and its time constant [s], (n,) each."""
    tau = np.zeros_like(u)
    for one in effects:
        out = np.empty_like(u)
        _run([one], (u,), out, tau)
        u = out
    return u, tau


def torque_along(
    effects: Iterable[Acting], u: Floats, theta: Floats, omega: Floats, t: Floats
) -> Floats:
    """Torque [N·m] of effects on a body that moves as given, (n,); `u` is what drives it."""
    out = np.zeros(theta.size)
    for one in effects:
        rows = (u, theta, omega, t) if one.effect.site == "motor" else (theta, omega, t)
        _run([one], rows, out, out)
    return out


def friction_along(
    effects: Iterable[Acting], theta: Floats, omega: Floats, t: Floats, load: Floats
) -> tuple[Floats, Floats]:
    """Factor on the declared friction and magnitude [N·m] added by effects, (n,) each.

    `load` is what presses on the bearings of the body [N·m].
    """
    factor, added = np.ones(theta.size), np.zeros(theta.size)
    _run(effects, (theta, omega, t, load), factor, added)
    return factor, added


def shift_along(
    effects: Iterable[Acting], near: tuple[Floats, Floats], far: tuple[Floats, Floats]
) -> tuple[Floats, Floats]:
    """Shift of a link's twist and change of its half-gap [rad], (n,) each.

    `near` and `far` are angles and speeds of the bodies at its ends.
    """
    shift, wider = np.zeros_like(near[0]), np.zeros_like(near[0])
    _run(effects, (*near, *far), shift, wider)
    return shift, wider


def stiffness_along(
    effects: Iterable[Acting], near: tuple[Floats, Floats], far: tuple[Floats, Floats]
) -> Floats:
    """Change of a link's stiffness [N·m/rad], (n,); arguments as :func:`shift_along`."""
    stiffer = np.zeros_like(near[0])
    _run(effects, (*near, *far), stiffer, stiffer, "stiffness")
    return stiffer


def reading_along(
    effects: Iterable[Acting], theta: Floats, omega: Floats, t: Floats
) -> tuple[Floats, Floats]:
    """Readings of angle and speed after effects on their sensors, (n,) each."""
    for one in effects:
        seen = np.empty_like(theta), np.empty_like(omega)
        _run([one], (theta, omega, t), *seen)
        theta, omega = seen
    return theta, omega


def law_along(omega: Floats, law: Floats) -> Floats:
    """Friction of a declared law along a speed, (n,), with the sign of the motion.

    `law` (9,) are the arguments of `stribeck_law`. At rest it is that of the way back.
    """
    out = np.empty_like(omega)
    _signals().law_along(omega, law, out)
    return out


def built_up_along(
    level: Floats,
    omega: Floats,
    travel: Floats,
    begins: Ints,
    bristles: Sequence[float],
    law: Floats,
) -> Floats:
    """Friction of sliding as presliding builds it up along a travel, exact for its steps, (n,).

    `level` has the sign of the motion; `begins` are the first samples of what was recorded at
    once; `bristles` the distance [rad] and the share of viscous friction that acts at once.
    """
    out = level.copy()
    _signals().built_up(omega, travel, begins, *bristles[:2], law, out)
    return out


def stops_along(x: Floats, half: Floats) -> Floats:
    """How far a variable is within plays of these half-widths, (n, k); in the middle at first.

    A sum of these is any hysteresis that forgets small loops inside of large ones (Prandtl and
    Ishlinskii; Visintin, Differential Models of Hysteresis, 1994).
    """
    out = np.zeros((x.size, half.size))
    _signals().stops(x, half, out)
    return out


def delayed_along(u: Floats, samples: float, before: float) -> Floats:
    """Mean over each sample of a held signal that comes so many samples later, (n,)."""
    whole = int(samples)
    part = samples - whole
    early = np.full(min(whole, u.size) + 1, before)
    held = np.concatenate([early, u[: u.size + 1 - early.size]])
    return part * held[:-1] + (1.0 - part) * held[1:]


def lagged_along(aim: Floats, tau: Floats, dt: float, before: float) -> Floats:
    """Mean over each sample of what relaxes to a held aim within `tau` [s], (n,) each."""
    out = np.empty_like(aim)
    _signals().lagged(aim, tau, dt, before, out)
    return out
