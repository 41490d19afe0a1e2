"""Stiffness variation: teeth in contact change as the pinion turns.

k += k_a cos(z₃ θ₃ + φ)

Source: paper Eq. 23 with the mesh angle as phase.
"""

from math import cos
from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class StiffnessVariation(NamedTuple):
    """Parameters."""

    amplitude: float  # N·m/rad, k_a
    teeth: float  # per turn of the pinion, z₃
    phase: float  # rad, φ


@njit
def varied_stiffness(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z and its rate, change of half-gap (none), of stiffness [N·m/rad]."""
    return 0.0, 0.0, 0.0, p.amplitude * cos(p.teeth * theta_p + p.phase)


STIFFNESS_VARIATION = Effect(
    name="stiffness_variation",
    site="mesh",
    kernel=varied_stiffness,
    parameters=(
        Parameter("amplitude", "N·m/rad", 0.0, 1e4, 100.0),
        Parameter("teeth", "", 1.0, 200.0, 1.0, (18.0, 20.0, 25.0)),
        Parameter("phase", "rad", -3.2, 3.2, 0.1, (0.0,)),
    ),
    values=StiffnessVariation,
    location="mesh",
    source="paper Eq. 23",
    depends_on=("theta_p",),
    reveals="fast turns under preload, at the frequency of the teeth",
)
