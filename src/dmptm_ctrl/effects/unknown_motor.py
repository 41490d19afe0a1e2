"""Unknown motor: what a motor makes of its voltage, as a curve without a name.

torque = u T(x) on the motor's shaft,  x one of θm in a turn or a part of it, ωm sgn u (braking
below zero), t in a period;  |u| T(x) with x = θm in a period, that of the ring gear's turn

A part of the torque may be lost over a sector of the rotor, while the motor brakes, or at fixed
intervals; a ripple over the ring gear's angle may grow with the voltage of either sign. Two motors
of one kind have one curve; the right one is ahead in its turn, or in a period, by `apart`.
"""

from math import floor, pi

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter
from dmptm_ctrl.effects.lookup import (
    BRAKING,
    CLOCK,
    PATH,
    TURN,
    in_period,
    looked_up,
    period_parameter,
    table_parameters,
)

LEFT, BOTH, RIGHT = -1.0, 0.0, 1.0  # values of `motors`
WIDEST = 1e4  # rad or rad/s of a motor; no log goes further


@njit
def table_motor(u, theta_m, omega_m, t, side, p):
    """Torque on the motor's shaft [N·m]."""
    ahead = side * p.apart
    angle, turn = theta_m + ahead, p.high - p.low
    if turn > 0.0:
        angle -= turn * floor((angle - p.low) / turn)
    x, factor = angle, u
    if p.variable == PATH:
        x, factor = in_period(theta_m, p), abs(u)
    if p.variable == CLOCK:
        x = in_period(t + ahead, p)
    if p.variable == BRAKING:
        x = omega_m if u > 0.0 else -omega_m
    torque = factor * looked_up(x, p)
    return 0.0 if p.motors * (2 * side - 1) < 0.0 else torque


UNKNOWN_MOTOR = Effect(
    name="unknown_motor",
    site="motor",
    kernel=table_motor,
    parameters=(
        *table_parameters("N·m/V", 2.0, 0.05, (BRAKING, TURN, CLOCK, PATH), (0.0, 0.02), WIDEST),
        Parameter("motors", "", LEFT, RIGHT, 1.0, (LEFT, BOTH, RIGHT)),
        Parameter("apart", "SI", -2.0 * pi, 2.0 * pi, 0.1, (0.0,)),
        period_parameter(),
    ),
    location="motors",
    source="lookup table, fitted",
    depends_on=("u", "theta_m", "omega_m", "time", "theta_L"),
    reveals="steady voltages of several sizes, in both directions, driving and braking",
)
