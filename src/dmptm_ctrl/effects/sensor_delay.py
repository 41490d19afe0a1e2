"""Sensor delay: the speed sensor reads late.

reading(t) = ω(t − T_d)
"""

from numba import njit

from dmptm_ctrl.contract import SENSORS, Effect, Parameter


@njit
def reading_delay(p):
    """Dead time of the speed reading [s]."""
    return p.delay


SENSOR_DELAY = Effect(
    name="sensor_delay",
    site="sensor_delay",
    kernel=reading_delay,
    parameters=(Parameter("delay", "s", 0.0, 0.03, 0.002),),  # T_d
    location="speed sensor",
    source="digital filter and bus of a gyro",
    depends_on=("omega_L",),
    reveals="position and speed of the same body, with fast changes",
    seen_by=SENSORS,
    matters=0.0007,
)
