"""Stiffness variation: teeth in contact change as the pinion turns.

k += C cos(n θp) + S sin(n θp), n teeth of the pinion

Source: paper Eq. 23 with the mesh angle as phase.
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter, cosine_and_sine


@njit
def varied_stiffness(theta_p, omega_p, theta_L, omega_L, side, p):
    """Shift of z and its rate, change of half-gap (none), of stiffness [N·m/rad]."""
    phase = p.order * theta_p
    return 0.0, 0.0, 0.0, p.cosine * cos(phase) + p.sine * sin(phase)


STIFFNESS_VARIATION = Effect(
    name="stiffness_variation",
    site="mesh",
    kernel=varied_stiffness,
    parameters=(
        *cosine_and_sine("N·m/rad", 1e4, 100.0),
        Parameter("order", "1/turn", 1.0, 400.0, 1.0, (18.0, 20.0, 25.0), fixed=True),  # n
    ),
    location="mesh",
    source="paper Eq. 23",
    depends_on=("theta_m",),
    reveals="fast turns under preload, at the frequency of the teeth",
    wave=True,
)
