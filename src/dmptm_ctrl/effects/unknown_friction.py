"""Unknown friction: Coulomb friction of the ring gear that a curve describes, without a name.

Coulomb friction of the ring gear += T(x),  x one of θL, ωL, t
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
)


@njit
def table_friction(theta, omega, t, mesh_torque, body, p):
    """Factor on the declared friction (1) and added Coulomb torque [N·m]."""
    if body != 2:
        return 1.0, 0.0
    return 1.0, looked_up(motion_of_ring(theta, omega, t, p), p)


UNKNOWN_FRICTION = Effect(
    name="unknown_friction",
    site="friction",
    kernel=table_friction,
    parameters=table_parameters("N·m", 60.0, 2.0, (ANGLE, SPEED, TIME), (0.0, 0.02)),
    location="ring-gear bearing",
    source="lookup table, fitted",
    depends_on=("theta_L", "omega_L", "time"),
    reveals="the range of the variable, slowly, in both directions",
)
