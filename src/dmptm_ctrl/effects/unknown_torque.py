"""Unknown torque: a torque on the ring gear that a curve describes and no name explains.

τ = T(x),  x one of θL, ωL, t, t in a period;  τ = ωL T(θL)
"""

from numba import njit

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.lookup import (
    ANGLE,
    CLOCK,
    DRAG,
    SPEED,
    TIME,
    in_period,
    in_turn,
    looked_up,
    motion_of_ring,
    period_parameter,
    table_parameters,
    table_type,
)


@njit
def table_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    x = motion_of_ring(theta_L, omega_L, t, p)
    if p.variable == CLOCK:
        x = in_period(t, p)
    if p.variable == DRAG:
        x = in_turn(theta_L, p)
    value = looked_up(x, p)
    return omega_L * value if p.variable == DRAG else value


UNKNOWN_TORQUE = Effect(
    name="unknown_torque",
    site="load",
    kernel=table_torque,
    parameters=(
        *table_parameters("N·m", 100.0, 2.0, (ANGLE, SPEED, CLOCK, TIME, DRAG), (0.0, 0.02)),
        period_parameter(),
    ),
    values=table_type("UnknownTorque", "period"),
    location="ring gear",
    source="lookup table, fitted",
    depends_on=("theta_L", "omega_L", "time"),
    reveals="the range of the variable, slowly, in both directions",
)
