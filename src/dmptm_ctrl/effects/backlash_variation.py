"""Backlash variation: the tooth gap changes around the ring gear.

Δ_i += C_i cos(θL + i·120°) + S_i sin(θL + i·120°), i = 0 left, 1 right
"""

from math import cos, pi, sin
from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter

PINION_ANGLE = 2.0 * pi / 3.0  # rad between the pinions on the ring gear


class BacklashVariation(NamedTuple):
    """Parameters."""

    left_cosine: float  # rad at the pinion
    left_sine: float  # rad at the pinion
    right_cosine: float  # rad at the pinion
    right_sine: float  # rad at the pinion


@njit
def varied_gap(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z and its rate (none), change of half-gap [rad], of stiffness (none)."""
    phase = theta_L + side * PINION_ANGLE
    if side == 0:
        return 0.0, 0.0, p.left_cosine * cos(phase) + p.left_sine * sin(phase), 0.0
    return 0.0, 0.0, p.right_cosine * cos(phase) + p.right_sine * sin(phase), 0.0


BACKLASH_VARIATION = Effect(
    name="backlash_variation",
    site="mesh",
    kernel=varied_gap,
    parameters=(
        Parameter("left_cosine", "rad", -5e-3, 5e-3, 1e-4),
        Parameter("left_sine", "rad", -5e-3, 5e-3, 1e-4),
        Parameter("right_cosine", "rad", -5e-3, 5e-3, 1e-4),
        Parameter("right_sine", "rad", -5e-3, 5e-3, 1e-4),
    ),
    values=BacklashVariation,
    location="ring gear",
    source="tooth thickness and centre distance around the rim",
    depends_on=("theta_L",),
    reveals="reversals at many ring-gear angles",
)
