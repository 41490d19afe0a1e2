"""Pinion runout: the pinions' pitch circles are off their axes.

z += C cos θp + S sin θp, each pinion with its own
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import MOTOR_ENCODERS, SIDES, Effect, cosine_and_sine


@njit
def runout_shift(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z [rad], its rate [rad/s], changes of half-gap and stiffness (none)."""
    if side == 0:
        cosine, sine = p.left_cosine, p.left_sine
    else:
        cosine, sine = p.right_cosine, p.right_sine
    c, s = cos(theta_p), sin(theta_p)
    return cosine * c + sine * s, (sine * c - cosine * s) * omega_p, 0.0, 0.0


PINION_RUNOUT = Effect(
    name="pinion_runout",
    site="mesh",
    kernel=runout_shift,
    parameters=cosine_and_sine("rad", 2e-2, 1e-4, SIDES),
    location="pinions",
    source="kinematic error of an eccentric pinion",
    depends_on=("theta_m",),
    reveals="several turns with motor encoders",
    seen_by=MOTOR_ENCODERS,
    wave=True,
)
