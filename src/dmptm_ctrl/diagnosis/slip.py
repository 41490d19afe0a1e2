"""What slips between motor and ring gear: its flanks are elsewhere at a log's end."""

import numpy as np

from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.identify.balance import SIDES

# N·m of twist, 0.48′ of the pinion: on rigs of benchmarks/rigs (seeds 5501, 5601) no named effect,
# and no lack of any, leaves half as much; a pinion that creeps on its hub three times it.
WANDERS = 5.0
WANDERS_SHARE = 0.1  # of the same without names, up to which a name's form is only nearly right
STRETCHES, FEWEST = 5, 20  # of a log; windows of it, fewer say nothing of where it was meanwhile
SLIP = ("mesh_torque",)  # what makes something slip


def wanders(before: Residual, after: Residual) -> float:
    """Return how far a flank is from where it was, within a log [N·m of twist]; 0 where it stays.

    What neither an angle nor a load brings back has slipped between motor and ring gear.
    """
    far = wandered(after)
    if far <= WANDERS or far <= WANDERS_SHARE * wandered(before):
        return 0.0
    return far


def wandered(left: Residual) -> float:
    """Range of the twist that is left, over stretches of a log, of the log where it is widest.

    Of fitted and of held-out logs the smaller one; 0 without motor encoders.
    """
    widest = []
    for balance in (left.balance, left.held):
        parts = balance.missing(left.base.model)
        ends = [
            part
            for e, part in zip(balance.equations, parts, strict=True)
            if e.kind in SIDES and part.size >= FEWEST
        ]
        ranges = [np.ptp([np.median(s) for s in np.array_split(c, STRETCHES)]) for c in ends]
        widest.append(float(max(ranges, default=0.0)))
    return min(widest)
