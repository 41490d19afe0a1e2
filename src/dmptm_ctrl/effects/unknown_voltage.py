"""Unknown voltage: what both drives add to their command, as a curve without a name.

u → u + T(x),  x one of u, t
"""

from numba import njit

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.lookup import TIME, VOLTAGE, looked_up, table_parameters


@njit
def table_voltage(u, t, side, p):
    """Voltage of the drive [V]."""
    return u + looked_up(u if p.variable > 2.5 else t, p)


UNKNOWN_VOLTAGE = Effect(
    name="unknown_voltage",
    site="amplifier",
    kernel=table_voltage,
    parameters=table_parameters("V", 2.0, 0.05, (VOLTAGE, TIME), (0.0, 0.1)),
    location="both drives",
    source="lookup table, fitted",
    depends_on=("u", "time"),
    reveals="a slow ramp over the whole range of voltages",
)
