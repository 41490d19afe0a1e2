"""Drive saturation: the current limit clips the command.

u_e = max(−U, min(U, u)),  parametrised by 1/U so that zero is absent
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def saturated_voltage(u, t, side, p):
    """Voltage after the limit [V]."""
    if p.inverse_limit <= 0.0:
        return u
    limit = 1.0 / p.inverse_limit
    return min(limit, max(-limit, u))


DRIVE_SATURATION = Effect(
    name="drive_saturation",
    site="amplifier",
    kernel=saturated_voltage,
    parameters=(Parameter("inverse_limit", "1/V", 0.0, 20.0, 0.05),),  # 1/U
    location="drives",
    source="peak current of the drive",
    depends_on=("u",),
    reveals="signals well below and well above the limit",
    search="limits",
    kink=0.05,
)
