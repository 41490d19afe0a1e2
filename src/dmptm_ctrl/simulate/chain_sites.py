"""The site functions of a chain without any effect; `chain_compose.py` replaces them.

With these the loop of `chain_core.py` is a complete module by itself: the declared chain.
"""

from numba import njit


@njit
def drive_signal(kind, u, t, p):
    """Input after the drive's effect, in the input's unit."""
    return u


@njit
def effect_torque(kind, theta, omega, t, p):
    """Torque [N·m] or force [N] added on a body."""
    return 0.0


@njit
def friction_change(kind, theta, omega, t, load, p):
    """Factor on the declared friction, and Coulomb torque [N·m] added."""
    return 1.0, 0.0
