"""What a fit of a dual-motor drive moves, and its bounded steps.

The numbers are the free parameters of the drive, each scaled so that its declared range is
[−1, 1], and amplitudes and shapes of effects, scaled by their `step`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.model import Floats, Model

PRIOR_SHARE = 0.6  # standard deviation of a uniform range, as a share of its half-width
# Standard deviation of an amplitude, as a share of its bound: where logs show only the sum of
# two (both motors' cogging without motor encoders), neither runs away.
AMPLITUDE_SHARE = 0.3
FLATTEST = 1e-14  # curvature of a step's square, as a share of the largest: what rounding leaves
ROUNDED = 1e-12  # of the largest slope; what pushes off a bound by less is rounding
MOST_SETS = 10  # of active numbers that are tried, per number


@dataclass(frozen=True)
class Unknown:
    """One number to fit.

    Attributes
    ----------
    effect : str or None
        None for a parameter of the drive.
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

    @property
    def label(self) -> str:
        """Its name, behind that of the effect if it is one's."""
        return self.name if self.effect is None else f"{self.effect}.{self.name}"

    def of(self, model: Model) -> float:
        """Return the value that a model has."""
        if self.effect is None:
            return float(model.drive[self.name])
        return float(model.effects.get(self.effect, {}).get(self.name, 0.0))


def drive_unknowns(model: Model) -> tuple[Unknown, ...]:
    """Return the free parameters of the drive, centred on their declared ranges."""
    unknowns = []
    for name in model.drive.free:
        low, high = model.drive.quantities[name].range
        unknowns.append(
            Unknown(None, name, 0.5 * (low + high), 0.5 * (high - low), -1.0, 1.0, PRIOR_SHARE)
        )
    return tuple(unknowns)


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


def placed(model: Model, unknowns: Sequence[Unknown], p: Floats) -> Model:
    """Return the model itself where it has these values, or else one that does."""
    known = all(k.effect is None or k.name in model.effects.get(k.effect, ()) for k in unknowns)
    there = known and np.array_equal(p, position(model, unknowns))
    return model if there else place(model, unknowns, p)


def position(model: Model, unknowns: Sequence[Unknown]) -> Floats:
    """Return `p` for the values that the model has."""
    return np.array([(k.of(model) - k.centre) / k.scale for k in unknowns])


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


class Normal(NamedTuple):
    """The square ‖r − J δ‖² + ‖(p + δ)/prior‖² of a step δ: δᵀ A δ − 2 bᵀ δ and a constant."""

    matrix: Floats  # A
    slope: Floats  # b
    low: Floats  # bounds of δ
    high: Floats

    @classmethod
    def of(cls, r: Floats, jac: Floats, p: Floats, unknowns: Sequence[Unknown]) -> "Normal":
        """Square of a step from p."""
        precision = np.diag([1.0 / k.prior**2 for k in unknowns])
        # A weak pull keeps effects' parameters that the data say nothing about where they are.
        matrix = jac.T @ jac + precision + 1e-6 * np.eye(p.size)
        low, high = (np.array([getattr(k, end) for k in unknowns]) - p for end in ("low", "high"))
        return cls(matrix, jac.T @ r - precision @ p, low, high)

    def step(self, damping: float) -> Floats:
        """Return the bounded step at which the square, and damping ‖δ‖²_diag, is least."""
        damped = self.matrix + damping * np.diag(np.diag(self.matrix))
        return least_in_box(damped, self.slope, self.low, self.high)


def least_in_box(normal: Floats, slope: Floats, low: Floats, high: Floats) -> Floats:
    """Return the x between bounds at which ½ xᵀ A x − bᵀ x is least.

    `normal` (k, k) is A, of numbers of like scale; directions that it does not determine stay put.
    `low` and `high` hold 0 between them.
    Source: active sets, Stark and Parker, Computational Statistics 10 (1995) 129.
    """
    whole = float(np.trace(normal))
    if whole <= 0.0:  # nothing is determined
        return np.zeros(slope.size)
    square = normal + FLATTEST * whole * np.eye(slope.size)
    x = np.clip(np.linalg.solve(square, slope), low, high)
    free, least = (x > low) & (x < high), ROUNDED * float(np.abs(slope).max())
    for _ in range(MOST_SETS * slope.size):
        target, own = x.copy(), np.flatnonzero(free)
        rest = slope[own] - square[own][:, ~free] @ x[~free]
        target[own] = np.linalg.solve(square[np.ix_(own, own)], rest)
        beyond = np.flatnonzero((target < low) | (target > high))
        if beyond.size:  # go on to the first bound, and stay there
            way = target - x
            ends = np.where(way < 0.0, low, high)
            reach = (ends[beyond] - x[beyond]) / way[beyond]
            first = beyond[np.argmin(reach)]
            x = np.clip(x + reach.min() * way, low, high)
            x[first], free[first] = ends[first], False
            continue
        x, push = target, slope - square @ target
        inwards = np.where(x <= low, push, -push) * (~free & (low < high))
        if inwards.max() <= least:
            break
        free[np.argmax(inwards)] = True
    return x


def secant(derivatives: Floats, change: Floats, step: Floats) -> Floats:
    """Return derivatives (…, k) that say what a step (k,) changed (…,), and differ least.

    Source: Broyden, Math. Comp. 19 (1965) 577.
    """
    return np.asarray(
        derivatives + ((change - derivatives @ step) / (step @ step))[..., None] * step
    )
