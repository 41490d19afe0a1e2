"""Sentences for the user about what a verdict does not name."""

import numpy as np

from dmptm_ctrl.diagnosis import at_rest
from dmptm_ctrl.diagnosis.decide import Decision
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.identify.windows import STIFFNESS
from dmptm_ctrl.simulate.damping import by_depth


def remarks(decision: Decision, final: Fit) -> tuple[str, ...]:
    """Say what is in the model, or shows in the logs, without a name."""
    return (*flanks(final), *softness(decision, final), *slipping(decision))


def flanks(final: Fit) -> tuple[str, ...]:
    """Say that the flanks follow another law than the declared one."""
    if not by_depth(final.model):
        return ()
    return (
        "the flanks damp by how deep they are pressed, not from the touch on as in Eq. 21: with "
        "this law the model meets the first landings, and it is in the augmented model",
    )


def softness(decision: Decision, final: Fit) -> tuple[str, ...]:
    """Say that there is pre-sliding in the model, where it is too little to be named."""
    if at_rest.NAME not in final.model.effects or decision.is_found(at_rest.NAME):
        return ()
    if at_rest.travel(final) < at_rest.NONE:
        return ()
    given = np.rad2deg(at_rest.travel(final)) * 60.0
    return (
        f"friction gives by {given:.2g} arc-minutes of the ring gear before it slides: too little "
        "to be named, but with it the model keeps step, and it is in the augmented model",
    )


def slipping(decision: Decision) -> tuple[str, ...]:
    """Say how far flanks wander, where that is what shows that something is missing."""
    what = decision.unexplained
    if what is None or what.slips == 0.0:
        return ()
    far = np.rad2deg(what.slips / STIFFNESS) * 60.0
    return (
        f"a pinion's flanks wander by {far:.2g} arc-minutes within a log, which no angle and no "
        "static load brings back: something slips between motor and ring gear",
    )
