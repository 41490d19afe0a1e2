"""Drive offset: a constant voltage is added to the command.

u_e = u + b
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def offset_voltage(u, t, side, p):
    """Voltage after the offset [V]."""
    return u + (p.left if side == 0 else p.right)


DRIVE_OFFSET = Effect(
    name="drive_offset",
    site="amplifier",
    kernel=offset_voltage,
    parameters=(Parameter("left", "V", -0.3, 0.3, 0.01), Parameter("right", "V", -0.3, 0.3, 0.01)),
    location="drives",
    source="analogue command interface",
    depends_on=("u",),
    reveals="motion in both directions at several speeds",
)
