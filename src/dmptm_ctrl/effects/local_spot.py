"""Local spot: dirt or a dent makes one place of the ring gear's bearing tight.

Coulomb friction of the ring gear += A exp(−½ (Δ/w)²),  Δ = θL − θ0 wrapped to ±π
"""

from math import exp, pi

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


@njit
def spot_friction(theta, omega, t, mesh_torque, body, p):
    """Factor on the declared friction (1) and added Coulomb torque [N·m]."""
    if body != 2:
        return 1.0, 0.0
    distance = (theta - p.place + pi) % (2.0 * pi) - pi
    return 1.0, p.height * exp(-0.5 * (distance / p.width) ** 2)


LOCAL_SPOT = Effect(
    name="local_spot",
    site="friction",
    kernel=spot_friction,
    parameters=(
        Parameter("height", "N·m", 0.0, 60.0, 2.0),  # A
        Parameter("place", "rad", -3.5, 3.5, 0.02, tuple(pi * i / 72 for i in range(-72, 72))),
        Parameter("width", "rad", 0.005, 0.5, 0.01, (0.02, 0.06, 0.2)),  # w
    ),
    location="ring-gear bearing",
    source="Gaussian bump",
    depends_on=("theta_L",),
    reveals="slow motion over the whole travel, both ways, several times",
    search="places",
)
