"""Maximum-a-posteriori fit of declared parameters, and of effects, to logs.

J = tau Σ ρ(r/σ) + ‖(p − p0)/s‖², Gauss–Newton with bounds. `p` are the free parameters of
the drive, each scaled so that its declared range is [−1, 1], and amplitudes and shapes of
effects, scaled by their `step`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import Record, difference, predict, settled
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.compiled import BODIES, observer_gains
from dmptm_ctrl.simulate.compose import layout
from dmptm_ctrl.simulate.damping import DAMPING, FLANKS, OF_FLANKS, by_depth, damped, damping_of
from dmptm_ctrl.simulate.model import BASE, Floats, Model, Stacked, stacked

CORRELATION_SECONDS = 0.1  # how long a model error lasts: samples closer than this are not news
PRIOR_SHARE = 0.6  # standard deviation of a uniform range, as a share of its half-width
# Standard deviation of an amplitude, as a share of its bound: where logs tell only the sum of
# two (both motors' cogging without motor encoders), neither runs away.
AMPLITUDE_SHARE = 0.3
# Difference steps, in half-ranges, taken in turn: beyond the roughness of contact events, and
# never the same twice, so that no event spoils a column for good.
PROBES = (0.3, 0.15)
AT_ONCE = 16  # models of one call
DAMPINGS = (0.0, 1.0, 5.0, 30.0)  # of a step, relative to the diagonal; all are tried
PERTURBATION = 0.01  # relative; well inside what is known of stiffness and damping
BEND = 4.0  # standard deviations beyond which a speed residual counts by its logarithm only
CAP = (
    3.0  # standard deviations that a twist residual cannot exceed: on another flank it says no more
)
FLOOR = {  # model error that no parameter mends; below it a channel is not judged more finely
    "speed": np.deg2rad(0.03),  # rad/s in a block
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
    """Return the free parameters of the drive, centred on their declared ranges.

    With flanks that damp by depth, their damping as well.
    """
    unknowns = []
    for name in model.drive.free:
        low, high = model.drive.quantities[name].range
        unknowns.append(
            Unknown(None, name, 0.5 * (low + high), 0.5 * (high - low), -1.0, 1.0, PRIOR_SHARE)
        )
    if by_depth(model):
        (own,) = (p for p in CATALOGUE[FLANKS].parameters if p.name == OF_FLANKS)
        usual = 4.0 * own.step  # about the middle of what is possible, see `simulate.damping`
        most = own.high / usual - 1.0
        unknowns.append(Unknown(FLANKS, OF_FLANKS, usual, usual, -1.0, most, PRIOR_SHARE))
    return tuple(unknowns)


def is_damping(unknown: Unknown) -> bool:
    """Whether an unknown is the damping of the meshes, by either law of their flanks."""
    return (unknown.effect, unknown.name) in ((None, DAMPING), (FLANKS, OF_FLANKS))


def effect_unknowns(name: str) -> tuple[Unknown, ...]:
    """Return the parameters of an effect; amplitudes are not expected beyond their bounds."""
    return tuple(
        Unknown(
            name,
            p.name,
            0.0,
            p.step,
            p.low / p.step,
            p.high / p.step,
            np.inf if p.bank else AMPLITUDE_SHARE * p.high / p.step,
        )
        for p in CATALOGUE[name].parameters
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


class Drives:
    """Numbers of many drives that differ in some unknowns; no model is made of each.

    Parameters
    ----------
    model : Model
    unknowns : sequence of Unknown
    """

    def __init__(self, model: Model, unknowns: Sequence[Unknown]) -> None:
        self._all = place(model, unknowns, position(model, unknowns)).arrays()
        self._centre = np.array([k.centre for k in unknowns])
        self._scale = np.array([k.scale for k in unknowns])
        slots = layout()
        own = [(j, k) for j, k in enumerate(unknowns) if k.effect is None]
        others = [(j, k.effect, k.name) for j, k in enumerate(unknowns) if k.effect is not None]
        self._bases = [j for j, _ in own], [BASE.index(k.name) for _, k in own]
        self._values = (
            [j for j, _, _ in others],
            [slots[effect][1] + _place_in(effect, name) for _, effect, name in others],
        )
        self._switched = [
            (slots[e][0], [slots[e][1] + _place_in(e, a) for a in CATALOGUE[e].amplitudes])
            for e in dict.fromkeys(effect for _, effect, _ in others)
        ]

    def __call__(self, several: Sequence[Floats]) -> Stacked:
        """Return ``place(model, unknowns, p).arrays()`` of several `p`."""
        numbers = self._centre + np.asarray(several) * self._scale
        count = len(several)
        bases, flags, rows = (np.empty((count, x.size), x.dtype) for x in self._all)
        bases[:], flags[:], rows[:] = self._all
        for table, (which, columns) in ((bases, self._bases), (rows, self._values)):
            if columns:
                table[:, columns] = numbers[:, which]
        for index, amplitudes in self._switched:
            flags[:, index] = np.any(rows[:, amplitudes] != 0.0, axis=1)
        return Stacked(bases, flags, rows)


def arrays_at(model: Model, unknowns: Sequence[Unknown], several: Sequence[Floats]) -> Stacked:
    """Return ``place(model, unknowns, p).arrays()`` of several `p`."""
    return Drives(model, unknowns)(several)


def _place_in(effect: str, parameter: str) -> int:
    """Place of a parameter among its effect's."""
    return [p.name for p in CATALOGUE[effect].parameters].index(parameter)


def position(model: Model, unknowns: Sequence[Unknown]) -> Floats:
    """Return `p` for the values that the model has."""
    values = [
        model.drive[k.name]
        if k.effect is None
        else model.effects.get(k.effect, {}).get(k.name, 0.0)
        for k in unknowns
    ]
    return np.array([(v - k.centre) / k.scale for v, k in zip(values, unknowns, strict=True)])


def bend(x: Floats) -> Floats:
    """Bend large weighted residuals (channels, blocks) over, so that no event rules a fit."""
    bent = x / np.hypot(1.0, x / CAP)
    bent[0] = BEND * np.arcsinh(x[0] / BEND)
    return bent


def jogged(model: Model, by: float) -> list[Model]:
    """Return models with meshes a little other: some times `by`, relative."""
    k_m, c = model.drive["k_m"], damping_of(model)
    return [
        damped(model.with_values(k_m=k_m * (1.0 + by * a)), c * (1.0 + by * b))
        for a, b in ((1.0, 2.0), (-1.0, 3.0), (2.0, -3.0), (-2.0, -2.0))
    ]


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
    weights : tuple of (channels, blocks) arrays, optional
        1/σ per record, zero where the model is not judged; see :meth:`weigh`.
    """

    records: Sequence[Record]
    bandwidth_hz: float = 0.05
    jobs: int = 2
    weights: tuple[Floats, ...] | None = None

    def runs(self, model: Model) -> list[Floats]:
        """Simulate every record."""
        arrays = model.arrays()
        return in_threads(
            lambda rec: predict(rec, arrays, self.bandwidth_hz),
            self.records,
            self.jobs,
            lambda rec: rec.omega.size,
        )

    def differences(self, models: Sequence[Model]) -> list[list[Floats]]:
        """Return measured minus simulated of several models per record, (channels, blocks)."""
        drives = stacked([model.arrays() for model in models])
        ratios = [(model.drive["N_1"], model.drive["N_2"]) for model in models]

        def some(task: tuple[Record, int]) -> list[Floats]:  # runs take memory
            rec, first = task
            led = observer_gains(self.bandwidth_hz, rec.dt) if self.bandwidth_hz > 0 else None
            runs = march_any(
                drives[first : first + AT_ONCE],
                rec.u,
                rec.x0,
                rec.dt,
                observer=led,
                measured=rec.theta,
                columns=range(BODIES),
            )
            own = ratios[first : first + AT_ONCE]
            return [difference(rec, run, *n) for run, n in zip(runs, own, strict=True)]

        parts = range(0, len(models), AT_ONCE)
        tasks = [(rec, first) for rec in self.records for first in parts]
        done = iter(in_threads(some, tasks, self.jobs))
        return [[diff for _ in parts for diff in next(done)] for _ in self.records]

    def unpredictable(self, model: Model) -> list[Floats]:
        """Return, per record, the standard deviation that rattle gives to each block.

        After a reversal the pinions bounce; parameters changed by less than anyone knows them
        then give another motion. Its spread is what no fit can explain.
        """
        kernel = np.ones(10) / 10  # the spread of four runs is smoothed over 50 ms
        return [
            np.sqrt(
                [
                    np.convolve(row, kernel, "same")
                    for row in np.mean([(own - other) ** 2 for other in others], axis=0)
                ]
            )
            for own, *others in self.differences([model, *jogged(model, PERTURBATION)])
        ]

    def weigh(self, model: Model) -> None:
        """Robust scales and masks from the residual of `model`; kept for what follows."""
        gaps = (model.drive["gap_l"], model.drive["gap_r"])
        rows = []
        outs = self.runs(model)
        n1, n2 = model.drive["N_1"], model.drive["N_2"]
        for rec, out, chaos in zip(self.records, outs, self.unpredictable(model), strict=True):
            diff = difference(rec, out, n1, n2)
            keep = settled(rec, out, gaps)
            floor = np.array([FLOOR[c] for c in rec.channels])
            spread = np.array(
                [
                    1.4826 * np.median(np.abs(d[k])) if k.any() else 0.0
                    for d, k in zip(diff, keep, strict=True)
                ]
            )
            rows.append(keep / np.hypot(np.hypot(floor, spread)[:, None], chaos))
        self.weights = tuple(rows)

    def vectors(self, models: Sequence[Model]) -> Floats:
        """Return the weighted residuals of several models, a row each for all records.

        Scaled so that the square counts independent news.
        """
        if self.weights is None:
            self.weigh(models[0])
        assert self.weights is not None
        rows = [
            [(np.sqrt(self.news(rec)) * bend(weight * diff)).ravel() for diff in several]
            for rec, several, weight in zip(
                self.records, self.differences(models), self.weights, strict=True
            )
        ]
        return np.concatenate(rows, axis=1)

    def vector(self, model: Model) -> Floats:
        """Return the weighted residual of all records in one vector."""
        return np.asarray(self.vectors([model])[0])

    def square(self, model: Model) -> float:
        """Squared misfit of a model."""
        return float(np.sum(self.vector(model) ** 2))

    def news(self, rec: Record) -> float:
        """Share of a block's square that counts as independent."""
        return min(1.0, rec.block * rec.dt / CORRELATION_SECONDS)

    def columns(
        self, model: Model, unknowns: Sequence[Unknown], r0: Floats, probe: float = PROBES[0]
    ) -> Floats:
        """Return d(−r)/dp by differences away from the bounds, (m, len(unknowns))."""
        if not unknowns:
            return np.empty((r0.size, 0))
        p0 = position(model, unknowns)
        steps = np.array([probe if unknown.effect is None else 1.0 for unknown in unknowns])
        steps *= np.where(p0 + steps > [unknown.high for unknown in unknowns], -1.0, 1.0)
        moved = [place(model, unknowns, p) for p in p0 + np.diag(steps)]
        return np.asarray((r0 - self.vectors(moved)) / steps[:, None]).T


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model with what is needed to judge it.

    Attributes
    ----------
    horizon : float
        Seconds over which it keeps step with the logs bounce by bounce; 0 if none, or not tried.
    """

    model: Model
    unknowns: tuple[Unknown, ...]
    p: Floats
    covariance: Floats
    horizon: float = 0.0

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


class Known(NamedTuple):
    """What is known of the unknowns beforehand: a normal distribution."""

    mean: Floats
    precision: Floats

    def cost(self, p: Floats) -> float:
        """Return (p − mean)ᵀ precision (p − mean)."""
        return float((p - self.mean) @ self.precision @ (p - self.mean))

    def costs(self, several: Sequence[Floats]) -> Floats:
        """The same of several `p`."""
        off = np.array(several) - self.mean
        return np.asarray(np.sum(off @ self.precision * off, axis=1))


def declared(unknowns: Sequence[Unknown]) -> Known:
    """Return what the declaration says: independent, about the middle of each range."""
    s = np.array([k.prior for k in unknowns])
    return Known(np.zeros(s.size), np.diag(np.where(np.isfinite(s), 1.0 / s**2, 0.0)))


def bounded_step(
    r: Floats,
    jac: Floats,
    p: Floats,
    unknowns: Sequence[Unknown],
    damping: float,
    known: Known | None = None,
) -> Floats:
    """Return the bounded step δ of min ‖r − J δ‖² + known.cost(p + δ) + damping ‖δ‖²_diag."""
    mean, precision = known or declared(unknowns)
    # A weak pull keeps effects' parameters that the data say nothing about where they are.
    normal = jac.T @ jac + precision + 1e-6 * np.eye(p.size)
    normal += damping * np.diag(np.diag(normal))
    root = np.linalg.cholesky(normal).T
    target = np.linalg.solve(root.T, jac.T @ r - precision @ (p - mean))
    low = np.minimum(np.array([k.low for k in unknowns]) - p, -1e-12)
    high = np.maximum(np.array([k.high for k in unknowns]) - p, 1e-12)
    return np.asarray(lsq_linear(root, target, (low, high), method="bvls").x)


class Step(NamedTuple):
    """An iterate of the fit."""

    cost: float
    p: Floats
    model: Model
    r: Floats


def best_step(
    misfit: Misfit,
    model: Model,
    unknowns: Sequence[Unknown],
    p: Floats,
    r: Floats,
    jac: Floats,
    cost: float,
    known: Known,
) -> Step:
    """Try steps of all dampings; return the best, or where it is if none is better."""
    low, high = [k.low for k in unknowns], [k.high for k in unknowns]

    steps = in_threads(
        lambda damping: bounded_step(r, jac, p, unknowns, damping, known), DAMPINGS, misfit.jobs
    )
    trials = [np.clip(p + step, low, high) for step in steps]
    models = [place(model, unknowns, trial) for trial in trials]
    missed = misfit.vectors(models)
    costs = np.sum(missed**2, axis=1) + known.costs(trials)
    tried = [Step(float(x), *rest) for x, *rest in zip(costs, trials, models, missed, strict=True)]
    return min([Step(cost, p, model, r), *tried], key=lambda s: s.cost)


def fit(
    misfit: Misfit,
    model: Model,
    unknowns: Sequence[Unknown],
    *,
    iterations: int = 4,
    tolerance: float = 1e-3,
    known: Known | None = None,
) -> Fit:
    """Fit unknowns to records, from the values that `model` has.

    Parameters
    ----------
    tolerance : float
        Relative fall of the cost below which an iteration counts as stalled: columns are
        taken anew, and the fit ends when those of each difference step have stalled.
    known : Known, optional
        What is known beforehand; by default the declared ranges.

    Returns
    -------
    Fit
    """
    unknowns = tuple(unknowns)
    known = known or declared(unknowns)
    p = position(model, unknowns)
    p = np.clip(p, [k.low for k in unknowns], [k.high for k in unknowns])
    model = place(model, unknowns, p)
    if misfit.weights is None:
        misfit.weigh(model)
    r = misfit.vector(model)
    cost = float(r @ r) + known.cost(p)
    jac: Floats | None = None
    probe, fresh, stalled = 0, False, 0
    for _ in range(iterations):
        if jac is None:
            jac = misfit.columns(model, unknowns, r, PROBES[probe % len(PROBES)])
            probe, fresh = probe + 1, True
        best = best_step(misfit, model, unknowns, p, r, jac, cost, known)
        gain = cost - best.cost
        if gain > 0.0:
            change = best.p - p
            update = (r - best.r - jac @ change) / float(change @ change)
            jac = jac + np.outer(update, change)  # Broyden: columns follow for free
            p, r, cost, model = best.p, best.r, best.cost, best.model
        if gain < tolerance * cost:
            stalled = stalled + 1 if fresh else stalled
            if stalled == len(PROBES):
                break
            jac = None
        else:
            stalled = 0
        fresh = False
    if jac is None:
        jac = misfit.columns(model, unknowns, r)
    precision = jac.T @ jac + known.precision + 1e-9 * np.eye(p.size)
    return Fit(model, unknowns, p, np.asarray(np.linalg.inv(precision), np.float64))
