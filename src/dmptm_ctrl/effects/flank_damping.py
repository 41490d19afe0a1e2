"""Flank damping: flanks that damp the more, the deeper they are pressed, with no jump at the touch.

    torque = k (1 + χ ż) (z - gap)     contact on the plus side, as its mirror on the other

in place of the c ż of Eq. 21. At the torque T of a mesh it damps as c = χ T does.
"""

from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter

MOST = 0.8  # of their stiffness, that opening flanks lose at most: soon after they would pull


class FlankDamping(NamedTuple):
    """Parameters."""

    damping: float  # s/rad, χ
    ratio: float  # N2, of the mesh
    stiffness: float  # N·m/rad, k


@njit
def flank_stiffness(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z [rad], its rate [rad/s], change of half-gap (none) and stiffness [N·m/rad]."""
    z, z_rate = theta_p - p.ratio * theta_L, omega_p - p.ratio * omega_L
    closing = z_rate if z >= 0.0 else -z_rate
    return 0.0, 0.0, 0.0, p.stiffness * max(p.damping * closing, -MOST)


FLANK_DAMPING = Effect(
    name="flank_damping",
    site="mesh",
    kernel=flank_stiffness,
    parameters=(
        Parameter("damping", "s/rad", 0.0, 5.0, 0.15),
        Parameter("ratio", "", 1.0, 100.0, 1.0, (8.25,)),
        Parameter("stiffness", "N·m/rad", 1e2, 1e6, 1e3, (36e3,)),
    ),
    values=FlankDamping,
    location="meshes",
    source="Hunt & Crossley 1975, J. Appl. Mech. 42, 440",
    depends_on=("mesh_torque",),
    reveals="hard reversals from rest",
)
