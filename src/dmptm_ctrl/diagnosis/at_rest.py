"""What acts near rest, where the balances do not look: tried in the simulator.

Balances count windows in which everything slides; pre-sliding shows as bodies come to rest
and break away. A free run of the held-out logs tells it from a friction law that is only a
little softer than the declared one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.augment import widened
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.residual import LEAD_HZ
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import Fit, Misfit, effect_unknowns, fit
from dmptm_ctrl.identify.records import RING_COUNT, Record
from dmptm_ctrl.simulate.model import Model

NAME = "presliding"
STARTS = (0.2, 1.0)  # of each distance, in its step
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
    """

    gain: float
    held_gain: float
    shares: tuple[float, float]
    fit: Fit

    @property
    def evidence(self) -> float:
        """Fall of the misfit on all logs beyond what a softer friction law would give."""
        if travel(self.fit) < MATTERS:
            return 0.0
        parts = zip((self.gain, self.held_gain), self.shares, strict=True)
        return max(0.0, sum(gain * (1.0 - SHARE / share) for gain, share in parts if share > 0.0))

    @property
    def convincing(self) -> bool:
        """Whether it is more than a friction law that is a little softer than the declared."""
        return min(self.shares) > SHARE and self.evidence > LEAST


def presliding(measured: Measured, before: Fit, jobs: int) -> AtRest:
    """Add pre-sliding to a fitted model."""
    misfit = weighed(measured.fit, before, jobs)
    held = weighed(measured.held, before, jobs)
    cost, held_cost = misfit.square(before.model), held.square(before.model)
    starts = [misfit.square(sized(before.model, size)) for size in STARTS]
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


def sized(model: Model, size: float) -> Model:
    """Return the model with pre-sliding of a size."""
    return model.with_effect(NAME, **{p.name: size * p.step for p in CATALOGUE[NAME].parameters})


def started(misfit: Misfit, before: Fit, size: float) -> Fit:
    """Fit pre-sliding from a size of its distances, and the rest from what is known."""
    own = effect_unknowns(NAME)
    known = widened(before.p, before.covariance, len(own))
    model = sized(before.model, size)
    unknowns = (*before.unknowns, *own)
    return fit(misfit, model, unknowns, iterations=ITERATIONS, known=known)
