"""The site chains over lanes of a drive without any effect; `compose.py` puts the catalogue's.

Each chain reads rows `A` and changes rows `R` of the work array, see `lane_stages_core.py`.
"""

from numba import njit


@njit
def drive_lanes(s, width, side, t, on):
    """Voltage A0 [V] after the drive's effects, in place."""


@njit
def lag_lanes(s, width, side, t, on):
    """Target R0 of the effective voltage A0 [V] and its time constant R1 [s]."""


@njit
def motor_lanes(s, width, side, t, on):
    """Torque added to R0 on the motor's shaft [N·m] at angle A0, speed A1 and voltage A2."""


@njit
def mesh_lanes(s, width, result, side, t, on):
    """Changes added to four rows from `result`: shift of z, its rate, half-gap, stiffness."""


@njit
def friction_lanes(s, width, side, t, on):
    """Factor R0 on the friction, torque R1 added [N·m] at A0, A1, mesh torque A2."""


@njit
def ageing_lanes(s, width, side, t, on):
    """Torque R1 added [N·m] at the age A0 of a body's contact."""


@njit
def load_lanes(s, width, side, t, on):
    """Torque added to R0 on the ring gear [N·m] at angle A0 and speed A1."""


@njit
def sensor_lanes(s, width, side, t, on):
    """Readings of ring-gear angle A0 [rad] and speed A1 [rad/s], in place."""
