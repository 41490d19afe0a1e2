"""Stribeck friction: more friction at low speed than Coulomb's, up to breakaway.

friction += A exp(−|ω|/Ω)

A is what static friction exceeds Coulomb friction by.
Source: paper Eq. 25 with exponent 1; Armstrong-Hélouvry et al., Automatica 30 (1994) 1083.
"""

from math import exp

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def stribeck_excess(theta, omega, t, mesh_torque, body, p):
    """Factor on the friction (1) and added magnitude [N·m]."""
    return 1.0, p.excess * exp(-abs(omega) / p.speed)


STRIBECK_FRICTION = Effect(
    name="stribeck_friction",
    site="friction",
    kernel=stribeck_excess,
    parameters=(
        Parameter("excess", "N·m", 0.0, float("inf"), 1.0),  # A = Ts − Tc
        Parameter(
            "speed", "rad/s", 1e-3, 0.5, 0.01, (0.003, 0.01, 0.03, 0.06, 0.12, 0.25)
        ),  # shares of the highest speed in the logs
    ),
    location="bearings and guides",
    source="Armstrong-Hélouvry et al., Automatica 30 (1994) 1083",
    depends_on=("omega_L",),
    reveals="slow reversals, and steady motion from very slow to fast",
)
