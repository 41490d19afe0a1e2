"""Maximum-a-posteriori fit of declared parameters, and of effects, to logs.

J = tau Σ ρ(r/σ) + ‖(p − p0)/s‖², Gauss–Newton with bounds. `p` are the free parameters of
the drive, each scaled so that its declared range is [−1, 1], and amplitudes and shapes of
effects, scaled by their `step`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import lsq_linear

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import Record, difference, predict, settled
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.compiled import BODIES
from dmptm_ctrl.simulate.damping import DAMPING, FLANKS, OF_FLANKS, by_depth, damped, damping_of
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.observer import observer_gains

CORRELATION_SECONDS = 0.1  # how long a model error lasts: samples closer than this are not news
PRIOR_SHARE = 0.6  # standard deviation of a uniform range, as a share of its half-width
# Standard deviation of an amplitude, as a share of its bound: where logs tell only the sum of
# two (both motors' cogging without motor encoders), neither runs away.
AMPLITUDE_SHARE = 0.3
AT_ONCE = 16  # models of one call
PERTURBATION = 0.01  # relative; well inside what is known of stiffness and damping
BEND = 4.0  # standard deviations beyond which a speed residual counts by its logarithm only
FLATTEST = 1e-14  # curvature of a step's square, as a share of the largest: what rounding leaves
NOWHERE = 1e-12  # width of a step at a bound
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
        drives = [model.arrays() for model in models]
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


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model with what is needed to judge it."""

    model: Model
    unknowns: tuple[Unknown, ...]
    p: Floats
    covariance: Floats

    def value(self, effect: str | None, name: str) -> tuple[float, float]:
        """Return value and standard error of one unknown, in its own unit."""
        for j, k in enumerate(self.unknowns):
            if (k.effect, k.name) == (effect, name):
                return (
                    k.centre + k.scale * float(self.p[j]),
                    k.scale * float(np.sqrt(max(self.covariance[j, j], 0.0))),
                )
        raise KeyError(f"{name} of {effect or 'the drive'} was not fitted")


def bounded_step(
    r: Floats, jac: Floats, p: Floats, unknowns: Sequence[Unknown], damping: float
) -> Floats:
    """Return the bounded step δ of min ‖r − J δ‖² + ‖(p + δ)/prior‖² + damping ‖δ‖²_diag."""
    precision = np.diag([1.0 / k.prior**2 for k in unknowns])
    # A weak pull keeps effects' parameters that the data say nothing about where they are.
    normal = jac.T @ jac + precision + 1e-6 * np.eye(p.size)
    normal += damping * np.diag(np.diag(normal))
    low = np.array([k.low for k in unknowns]) - p
    high = np.array([k.high for k in unknowns]) - p
    return least_in_box(normal, jac.T @ r - precision @ p, low, high)


def least_in_box(normal: Floats, slope: Floats, low: Floats, high: Floats) -> Floats:
    """Return the x between bounds at which ½ xᵀ A x − bᵀ x is least.

    `normal` (k, k) is A, of numbers of like scale; directions that it does not tell stay put.
    """
    values, vectors = np.linalg.eigh(normal)
    if values[-1] <= 0.0:  # nothing is told
        return np.zeros(slope.size)
    root = np.sqrt(np.maximum(values, FLATTEST * values[-1]))
    target = (vectors / root).T @ slope
    bounds = np.minimum(low, -NOWHERE), np.maximum(high, NOWHERE)
    return np.asarray(lsq_linear((vectors * root).T, target, bounds, method="bvls").x)
