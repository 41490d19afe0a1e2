"""What acts near rest, where the balances do not look: tried in the simulator.

Balances count windows in which everything slides; pre-sliding shows as bodies come to rest
and break away. On a machine that obeys the model's laws otherwise, it alone lets the model keep
step with the first tenths of a second of each log. Elsewhere a free run of the held-out logs
tells it from a friction law that is only a little softer than the declared one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.augment import widened
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import LEAD_HZ, Residual
from dmptm_ctrl.diagnosis.runoff import KEEPS_SECONDS, SECONDS, lost
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import fit_balance
from dmptm_ctrl.identify.fit import Fit, Misfit, Unknown, effect_unknowns, fit
from dmptm_ctrl.identify.lock import LOOSE, Locked, cut, lock
from dmptm_ctrl.identify.records import RING_COUNT, Record
from dmptm_ctrl.simulate.model import Model

NAME = "presliding"
STARTS = (0.2, 1.0)  # of each distance, in its step
STRIDES = (0.5, 2.0, 8.0)  # the same, from which it tries to keep step
FIRST_SECONDS = 0.1  # of each log, on which the best of them is found
FAINT_SECONDS = 0.05  # for which it does at least before the meshes' damping is told anew
ITERATIONS = 6
# Any real contact pre-slides a little: a common friction law with bristles lets that take off
# up to half of the misfit, by distances of one or two counts of the ring encoder. An effect
# takes off this share, on fitted and held-out logs, by distances beyond those.
SHARE = 0.1
MATTERS = 3 * RING_COUNT
LEAST = 70.0  # fall of the misfit beyond that, fitted and held-out logs together


@dataclass(frozen=True, eq=False)
class AtRest:
    """Pre-sliding fitted in the simulator.

    Attributes
    ----------
    gain, held_gain : float
        Fall of the misfit, in variances, on fitted and held-out logs.
    shares : (float, float)
        The same, of the whole misfit.
    fit : Fit
        Without pre-sliding where any amount of it only harms.
    in_step : float
        Seconds for which it keeps step where the model without it does not; 0 if neither does.
    """

    gain: float
    held_gain: float
    shares: tuple[float, float]
    fit: Fit
    in_step: float = 0.0

    @property
    def evidence(self) -> float:
        """Fall of the misfit on all logs beyond what a softer friction law would give."""
        if travel(self.fit) < MATTERS:
            return 0.0
        if self.in_step > 0.0:
            return self.gain + self.held_gain
        parts = zip((self.gain, self.held_gain), self.shares, strict=True)
        return max(0.0, sum(gain * (1.0 - SHARE / share) for gain, share in parts if share > 0.0))

    @property
    def convincing(self) -> bool:
        """Whether it is more than a friction law that is a little softer than the declared."""
        return min(self.shares) > SHARE and self.evidence > LEAST


def presliding(left: Residual, before: Fit, jobs: int) -> AtRest:
    """Add pre-sliding to a fitted model.

    Parameters
    ----------
    left : Residual
        What the model without it leaves.
    before : Fit
        That model, refitted inside the simulator.
    """
    if before.horizon >= KEEPS_SECONDS:  # nothing is missing near rest
        return AtRest(0.0, 0.0, (0.0, 0.0), before)
    kept = keeping_step(left, before, jobs)
    return kept or by_misfit(left.measured, before, jobs)


def keeping_step(left: Residual, before: Fit, jobs: int) -> AtRest | None:
    """Add pre-sliding if the model keeps step with it, and not without."""
    whole = left.measured.fit, left.measured.held
    starts, first = ([cut(rec, h) for rec in whole[0]] for h in (SECONDS, FIRST_SECONDS))
    bare = left.base.model
    strides = [stride(left, sized(NAME, bare, size), first, jobs) for size in STRIDES]
    best, unknowns = max(strides, key=lambda found: found[0].lasts())
    if best.horizon < FAINT_SECONDS:
        return None
    # the rattle told the meshes' damping with friction of another size; now once more
    again, _ = stride(left, best.model, starts, jobs)
    best = max(best, again, key=Locked.lasts)
    found = lost(whole, before.model, best.model, (FAINT_SECONDS, best.horizon), jobs)
    if found is None:
        return None
    _, without, with_it = found
    gains = without.fitted - with_it.fitted, without.held - with_it.held
    shares = gains[0] / without.fitted, gains[1] / without.held
    done = Fit(best.model, unknowns, best.p, best.covariance, best.horizon)
    return AtRest(*gains, shares, done, best.horizon)


def stride(
    left: Residual, model: Model, records: Sequence[Record], jobs: int
) -> tuple[Locked, tuple[Unknown, ...]]:
    """Keep step with pre-sliding from a size on.

    What the balances know of friction, and the rattle of the meshes' damping, they know beside it.
    """
    measured, own = left.measured, effect_unknowns(NAME)
    start = fit_balance(left.balance, model, left.base.unknowns)
    fit = rattled(measured.fit, start, measured.drive, jobs)
    known = widened(fit.p, LOOSE * fit.covariance, len(own))
    unknowns = (*fit.unknowns, *own)
    # other sizes are tried already; to begin anew with each would take most of a diagnosis
    return lock(records, fit.model, unknowns, known, jobs=jobs, anew=False), unknowns


def by_misfit(measured: Measured, before: Fit, jobs: int) -> AtRest:
    """Add pre-sliding by the misfit of whole free runs."""
    misfit = weighed(measured.fit, before, jobs)
    held = weighed(measured.held, before, jobs)
    cost, held_cost = misfit.square(before.model), held.square(before.model)
    starts = [misfit.square(sized(NAME, before.model, size)) for size in STARTS]
    if min(starts) > cost:  # any amount only harms: there is nothing to fit
        return AtRest(0.0, 0.0, (0.0, 0.0), before)
    best = started(misfit, before, STARTS[int(np.argmin(starts))])
    gain, held_gain = cost - misfit.square(best.model), held_cost - held.square(best.model)
    return AtRest(gain, held_gain, (gain / cost, held_gain / held_cost), best)


def travel(of: Fit) -> float:
    """Larger one of the distances, at the ring gear [rad]."""
    if NAME not in of.model.effects:
        return 0.0
    values = of.model.effects[NAME]
    return max(values["ring_distance"], values["reducer_distance"] / of.model.drive["N_2"])


def weighed(records: Sequence[Record], before: Fit, jobs: int) -> Misfit:
    """Misfit on records with the scales that a model leaves there."""
    misfit = Misfit(records, LEAD_HZ, jobs)
    misfit.weigh(before.model)
    return misfit


def sized(name: str, model: Model, size: float) -> Model:
    """Return the model with an effect of a size, in the steps of its amplitudes."""
    own = CATALOGUE[name]
    steps = {p.name: p.step for p in own.parameters}
    return model.with_effect(name, **{a: size * steps[a] for a in own.amplitudes})


def started(misfit: Misfit, before: Fit, size: float) -> Fit:
    """Fit pre-sliding from a size of its distances, and the rest from what is known."""
    own = effect_unknowns(NAME)
    known = widened(before.p, before.covariance, len(own))
    model = sized(NAME, before.model, size)
    unknowns = (*before.unknowns, *own)
    return fit(misfit, model, unknowns, iterations=ITERATIONS, known=known)
