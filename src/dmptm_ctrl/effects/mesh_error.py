"""Mesh error: tooth-to-tooth error and varying stiffness, once per tooth.

z += C cos(n θp) + S sin(n θp), n teeth of the pinion, each pinion with its own
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import SIDES, Effect, Parameter, cosine_and_sine

TEETH = 20.0  # z3, Table 1: of the dual-motor drive


@njit
def tooth_shift(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z [rad], its rate [rad/s], changes of half-gap and stiffness (none)."""
    if side == 0:
        cosine, sine = p.left_cosine, p.left_sine
    else:
        cosine, sine = p.right_cosine, p.right_sine
    phase = p.order * theta_p
    c, s = cos(phase), sin(phase)
    return cosine * c + sine * s, p.order * (sine * c - cosine * s) * omega_p, 0.0, 0.0


MESH_ERROR = Effect(
    name="mesh_error",
    site="mesh",
    kernel=tooth_shift,
    parameters=(
        *cosine_and_sine("rad", 5e-3, 2e-5, SIDES),
        Parameter("order", "1/turn", 1.0, 400.0, 1.0, (TEETH,), fixed=True),  # n
    ),
    location="pinions",
    source="first harmonic of the tooth-to-tooth error; phase by mesh angle (Eq. 23, erratum)",
    depends_on=("theta_m",),
    reveals="slow constant speed with motor encoders",
    wave=True,
)
