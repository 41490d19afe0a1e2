"""The site chains of a drive without any effect; `compose.py` puts the catalogue's in place.

With these the loop of `core.py` is a complete module by itself: the declared plant.
"""

from numba import njit


@njit
def active_sites(on):
    """Which sites of the inner loop are in use: none."""
    return False, False, False, False, False, False


@njit
def drive_voltage(u, t, side, on, values):
    """Voltage after the drive's effects [V]."""
    return u


@njit
def voltage_delay(on, values):
    """Dead time of the voltage [s]."""
    return 0.0


@njit
def lag_relaxation(u, side, on, values):
    """Target of the effective voltage [V] and its time constant [s]."""
    return u, 0.0


@njit
def motor_torque(u, theta_m, omega_m, t, side, on, values):
    """Torque added on the motor's shaft [N·m]."""
    return 0.0


@njit
def shaft_compliance(inertia, on, values):
    """Compliance [rad/(N·m)] and damping [N·m·s/rad] of the reducer."""
    return 0.0, 0.0


@njit
def mesh_shift(theta_p, omega_p, theta_L, omega_L, side, on, values):
    """Shift of z [rad], its rate [rad/s], changes of half-gap [rad] and stiffness [N·m/rad]."""
    return 0.0, 0.0, 0.0, 0.0


@njit
def friction_level(theta, omega, t, mesh_torque, body, on, values):
    """Factor on the declared friction, and Coulomb torque added [N·m]."""
    return 1.0, 0.0


@njit
def presliding_law(body, on, values):
    """Relaxation distance [rad], share of viscous friction that acts at once, damping ratio."""
    return 0.0, 0.0, 0.0


@njit
def aged_friction(age, body, on, values):
    """Coulomb torque added [N·m] at the age of a contact, and slip that makes it new [rad]."""
    return 0.0, 0.0


@njit
def load_torque(theta_L, omega_L, t, on, values):
    """Torque added on the ring gear [N·m]."""
    return 0.0


@njit
def sensor_reading(theta_L, omega_L, t, on, values):
    """Readings of ring-gear angle [rad] and speed [rad/s]."""
    return theta_L, omega_L


@njit
def speed_delay(on, values):
    """Dead time of the speed reading [s]."""
    return 0.0
