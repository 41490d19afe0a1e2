"""Who takes part in a race: the model as it is, and effects beside it in their shapes.

See :mod:`dmptm_ctrl.diagnosis.race`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.finish import Place
from dmptm_ctrl.diagnosis.rattle import GAP_DAMPING, tie
from dmptm_ctrl.diagnosis.trace import FIXED_SHAPES, SATURATED, Trial, unknowns_of
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit, Known, Unknown, is_damping, position
from dmptm_ctrl.identify.lock import HORIZONS, ROUGH, TINY, Seeker, Steps, cut, walk
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

ROUNDS = 2  # in which who begins anew draws closer
SIZES = (1.0, -1.0, 4.0, -4.0)  # of each amplitude, in its step, where who stayed behind begins
SIZED = 3  # of these, from which who joins late begins
# Shapes that are no slope, all tried: (seconds of each log, steps of a fit, how many go on).
SCAN = ((0.03, 2, 32), (0.05, 4, 12), (0.07, 4, 6), (0.1, 6, 4))
SHAPE_WIDTH = 10.0  # steps of a shape, about the value that the balances like best


@dataclass(eq=False)
class Runner(Seeker):
    """A candidate, or the model as it is, on its way.

    Attributes
    ----------
    name : str or None
        None for the model as it is.
    told : float
        Evidence of the balances for it.
    wave : int
        How many amplitudes over an angle it has behind the drive's own values.
    alone : bool
        Whether it may still try to go alone from the start.
    """

    name: str | None = None
    told: float = 0.0
    wave: int = 0
    alone: bool = True

    def from_place_of(self, other: "Runner") -> None:
        """Try the values of one with an effect, without it: a start may be all that it had ahead.

        Its own unknowns are behind those of the model as it is.
        """
        self.pursue(other.places[0][: len(self.unknowns)])

    def crosses(self, others: Sequence["Runner"], common: int) -> None:
        """Go on from the best of others' values of the drive, with the own effect or none.

        Another's effect may be wrong where the way that it found through the bounces is not.
        """
        nothing = position(self.model, self.unknowns)
        owns = [own[common:] for own in (self.places[0], nothing)]
        starts = [
            np.clip(
                np.concatenate([other.places[0][:common], own]), self.steps.low, self.steps.high
            )
            for other in others
            for own in (owns if owns[0].size else owns[:1])
        ]
        costs = self.steps.costs(self.steps.residuals(starts), starts)
        if costs.min() < self.cost:
            self.pursue(starts[int(np.argmin(costs))])

    def joins(self, bare: "Runner", records: Sequence[Record], jobs: int) -> bool:
        """Start anew from where the model as it is is, if some size of the effect misses less.

        What acts at the first reversal only has told nothing before it.
        """
        n = len(bare.unknowns)
        own = self.places[0][n:]
        drawn = [np.concatenate([bare.places[0], x]) for x in (own, *self.sizes(own, records))]
        steps = self.prepared(records, jobs, None)
        costs = steps.costs(steps.residuals(drawn), drawn)
        best = np.argsort(costs)[:SIZED]
        self.places = [np.clip(drawn[i], steps.low, steps.high) for i in best]
        return bool(costs[best[0]] < bare.cost)

    def sizes(self, own: Floats, records: Sequence[Record]) -> list[Floats]:
        """Return an effect's unknowns with one amplitude after another of several sizes."""
        unknowns = self.unknowns[-own.size :]
        amplitudes = CATALOGUE[str(self.name)].amplitudes
        sizes: Sequence[float] = SIZES
        if self.name == "drive_saturation":
            top = max(float(np.abs(rec.u).max()) for rec in records)
            sizes = [1.0 / (share * top * unknowns[0].scale) for share in SATURATED]
        several = []
        for j, size in product(range(own.size), sizes):
            if unknowns[j].name in amplitudes and unknowns[j].low <= size <= unknowns[j].high:
                one = own.copy()
                one[j] = size
                several.append(one)
        return several

    def from_the_start(self, records: Sequence[Record], seconds: float, jobs: int) -> None:
        """Try where a lock comes out that goes alone, with more care at each horizon."""
        horizons = [h for h in HORIZONS if h <= seconds]
        self.alone = False
        found = walk(self.afresh(), records, horizons, jobs)
        if found.horizon == seconds:
            self.pursue(found.p)

    def afresh(self, **how: Any) -> Seeker:
        """Return one of its kind that knows nothing but what was known beforehand."""
        covariance = np.asarray(np.linalg.inv(self.known.precision), np.float64)
        places = [self.known.mean]
        return Seeker(self.model, self.unknowns, self.known, places, covariance, **how)

    def scatters(self, records: Sequence[Record], jobs: int) -> None:
        """Begin anew as well, from the best of many places that balances hold possible."""
        fresh = self.afresh(rng=self.rng)
        fresh.scatter(records, jobs)
        fresh.closer(ROUNDS)
        self.pursue(*fresh.different(len(self.places)))

    def steps_down(self, records: Sequence[Record], iterations: int) -> None:
        """Go a few steps down from where it is, without a look around."""
        steps = Steps(records, self.model, self.unknowns, self.known, 1, ROUGH)
        self.places = [steps.descend(self.places[0], iterations)[0]]
        self.cost = float(steps.costs(steps.residuals(self.places), self.places)[0])

    def place(self) -> Place:
        """Return where it is."""
        return Place(self.name, self.steps, self.places[0], self.cost, self.level)


def together(action: Callable[..., None], some: Sequence[Runner], jobs: int, *args: Any) -> None:
    """Let some runners do the same, each on a thread of its own; who takes longest begins.

    One alone has all threads.
    """
    some = sorted(some, key=lambda runner: -len(runner.places))
    in_threads(lambda runner: action(runner, *args), some, jobs)


def with_effect(
    trial: Trial, values: Mapping[str, float], start: BalanceFit, known: Known
) -> Runner:
    """Enter an effect of some shape, from nothing and from what the balances make of it.

    What they know of the drive they know beside the effect: without it they have taken up a
    part of it elsewhere.
    """
    name, own = trial.name, unknowns_of(trial.name)
    bare = dict.fromkeys(CATALOGUE[name].amplitudes, 0.0)
    model = start.model.with_effect(name, **{**values, **bare})
    unknowns = (*start.unknowns, *own)
    if values != trial.fit.model.effects[name]:
        return entrant(name, model, unknowns, beside(known, model, own), ())
    known = loosened(meshes_from(start, trial.fit))
    entered = entrant(name, model, unknowns, known, (known.mean,))
    entered.told = trial.evidence
    return entered


def meshes_from(start: BalanceFit | Fit, fit: BalanceFit) -> BalanceFit:
    """Take the damping of meshes and gaps, which balances do not tell, from another fit.

    That of the meshes as it follows the rest of the drive.
    """
    p, covariance = fit.p.copy(), fit.covariance.copy()
    of_drive = [k for k in start.unknowns if k.effect is None or is_damping(k)]
    names = [k.name for k in of_drive]
    if GAP_DAMPING in names:
        j = names.index(GAP_DAMPING)
        p[j] = start.p[j]
        tie(covariance, j, variance=start.covariance[j, j])
    for j in (j for j, k in enumerate(of_drive) if is_damping(k)):
        rest = [i for i in range(len(names)) if i != j]
        with_rest = start.covariance[rest, j]
        slopes = np.zeros(p.size)
        slopes[rest] = np.linalg.solve(start.covariance[np.ix_(rest, rest)], with_rest)
        p[j] = start.p[j] + slopes[rest] @ (p[rest] - start.p[rest])
        tie(covariance, j, slopes, start.covariance[j, j] - slopes[rest] @ with_rest)
    return replace(fit, p=p, covariance=covariance)


def beside(known: Known, model: Model, own: Sequence[Unknown]) -> Known:
    """Add an effect's unknowns, of which only the likely size is known."""
    width = np.array([k.prior if np.isfinite(k.prior) else SHAPE_WIDTH for k in own])
    centre = np.where([np.isfinite(k.prior) for k in own], 0.0, position(model, own))
    n = known.mean.size
    precision = np.zeros((n + len(own),) * 2)
    precision[:n, :n] = known.precision
    precision[n:, n:] = np.diag(width**-2.0)
    return Known(np.concatenate([known.mean, centre]), precision)


def shaped(
    trial: Trial,
    start: BalanceFit,
    known: Known,
    records: Sequence[Record],
    jobs: int,
    *,
    scan: bool = True,
) -> list[Runner]:
    """Enter an effect in the shape that the balances like best, and in others they may not see.

    They average over orders beyond 25 Hz, and without motor encoders do not tell which motor.
    Where there are many others, and no scan is wanted, they stay out.
    """
    told = trial.fit.model.effects[trial.name]
    first = with_effect(trial, told, start, known)
    fixed = FIXED_SHAPES.get(trial.name, ())
    banks = [p for p in CATALOGUE[trial.name].parameters if p.name in fixed]
    others = [
        with_effect(trial, {**told, p.name: value}, start, known)
        for p in banks
        for value in p.bank
        if value != told[p.name]
    ]
    if not scan and len(others) > SCAN[0][-1]:
        return [first]
    for seconds, iterations, most in SCAN:
        if len(others) <= SCAN[-1][-1]:
            break
        parts = [cut(rec, seconds) for rec in records]
        together(Runner.steps_down, others, jobs, parts, iterations)
        others = sorted(others, key=lambda one: one.cost)[:most]
    return [first, *others]


def entrant(
    name: str | None,
    model: Model,
    unknowns: Sequence[Unknown],
    known: Known,
    others: Sequence[Floats],
) -> Runner:
    """Enter a model that starts from its own values and from others."""
    low, high = ([getattr(k, end) for k in unknowns] for end in ("low", "high"))
    starts = [np.clip(p, low, high) for p in (position(model, unknowns), *others)]
    precision = known.precision + TINY * np.eye(len(unknowns))
    covariance = np.asarray(np.linalg.inv(precision), np.float64)
    known = Known(known.mean, precision)
    return Runner(model, tuple(unknowns), known, starts, covariance, stalled=ROUGH, name=name)
