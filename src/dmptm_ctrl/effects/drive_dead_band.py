"""Drive dead band: small commands give no torque.

u_e = u − b for u > b, u + b for u < −b, else 0
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def dead_band_voltage(u, t, side, p):
    """Voltage after the dead band [V]."""
    if u > p.width:
        return u - p.width
    if u < -p.width:
        return u + p.width
    return 0.0


DRIVE_DEAD_BAND = Effect(
    name="drive_dead_band",
    site="amplifier",
    kernel=dead_band_voltage,
    parameters=(Parameter("width", "V", 0.0, 0.5, 0.01),),  # b
    location="drives",
    source="dead time of the bridge's switches",
    depends_on=("u",),
    reveals="small slow signals around zero, besides large ones",
    starts=(("width", 1.0), ("width", 5.0)),
    kink=0.05,
)
