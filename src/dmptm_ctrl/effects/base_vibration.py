"""Base vibration: the platform's base shakes at a fixed frequency.

    torque = A cos(2π f t) + B sin(2π f t)

on the ring gear, locked to each log's clock.
"""

from math import cos, pi, sin

from numba import njit

from dmptm_ctrl.contract import Effect, Parameter, cosine_and_sine


@njit
def vibration_torque(theta_L, omega_L, t, p):
    """Torque on the ring gear [N·m]."""
    phase = 2.0 * pi * p.frequency * t
    return p.cosine * cos(phase) + p.sine * sin(phase)


BASE_VIBRATION = Effect(
    name="base_vibration",
    site="load",
    kernel=vibration_torque,
    parameters=(
        *cosine_and_sine("N·m", 60.0, 2.0),  # A, B
        Parameter("frequency", "Hz", 0.5, 30.0, 0.02, tuple(0.5 + 0.02 * i for i in range(1476))),
    ),
    location="base",
    source="harmonic inertia torque of a shaken base",
    depends_on=("time",),
    reveals="a log at rest, and motion at several speeds",
    search="frequencies",
)
