"""Unbalance: the ring gear's centre of mass is off its axis, which is not vertical.

    torque = A cos θL + B sin θL

Even in direction, order 1 of the ring-gear angle.
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import Effect, cosine_and_sine


@njit
def unbalance_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    return p.cosine * cos(theta_L) + p.sine * sin(theta_L)


UNBALANCE = Effect(
    name="unbalance",
    site="load",
    kernel=unbalance_torque,
    parameters=cosine_and_sine("N·m", 60.0, 2.0),  # A, B
    location="ring gear",
    source="m g r of an off-axis mass",
    depends_on=("theta_L",),
    reveals="slow motion over a whole turn, both ways",
    wave=True,
)
