"""Sensor gain: the speed sensor reads too much or too little.

reading = (1 + s) ω
"""

from numba import njit

from dmptm_ctrl.contract import SENSORS, Effect, Parameter


@njit
def gained_reading(theta_L, omega_L, t, p):
    """Readings of ring-gear angle [rad] and speed [rad/s]."""
    return theta_L, (1.0 + p.error) * omega_L


SENSOR_GAIN = Effect(
    name="sensor_gain",
    site="sensor",
    kernel=gained_reading,
    parameters=(Parameter("error", "", -0.3, 0.3, 0.01),),  # relative, s
    location="speed sensor",
    source="scale factor of a gyro",
    depends_on=("omega_L",),
    reveals="position and speed of the same body",
    seen_by=SENSORS,
    matters=0.003,
)
