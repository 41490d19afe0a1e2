"""The sites of a drive without any effect; `law.py` puts the catalogue's in their place."""

from numba import njit


@njit
def active_sites(on):
    """Which sites of the feed-forward are in use: none."""
    return False, False, False


@njit
def drive_voltage(u, t, side, on, values):
    """Voltage after the drive's effects [V]."""
    return u


@njit
def motor_torque(u, theta_m, omega_m, t, side, on, values):
    """Torque added on the motor's shaft [N·m]."""
    return 0.0


@njit
def friction_level(theta, omega, t, mesh_torque, body, on, values):
    """Factor on the declared friction, and Coulomb torque added [N·m]."""
    return 1.0, 0.0


@njit
def presliding_law(body, on, values):
    """Relaxation distance [rad], share of viscous friction that acts at once, damping ratio."""
    return 0.0, 0.0, 0.0


@njit
def load_torque(theta_L, omega_L, t, on, values):
    """Torque added on the ring gear [N·m]."""
    return 0.0


@njit
def sensor_reading(theta_L, omega_L, t, on, values):
    """Readings of ring-gear angle [rad] and speed [rad/s]."""
    return theta_L, omega_L
