"""Unknown torque: a torque on the ring gear that a curve describes and no name explains.

τ = T(x),  x one of θL, ωL, t
"""

from numba import njit

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.lookup import ANGLE, SPEED, TIME, looked_up, table_parameters, table_type


@njit
def table_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    x = theta_L
    if p.variable > 0.5:
        x = omega_L
    if p.variable > 1.5:
        x = t
    return looked_up(x, p)


UNKNOWN_TORQUE = Effect(
    name="unknown_torque",
    site="load",
    kernel=table_torque,
    parameters=table_parameters("N·m", 60.0, 2.0, (ANGLE, SPEED, TIME), (0.0, 0.02)),
    values=table_type("UnknownTorque"),
    location="ring gear",
    source="lookup table, fitted",
    depends_on=("theta_L", "omega_L", "time"),
    reveals="the range of the variable, slowly, in both directions",
)
