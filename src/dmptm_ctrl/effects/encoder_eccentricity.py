"""Encoder eccentricity: the encoder's disc is off the axis.

reading = θL + C cos θL + S sin θL
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import SENSORS, Effect, cosine_and_sine


@njit
def eccentric_reading(theta_L, omega_L, t, p):
    """Readings of ring-gear angle [rad] and speed [rad/s]."""
    return theta_L + p.cosine * cos(theta_L) + p.sine * sin(theta_L), omega_L


ENCODER_ECCENTRICITY = Effect(
    name="encoder_eccentricity",
    site="sensor",
    kernel=eccentric_reading,
    parameters=cosine_and_sine("rad", 0.02, 2e-4),
    location="ring-gear encoder",
    source="eccentric disc",
    depends_on=("theta_L",),
    reveals="position and speed of the same body over whole turns",
    seen_by=SENSORS,
    matters=5e-5,
)
