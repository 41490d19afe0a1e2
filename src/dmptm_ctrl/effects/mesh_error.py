"""Mesh error: tooth-to-tooth error and varying stiffness, once per tooth.

z += C cos(z3 θp) + S sin(z3 θp)
"""

from math import cos, sin
from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter

TEETH = 20.0  # z3, Table 1


class MeshError(NamedTuple):
    """Parameters."""

    cosine: float  # rad
    sine: float  # rad


@njit
def tooth_shift(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z [rad], its rate [rad/s], changes of half-gap and stiffness (none)."""
    phase = TEETH * theta_p
    c, s = cos(phase), sin(phase)
    return p.cosine * c + p.sine * s, TEETH * (p.sine * c - p.cosine * s) * omega_p, 0.0, 0.0


MESH_ERROR = Effect(
    name="mesh_error",
    site="mesh",
    kernel=tooth_shift,
    parameters=(
        Parameter("cosine", "rad", -1e-3, 1e-3, 2e-5),
        Parameter("sine", "rad", -1e-3, 1e-3, 2e-5),
    ),
    values=MeshError,
    location="pinions",
    source="first harmonic of the tooth-to-tooth error; phase by mesh angle (Eq. 23, erratum)",
    depends_on=("theta_m",),
    reveals="slow constant speed with motor encoders",
)
