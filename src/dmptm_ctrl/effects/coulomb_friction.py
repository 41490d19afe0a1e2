"""Coulomb friction: a constant force against the motion.

moving:   F against the motion
at rest:  any value in [−F, F], as much as it takes to stay
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def coulomb_level(theta, omega, t, mesh_torque, body, p):
    """Factor on the friction (1) and added magnitude [N·m]."""
    return 1.0, p.level


COULOMB_FRICTION = Effect(
    name="coulomb_friction",
    site="friction",
    kernel=coulomb_level,
    parameters=(Parameter("level", "N·m", 0.0, float("inf"), 1.0),),  # F
    location="bearings and guides",
    source="Coulomb 1785",
    depends_on=("omega_L",),
    reveals="motion in both directions at several speeds",
)
