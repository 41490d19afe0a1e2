"""Whether held-out logs confirm the size of an effect.

What an effect changes of a residual has a power S, in units of its scatter. Where the effect is
right, the square that is left falls by S, give or take the scatter, 2 √S. An effect that stands for
something else takes less than it promises, or more.
"""

from math import sqrt
from typing import Any

from dmptm_ctrl.diagnosis.candidate import FIRM, Evidence
from dmptm_ctrl.diagnosis.negligible import without_weak
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.simulate.model import Floats

ALIKE = 2.0  # times what is promised, or one over it: at a size of 3/4 or 3/2, fitted anew


def contradicted(before: Floats, after: Floats) -> bool:
    """Whether an effect takes clearly less, or more, than it promises.

    Parameters
    ----------
    before, after : (m,) arrays
        Residual without and with it, in units of the scatter with it, of independent rows.
    """
    promised = float((before - after) @ (before - after))
    taken = float(before @ before - after @ after)
    far = max(promised / ALIKE - taken, taken - ALIKE * promised)
    return far > FIRM * 2.0 * sqrt(promised)


def confirmed(evidence: Evidence, selection: Selection) -> Selection:
    """Take out effects that held-out logs contradict, those of least evidence first."""

    def worth(without: Any, final: Any) -> float:
        wrong = contradicted(*evidence.held_rows(without, final))
        return sum(evidence.gains(without, final)) if wrong else float("inf")

    return without_weak(
        evidence, selection, worth, float("inf"), "held-out logs contradict its size"
    )
