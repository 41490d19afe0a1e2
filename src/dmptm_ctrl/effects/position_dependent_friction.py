"""Position-dependent friction: the ring gear's bearing is tighter on one side.

Coulomb friction of the ring gear += C cos θL + S sin θL
"""

from math import cos, sin
from typing import NamedTuple

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter


class PositionDependentFriction(NamedTuple):
    """Parameters."""

    cosine: float  # N·m
    sine: float  # N·m


@njit
def position_friction(theta, omega, t, mesh_torque, body, p):
    """Factor on the declared friction (1) and added Coulomb torque [N·m]."""
    if body != 2:
        return 1.0, 0.0
    return 1.0, p.cosine * cos(theta) + p.sine * sin(theta)


POSITION_DEPENDENT_FRICTION = Effect(
    name="position_dependent_friction",
    site="friction",
    kernel=position_friction,
    parameters=(
        Parameter("cosine", "N·m", -30.0, 30.0, 1.0),
        Parameter("sine", "N·m", -30.0, 30.0, 1.0),
    ),
    values=PositionDependentFriction,
    location="ring-gear bearing",
    source="out-of-round raceway",
    depends_on=("theta_L",),
    reveals="a full turn in each direction",
)
