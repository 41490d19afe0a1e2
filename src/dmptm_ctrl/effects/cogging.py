"""Cogging: the rotor's magnets pull towards the stator's teeth.

    torque = Σ over sides of C cos(n θm) + S sin(n θm), on each motor's shaft

n is the order per motor turn. Each motor has its own amplitude and phase.
"""

from math import cos, sin

from numba import njit

from dmptm_ctrl.contract import SIDES, Effect, Parameter, cosine_and_sine


@njit
def cogging_torque(u, theta_m, omega_m, t, side, p):
    """Torque on the shaft of the motor on `side` [N·m]."""
    phase = p.order * theta_m
    if side == 0:
        return p.left_cosine * cos(phase) + p.left_sine * sin(phase)
    return p.right_cosine * cos(phase) + p.right_sine * sin(phase)


ORDERS = tuple(float(n) for n in range(1, 97))  # per turn of the motor

COGGING = Effect(
    name="cogging",
    site="motor",
    kernel=cogging_torque,
    parameters=(
        *cosine_and_sine("N·m", 0.1, 0.005, SIDES),
        Parameter("order", "1/turn", 1.0, 96.0, 1.0, ORDERS, fixed=True),  # n
    ),
    location="motors",
    source="first harmonic of the cogging torque, Hanselman 2003, ch. 7",
    depends_on=("theta_m",),
    reveals="slow steady motion over several periods of it, at two speeds",
    search="orders",
    wave=True,
    fast=True,
)
