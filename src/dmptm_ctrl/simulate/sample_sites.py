"""The site chains over samples of a drive without any effect; `compose.py` puts the catalogue's.

Each chain reads and changes rows of the work array, see `along_core.py`.
"""

from numba import njit


@njit
def drive_samples(s, width, side, on, values):
    """Voltage [V] after the drive's effects, in place."""


@njit
def motor_samples(s, width, side, on, values):
    """Torque added on the motor's shaft [N·m]."""


@njit
def mesh_samples(s, width, side, on, values):
    """Shift of z and change of the half-gap [rad], added."""


@njit
def friction_samples(s, width, side, on, values):
    """Factor on the declared friction, and Coulomb torque added [N·m]."""


@njit
def load_samples(s, width, side, on, values):
    """Torque added on the ring gear [N·m]."""
