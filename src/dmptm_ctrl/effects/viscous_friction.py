"""Viscous friction: a force against the motion that grows with the speed.

friction = B |ω|
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def viscous_level(theta, omega, t, mesh_torque, body, p):
    """Factor on the friction (1) and added magnitude [N·m]."""
    return 1.0, p.coefficient * abs(omega)


VISCOUS_FRICTION = Effect(
    name="viscous_friction",
    site="friction",
    kernel=viscous_level,
    parameters=(Parameter("coefficient", "N·m·s/rad", 0.0, float("inf"), 1.0),),  # B
    location="bearings and guides; of a voltage-driven motor its back-EMF too",
    source="Newton's fluid",
    depends_on=("omega_L",),
    reveals="steady motion at several speeds",
)
