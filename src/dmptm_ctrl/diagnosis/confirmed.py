"""Whether held-out logs confirm the size of an effect.

What an effect changes of a residual has a power S, in units of its scatter. If the effect is a
times as large on these logs as it was fitted, the square that is left falls by (2 a − 1) S, give
or take the scatter, 2 √S. An effect that stands for something else has another size there.
"""

from math import inf, sqrt
from typing import Any

from dmptm_ctrl.diagnosis.candidate import FIRM, Evidence
from dmptm_ctrl.diagnosis.negligible import without_weak
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.simulate.model import Floats

SIZES = 0.75, 1.5  # where the squares fall by half and by twice the power
VAGUE = 0.5  # standard error of a size that says nothing


def held_size(before: Floats, after: Floats) -> tuple[float, float]:
    """Return how large an effect is, in units of its fitted size, and the standard error.

    Parameters
    ----------
    before, after : (m,) arrays
        Residual without and with it, in units of the scatter with it, of independent rows.
    """
    power = float((before - after) @ (before - after))
    if power == 0.0:
        return 1.0, inf
    fall = float(before @ before - after @ after)
    return 0.5 * (1.0 + fall / power), 1.0 / sqrt(power)


def contradicted(before: Floats, after: Floats) -> bool:
    """Whether an effect is clearly smaller, or larger, than it was fitted."""
    size, error = held_size(before, after)
    least, most = SIZES
    return max(least - size, size - most) > FIRM * error


def confirmed(evidence: Evidence, selection: Selection) -> Selection:
    """Take out effects that held-out logs contradict, those of least evidence first.

    Until they contradict none of those that are left.
    """

    def worth(without: Any, final: Any) -> float:
        wrong = contradicted(*evidence.held_residuals(without, final))
        return sum(evidence.gains(without, final)) if wrong else inf

    why = "held-out logs contradict its size"
    while (kept := without_weak(evidence, selection, worth, inf, why)) is not selection:
        selection = kept
    return selection


def size_text(evidence: Evidence, without: Any, final: Any) -> str:
    """Return what held-out logs say of an effect's size."""
    size, error = held_size(*evidence.held_residuals(without, final))
    if error > VAGUE:
        return "held-out logs hardly show its size"
    return f"on held-out logs the effect is {size:.2f} ± {error:.1g} times as large as fitted"
