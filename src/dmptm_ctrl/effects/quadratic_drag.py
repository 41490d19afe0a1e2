"""Quadratic drag: air or churning oil brakes with the square of the speed.

torque = −c ω |ω|
"""

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def drag_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    return -p.coefficient * omega_L * abs(omega_L)


QUADRATIC_DRAG = Effect(
    name="quadratic_drag",
    site="load",
    kernel=drag_torque,
    parameters=(Parameter("coefficient", "N·m·s²/rad²", 0.0, 400.0, 5.0),),  # c
    location="ring gear",
    source="turbulent drag",
    depends_on=("omega_L",),
    reveals="steady motion from slow to the highest speed",
)
