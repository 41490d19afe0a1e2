"""Fit whole runs sample by sample, over a horizon that grows while the model keeps up.

After a reversal the pinions bounce, and a small error of a parameter becomes another motion: a
fit over whole logs at once finds no way down. Over the first hundredths of a second the run
depends on the parameters smoothly. What they tell carries the fit through the first impacts,
these through the next, and so on: the parameters become so sharp that the bounces themselves
are met one by one. Where the laws of the machine are not the model's, the first impacts are
already missed, and the fit says so.
Source: the growing horizon is the usual way to fit chaotic motion, Baake et al., Phys. Rev. A
45 (1992) 5524; Voss, Timmer & Kurths, Int. J. Bifurcation Chaos 14 (2004) 1905.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dmptm_ctrl.identify.fit import Drives, Fit, Known, Unknown, place, position
from dmptm_ctrl.identify.led import EARLY_SECONDS, Bench
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.compiled import SUBSTEPS
from dmptm_ctrl.simulate.model import Floats, Model

RANKING_SUBSTEPS = 4  # where places are only ranked; what is pursued takes finer ones
HORIZONS = (0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.9)  # s
BLOCK_SECONDS = 0.002
FREEDOM = 4.0  # what has lost step counts by the logarithm of its miss only
NEWS = 0.2  # share of the samples that is independent
NOISE_LEVEL = 0.25  # mean loss per sample of noise alone
LOST = 0.6  # the same, above which the model has lost step
# Slopes are taken as far apart as values may still lie, in standard deviations, for one impact
# missed by a sample makes the loss jagged below; nearer where that leads nowhere.
REACH, NEARER, NEAREST = 0.7, 0.3, 0.05
FARTHEST = 1.0  # half-ranges, or steps of an effect, that a slope takes at most
DAMPINGS = np.array([0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0, 1000.0])  # of a step; all are tried
ITERATIONS = 8  # per horizon
LOOSE = 4.0  # factor on the variance of what balances know, before bounces sharpen it
TINY = 1e-9  # precision of what nothing is known about
SINGULAR = 1e-6  # of directions that bounds have made one
STALLED = 5e-3  # relative fall of the cost that ends them
ROUGH = 0.02  # the same where names are compared, which differ by far more
# The same, above which another start is looked for: from a wrong one the next impact is not met
DOUBTFUL = 0.32
UNEASY = 0.45  # mean loss per sample above which all is not well; noise gives 0.25
SEARCHED_SECONDS = 0.4  # up to which other starts are tried; later none that is drawn comes near
DRAWS, SIZES = 32, (0.3, 1.0)  # how many, and how far in standard deviations of what is known
PURSUED = 2  # of the draws that are fitted
SAME = 0.2  # half-ranges, or steps of an effect, by which no two values differ at one place
# Stuck early, it begins anew: horizon, how many places are drawn from what is known, how many of
# the best are fitted by how many steps, round by round.
ANEW_SECONDS, SCATTERED, FOLLOWED = 0.07, 256, ((24, 2), (8, 8))
# About how many places it draws closer, how far in standard deviations of what is known, and from
# how many of these it goes down.
CENTRES, CLOSER, AGAIN = 4, (0.2, 0.4), 12
OPEN = 2.0  # half-ranges, or steps of an effect, beyond which a value is not known but open
OPEN_SIZE = 4.0  # of such a value, if it may have either sign


@dataclass(frozen=True, eq=False)
class Locked:
    """How far a model keeps step with the logs, and with which values.

    Attributes
    ----------
    horizon : float
        Seconds from the start of each log over which every bounce is met; 0 if none.
    level : float
        Mean loss per sample there; noise alone gives about 0.25.
    covariance : (k, k) array
    """

    model: Model
    p: Floats
    horizon: float
    level: float
    covariance: Floats

    def as_fit(self, unknowns: tuple[Unknown, ...]) -> Fit:
        """The same as a fit of its unknowns."""
        return Fit(self.model, unknowns, self.p, self.covariance, self.horizon)

    def lasts(self) -> tuple[float, float]:
        """How well it keeps step: the longer the better, then the nearer."""
        return self.horizon, -self.level


def lock(
    records: Sequence[Record],
    model: Model,
    unknowns: Sequence[Unknown],
    known: Known,
    *,
    reached: float = 0.0,
    jobs: int = 2,
    seed: int = 0,
    anew: bool = True,
) -> Locked:
    """Fit unknowns to the starts of logs, sample by sample, over a growing horizon.

    Parameters
    ----------
    records : sequence of Record
        Each from rest.
    known : Known
        What is known of the unknowns beforehand.
    reached : float
        Seconds for which the model keeps step already: shorter horizons are left out.
    jobs : int
        Threads.
    seed : int
        Of the starts that are tried where the model is about to lose step.
    anew : bool
        Whether it begins anew where it got stuck.

    Returns
    -------
    Locked
        At the last horizon on which the model kept step; as it came if on none.
    """
    p = np.clip(position(model, unknowns), [k.low for k in unknowns], [k.high for k in unknowns])
    prior = np.asarray(np.linalg.inv(known.precision + TINY * np.eye(p.size)), np.float64)
    rng = np.random.default_rng(seed)
    one = Seeker(model, tuple(unknowns), known, [p], prior, rng=rng)
    longest = max(rec.dt * rec.omega.size for rec in records)
    ahead = [h for h in HORIZONS if reached <= h <= longest]
    best = walk(one, records, ahead, jobs)
    later = [h for h in ahead if h >= ANEW_SECONDS]
    if anew and later and best.horizon < min(SEARCHED_SECONDS, ahead[-1]):
        fresh = Seeker(model, tuple(unknowns), known, [p], prior / LOOSE, rng=rng)
        fresh.scatter([cut(rec, later[0]) for rec in records], jobs)
        best = max(best, walk(fresh, records, later, jobs), key=Locked.lasts)
    return best


def walk(one: "Seeker", records: Sequence[Record], horizons: Sequence[float], jobs: int) -> Locked:
    """Go from horizon to horizon for as long as the model keeps step."""
    start = one.places[0]
    best = Locked(one.model, start, 0.0, np.inf, one.covariance)
    for horizon in horizons:
        one.go([cut(rec, horizon) for rec in records], jobs)
        if best.horizon == 0.0:  # what is known may leave some values open altogether
            one.settle()
        if one.level > DOUBTFUL and horizon <= SEARCHED_SECONDS:
            one.search()
        if one.level > LOST:
            break
        one.settle()
        one.places = one.places[:1]
        best = Locked(one.there, one.places[0], horizon, one.level, one.covariance)
    return best


def cut(rec: Record, seconds: float) -> Record:
    """Return the start of a record, in the blocks that are compared here."""
    n = min(rec.omega.size, rec.led + round(seconds / rec.dt))
    return replace(
        rec,
        u=np.ascontiguousarray(rec.u[:, :n]),
        theta=rec.theta[:n],
        omega=rec.omega[:n],
        twist=None if rec.twist is None else rec.twist[:n],
        time=rec.time[:n],
        block=max(1, round(BLOCK_SECONDS / rec.dt)),
    )


def losses(model: Model, records: Sequence[Record], jobs: int) -> Floats:
    """Loss of each sample of a model's runs on records."""
    none: Floats = np.zeros(0)
    steps = Steps(records, model, (), Known(none, np.zeros((0, 0))), jobs)
    return loss(steps.residuals([none])[0])


def level(model: Model, records: Sequence[Record], seconds: float, jobs: int) -> float:
    """Mean loss per sample of a model's runs on the starts of records."""
    return float(losses(model, [cut(rec, seconds) for rec in records], jobs).mean())


@dataclass(eq=False)
class Steps:
    """Gauss–Newton on records of one horizon.

    Loss Σ ν log(1 + r²/ν) of the residual r in its units, times :data:`NEWS`, plus what is
    known beforehand.
    """

    records: Sequence[Record]
    model: Model
    unknowns: tuple[Unknown, ...]
    known: Known
    jobs: int
    stalled: float = STALLED
    spread: Floats | None = None
    substeps: int | None = None  # per sample; as fine as needed

    def __post_init__(self) -> None:
        self.bench = Bench(self.records)
        self.drives = Drives(self.model, self.unknowns)
        self.low = np.array([k.low for k in self.unknowns])
        self.high = np.array([k.high for k in self.unknowns])
        # few impacts grow what coarse steps miss: they tell as well where it goes down
        self.early = all(
            (rec.u.shape[1] - rec.led) * rec.dt <= EARLY_SECONDS + 0.5 * rec.dt
            for rec in self.records
        )

    def placed(self, p: Floats) -> Model:
        """Return the model with values."""
        return place(self.model, self.unknowns, p)

    def residuals(self, several: Sequence[Floats], substeps: int | None = None) -> Floats:
        """Measured minus simulated, in units, (len(several), m)."""
        return self.bench.compared(self.drives(several), self.jobs, substeps or self.substeps)

    def levels(self, several: Sequence[Floats]) -> Floats:
        """Mean loss per sample of each."""
        return np.asarray(np.mean(loss(self.residuals(several)), axis=1))

    def costs(self, residuals: Floats, several: Sequence[Floats]) -> Floats:
        """Loss of each, with what is known."""
        return np.asarray(NEWS * loss(residuals).sum(1) + self.known.costs(several))

    def slopes(self, p: Floats, directions: Floats) -> Floats:
        """Slopes of the residuals by differences, (len(p), m)."""
        ends = np.clip(p + directions, self.low, self.high)
        other = np.clip(p - directions, self.low, self.high)
        shorter = np.sum((ends - p) ** 2, axis=1) < np.sum((other - p) ** 2, axis=1)
        ends[shorter] = other[shorter]
        runs = self.residuals([p, *ends], SUBSTEPS if self.early else None)
        return np.linalg.pinv(ends - p, rcond=SINGULAR) @ (runs[1:] - runs[0])

    def descend(self, p: Floats, iterations: int = ITERATIONS) -> tuple[Floats, Floats]:
        """Go down from `p` for as long as it pays: place, and covariance of the last step."""
        known = self.known.precision + TINY * np.eye(p.size)
        spread = np.asarray(np.linalg.inv(known)) if self.spread is None else self.spread
        reach = REACH
        r = self.residuals([p])[0]
        cost = self.costs(r[None], [p])[0]
        for _ in range(iterations):
            slopes = self.slopes(p, reach * axes(spread))
            w = NEWS / (1.0 + r**2 / FREEDOM)
            normal = (slopes * w) @ slopes.T + known
            covariance = np.asarray(np.linalg.inv(normal), np.float64)
            uphill = (slopes * w) @ r + self.known.precision @ (p - self.known.mean)
            damped = normal + DAMPINGS[:, None, None] * np.diag(np.diag(normal))
            moves = np.linalg.solve(damped, uphill[:, None])[..., 0]
            tried = [*np.clip(p - moves, self.low, self.high)]
            missed = self.residuals(tried)
            costs = self.costs(missed, tried)
            best, before = int(np.argmin(costs)), cost
            gain = cost - costs[best]
            # what is missed says how far off the values may be
            spread = covariance * max(1.0, float(loss(r).mean()) / NOISE_LEVEL)
            if gain > 0.0:
                p, r, cost = tried[best], missed[best], costs[best]
            if gain < self.stalled * before:
                if gain > 0.0 or reach < NEAREST:
                    break
                reach *= NEARER
        return p, covariance


def axes(spread: Floats, most: float = FARTHEST) -> Floats:
    """Return the principal axes of what is known, one standard deviation long, as rows.

    Each value is taken to be known to `most` at least.
    """
    near = np.minimum(1.0, most / np.sqrt(np.maximum(np.diag(spread), TINY)))
    size, vectors = np.linalg.eigh(near[:, None] * spread * near)
    return np.asarray((vectors * np.sqrt(np.maximum(size, TINY))).T)


@dataclass(eq=False)
class Seeker:
    """A model on its way through the horizons, with the places where it may go on.

    Attributes
    ----------
    places : list of arrays
        Values from which the next horizon starts, the best first.
    cost : float
        Of the best, with what is known beforehand.
    level : float
        Mean loss per sample.
    """

    model: Model
    unknowns: tuple[Unknown, ...]
    known: Known
    places: list[Floats]
    covariance: Floats
    cost: float = np.inf
    level: float = np.inf
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))
    stalled: float = STALLED

    def go(self, records: Sequence[Record], jobs: int = 1) -> None:
        """Fit to records of one horizon."""
        self.prepare(records, jobs, self.covariance)
        self.found: list[tuple[float, Floats, Floats, float]] = []
        self.pursue(*self.places)

    def prepare(self, records: Sequence[Record], jobs: int, spread: Floats | None) -> None:
        """Take what goes down on some records, and the same in coarse steps."""
        self.steps = self.prepared(records, jobs, spread)
        self.rough = replace(self.steps, substeps=SUBSTEPS)
        self.rough.bench = self.steps.bench

    def prepared(self, records: Sequence[Record], jobs: int, spread: Floats | None) -> Steps:
        """Return what goes down on some records."""
        return Steps(
            records, self.model, self.unknowns, self.known, jobs, self.stalled, spread=spread
        )

    def pursue(self, *starts: Floats) -> None:
        """Go down from some starts, at once where threads are free; keep the best two places."""
        self.found += in_threads(self.reached, starts, self.steps.jobs)
        self.found.sort(key=lambda found: found[0])
        self.cost, _, _, self.level = self.found[0]
        self.places = [found[1] for found in self.found[:2]]

    def reached(self, start: Floats) -> tuple[float, Floats, Floats, float]:
        """Go down from a start: cost, place, covariance there, mean loss per sample."""
        if self.steps.early and self.steps.levels([start])[0] > UNEASY:
            start, _ = self.rough.descend(start)
        p, covariance = self.steps.descend(start)
        missed = self.steps.residuals([p])
        cost = float(self.steps.costs(missed, [p])[0])
        return cost, p, covariance, float(loss(missed).mean())

    def down(self, starts: Sequence[Floats], iterations: int) -> list[Floats]:
        """Go down from some starts by so many coarse steps at most."""
        return in_threads(lambda p: self.rough.descend(p, iterations)[0], starts, self.steps.jobs)

    def scatter(self, records: Sequence[Record], jobs: int) -> None:
        """Begin anew from the best of many places that are known to be possible."""
        self.prepare(records, jobs, None)
        self.found = []
        self.spread(self.draw(SCATTERED))
        self.covariance = self.found[0][2]

    def spread(self, drawn: Sequence[Floats]) -> None:
        """Go down from the best of many places, too."""
        for follow, iterations in FOLLOWED:
            drawn = self.down(self.nearest(drawn, follow), iterations)
        self.pursue(*drawn)

    def nearest(self, drawn: Sequence[Floats], count: int) -> list[Floats]:
        """Return the best of many places."""
        costs = self.steps.costs(self.steps.residuals(drawn, RANKING_SUBSTEPS), drawn)
        return [drawn[i] for i in np.argsort(costs)[:count]]

    def draw(self, count: int) -> list[Floats]:
        """Draw places from what is known; of a value that is open, another size or sign."""
        first = self.places[0]
        scale, other = np.moveaxis(self.rng.standard_normal((count, 2, first.size)), 1, 0)
        width = np.sqrt(np.diag(self.covariance))
        of_open = width > OPEN
        told = np.where(of_open[:, None] | of_open, 0.0, self.covariance)
        told[np.diag_indices_from(told)] += np.where(of_open, 1.0, TINY)
        near = first + other @ axes(told, np.inf)
        sized = np.where(self.steps.low < 0.0, OPEN_SIZE * scale, first * np.exp(scale))
        return [*np.clip(np.where(of_open, sized, near), self.steps.low, self.steps.high)]

    def search(self) -> None:
        """Try other starts, drawn from what the last horizon left open."""
        spread, best = axes(self.covariance, np.inf), self.places[0]
        drawn = [self.about(best, SIZES[i % len(SIZES)], spread) for i in range(DRAWS)]
        self.pursue(*self.nearest(drawn, PURSUED))

    def about(self, p: Floats, size: float, spread: Floats) -> Floats:
        """Draw a place about another, `size` times as far as the axes of `spread` reach."""
        drawn = p + size * self.rng.standard_normal(p.size) @ spread
        return np.clip(drawn, self.steps.low, self.steps.high)

    def closer(self, rounds: int) -> None:
        """Draw anew about the best places, nearer than what is known, and go down from there."""
        known = self.known.precision + TINY * np.eye(self.known.mean.size)
        spread = axes(np.asarray(np.linalg.inv(known), np.float64), np.inf)
        for _ in range(rounds):
            drawn = [
                self.about(p, size, spread)
                for p in self.different(CENTRES)
                for size in CLOSER
                for _ in range(DRAWS)
            ]
            followed = self.down(self.nearest(drawn, AGAIN), 2)
            self.pursue(*self.nearest(followed, CENTRES))

    def anew(self, open_values: int, count: int, sizes: Sequence[float]) -> list[Floats]:
        """Draw the last values anew about each place; the others stay."""
        sized = np.resize(np.array(sizes), count // len(self.places))[:, None]
        drawn = []
        for p in self.places:
            moved = np.zeros((sized.size, p.size))
            moved[:, -open_values:] = sized * self.rng.standard_normal((sized.size, open_values))
            drawn += [*np.clip(p + moved, self.steps.low, self.steps.high)]
        return drawn

    def different(self, count: int) -> list[Floats]:
        """Return the best places that are not the same."""
        kept: list[Floats] = []
        for _, p, _, _ in self.found:
            if all(np.abs(p - other).max() > SAME for other in kept):
                kept.append(p)
        return kept[:count]

    def settle(self) -> None:
        """Take what was learnt to the next horizon: one place, if all is well there."""
        self.covariance = self.found[0][2]
        if self.level < UNEASY:
            self.places = self.places[:1]

    @property
    def there(self) -> Model:
        """The model at its best place."""
        return self.steps.placed(self.places[0])


def loss(residuals: Floats) -> Floats:
    """Loss of residuals in their units."""
    return np.asarray(FREEDOM * np.log1p(residuals**2 / FREEDOM))
