"""Cable wrap: a cable or hose that winds up turns the ring gear back.

torque = −k (θL − θ0) = −k θL + T0
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def cable_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    return p.offset - p.stiffness * theta_L


CABLE_SPRING = Effect(
    name="cable_spring",
    site="load",
    kernel=cable_torque,
    parameters=(
        Parameter("stiffness", "N·m/rad", 0.0, 40.0, 1.0),  # k
        Parameter("offset", "N·m", -60.0, 60.0, 2.0),  # T0 = k θ0
    ),
    location="ring gear",
    source="linear spring",
    depends_on=("theta_L",),
    reveals="slow motion over the whole travel, both ways, with stops",
    constants=("offset",),
)
