"""What no catalogue effect explains: which variable the missing torque depends on.

Curves without a name, of the ring-gear angle, the speed, the voltage, the time …, are fitted
to what is left of the balances; a variable whose curve predicts the held-out logs is one that
the missing effect depends on. Bursts too short and too large for the robust loss are looked
at for themselves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from dmptm_ctrl.diagnosis.bursts import BURSTS, Bursts, bursts
from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.curves import Curve, curves
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.slip import SLIP, wanders

CURVE = LEVEL  # evidence of a curve, less the price of its knots: that of any effect
HELD = 8.0  # of it on the held-out logs: a curve has many knots
# What a named effect leaves because its form is only nearly right is small beside it.
CURVE_SHARE = 0.1
ALIKE = 0.7  # share of the best curve's evidence from which another is named with it
# The same for one that predicts held-out logs so many times as well: most of the evidence is
# of the fitted logs, on which a curve may bend as it likes.
ALIKE_HELD, BETTER_HELD = 0.5, 2.0


@dataclass(frozen=True)
class Unexplained:
    """What no name stands for.

    Attributes
    ----------
    variables : tuple of str
        That it depends on.
    curve : Curve or None
        The best of those that count.
    slips : float
        How far a flank wanders within a log that no curve follows [N·m of twist]; 0 if it does not.
    """

    variables: tuple[str, ...]
    curve: Curve | None
    bursts: Bursts
    slips: float = 0.0


def unexplained(before: Residual, after: Residual, named: float) -> Unexplained | None:
    """Tell whether something is left that no name stands for.

    Parameters
    ----------
    before, after : Residual
        Without and with the named effects; the same where none was found.
    named : float
        Evidence of the named effects together.
    """
    seen = curves(after)
    left = significant(seen, max(CURVE, CURVE_SHARE * named))
    shots = bursts(after)
    by_the_clock = after is before and shots.period > 0.0
    few = left is None and shots.share < BURSTS and not by_the_clock
    slips = wanders(before, after) if few else 0.0
    if few and slips == 0.0:
        return None
    best = left
    if after is not before:
        bare = curves(before)
        top = significant(bare, CURVE)
        if top is not None and top.evidence > named:
            best, seen, shots = top, bare, bursts(before)
    variables = alike(seen, best) if best is not None else ()
    if shots.share >= BURSTS and (best is None or "time" in shots.variables[:1]):
        variables = (*variables, *shots.variables)
    if slips > 0.0 and best is None:
        variables = SLIP
    return Unexplained(tuple(dict.fromkeys(variables)), best, shots, slips)


def alike(found: Sequence[Curve], best: Curve) -> tuple[str, ...]:
    """Variables of the best curve, then of those that the logs hardly distinguish from it."""
    near = []
    for c in found:
        better = c.held_gain > BETTER_HELD * best.held_gain
        least = (ALIKE_HELD if better else ALIKE) * best.evidence
        if c.evidence > least and c.held_gain > HELD:
            near.append(c)
    names = [name for c in (best, *near) for name in c.variables]
    return tuple(dict.fromkeys(names))


def significant(found: Sequence[Curve], least: float) -> Curve | None:
    """Return the best curve with enough evidence, on the held-out logs too."""
    return next((c for c in found if c.evidence > least and c.held_gain > HELD), None)
