"""Torque constant mismatch: one motor gives more or less torque per volt than the other.

u × (1 + δ) on one motor; or left × (1 + δ), right × (1 − δ)
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter

LEFT, RIGHT, OPPOSITE = 0.0, 1.0, 2.0  # which motors are off


@njit
def mismatched_voltage(u, t, side, p):
    """Voltage that would give the same torque with the declared constant [V]."""
    if p.pattern == OPPOSITE:
        return u * (1.0 + p.error) if side == 0 else u * (1.0 - p.error)
    return u * (1.0 + p.error) if p.pattern == side else u


TORQUE_CONSTANT_MISMATCH = Effect(
    name="torque_constant_mismatch",
    site="amplifier",
    kernel=mismatched_voltage,
    parameters=(
        Parameter("error", "", -0.5, 0.5, 0.02),  # relative, δ
        Parameter("pattern", "", LEFT, OPPOSITE, 1.0, (LEFT, RIGHT, OPPOSITE), fixed=True),
    ),
    location="motors",
    source="spread of magnets and windings",
    depends_on=("u",),
    reveals="each motor driven alone at the same voltage, with motor encoders",
)
