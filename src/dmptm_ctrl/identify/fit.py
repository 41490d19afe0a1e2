"""Maximum-a-posteriori fit of declared parameters, and of effects, to logs.

J = tau Σ ρ(r/σ) + ‖(p − p0)/s‖², Gauss–Newton with bounds. `p` are the free parameters of
the drive, each scaled so that its declared range is [−1, 1], and amplitudes and shapes of
effects, scaled by their `step`.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import lsq_linear

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import Record, difference, predict, settled
from dmptm_ctrl.simulate.model import Floats, Model

CORRELATION_SECONDS = 0.1  # how long a model error lasts: samples closer than this are not news
PRIOR_SHARE = 0.6  # standard deviation of a uniform range, as a share of its half-width
PROBE = 0.3  # difference step, in half-ranges: beyond the roughness of contact events
HUBER = 2.5  # robust standard deviations beyond which a residual counts linearly
FLOOR = {  # model error that no parameter mends; below it a channel is not judged more finely
    "speed": np.deg2rad(0.03),  # rad/s in a 10 ms block
    "twist_l": np.deg2rad(0.15 / 60),  # rad at the pinion
    "twist_r": np.deg2rad(0.15 / 60),
}


@dataclass(frozen=True)
class Unknown:
    """One number to fit.

    Attributes
    ----------
    effect : str or None
        None for a parameter of the drive.
    name : str
    centre, scale : float
        value = centre + scale · p.
    low, high : float
        Bounds of p.
    prior : float
        Standard deviation of p around 0; infinite for an effect's parameters.
    """

    effect: str | None
    name: str
    centre: float
    scale: float
    low: float
    high: float
    prior: float


def drive_unknowns(model: Model) -> tuple[Unknown, ...]:
    """Return the free parameters of the drive, centred on their declared ranges."""
    unknowns = []
    for name in model.drive.free:
        low, high = model.drive.quantities[name].range
        unknowns.append(
            Unknown(None, name, 0.5 * (low + high), 0.5 * (high - low), -1.0, 1.0, PRIOR_SHARE)
        )
    return tuple(unknowns)


def effect_unknowns(name: str, *, shapes: bool = True) -> tuple[Unknown, ...]:
    """Return the parameters of an effect; `shapes` includes order, place, time constant."""
    return tuple(
        Unknown(name, p.name, 0.0, p.step, p.low / p.step, p.high / p.step, np.inf)
        for p in CATALOGUE[name].parameters
        if shapes or not p.bank
    )


def place(model: Model, unknowns: Sequence[Unknown], p: Floats) -> Model:
    """Return the model with the values that `p` stands for."""
    drive: dict[str, float] = {}
    effects = {name: dict(values) for name, values in model.effects.items()}
    for unknown, x in zip(unknowns, p, strict=True):
        value = unknown.centre + unknown.scale * float(x)
        if unknown.effect is None:
            drive[unknown.name] = value
        else:
            effects.setdefault(unknown.effect, {})[unknown.name] = value
    return Model(model.drive.with_values(**drive), effects)


def position(model: Model, unknowns: Sequence[Unknown]) -> Floats:
    """Return `p` for the values that the model has."""
    values = [
        model.drive[k.name] if k.effect is None else model.effects.get(k.effect, {}).get(k.name, 0.0)
        for k in unknowns
    ]
    return np.array([(v - k.centre) / k.scale for v, k in zip(values, unknowns, strict=True)])


@dataclass(frozen=True, eq=False)
class Weights:
    """Per record: 1/σ per channel and block, zero where the model is not judged."""

    rows: tuple[Floats, ...]
    scales: tuple[Floats, ...]


@dataclass(eq=False)
class Misfit:
    """The residual of a model on records, as a vector.

    Parameters
    ----------
    records : sequence of Record
    bandwidth_hz : float
        Of the slow lead by the measured angle; 0 is a free run.
    jobs : int
        Threads; the compiled loop does not hold the interpreter lock.
    """

    records: Sequence[Record]
    bandwidth_hz: float = 0.05
    jobs: int = 2
    weights: Weights | None = None
    simulations: int = field(default=0)

    def runs(self, model: Model) -> list[Floats]:
        """Simulate every record."""
        arrays = model.arrays()
        return [predict(rec, arrays, self.bandwidth_hz) for rec in self.records]

    def differences(self, model: Model, runs: Sequence[Floats] | None = None) -> list[Floats]:
        """Return measured minus simulated per record, (channels, blocks)."""
        n1, n2 = model.drive["N_1"], model.drive["N_2"]
        outs = self.runs(model) if runs is None else runs
        self.simulations += len(self.records) if runs is None else 0
        return [difference(rec, out, n1, n2) for rec, out in zip(self.records, outs, strict=True)]

    def weigh(self, model: Model) -> Weights:
        """Robust scales and masks from the residual of `model`; kept for what follows."""
        gaps = (model.drive["gap_l"], model.drive["gap_r"])
        rows, scales = [], []
        outs = self.runs(model)
        for rec, out, diff in zip(
            self.records, outs, self.differences(model, outs), strict=True
        ):
            keep = settled(rec, out, gaps)
            floor = np.array([FLOOR[c] for c in rec.channels])
            spread = np.array(
                [
                    1.4826 * np.median(np.abs(d[k])) if k.any() else 0.0
                    for d, k in zip(diff, keep, strict=True)
                ]
            )
            sigma = np.hypot(floor, spread)
            size = np.abs(diff) / sigma[:, None]
            huber = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-12)))
            rows.append(keep * huber / sigma[:, None])
            scales.append(sigma)
        self.weights = Weights(tuple(rows), tuple(scales))
        return self.weights

    def vector(self, model: Model) -> Floats:
        """Return the weighted residual of all records in one vector."""
        if self.weights is None:
            self.weigh(model)
        assert self.weights is not None
        return self.weighted(self.differences(model))

    def weighted(self, diffs: Sequence[Floats]) -> Floats:
        """Weight and stack differences; scaled so that its square counts independent news."""
        assert self.weights is not None
        parts = []
        for rec, diff, row in zip(self.records, diffs, self.weights.rows, strict=True):
            news = np.sqrt(min(1.0, rec.block * rec.dt / CORRELATION_SECONDS))
            parts.append((news * row * diff).ravel())
        return np.concatenate(parts)

    def columns(self, model: Model, unknowns: Sequence[Unknown], r0: Floats) -> Floats:
        """Return d(−r)/dp by differences away from the bounds, (m, len(unknowns))."""
        p0 = position(model, unknowns)

        def column(j: int) -> Floats:
            unknown = unknowns[j]
            step = PROBE if unknown.effect is None else 1.0
            if p0[j] + step > unknown.high:
                step = -step
            p = p0.copy()
            p[j] += step
            return (r0 - self.vector(place(model, unknowns, p))) / step

        return self.map(column, range(len(unknowns)))

    def map(self, function: Callable[[int], Floats], items: Sequence[int]) -> Floats:
        """Stack columns computed on `jobs` threads."""
        with ThreadPoolExecutor(self.jobs) as pool:
            done = list(pool.map(function, items))
        return np.array(done).T if done else np.empty((0, 0))


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model with what is needed to judge it."""

    model: Model
    unknowns: tuple[Unknown, ...]
    p: Floats
    cost: float
    residual: Floats
    jacobian: Floats
    covariance: Floats
    start_cost: float

    def value(self, effect: str | None, name: str) -> tuple[float, float]:
        """Return value and standard error of one unknown, in its own unit."""
        for j, k in enumerate(self.unknowns):
            if (k.effect, k.name) == (effect, name):
                return (
                    k.centre + k.scale * float(self.p[j]),
                    k.scale * float(np.sqrt(max(self.covariance[j, j], 0.0))),
                )
        raise KeyError(f"{name} of {effect or 'the drive'} was not fitted")

    @property
    def at_bounds(self) -> tuple[str, ...]:
        """Names of unknowns that sit on a bound."""
        return tuple(
            k.name
            for k, x in zip(self.unknowns, self.p, strict=True)
            if min(x - k.low, k.high - x) < 1e-6
        )


def prior_cost(unknowns: Sequence[Unknown], p: Floats) -> float:
    """Return ‖p/s‖²."""
    s = np.array([k.prior for k in unknowns])
    return float(np.sum((p / s) ** 2))


def gauss_newton_step(r: Floats, jac: Floats, p: Floats, unknowns: Sequence[Unknown]) -> Floats:
    """Return the bounded step δ of min ‖r − J δ‖² + ‖(p + δ)/s‖²."""
    s = np.array([k.prior for k in unknowns])
    # A weak pull keeps effects' parameters that the data say nothing about where they are.
    inverse = np.where(np.isfinite(s), 1.0 / s, 1e-3)
    pull = np.where(np.isfinite(s), p / s, 0.0)
    a = np.vstack([jac, np.diag(inverse)])
    b = np.concatenate([r, -pull])
    low = np.array([k.low for k in unknowns]) - p
    high = np.array([k.high for k in unknowns]) - p
    solution = lsq_linear(a, b, (np.minimum(low, -1e-12), np.maximum(high, 1e-12)), method="bvls")
    return np.asarray(solution.x)


def fit(
    misfit: Misfit,
    model: Model,
    unknowns: Sequence[Unknown],
    *,
    iterations: int = 4,
    jacobian: Floats | None = None,
    reweigh: bool = False,
    tolerance: float = 1e-3,
) -> Fit:
    """Fit unknowns to records, from the values that `model` has.

    Parameters
    ----------
    jacobian : (m, k) array, optional
        Columns of the first k unknowns at `model`, to be used in the first step.
    reweigh : bool
        Renew robust scales and masks at each iterate (base fit); otherwise keep them.
    tolerance : float
        Relative fall of the cost below which the fit ends.

    Returns
    -------
    Fit
    """
    unknowns = tuple(unknowns)
    p = position(model, unknowns)
    p = np.clip(p, [k.low for k in unknowns], [k.high for k in unknowns])
    model = place(model, unknowns, p)
    jac = np.empty((0, 0))
    start = None
    for _ in range(iterations):
        if reweigh or misfit.weights is None:
            misfit.weigh(model)
        r = misfit.vector(model)
        cost = float(r @ r) + prior_cost(unknowns, p)
        start = cost if start is None else start
        if jacobian is not None:
            k = jacobian.shape[1]
            rest = misfit.columns(model, unknowns[k:], r) if k < len(unknowns) else None
            jac = jacobian if rest is None else np.hstack([jacobian, rest])
            jacobian = None
        else:
            jac = misfit.columns(model, unknowns, r)
        step = gauss_newton_step(r, jac, p, unknowns)
        size, better = 1.0, False
        while size > 0.1:
            trial = np.clip(
                p + size * step, [k.low for k in unknowns], [k.high for k in unknowns]
            )
            trial_model = place(model, unknowns, trial)
            trial_r = misfit.vector(trial_model)
            trial_cost = float(trial_r @ trial_r) + prior_cost(unknowns, trial)
            if trial_cost < cost:
                better = True
                break
            size *= 0.5
        if not better:
            break
        gain = cost - trial_cost
        p, model, r, cost = trial, trial_model, trial_r, trial_cost
        if gain < tolerance * cost:
            break
    precision = jac.T @ jac + np.diag([1.0 / k.prior**2 + 1e-9 for k in unknowns])
    return Fit(
        model,
        unknowns,
        p,
        cost,
        r,
        jac,
        np.linalg.inv(precision),
        cost if start is None else start,
    )


def renamed(fitted: Fit, **changes: object) -> Fit:
    """Return a copy with fields replaced."""
    return replace(fitted, **changes)  # type: ignore[arg-type]


def effect_values(model: Model, name: str) -> Mapping[str, float]:
    """Return the parameters of an effect in a model."""
    return model.effects[name]
