"""Torque constant mismatch: one motor gives more torque per volt than the other.

left × (1 + δ), right × (1 − δ)
"""

from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class TorqueConstantMismatch(NamedTuple):
    """Parameters."""

    difference: float  # relative, δ


@njit
def mismatched_voltage(u, t, side, p):
    """Voltage that would give the same torque with the declared constant [V]."""
    return u * (1.0 + p.difference) if side == 0 else u * (1.0 - p.difference)


TORQUE_CONSTANT_MISMATCH = Effect(
    name="torque_constant_mismatch",
    site="drive",
    kernel=mismatched_voltage,
    parameters=(Parameter("difference", "", -0.5, 0.5, 0.02),),
    values=TorqueConstantMismatch,
    location="motors",
    source="spread of magnets and windings",
    depends_on=("u",),
    reveals="large voltage of both signs, with motor encoders",
)
