"""Unknown torque: a torque on the ring gear that a curve describes and no name explains.

τ = T(x),  x one of θL, ωL, t, t in a period;  τ = ωL T(θL);
τ = A(|ωL|) cos(2π θL / period) + B(|ωL|) sin(2π θL / period)
"""

from math import cos, pi, sin

from numba import njit

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.lookup import (
    ANGLE,
    CLOCK,
    DRAG,
    HALF,
    KNOTS,
    SPEED,
    TIME,
    WAVE,
    in_period,
    in_turn,
    looked_up,
    motion_of_ring,
    period_parameter,
    table_parameters,
)


@njit
def wave(theta, omega, p):
    """Torque of a wave over the angle, its size over the speed."""
    step = (p.high - p.low) / (KNOTS - 1)
    place = p.low + min(abs(omega), (HALF - 1) * step)
    phase = 2.0 * pi / p.period * theta
    return looked_up(place, p) * cos(phase) + looked_up(place + HALF * step, p) * sin(phase)


@njit
def table_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    if p.variable == WAVE:
        return wave(theta_L, omega_L, p)
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
        *table_parameters("N·m", 100.0, 2.0, (ANGLE, SPEED, WAVE, CLOCK, TIME, DRAG), (0.0, 0.02)),
        period_parameter(),
    ),
    location="ring gear",
    source="lookup table, fitted",
    depends_on=("theta_L", "omega_L", "time"),
    reveals="the range of the variable, slowly, in both directions",
)
