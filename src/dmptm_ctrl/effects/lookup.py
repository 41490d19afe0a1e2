"""A curve as a table: what an effect on nobody's list is known by.

Linear between evenly spaced knots, constant beyond the ends. The table is over one of the
variables of its site, chosen by a number.
"""

from collections.abc import Callable
from math import floor, pi
from typing import Any

from numba import njit

from dmptm_ctrl.contract import Parameter

KNOTS = 32
FIRST = 3  # position of the first knot among the parameters
ANGLE, SPEED, TIME, VOLTAGE = 0.0, 1.0, 2.0, 3.0  # values of `variable`
# The same of a motor: its angle in a turn, its speed (braking is negative), the time in a period,
# its angle in a turn of the ring gear.
TURN, BRAKING, CLOCK, PATH = 4.0, 5.0, 6.0, 7.0
DRAG = 8.0  # angle again, of what is multiplied by the speed
# Speed either way, of the sizes of a wave over the angle: half of the knots are its cosine's
WAVE = 9.0
HALF = KNOTS // 2
WIDEST = 60.0  # rad, rad/s, s or V: no log goes further
# s, or rad: a period that no log comes to the end of; the time in it is that in the log
LONGEST = 1e4


def table_parameters(
    unit: str,
    largest: float,
    step: float,
    variables: tuple[float, ...],
    ends: tuple[float, float],
    widest: float = WIDEST,
) -> tuple[Parameter, ...]:
    """Parameters of a table with knots up to `largest`.

    The middle one of `variables` is the default, and `ends` of its table, not beyond `widest`.
    """
    low, high = ends
    return (
        Parameter("variable", "", ANGLE, WAVE, 1.0, variables),
        Parameter("low", "SI", -widest, widest, 0.02, (low,)),
        Parameter("high", "SI", -widest, widest, 0.02, (high,)),
        *(Parameter(f"k{i}", unit, -largest, largest, step) for i in range(KNOTS)),
    )


def period_parameter() -> Parameter:
    """Return the period of a table over the clock or a motor's angle, or of a wave."""
    return Parameter("period", "SI", 0.01, LONGEST, 0.01, (0.03,))


@njit
def in_period(x, p):
    """Time, or a motor's angle, in a period that begins with the table, counted from `low`."""
    past = (x - p.low) / p.period
    return p.low + p.period * (past - floor(past))


@njit
def in_turn(theta, p):
    """Angle within half a turn of the table's middle: what it stands for comes back each turn."""
    return theta - 2.0 * pi * floor((theta - 0.5 * (p.low + p.high)) / (2.0 * pi) + 0.5)


@njit
def motion_of_ring(theta, omega, t, p):
    """Variable that a table of the ring gear is over: angle in a turn, speed or time."""
    if p.variable < 0.5:
        return in_turn(theta, p)
    return omega if p.variable < 1.5 else t


@njit
def looked_up(x, p):
    """Value of the table at x; that of the first knot if the ends are the wrong way round."""
    if not p.high > p.low:
        return p[FIRST]
    place = (x - p.low) / (p.high - p.low) * (KNOTS - 1)
    place = min(max(place, 0.0), KNOTS - 1.0)
    i = max(0, min(int(place), KNOTS - 2))
    share = place - i
    return (1.0 - share) * p[FIRST + i] + share * p[FIRST + 1 + i]


def _sum_of_hats() -> Callable[..., float]:
    """Return the sum of what each knot adds at a place, term by term, in four sums."""
    hats = [f"p.k{k} * max(1.0 - abs(place - {k}.0), 0.0)" for k in range(KNOTS)]
    sums = "".join(f"    s{j} = {' + '.join(hats[j::4])}\n" for j in range(4))
    names: dict[str, Any] = {}
    exec(f"def table(place, p):\n{sums}    return (s0 + s1) + (s2 + s3)\n", names)
    return names["table"]


_sum = njit(_sum_of_hats())


@njit
def summed(x, p):
    """Give the same as :func:`looked_up` without fetching a knot by its number.

    For several drives side by side, each at another place, that takes longer than to add what all
    knots give, nearly all of them nothing.
    """
    length = p.high - p.low
    place = (x - p.low) / (length if length > 0.0 else 1.0) * (KNOTS - 1)
    place = min(max(place, 0.0), KNOTS - 1.0)
    return _sum(place if length > 0.0 else 0.0, p)
