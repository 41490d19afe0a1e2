"""Friction asymmetry: more friction one way than the other.

friction × (1 + α sgn ω)

The whole friction of the body scales: Coulomb, viscous and Stribeck alike.
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def directional_factor(theta, omega, t, mesh_torque, body, p):
    """Factor on the friction and added magnitude [N·m] (none)."""
    return (1.0 + p.difference if omega > 0.0 else 1.0 - p.difference), 0.0


FRICTION_ASYMMETRY = Effect(
    name="friction_asymmetry",
    site="friction",
    kernel=directional_factor,
    parameters=(Parameter("difference", "", -0.9, 0.9, 0.02),),  # relative, α
    location="bearings and guides",
    source="Table 2 of the paper: every row differs by direction",
    depends_on=("omega_L",),
    reveals="motion in both directions at several speeds; only these separate it from "
    "an offset of the drive",
)
