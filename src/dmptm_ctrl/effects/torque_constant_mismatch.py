"""Torque constant mismatch: a motor gives more or less torque per volt than declared.

    left × (1 + δl), right × (1 + δr)
"""

from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class TorqueConstantMismatch(NamedTuple):
    """Relative error of each motor's torque constant."""

    left: float  # relative, δl
    right: float  # relative, δr


@njit
def mismatched_voltage(u, t, side, p):
    """Voltage that would give the same torque with the declared constant [V]."""
    return u * (1.0 + (p.left if side == 0 else p.right))


TORQUE_CONSTANT_MISMATCH = Effect(
    name="torque_constant_mismatch",
    site="drive",
    kernel=mismatched_voltage,
    parameters=(
        Parameter("left", "", -0.5, 0.5, 0.02),
        Parameter("right", "", -0.5, 0.5, 0.02),
    ),
    values=TorqueConstantMismatch,
    location="motors",
    source="spread of magnets and windings",
    depends_on=("u",),
    reveals="each motor driven alone at the same voltage, with motor encoders",
)
