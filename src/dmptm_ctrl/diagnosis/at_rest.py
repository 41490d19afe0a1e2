"""What acts near rest, where the balances do not look: tried in the simulator.

Balances count windows in which everything slides; pre-sliding shows as bodies leave rest. Each
log begins there: within its first tenth of a second, before chance has a say, bristles let the
drive give way at once where friction that sticks holds it. Under every law of contact and of
friction that takes off most of what the model misses there, and no other effect does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dmptm_ctrl.diagnosis.augment import widened
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.runners import entrant
from dmptm_ctrl.diagnosis.runoff import Run, lost, run, starts
from dmptm_ctrl.diagnosis.trace import unknowns_of
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import BalanceFit, fit_balance
from dmptm_ctrl.identify.fit import Fit, Unknown, position
from dmptm_ctrl.identify.lock import LOOSE, UNEASY, Seeker, cut, lock
from dmptm_ctrl.identify.records import RING_COUNT
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

NAME = "presliding"
# Of each distance, in its step, from which they are fitted: three times as far as it is, none
# finds the way back.
STRIDES = tuple(0.1 * 2.0**k for k in range(8))
SHAPES = {p.name: p.bank for p in CATALOGUE[NAME].parameters}
AT_ONCE = SHAPES["viscous_at_once"]  # Dahl's law, then LuGre's
LITTLE = 0.3  # of each distance, in its step, that any friction may give way
FIRST_SECONDS = (0.03, 0.05, 0.1)  # of each log, one after another
FAINT_SECONDS = 0.05  # for which a model with a little of it keeps step
# Of what the model misses at first, on fitted and on held-out logs, pre-sliding takes off 0.5 to
# 0.9, whatever the laws of the rig; where it is something else, less than 0.3.
SHARE = 0.4
# The same beside another lack, where the friction law is one that gives; where friction sticks
# it takes off nothing on the held-out logs.
HELPS = 0.05
# Any real contact pre-slides a little: common bristles bend by one or two counts of the ring
# encoder and are taken for up to twice that. An effect bends by more.
MATTERS = 4 * RING_COUNT
NONE = 0.1 * RING_COUNT  # nobody would notice
# Standard errors of a distance that has a name: true ones of half the size that shows have 5 and
# more, bristles of a friction law that the model does not have less than 1.
KNOWN_TO = 2.0
# Damping ratio of bristles from which they do not swing but creep, as what lands on teeth of
# another law does: two of 200 rigs that lack nothing had 1.1 and 1.5, and distances that one fit
# knew and the next one did not; true ones have what they were given, 0.4, within 0.1.
CREEPS = 1.0
LEAST = 70.0  # fall of the loss on fitted and held-out logs together


@dataclass(frozen=True, eq=False)
class AtRest:
    """Pre-sliding fitted in the simulator.

    Attributes
    ----------
    gain, held_gain : float
        Fall of the loss on fitted and held-out logs.
    shares : (float, float)
        The same, of the whole loss there.
    fit : Fit
        With it; without where nothing is missing at first.
    in_step : float
        Seconds for which it keeps step where the model without it does not; 0 if neither does.
    sticks : bool
        Whether what is missed there is something else, beside which friction sticks.
    told : bool
        Whether anything, beside friction that sticks or gives, meets the first landings.
    """

    gain: float
    held_gain: float
    shares: tuple[float, float]
    fit: Fit
    in_step: float = 0.0
    sticks: bool = False
    told: bool = True

    @property
    def evidence(self) -> float:
        """Fall of the loss on all logs; none by less than any friction gives way."""
        return self.gain + self.held_gain if travel(self.fit) >= MATTERS else 0.0

    @property
    def gives(self) -> bool:
        """Whether a little of it helps, under a friction law of another kind."""
        told = min(self.shares) > HELPS and self.gain + self.held_gain > LEAST
        return told and not self.sticks

    @property
    def doubtful(self) -> bool:
        """Whether it helps less than where friction gives, so that something else may be it.

        Or whether nothing meets the first landings beside it, however much it helps.
        """
        return self.gives and (max(self.shares) < SHARE or not self.told)

    @property
    def convincing(self) -> bool:
        """Whether it is more than a friction law that is a little softer than the declared."""
        told = self.in_step > 0.0 or min(self.shares) > SHARE
        return told and self.evidence > LEAST


def presliding(left: Residual, jobs: int) -> AtRest:
    """Fit pre-sliding to the first tenth of a second of the logs, which begin at rest.

    Parameters
    ----------
    left : Residual
        What the model without it leaves.
    """
    base = told(left, left.base.model, jobs)
    without = entered(base)
    brought(without, left, FIRST_SECONDS, jobs)
    if without.level < UNEASY:  # nothing is missing there
        return AtRest(0.0, 0.0, (0.0, 0.0), fitted(without))
    laws = [
        [entered(base, with_share(sized(NAME, base.model, stride), share)) for stride in STRIDES]
        for share in AT_ONCE
    ]
    begun = [one for law in laws for one in law]
    in_threads(lambda one: brought(one, left, FIRST_SECONDS, 1), begun, jobs)
    near = [min(law, key=lambda one: one.level) for law in laws]
    if min(one.level for one in near) < (1.0 - HELPS) * without.level:
        near = in_threads(lambda one: once_more(one, left), near, jobs)
    parts = starts((left.measured.fit, left.measured.held), FIRST_SECONDS[-1])
    bare, *runs = (run(parts, one.there, jobs) for one in (without, *near))
    best, of_the_best = min(zip(near, runs, strict=True), key=lambda pair: pair[1].total)
    return compared(bare, of_the_best, fitted(best))


def with_share(model: Model, share: float) -> Model:
    """Return a model of whose viscous friction a share acts at once."""
    return model.with_effect(NAME, **{**model.effects[NAME], "viscous_at_once": share})


def told(left: Residual, model: Model, jobs: int) -> BalanceFit:
    """Return what is known of a model: of friction by balances, of damping by the rattle."""
    start = fit_balance(left.balance, model, left.base.unknowns)
    return rattled(left.measured.fit, start, left.measured.drive, jobs)


def entered(fit: BalanceFit, model: Model | None = None, places: Sequence[Floats] = ()) -> Seeker:
    """Enter what is known, or a model with pre-sliding beside it."""
    own = () if model is None else unknowns_of(NAME)
    known = widened(fit.p, LOOSE * fit.covariance, len(own))
    return entrant(None, model or fit.model, (*fit.unknowns, *own), known, places)


def brought(one: Seeker, left: Residual, horizons: Sequence[float], jobs: int) -> None:
    """Fit a model to the first hundredths of a second of the logs, then to the next."""
    for seconds in horizons:
        one.go([cut(rec, seconds) for rec in left.measured.fit], jobs)
        one.settle()


def once_more(near: Seeker, left: Residual) -> Seeker:
    """Fit one that is near again, with what balances and rattle tell beside its pre-sliding.

    From a wrong start the right law meets less than the other one.
    """
    fit = told(left, near.there, 1)
    one = entered(fit, fit.model, near.places[:1])
    brought(one, left, FIRST_SECONDS[-1:], 1)
    if one.level > UNEASY:
        one.search()
    return one


def compared(without: Run, with_it: Run, fit: Fit) -> AtRest:
    """Describe a fit by what it takes off the loss of runs without it."""
    gains = without.fitted - with_it.fitted, without.held - with_it.held
    shares = gains[0] / without.fitted, gains[1] / without.held
    return AtRest(*gains, shares, fit, fit.horizon)


def fitted(seeker: Seeker, horizon: float = 0.0) -> Fit:
    """Where a seeker is."""
    return Fit(seeker.there, seeker.unknowns, seeker.places[0], seeker.covariance, horizon)


def a_little(left: Residual, before: Fit, shown: AtRest, jobs: int) -> AtRest | None:
    """Return pre-sliding with which a model keeps step and without which it does not.

    Parameters
    ----------
    left : Residual
        What the model without it leaves.
    before : Fit
        That model, refitted inside the simulator.
    shown : AtRest
        What the first tenth of a second tells of it.
    """
    whole = left.measured.fit, left.measured.held
    # the rattle told the meshes' damping with friction of another size; now once more
    fit = told(left, shown.fit.model, jobs)
    one = entered(fit, fit.model)
    # where it cannot keep step, another start would not either
    kept = lock(whole[0], fit.model, one.unknowns, one.known, jobs=jobs, anew=False)
    ahead = lost(whole, before.model, kept.model, (FAINT_SECONDS, kept.horizon), jobs)
    if ahead is None:
        return None
    _, without, with_it = ahead
    return compared(without, with_it, kept.as_fit(one.unknowns))


def softened(fit: BalanceFit, behind: int) -> BalanceFit:
    """Let friction give way a little before it slides, by as much as the runs will tell.

    Bristles or a steep tanh do; beside them, what else is missing is told from the first bounces.

    Parameters
    ----------
    behind : int
        Unknowns of `fit` behind which those of pre-sliding come.
    """
    model = fit.model
    if NAME not in model.effects:
        model = sized(NAME, model, LITTLE)
    return extended(fit, model, unknowns_of(NAME), LITTLE, behind)


def extended(
    fit: BalanceFit, model: Model, own: tuple[Unknown, ...], width: float, behind: int
) -> BalanceFit:
    """Add to a fit what the balances do not tell.

    Parameters
    ----------
    model : Model
        Of the fit, with the values of the added unknowns.
    width : float
        Standard deviation of what is known of each, in its steps.
    behind : int
        Unknowns of `fit` behind which they come.
    """
    n = fit.p.size
    covariance = np.diag(np.full(n + len(own), width**2))
    covariance[:n, :n] = fit.covariance
    unknowns = np.array([*fit.unknowns, *own], object)
    p = np.concatenate([fit.p, position(model, own)])
    order = [*range(behind), *range(n, n + len(own)), *range(behind, n)]
    return replace(
        fit,
        model=model,
        unknowns=tuple(unknowns[order]),
        p=p[order],
        covariance=covariance[np.ix_(order, order)],
    )


def travel(of: Fit) -> float:
    """Larger one of the distances, at the ring gear [rad]."""
    if NAME not in of.model.effects:
        return 0.0
    values = of.model.effects[NAME]
    return max(values["ring_distance"], values["reducer_distance"] / of.model.drive["N_2"])


def matters(*fits: Fit) -> bool:
    """Whether friction is known to give way by more than any does, by one fit after another.

    A refit that holds over next to nothing may know it less well than the one before; that of
    bristles that only creep, which may be no friction, each fit has to know.
    """
    if any(travel(of) < MATTERS for of in fits):
        return False
    told = [knows(of) for of in fits]
    return all(told) or any(t and damping(of) < CREEPS for t, of in zip(told, fits, strict=True))


def damping(of: Fit) -> float:
    """Damping ratio of the bristles."""
    return of.model.effects[NAME]["damping"]


def knows(of: Fit) -> bool:
    """Whether the larger one of the distances is more than :data:`KNOWN_TO` standard errors."""
    ratios = {"ring_distance": 1.0, "reducer_distance": of.model.drive["N_2"]}
    known = {k.name for k in of.unknowns if k.effect == NAME}
    told = [np.array(of.value(NAME, name)) / ratios[name] for name in ratios if name in known]
    value, error = max(told, key=lambda one: one[0], default=(travel(of), 0.0))
    return bool(value > KNOWN_TO * error)


def sized(name: str, model: Model, size: float) -> Model:
    """Return the model with an effect of a size, in the steps of its amplitudes."""
    own = CATALOGUE[name]
    steps = {p.name: p.step for p in own.parameters}
    return model.with_effect(name, **{a: size * steps[a] for a in own.amplitudes})
