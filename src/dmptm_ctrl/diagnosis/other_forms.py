"""Forms that no effect of the catalogue has, held against those that it has.

A local spot is a bump. Friction may also be other over a stretch, with edges: another bearing, a
part of a rail. The bump then takes most of it, and has the wrong name.
"""

from collections.abc import Callable
from math import pi

import numpy as np

from dmptm_ctrl.diagnosis.rig_shapes import friction_columns, rows_of, unit_columns
from dmptm_ctrl.diagnosis.rig_tangent import Tangent
from dmptm_ctrl.diagnosis.select import NEAR
from dmptm_ctrl.effects.local_spot import LOCAL_SPOT
from dmptm_ctrl.identify.free_parameters import on_slide
from dmptm_ctrl.identify.rig_fit import RigFit
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import Placed

BINS = 512  # of the travel, where edges are looked for


def other_form(effect: Placed, before: RigFit) -> str:
    """Why an effect is not what it looks like; empty where its form is the best.

    Both forms have as many numbers: two places, and how much friction there is between them.

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
    more = tangent.score(edged)[0] - tangent.score(bump)[0]
    return "friction with sharp edges explains more" if more > NEAR else ""


def stretch(tangent: Tangent, body: str) -> Callable[[Floats], Floats] | None:
    """Return where friction is most unlike that around, 1.0 at angles there and 0.0 elsewhere.

    Of all pairs of edges, those between which it differs by most of the variance.
    """
    logs = [rows_of(tangent, k, body) for k in range(len(tangent.balance.motions))]
    angle, speed, left = (np.concatenate(x) for x in zip(*logs, strict=True))
    low, span = float(angle.min(initial=0.0)), float(np.ptp(angle)) if angle.size else 0.0
    if span == 0.0:
        return None
    turns = not on_slide(tangent.fit.model, body) and span > 2.0 * pi
    if turns:
        low, span = 0.0, 2.0 * pi

    def bin_of(theta: Floats) -> Floats:
        place = np.floor((theta - low) / span * BINS)
        return np.mod(place, BINS) if turns else np.clip(place, 0, BINS - 1)

    bins, count = bin_of(angle).astype(int), angle.size
    sums = np.cumsum(np.append(0.0, np.bincount(bins, np.sign(speed) * left, BINS)))
    rows = np.cumsum(np.append(0, np.bincount(bins, minlength=BINS)))
    share = np.triu(rows[None, :] - rows[:, None]) / count
    more = sums[None, :] - sums[:, None] - share * sums[-1]
    between = share * (1.0 - share)
    gain = np.divide(more**2, between, out=np.zeros_like(more), where=between > 0.0)
    if not turns:  # what is beyond both edges is no stretch
        gain[more < 0.0] = 0.0
    first, last = np.unravel_index(np.argmax(gain), gain.shape)
    between_them = more[first, last] > 0.0

    def inside(theta: Floats) -> Floats:
        place = bin_of(theta)
        return np.where(((place >= first) & (place < last)) == between_them, 1.0, 0.0)

    return inside
