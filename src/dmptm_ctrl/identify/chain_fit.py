"""Fit a chain's parameters to the balance of torques, by Gauss–Newton with bounds.

J = Σ (w · residual)² + Σ ((p − p0)/σ)², the second sum over declared ranges.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np
from scipy.optimize import lsq_linear

from dmptm_ctrl.identify.chain_free import Floats, Free, free_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import NONE, Balance, Nuisance, residual
from dmptm_ctrl.parallel import in_threads, small_matrices
from dmptm_ctrl.simulate.chain_model import ChainModel

ROWS_PER_NEWS = 8.0  # rows of the balance that carry one independent piece of news
DIFFERENCE = 1e-4  # step of the finite differences, in scales
KINKS = {  # step of the finite differences, in scales: wide enough to pass a few kinks
    "drive_delay": 0.05, "current_lag": 0.05, "drive_dead_band": 0.05, "drive_saturation": 0.05,
    "backlash": 0.005,
}  # fmt: skip
STEADY = 0.05  # change of an equation's weight at which a fit has settled


@dataclass(frozen=True, eq=False)
class State:
    """A model and what belongs to each log."""

    model: ChainModel
    logs: Mapping[str, Nuisance] = field(default_factory=dict)

    def nuisance(self, log: str) -> Nuisance:
        """What belongs to a log."""
        return self.logs.get(log, NONE)

    def get(self, free: Free) -> float:
        """Value of a number."""
        if free.kind == "value":
            return self.model.value(free.owner)
        if free.kind == "effect":
            effect = next(e for e in self.model.effects if e.key == free.owner)
            return effect.values.get(free.name, 0.0)
        return getattr(self.nuisance(free.owner), free.kind).get(free.name, 0.0)

    def moved(self, frees: Sequence[Free], values: Sequence[float]) -> "State":
        """Return the state with numbers replaced."""
        declared: dict[str, float] = {}
        effects = {e.key: dict(e.values) for e in self.model.effects}
        zero = {k: dict(n.zero) for k, n in self.logs.items()}
        twist = {k: dict(n.twist) for k, n in self.logs.items()}
        for free, value in zip(frees, values, strict=True):
            if free.kind == "value":
                declared[free.owner] = float(value)
            elif free.kind == "effect":
                effects[free.owner][free.name] = float(value)
            else:
                into = zero if free.kind == "zero" else twist
                into.setdefault(free.owner, {})[free.name] = float(value)
        model = replace(
            self.model,
            effects=tuple(e._replace(values=effects[e.key]) for e in self.model.effects),
            values={**self.model.values, **declared},
        )
        names = {*zero, *twist}
        return State(model, {k: Nuisance(zero.get(k, {}), twist.get(k, {})) for k in names})


@dataclass(frozen=True, eq=False)
class ChainFit:
    """A fitted chain.

    Attributes
    ----------
    state : State
    frees : tuple of Free
    left : tuple of (equations, rows) arrays
        Residual per log.
    drive : tuple of (rows,) arrays
        Driving torque per log.
    slopes : tuple of (equations, rows, free numbers) arrays
        Derivatives of the residual per log.
    weights : (equations,) array
    cost : float
    """

    state: State
    frees: tuple[Free, ...]
    left: tuple[Floats, ...]
    drive: tuple[Floats, ...]
    slopes: tuple[Floats, ...]
    weights: Floats
    cost: float

    @property
    def model(self) -> ChainModel:
        """The fitted model."""
        return self.state.model

    @property
    def misfit(self) -> float:
        """Sum of the logarithms of each equation's residual, for fits of equal equations."""
        return -float(np.sum(np.log(_weights(self.left))))

    @property
    def values(self) -> dict[str, float]:
        """Fitted numbers by label."""
        return {f.label: self.state.get(f) for f in self.frees}


def residuals(
    state: State, balance: Balance, *, jobs: int = 1
) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Return the residual and the driving torque per log, rows at rest set to zero."""
    done = [_one(state, balance, k) for k in range(len(balance.motions))]
    return tuple(d[0] for d in done), tuple(d[1] for d in done)


def _one(state: State, balance: Balance, k: int) -> tuple[Floats, Floats]:
    motion = balance.motions[k]
    left, drive = residual(state.model, balance, motion, state.nuisance(motion.name))
    return left * motion.moving, drive * motion.moving


def jacobian(
    state: State,
    balance: Balance,
    frees: Sequence[Free],
    left: Sequence[Floats],
    *,
    jobs: int = 2,
) -> tuple[Floats, ...]:
    """Return the derivatives of the residual per log, per scale of each number."""
    columns = [np.zeros((*part.shape, len(frees))) for part in left]

    def column(j: int) -> None:
        free = frees[j]
        here = state.get(free)
        step = _step(free)
        if here + step > free.high:
            step = -step
        there = state.moved([free], [here + step])
        for k, motion in enumerate(balance.motions):
            if free.kind in ("zero", "twist") and free.owner != motion.name:
                continue
            moved, _ = _one(there, balance, k)
            columns[k][:, :, j] = (moved - left[k]) / (step / free.scale)

    in_threads(column, range(len(frees)), jobs)
    return tuple(columns)


def _step(free: Free) -> float:
    if _has_kinks(free):
        return KINKS[free.owner.partition("@")[0]] * free.scale
    return DIFFERENCE * free.scale


@small_matrices
def fit_chain(
    state: State,
    balance: Balance,
    *,
    frees: Sequence[Free] | None = None,
    iterations: int = 6,
    tolerance: float = 1e-4,
    jobs: int = 2,
) -> ChainFit:
    """Fit by Gauss–Newton.

    Parameters
    ----------
    state : State
        Where to start; every quantity has a value.
    balance : Balance
    frees : sequence of Free, optional
        By default all of `free_parameters`.
    iterations : int
        At most.
    tolerance : float
        Stops when the cost falls by less than this share.

    Returns
    -------
    ChainFit
    """
    scales = scales_of(balance)
    if frees is None:
        frees = free_parameters(state.model, balance, scales)
    frees = tuple(frees)
    left, drive = residuals(state, balance)
    weights = _weights(left)
    cost = _cost(state, frees, left, weights)
    slopes = jacobian(state, balance, frees, left, jobs=jobs)
    for _ in range(iterations):
        if not frees:
            break
        better = _better(state, balance, frees, left, slopes, weights, cost)
        gain = 0.0
        if better is not None:
            gain = 1.0 - better[3] / cost
            state, left, drive, cost = better
            frees = tuple(_rescaled(f, state) for f in frees)
            slopes = jacobian(state, balance, frees, left, jobs=jobs)
        if gain < tolerance:
            # equations count by what is left of each, which has changed on the way
            old, weights = weights, _weights(left)
            share, share_old = weights / weights.sum(), old / old.sum()
            if np.all(np.abs(share - share_old) <= STEADY * share_old):
                break
            cost = _cost(state, frees, left, weights)
    return ChainFit(state, frees, left, drive, slopes, weights, cost)


def _better(
    state: State,
    balance: Balance,
    frees: Sequence[Free],
    left: Sequence[Floats],
    slopes: Sequence[Floats],
    weights: Floats,
    cost: float,
) -> tuple[State, tuple[Floats, ...], tuple[Floats, ...], float] | None:
    """Return state, residual, drive and cost after a step that lowers the cost; else None.

    Where a whole step fails, numbers with kinks (a gap, a dead time) are left out of it.
    """
    smooth = [not _has_kinks(f) for f in frees]
    for used in ([True] * len(frees), smooth):
        if used is smooth and (all(smooth) or not any(smooth)):
            continue
        own = [f for f, u in zip(frees, used, strict=True) if u]
        step = _step_of(state, own, left, [p[..., used] for p in slopes], weights)
        for shrink in (1.0, 0.3, 0.1, 0.03):
            values = [
                float(np.clip(state.get(f) + shrink * f.scale * d, f.low, f.high))
                for f, d in zip(own, step, strict=True)
            ]
            trial = state.moved(own, values)
            try:
                new_left, new_drive = residuals(trial, balance)
            except (ValueError, ArithmeticError):
                continue
            new_cost = _cost(trial, frees, new_left, weights)
            if isfinite(new_cost) and new_cost < cost:
                return trial, new_left, new_drive, new_cost
    return None


def _has_kinks(free: Free) -> bool:
    return free.kind == "effect" and free.owner.partition("@")[0] in KINKS


def _rescaled(free: Free, state: State) -> Free:
    """Keep the difference step in proportion to the value."""
    if free.kind != "value":
        return free
    return replace(free, scale=max(abs(state.get(free)), free.least) or free.scale)


def _weights(left: Sequence[Floats]) -> Floats:
    """1/rms of each equation."""
    count = left[0].shape[0]
    out = np.ones(count)
    for e in range(count):
        rms = float(np.sqrt(np.mean(np.concatenate([part[e] for part in left]) ** 2)))
        out[e] = 1.0 / rms if rms > 0 else 1.0
    return out


def _news(left: Sequence[Floats]) -> float:
    return 1.0 / ROWS_PER_NEWS


def _cost(state: State, frees: Sequence[Free], left: Sequence[Floats], weights: Floats) -> float:
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable trial is a costly one
        total = sum(float(np.sum((weights[:, None] * part) ** 2)) for part in left) * _news(left)
    for free in frees:
        if free.prior is not None and free.prior[1] > 0:
            total += ((state.get(free) - free.prior[0]) / free.prior[1]) ** 2
    return total


def _step_of(
    state: State,
    frees: Sequence[Free],
    left: Sequence[Floats],
    slopes: Sequence[Floats],
    weights: Floats,
) -> Floats:
    """Bounded least-squares step, in scales."""
    share = np.sqrt(_news(left))
    rows = (
        np.concatenate([(weights[:, None, None] * s).reshape(-1, len(frees)) for s in slopes])
        * share
    )
    target = np.concatenate([(weights[:, None] * part).ravel() for part in left]) * share
    low = np.array([(f.low - state.get(f)) / f.scale for f in frees])
    high = np.array([(f.high - state.get(f)) / f.scale for f in frees])
    extra_rows, extra_target = [], []
    for j, free in enumerate(frees):
        if free.prior is not None and free.prior[1] > 0:
            row = np.zeros(len(frees))
            row[j] = free.scale / free.prior[1]
            extra_rows.append(row)
            extra_target.append((state.get(free) - free.prior[0]) / free.prior[1])
    # A little of Levenberg's damping decides directions that the logs do not show.
    size = np.sqrt(np.mean(np.sum(rows**2, axis=0))) if rows.size else 1.0
    rows = np.vstack([rows, *extra_rows, 1e-6 * size * np.eye(len(frees))])
    target = np.concatenate([target, extra_target, np.zeros(len(frees))])
    # Normal equations: numbers are scaled, and their condition is well below 1e8.
    square = rows.T @ rows
    values, vectors = np.linalg.eigh(square)
    values = np.maximum(values, 1e-14 * values[-1])
    root = (vectors * np.sqrt(values)).T
    against = (vectors / np.sqrt(values)).T @ (rows.T @ target)
    high = np.maximum(high, low + 1e-12)
    return lsq_linear(root, -against, bounds=(low, high)).x
