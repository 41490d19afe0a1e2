"""The site chains of a drive without any effect, of one of several drives; see `sites.py`.

`compose.py` puts the catalogue's in place, which read their numbers from a row of `values`.
"""

from numba import njit


@njit
def drive_voltage_of(u, t, side, on, values, row):
    """Voltage after the drive's effects [V]."""
    return u


@njit
def voltage_delay_of(on, values, row):
    """Dead time of the voltage [s]."""
    return 0.0


@njit
def lag_relaxation_of(u, side, on, values, row):
    """Target of the effective voltage [V] and its time constant [s]."""
    return u, 0.0


@njit
def motor_torque_of(u, theta_m, omega_m, t, side, on, values, row):
    """Torque added on the motor's shaft [N·m]."""
    return 0.0


@njit
def shaft_compliance_of(inertia, on, values, row):
    """Compliance [rad/(N·m)] and damping [N·m·s/rad] of the reducer."""
    return 0.0, 0.0


@njit
def mesh_shift_of(theta_p, omega_p, theta_L, omega_L, side, on, values, row):
    """Shift of z [rad], its rate [rad/s], changes of half-gap [rad] and stiffness [N·m/rad]."""
    return 0.0, 0.0, 0.0, 0.0


@njit
def friction_level_of(theta, omega, t, mesh_torque, body, on, values, row):
    """Factor on the declared friction, and Coulomb torque added [N·m]."""
    return 1.0, 0.0


@njit
def presliding_law_of(body, on, values, row):
    """Relaxation distance [rad], share of viscous friction that acts at once, damping ratio."""
    return 0.0, 0.0, 0.0


@njit
def aged_friction_of(age, body, on, values, row):
    """Coulomb torque added [N·m] at the age of a contact, and slip that makes it new [rad]."""
    return 0.0, 0.0


@njit
def load_torque_of(theta_L, omega_L, t, on, values, row):
    """Torque added on the ring gear [N·m]."""
    return 0.0


@njit
def sensor_reading_of(theta_L, omega_L, t, on, values, row):
    """Readings of ring-gear angle [rad] and speed [rad/s]."""
    return theta_L, omega_L


@njit
def speed_delay_of(on, values, row):
    """Dead time of the speed reading [s]."""
    return 0.0
