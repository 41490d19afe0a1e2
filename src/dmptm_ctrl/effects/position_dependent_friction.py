"""Position-dependent friction: the ring gear's bearing is tighter on one side.

Coulomb friction of the ring gear += C cos(n θL) + S sin(n θL), n a whole number
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter, cosine_and_sine


@njit
def position_friction(theta, omega, t, mesh_torque, body, p):
    """Factor on the declared friction (1) and added Coulomb torque [N·m]."""
    if body != 2:
        return 1.0, 0.0
    phase = p.order * theta
    return 1.0, p.cosine * cos(phase) + p.sine * sin(phase)


POSITION_DEPENDENT_FRICTION = Effect(
    name="position_dependent_friction",
    site="friction",
    kernel=position_friction,
    parameters=(
        *cosine_and_sine("N·m", 30.0, 1.0),
        # the middle of a bank is the default
        Parameter("order", "1/turn", 1.0, 4.0, 1.0, (4.0, 2.0, 1.0, 3.0), fixed=True),  # n
    ),
    location="ring-gear bearing",
    source="out-of-round raceway; higher orders by its bolts",
    depends_on=("theta_L",),
    reveals="slow motion over the whole travel, both ways",
    wave=True,
)
