"""Shaft compliance: what is declared as one rigid body is two, joined by a spring.

    J2 = s J,  k = J2 ω_a²,  c = 2 ζ ω_a J2

s is the share of the inertia behind the spring, ω_a the antiresonance seen at the near body
(the far one swinging alone), ω_a/√(1 − s) the resonance.
"""

from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class ShaftCompliance(NamedTuple):
    """Parameters."""

    share: float  # of the inertia, s
    antiresonance: float  # rad/s, ω_a
    damping_ratio: float  # ζ


@njit
def spring(inertia, p):
    """Compliance [rad/(N·m)] and damping [N·m·s/rad] of the spring; `inertia` is the whole J."""
    if p.share <= 0.0 or p.antiresonance <= 0.0:
        return 0.0, 0.0
    far = p.share * inertia
    stiffness = far * p.antiresonance**2
    return 1.0 / stiffness, 2.0 * p.damping_ratio * p.antiresonance * far


SHAFT_COMPLIANCE = Effect(
    name="shaft_compliance",
    site="shaft",
    kernel=spring,
    parameters=(
        Parameter("share", "", 0.0, 0.99, 0.05),
        Parameter("antiresonance", "rad/s", 1.0, 1e5, 1.0, (10.0, 100.0, 1000.0)),
        Parameter("damping_ratio", "", 0.0, 1.0, 0.01, (0.01, 0.05, 0.2)),
    ),
    values=ShaftCompliance,
    location="shaft",
    source="two-inertia system, Hori et al., IEEE TIE 46 (1999) 162",
    depends_on=("u",),
    reveals="a chirp or multisine past the resonance, at best with sensors on both sides",
)
