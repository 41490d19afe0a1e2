"""Fit a chain's parameters to the balance of torques, by Gauss–Newton with bounds.

J = Σ (w · residual)² + Σ ((p − p0)/σ)², the second sum over declared ranges.
"""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from math import inf, isfinite

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import lsq_linear

from dmptm_ctrl.identify.inverse_dynamics import NONE, Balance, Nuisance, residual
from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE
from dmptm_ctrl.simulate.chain_model import FAR, ChainModel, Placed

Floats = NDArray[np.float64]

PRIOR_SHARE = 0.6  # standard deviation of a uniform range, as a share of its half-width
ROWS_PER_NEWS = 8.0  # rows of the balance that carry one independent piece of news
DIFFERENCE = 1e-4  # step of the finite differences, in scales
KINKS = {  # step of the finite differences, in scales: wide enough to pass a few kinks
    "drive_delay": 0.05, "current_lag": 0.05, "drive_dead_band": 0.05, "drive_saturation": 0.05,
    "backlash": 0.005,
}  # fmt: skip
HARMONIC = ("cogging", "unbalance", "position_dependent_friction")  # cosine and sine of the angle
STEADY = 0.05  # change of an equation's weight at which a fit has settled
LEAST_SCALE = 0.01  # of the typical size of a quantity
SHARES = 0.005, 0.99  # of the inertia behind a spring
NOT_FITTED = ("ratio", "gain", "stribeck_exponent", "gap_damping", "limit")


@dataclass(frozen=True)
class Free:
    """One number to fit.

    Attributes
    ----------
    kind : {"value", "effect", "zero", "twist"}
    owner, name : str
        Key of the declared quantity; or key and parameter of an effect; or log and effect; or
        log and link.
    scale : float
        A clearly visible size.
    prior : (centre, sigma) or None
    least : float
        Of the scale: a number that was driven to zero must find its way back.
    """

    kind: str
    owner: str
    name: str
    low: float
    high: float
    scale: float
    prior: tuple[float, float] | None = None
    least: float = 0.0

    @property
    def label(self) -> str:
        """Key of the number."""
        return self.owner if self.kind == "value" else f"{self.owner}.{self.name}"


@dataclass(frozen=True)
class Scales:
    """Typical sizes in the logs, from which those of parameters follow."""

    force: float
    position: float
    speed: float
    acceleration: float
    dt: float
    u: Mapping[str, float]

    def of(self, unit: str) -> float:
        """Size of a quantity by its unit, angles and lengths alike."""
        plain = unit.replace("N·m", "N").replace("rad", "m").replace("/(", "/")
        return {
            "N": self.force,
            "N·s/m": self.force / self.speed,
            "N·s²/m²": self.force / self.speed**2,
            "N/m": self.force / self.position,
            "kg·m²": self.force / self.acceleration,
            "kg": self.force / self.acceleration,
            "m": self.position,
            "m/s": self.speed,
            "s": self.dt,
            "": 1.0,
        }.get(plain.replace("N·m·s", "N·s"), 1.0)


def scales_of(balance: Balance) -> Scales:
    """Return typical sizes, over all logs."""
    motions = balance.motions
    point = balance.points[0].name

    def rms(parts: Sequence[Floats]) -> float:
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) or 1.0

    gains = {i.name: i.gain.value if isfinite(i.gain.value) else 1.0 for i in balance.rig.inputs}
    force = rms([np.sum([gains[k] * u for k, u in m.u.items()], axis=0) for m in motions])
    return Scales(
        force,
        max(max(float(np.ptp(m.q[point])) for m in motions), 1e-12),
        rms([m.v[point] for m in motions]),
        rms([m.a[point] for m in motions]),
        motions[0].dt,
        {k: rms([m.u[k] for m in motions]) for k in gains},
    )


def free_parameters(
    model: ChainModel, balance: Balance, scales: Scales, *, nuisances: bool = True
) -> list[Free]:
    """Return what a fit may move: unknown and uncertain quantities, effects, and per-log terms."""
    frees = []
    for key, quantity in model.quantities.items():
        name = key.rpartition(".")[2]
        if name in NOT_FITTED or not quantity.is_free:
            continue
        low, high = quantity.range
        known = isfinite(quantity.value)
        prior = None
        if known:
            half = 0.5 * (high - low) if isfinite(high - low) else inf
            prior = (quantity.value, PRIOR_SHARE * half)
        least = LEAST_SCALE * scales.of(quantity.unit)
        size = max(abs(model.value(key)), least)
        frees.append(Free("value", key, name, 0.0, inf, size, prior, least))
    for effect in model.effects:
        frees += _effect_parameters(effect, model, scales)
    if not nuisances:
        return frees
    for motion in balance.motions:
        frees += log_parameters(model, balance, motion.name, balance.motions[0].name)
    return frees


def _effect_parameters(effect: Placed, model: ChainModel, scales: Scales) -> list[Free]:
    frees = []
    linear = on_slide(model, effect.on)
    for parameter in CHAIN_CATALOGUE[effect.name].keep:
        value = effect.values.get(parameter.name, 0.0)
        low, high, size = parameter.low, parameter.high, abs(value)
        if parameter.name == "order":
            if not linear:
                continue  # whole number per turn
            low, high = 0.98 * value, 1.02 * value
            size = 0.002 * value
        elif parameter.bank:
            # a shape stays near the member of the bank that it was found at
            low, high = value / 4, value * 4
            if parameter.name == "place":
                low, high = -inf, inf
            size = 0.3 * abs(value)
        else:
            # a gap and a bristle are tiny beside the travel
            if not (size and parameter.name in ("half_gap", "distance")):
                size = max(size, 0.05 * scales.of(parameter.unit))
            if not -1.0 <= low <= high <= 1.0 or parameter.unit:
                low = -inf if low < 0 else 0.0
                high = inf
        if effect.name in ("drive_delay", "current_lag"):
            high = max(3.0 * value, 2.0 * scales.dt)  # a search far out finds aliases
        if effect.name == "drive_saturation":
            high = 2.0 * value
        if parameter.name == "share":
            low, high = SHARES
        if effect.name == "drive_offset":
            size = max(abs(value), 0.02 * scales.u[effect.on])
        frees.append(Free("effect", effect.key, parameter.name, low, high, size or 1.0))
    if effect.name == "cable_spring" and any(e.name == "drive_offset" for e in model.effects):
        frees = [f for f in frees if f.name != "offset"]  # one constant is enough
    if effect.name == "position_dependent_friction" and linear:
        frees = [f for f in frees if f.name == "sine"]  # a slope along the axis
    if effect.name == "shaft_compliance" and any(k.name == effect.on for k in model.rig.links):
        frees = [f for f in frees if f.name not in ("share", "far_viscous")]
    return frees


def on_slide(model: ChainModel, body: str) -> bool:
    """Whether a body slides instead of turning."""
    return any(b.name == body.removesuffix(FAR) and b.linear for b in model.rig.bodies)


def log_parameters(model: ChainModel, balance: Balance, log: str, reference: str) -> list[Free]:
    """Return what belongs to one log; phases are counted from those of the reference log."""
    frees = []
    layout = model.layout
    seen = {layout.coordinate[layout.sensor_body[p.name]] for p in balance.points}
    for k, link in enumerate(layout.links):
        ends = [layout.bodies[i] for i in model.plant().link_body[k]]
        if all(layout.coordinate[b] in seen for b in ends):
            frees.append(Free("twist", log, link, -inf, inf, 1e-3))
    for effect in model.effects:
        if log != reference and has_phase(model, balance, effect):
            size = 0.1 / effect.values.get("order", 1.0)
            frees.append(Free("zero", log, effect.key, -inf, inf, size))
    return frees


def has_phase(model: ChainModel, balance: Balance, effect: Placed) -> bool:
    """Whether an effect goes with the angle, of which each log has its own zero."""
    slope = effect.name == "position_dependent_friction" and on_slide(model, effect.on)
    return effect.name in HARMONIC and not slope and not absolute(model, balance, effect.on)


def absolute(model: ChainModel, balance: Balance, body: str) -> bool:
    """Whether the angle of a body has the same zero in every log."""
    group = model.layout.coordinate[body]
    return any(
        s.absolute and model.layout.coordinate[model.layout.sensor_body[s.name]] == group
        for s in balance.rig.sensors
    )


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

    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        list(pool.map(column, range(len(frees))))
    return tuple(columns)


def _step(free: Free) -> float:
    if _has_kinks(free):
        return KINKS[free.owner.partition("@")[0]] * free.scale
    return DIFFERENCE * free.scale


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
