"""Newton's law on the measured motion: what torque is missing, window by window.

Summed over all bodies the mesh torques cancel, so that the balance at the ring gear

    J_L α_L + N2 J̄3 (α_3l + α_3r) = N2 (N1 K (u_l + u_r) − F_3l − F_3r) − F_L + effects

holds through gaps and rattle, of which no simulation predicts the course; per chain the
mesh torque follows from the measured twist while the pinion rests on a flank. Nothing is
integrated: no drift, no chaos, and nearly linear in everything unknown.
Source: paper Eqs. 16 to 18, 21, 25.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from math import exp
from typing import Any

import numpy as np
from numba import njit

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.stribeck import Stribeck, sliding_torque
from dmptm_ctrl.identify.fit import Unknown, bounded_step, place, position
from dmptm_ctrl.identify.motion import Motion, odd_span, readings, second_difference, smooth
from dmptm_ctrl.simulate.compose import engine, layout
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats, Model

REDUCER, BEARING = BASE.index("T3s_plus"), BASE.index("TLs_plus")  # in the base array
INERTIA = (
    36.5  # kg·m², Table 1: of all bodies at the ring gear; expresses an acceleration as a torque
)
STIFFNESS = 3.6e4  # N·m/rad, Table 1: expresses a twist as a torque, whatever k_m is fitted
SEEN_SECONDS = 0.01  # passes what the multisine excites, keeps the encoders' noise small
CARRIED_SECONDS = 0.02  # span over which the mesh torque is smoothed
ENCODER_UNIT = 1e-4  # rad, at which the encoder's error is read off its kernel
FIRM = 1.0  # N·m at the pinion; below, the flanks part and meet again within a window
MIN_WINDOWS = 8  # of a log and equation; fewer tell nothing about their own scatter
FREEDOM = 4.0  # of Student's t: how a window may scatter, bursts and rattle included
SCALE_STEPS = 12
FLOOR = {"total": 0.1, "chain": 0.4}  # N·m; friction laws are not known more finely
# Difference steps, in scales of an unknown; small for what enters a phase or an exponent.
PROBES = {"drive": 0.1, "amplitude": 1.0, "shape": 0.02}
ITERATIONS = 8
STALLED = 0.5  # fall of the loss that ends the iterations
# Share of the windows that are independent: they overlap by half, and the wobble of a pinion
# on its flank lasts for several. Not read off the misfit, which a missing effect correlates.
NEWS = {"total": 0.6, "chain": 0.25}


@njit(nogil=True)
def friction_along(speed: Floats, law: Stribeck, out: Floats) -> None:
    """Sliding friction along a recorded speed, negative when forward."""
    for i in range(speed.size):
        direction = 1.0 if speed[i] > 0.0 else -1.0
        out[i] = -direction * sliding_torque(speed[i], direction, law)


@njit(nogil=True)
def presliding_along(angle: Floats, distance: float, out: Floats) -> None:
    """Turn sliding friction into that of Dahl's equation along an angle, exact for its steps."""
    force = 0.0
    for i in range(1, angle.size):
        moved = angle[i] - angle[i - 1]
        if moved != 0.0:
            # where the speed has the other sign, there is nothing to slide against yet
            goal = out[i] if out[i] * moved < 0.0 else 0.0
            force = goal + (force - goal) * exp(-abs(moved) / distance)
        out[i] = force


@dataclass(frozen=True, eq=False)
class Equation:
    """One balance on one log: which windows of it count."""

    motion: int
    kind: str  # total, or the chain: left, right
    used: np.ndarray


@dataclass(eq=False)
class Balance:
    """Missing torque [N·m] of a model on measured motions.

    Parameters
    ----------
    motions : sequence of Motion
    declared : Model
        Tells which meshes push firmly; which windows count does not follow a fit.
    jobs : int
        Threads; nothing depends on it.
    """

    motions: Sequence[Motion]
    declared: Model
    jobs: int = 1

    @cached_property
    def equations(self) -> tuple[Equation, ...]:
        """Equations with enough windows, log by log."""
        found = []
        for i, mo in enumerate(self.motions):
            kinds = [("total", mo.slides)]
            if mo.rec.twist is not None:
                firm = pushes(mo, self.volts[i], self.declared)
                kinds += [
                    (k, mo.slides & mo.touches[:, s] & firm[:, s]) for s, k in enumerate(SIDES)
                ]
            found += [Equation(i, k, used) for k, used in kinds if used.sum() >= MIN_WINDOWS]
        return tuple(found)

    @cached_property
    def volts(self) -> list[Floats]:
        """Window means of both voltages per motion."""
        return [mo.mean(mo.rec.u) for mo in self.motions]

    @property
    def simulated(self) -> bool:
        """Whether a simulation told which pinions touch."""
        return any(mo.rec.twist is None for mo in self.motions)

    @cached_property
    def kinds(self) -> list[str]:
        """Kind of each equation."""
        return [e.kind for e in self.equations]

    def missing(self, model: Model) -> list[Floats]:
        """Missing torque per equation, on the windows that count."""
        arrays = model.arrays()
        reduced = reducer_compliance(model)
        tables = [
            missing_torques(mo, volts, arrays, reduced)
            for mo, volts in zip(self.motions, self.volts, strict=True)
        ]
        return [tables[e.motion][ROWS[e.kind]][e.used] for e in self.equations]


def pushes(mo: Motion, volts: Floats, model: Model) -> np.ndarray:
    """Windows in which the mesh pushes so firmly that it does not lift in between, (w, 2)."""
    base, _, _ = model.arrays()
    n1 = base[5]
    friction = mo.mean(frictions(mo, base)[:2], held=False)
    inertia = n1 * n1 * base[2] + base[3]
    left = n1 * base[0] * base[1] * volts + friction - inertia * mo.pinions.T
    return np.asarray((mo.mean(np.sign(mo.run[:, 6:8].T)) * left > FIRM).T)


SIDES = ("left", "right")
ROWS = {"total": 0, "left": 1, "right": 2}


def reducer_compliance(model: Model) -> float:
    """Compliance of the reducers at the pinion [rad/(N·m)], 0 if rigid."""
    return float(model.effects.get("reducer_compliance", {}).get("compliance", 0.0))


def encoder_error(mo: Motion, on: Any, values: Floats) -> Floats:
    """Error of the ring encoder [rad], (n,), beyond what was taken off the readings."""
    _, on_before, before = mo.declared.arrays()
    index, first = layout()["encoder_eccentricity"]
    now = values[first : first + 2] * on[index]
    then = before[first : first + 2] * on_before[index]
    if np.array_equal(now, then):
        return np.zeros(1)
    waves = []
    for k in (0, 1):
        unit = np.zeros_like(values)
        unit[first + k] = ENCODER_UNIT
        flags = np.zeros_like(on)
        flags[index] = 1
        read, speed = np.empty(mo.run.shape[0]), np.empty(mo.run.shape[0])
        sensor = engine().sensor_reading
        readings(sensor, mo.run[:, 0], mo.run[:, 1], mo.rec.dt, flags, unit, read, speed)
        waves.append((read - mo.run[:, 0]) / ENCODER_UNIT)
    return np.asarray((now - then) @ np.array(waves))


def frictions(mo: Motion, base: Floats) -> Floats:
    """Friction on pinions and ring gear along a motion, (3, n) [N·m], negative when forward."""
    rows = np.empty((3, mo.run.shape[0]))
    reducer = Stribeck(*base[REDUCER : REDUCER + 9])
    for s in (0, 1):
        friction_along(np.ascontiguousarray(mo.pinion_speed[:, s]), reducer, rows[s])
    bearing = Stribeck(*base[BEARING : BEARING + 9])
    friction_along(np.ascontiguousarray(mo.run[:, 1]), bearing, rows[2])
    return rows


def missing_torques(mo: Motion, volts: Floats, arrays: Arrays, compliance: float) -> Floats:
    """All balances on all windows of a motion, (3, w) [N·m]."""
    base, on, values = arrays
    n1, n2 = base[5], base[6]
    gain = base[0] * base[1]
    j3, jl = n1 * n1 * base[2] + base[3], base[4]
    twisted = mo.rec.twist is not None
    n = mo.run.shape[0]
    rows = frictions(mo, base)
    distances = [engine().presliding_distance(body, on, values) for body in range(3)]
    for body, distance in enumerate(distances):
        if distance > 0.0:
            angle = mo.run[:, 0] if body == 2 else mo.run[:, 2 + body] / n1
            presliding_along(np.ascontiguousarray(angle), distance, rows[body])
    force = mo.mean(rows, held=False)
    shift = np.zeros((2, n)) + n2 * encoder_error(mo, on, values)
    if on.any():
        torque, moved = disturbance(mo, arrays, rows)
        force += mo.mean(torque)
        shift += moved
    force[:2] += n1 * gain * volts
    out = np.empty((3, mo.starts.size))
    # As an acceleration: the sensors' noise is one, and must not favour a small inertia.
    out[0] = jl * mo.ring + n2 * j3 * mo.pinions.sum(1) - n2 * force[:2].sum(0) - force[2]
    out[0] *= INERTIA / (jl + 2.0 * n2 * n2 * j3)
    if twisted:
        for s in (0, 1):
            z = mo.run[:, 6 + s] + shift[s]
            rate = mo.pinion_speed[:, s] - n2 * mo.run[:, 1]
            flank = np.where(mo.run[:, 6 + s] > 0.0, base[13 + s], -base[13 + s])
            twist = mo.mean(z - flank + base[11] / base[8] * rate, held=False)
            carried = force[s] - j3 * mo.pinions[:, s]
            # In the twist, not in the torque: the twist's noise must not bias the stiffness.
            # A soft reducer adds its own, for z is seen at the motor.
            out[1 + s] = STIFFNESS * (twist - (1.0 / base[8] + compliance) * carried)
    return out


def carried(mo: Motion, base: Floats, friction: Floats) -> Floats:
    """Torque that each mesh carries [N·m], (2, n), by what drives and brakes; smoothed.

    From the voltages, not from the measured acceleration: without motor encoders its noise
    would pass for friction that grows with the load.
    """
    n2 = base[6]
    j3 = base[5] * base[5] * base[2] + base[3]
    drive = base[5] * base[0] * base[1] * mo.rec.u + friction[:2]
    force = n2 * drive.sum(0) + friction[2]
    rest = drive - j3 * n2 * force / (base[4] + 2.0 * n2 * n2 * j3)
    return np.array([smooth(row, odd_span(CARRIED_SECONDS, mo.rec.dt)) for row in rest])


def seen(mo: Motion, base: Floats, friction: Floats) -> Floats:
    """Torque that each mesh carries [N·m], (2, n), with the motors' measured acceleration."""
    gain, j3 = base[5] * base[0] * base[1], base[5] * base[5] * base[2] + base[3]
    rows = gain * mo.rec.u + friction[:2]
    for s in (0, 1):
        rows[s] -= j3 * second_difference(mo.run[:, 2 + s] / base[5], mo.rec.dt)
    return np.array([smooth(row, odd_span(SEEN_SECONDS, mo.rec.dt)) for row in rows])


def loads(on: Any) -> bool:
    """Whether an effect in use depends on the torque of the meshes."""
    return any(
        on[layout()[name][0]] and e.site == "friction" and "mesh_torque" in e.depends_on
        for name, e in CATALOGUE.items()
    )


def disturbance(mo: Motion, arrays: Arrays, friction: Floats) -> tuple[Floats, Floats]:
    """Torques (3, n) on pinions and ring gear, and shifts (2, n) of z, of a model's effects."""
    base, on, values = arrays
    n = mo.run.shape[0]
    torque, moved = np.empty((n, 3)), np.empty((n, 2))
    run = mo.run.copy()  # with the mesh torques, for friction that grows with them
    run[:, 4:6] = (carried if mo.rec.twist is None else seen)(mo, base, friction).T
    for _ in range(2 if loads(on) else 1):
        engine().along(mo.rec.u, run, mo.rec.dt, base, on, values, torque, moved)
        # The mesh carries what friction leaves, which depends on what it carries.
        run[:, 4:6] += torque[:, :2]
    return torque.T, moved.T


def scatter(parts: Sequence[Floats], kinds: Sequence[str]) -> list[float]:
    """How far the windows of each equation scatter [N·m]."""
    return [
        float(np.hypot(robust_scale(part), FLOOR[role_of(kind)]))
        for part, kind in zip(parts, kinds, strict=True)
    ]


def robust_scale(e: Floats) -> float:
    """Most likely scale about zero of Student's t with :data:`FREEDOM` degrees."""
    s = max(1.4826 * float(np.median(np.abs(e))), 1e-9)
    for _ in range(SCALE_STEPS):  # expectation–maximisation
        weight = (FREEDOM + 1.0) / (FREEDOM + (e / s) ** 2)
        s = max(float(np.sqrt(np.mean(weight * e**2))), 1e-9)
    return s


@dataclass(frozen=True, eq=False)
class BalanceFit:
    """Parameters that close the balances best.

    Attributes
    ----------
    loss : float
        Twice the negative log-likelihood of the independent windows, plus ‖p/s‖².
    parts : list of arrays
        Missing torque per equation.
    kinds : list of str
        Of each part.
    jacobian : (m, k) array
        d missing/dp, unweighted.
    covariance : (k, k) array
    """

    model: Model
    unknowns: tuple[Unknown, ...]
    p: Floats
    loss: float
    parts: list[Floats]
    kinds: list[str]
    jacobian: Floats
    covariance: Floats

    @property
    def missing(self) -> Floats:
        """All parts in one vector."""
        return np.concatenate(self.parts)

    @cached_property
    def weights(self) -> Floats:
        """Square roots of what each window counts."""
        return weights(self.parts, self.kinds)


def weights(parts: Sequence[Floats], kinds: Sequence[str]) -> Floats:
    """Square roots of what each window counts: its equation's scale, bent, and news."""
    return np.concatenate(
        [
            np.sqrt(NEWS[role_of(kind)] * (FREEDOM + 1.0) / (FREEDOM + (part / sigma) ** 2)) / sigma
            for part, kind, sigma in zip(parts, kinds, scatter(parts, kinds), strict=True)
        ]
    )


def surprise(parts: Sequence[Floats], kinds: Sequence[str]) -> float:
    """Twice the negative log-likelihood of Student's t, each equation at its own scale."""
    total = 0.0
    for part, kind, s in zip(parts, kinds, scatter(parts, kinds), strict=True):
        tail = (FREEDOM + 1.0) * np.mean(np.log1p((part / s) ** 2 / FREEDOM))
        total += NEWS[role_of(kind)] * part.size * float(2.0 * np.log(s) + tail)
    return total


def loss(
    parts: Sequence[Floats], kinds: Sequence[str], unknowns: Sequence[Unknown], p: Floats
) -> float:
    """Scale-free misfit plus the prior's."""
    prior = sum((x / k.prior) ** 2 for x, k in zip(p, unknowns, strict=True))
    return surprise(parts, kinds) + float(prior)


def role_of(kind: str) -> str:
    """Tell the balance of the whole from that of a chain."""
    return "total" if kind == "total" else "chain"


def role(unknown: Unknown) -> str:
    """Tell the drive's parameters, an effect's amplitudes and its shapes apart."""
    if unknown.effect is None:
        return "drive"
    return "shape" if unknown.name in CATALOGUE[unknown.effect].shapes else "amplitude"


def columns(balance: Balance, model: Model, unknowns: Sequence[Unknown], e0: Floats) -> Floats:
    """Slopes of the missing torques by differences, (m, k)."""
    p0 = position(model, unknowns)

    def column(j: int) -> Floats:
        step = PROBES[role(unknowns[j])]
        if p0[j] + step > unknowns[j].high:
            step = -step
        p = p0.copy()
        p[j] += step
        return (np.concatenate(balance.missing(place(model, unknowns, p))) - e0) / step

    with ThreadPoolExecutor(balance.jobs) as pool:
        done = list(pool.map(column, range(len(unknowns))))
    return np.array(done).T if done else np.empty((e0.size, 0))


def fit_balance(
    balance: Balance,
    model: Model,
    unknowns: Sequence[Unknown],
    *,
    jacobian: Floats | None = None,
) -> BalanceFit:
    """Fit unknowns by Gauss–Newton with weights that follow the misfit.

    Parameters
    ----------
    jacobian : (m, j) array, optional
        Of the first j unknowns, kept as it is (the drive's are nearly constant).
    """
    unknowns = tuple(unknowns)
    low = np.array([k.low for k in unknowns])
    high = np.array([k.high for k in unknowns])
    p = np.clip(position(model, unknowns), low, high)
    model = place(model, unknowns, p)
    kinds = balance.kinds
    parts = balance.missing(model)
    value = loss(parts, kinds, unknowns, p)
    kept = 0 if jacobian is None else jacobian.shape[1]
    jac = np.empty((sum(map(len, parts)), 0))
    for k in range(ITERATIONS):
        e = np.concatenate(parts)
        if k == 0 or kept < len(unknowns):
            fresh = columns(balance, model, unknowns[kept:], e)
            jac = fresh if jacobian is None else np.hstack([jacobian, fresh])
        w = weights(parts, kinds)
        step = bounded_step(w * e, -w[:, None] * jac, p, unknowns, 0.0)
        gain = 0.0
        for shrink in (1.0, 0.5, 0.2):
            trial = np.clip(p + shrink * step, low, high)
            moved = place(model, unknowns, trial)
            tried = balance.missing(moved)
            cost = loss(tried, kinds, unknowns, trial)
            if cost < value:
                gain = value - cost
                p, model, parts, value = trial, moved, tried, cost
                break
        if gain < STALLED:
            break
    weighted = weights(parts, kinds)[:, None] * jac
    prior = np.array([1.0 / k.prior**2 + 1e-9 for k in unknowns])
    covariance = np.asarray(np.linalg.inv(weighted.T @ weighted + np.diag(prior)), np.float64)
    return BalanceFit(model, unknowns, p, value, parts, kinds, jac, covariance)
