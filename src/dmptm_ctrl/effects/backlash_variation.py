"""Backlash variation: the tooth gap changes around the ring gear.

Δ_i += (C ± C') cos(n (θL + i·120°)) + (S ± S') sin(n (θL + i·120°)), i = 0 left (+), 1 right (−)

Both pinions meet the same ring gear a third of a turn apart; C' and S' are what differs between
the two meshes.
"""

from math import cos, pi, sin

from numba import njit

from dmptm_ctrl.contract import MOTOR_ENCODERS, Effect, Parameter, cosine_and_sine

PINION_ANGLE = 2.0 * pi / 3.0  # rad between the pinions on the ring gear


@njit
def varied_gap(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z and its rate (none), change of half-gap [rad], of stiffness (none)."""
    phase = p.order * (theta_L + side * PINION_ANGLE)
    own = 1.0 - 2.0 * side
    cosine, sine = p.cosine + own * p.apart_cosine, p.sine + own * p.apart_sine
    return 0.0, 0.0, cosine * cos(phase) + sine * sin(phase), 0.0


BACKLASH_VARIATION = Effect(
    name="backlash_variation",
    site="mesh",
    kernel=varied_gap,
    parameters=(
        *cosine_and_sine("rad", 5e-3, 1e-4),
        *cosine_and_sine("rad", 1.5e-3, 1e-4, ("apart_",)),
        # n; the middle one is meant where none is given
        Parameter("order", "1/turn", 1.0, 8.0, 1.0, (2.0, 1.0, 3.0), fixed=True),
    ),
    location="ring gear",
    source="tooth thickness and centre distance around the rim",
    depends_on=("theta_L",),
    reveals="reversals at many ring-gear angles",
    seen_by=MOTOR_ENCODERS,
    wave=True,
)
