"""Ring-gear eccentricity: the ring gear's pitch circle is off its axis.

    z_i += C cos(θL + i·120°) + S sin(θL + i·120°), i = 0 left, 1 right

The pinions sit 120° apart.
"""

from math import cos, pi, sin

from numba import njit

from dmptm_ctrl.contract import MOTOR_ENCODERS, Effect, cosine_and_sine

PINION_ANGLE = 2.0 * pi / 3.0  # rad between the pinions on the ring gear


@njit
def eccentric_shift(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z [rad], its rate [rad/s], changes of half-gap and stiffness (none)."""
    phase = theta_L + side * PINION_ANGLE
    c, s = cos(phase), sin(phase)
    return p.cosine * c + p.sine * s, (p.sine * c - p.cosine * s) * omega_L, 0.0, 0.0


RING_GEAR_ECCENTRICITY = Effect(
    name="ring_gear_eccentricity",
    site="mesh",
    kernel=eccentric_shift,
    parameters=cosine_and_sine("rad", 3e-2, 1e-4),
    location="ring gear",
    source="kinematic error of an eccentric ring gear",
    depends_on=("theta_L",),
    reveals="a full turn with motor encoders",
    seen_by=MOTOR_ENCODERS,
    wave=True,
)
