"""Forms that no effect of the catalogue has, held against those that it has.

A local spot is a bump of friction. Friction may also differ over a stretch with sharp edges, as on
another part of a rail. A bump explains most of that, but it is the wrong name.
"""

from collections.abc import Callable, Sequence

import numpy as np

from dmptm_ctrl.diagnosis.rig_shapes import friction_columns, travel_of, unit_columns
from dmptm_ctrl.diagnosis.rig_tangent import Tangent
from dmptm_ctrl.diagnosis.select import NEAR
from dmptm_ctrl.effects.local_spot import LOCAL_SPOT
from dmptm_ctrl.identify.rig_fit import RigFit
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import Placed

BINS = 512  # of the travel, where edges are looked for


def other_form(effect: Placed, before: RigFit) -> str:
    """Why the form of an effect is wrong; empty where no other explains more.

    A bump and a stretch have three numbers each: two for where it is, one for how much.

    Parameters
    ----------
    before : RigFit
        Fit of the model without the effect.
    """
    if effect.name != LOCAL_SPOT.name:
        return ""
    tangent, amplitude = Tangent(before), LOCAL_SPOT.amplitudes
    inside = stretch(tangent, effect.on)
    if inside is None:
        return ""
    edged = friction_columns(before, tangent.balance, effect.on, inside)
    bump = unit_columns(before, tangent.balance, effect, amplitude)
    more = _surprise(tangent, bump) - _surprise(tangent, edged)
    return "friction with sharp edges explains more" if more > NEAR else ""


def _surprise(tangent: Tangent, columns: Sequence[Floats]) -> float:
    """−2 log-likelihood of what is left beside columns, to first order."""
    fit, (_, amplitudes) = tangent.fit, tangent.score(columns)
    change = [own @ amplitudes for own in columns]
    shift = tangent.shift(tangent.stack(change))
    parts = zip(fit.left, change, fit.derivatives, strict=True)
    return fit.likelihood.surprise([e + c + d @ shift for e, c, d in parts], fit.model)


def stretch(tangent: Tangent, body: str) -> Callable[[Floats], Floats] | None:
    """Return the stretch that explains most: a function that is 1.0 at its angles, 0.0 elsewhere.

    All pairs of edges are tried: what is between them explains a share of the variance.
    """
    travel = travel_of(tangent, body)
    if travel is None:
        return None
    bins, count = travel.bins(travel.angle, BINS), travel.angle.size
    sums = np.cumsum(np.append(0.0, np.bincount(bins, travel.excess, BINS)))
    rows = np.cumsum(np.append(0, np.bincount(bins, minlength=BINS)))
    share = np.triu(rows[None, :] - rows[:, None]) / count
    more = sums[None, :] - sums[:, None] - share * sums[-1]
    between = share * (1.0 - share)
    gain = np.divide(more**2, between, out=np.zeros_like(more), where=between > 0.0)
    if not travel.turns:  # what is beyond both edges is no stretch
        gain[more < 0.0] = 0.0
    first, last = np.unravel_index(np.argmax(gain), gain.shape)
    between_them = more[first, last] > 0.0

    def inside(theta: Floats) -> Floats:
        place = travel.bins(theta, BINS)
        return np.where(((place >= first) & (place < last)) == between_them, 1.0, 0.0)

    return inside
