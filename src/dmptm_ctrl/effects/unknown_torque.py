"""Unknown torque: a torque on the ring gear that a curve describes and no name explains.

τ = T(x),  x one of θL, ωL, t
"""

from numba import njit

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.lookup import (
    ANGLE,
    SPEED,
    TIME,
    looked_up,
    motion_of_ring,
    table_parameters,
    table_type,
)


@njit
def table_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    return looked_up(motion_of_ring(theta_L, omega_L, t, p), p)


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
