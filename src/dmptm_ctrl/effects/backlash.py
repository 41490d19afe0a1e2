"""Backlash with contact damping: Eq. 21 with its exponent put right.

    torque = k (z - gap) + c ż     contact on the plus side
             k (z + gap) + c ż     contact on the minus side
             c_f ż                 in the gap

z = θ3 − N2 θL, `gap` is the half-gap Δ. The elastic tooth (k, c) is in series with a
gap that has damping c_f; at constant ż the position in the gap is
θb(z) = z − (c_f/k) ż + ((c + c_f)/k) ż exp(−k/(c + c_f) ((z + Δ)/ż + c/k)).

Sign: positive torque drives the ring gear. Teeth push, never pull.
Source: paper Eq. 21; as printed the exponent is (z + b)/(ż + k), which adds a speed to
a stiffness.
"""

from math import exp
from typing import NamedTuple

from numba import njit


class Backlash(NamedTuple):
    """Parameters of one mesh, seen at the pinion."""

    stiffness: float  # N·m/rad, k
    damping: float  # N·m·s/rad, c
    gap_damping: float  # N·m·s/rad, c_f
    half_gap: float  # rad, Δ


@njit
def gap_position(z, z_rate, p):
    """Position in the gap θb [rad] for a crossing at constant rate that left −Δ sign(ż)."""
    relaxation = p.damping + p.gap_damping
    if z_rate == 0.0 or relaxation == 0.0:
        return z - p.gap_damping / p.stiffness * z_rate
    side = 1.0 if z_rate > 0.0 else -1.0
    flight = (z + side * p.half_gap) / z_rate + p.damping / p.stiffness
    decay = exp(-p.stiffness / relaxation * max(flight, 0.0))
    return z + (relaxation * decay - p.gap_damping) / p.stiffness * z_rate


@njit
def mesh_torque(z, z_rate, p):
    """Torque of the mesh [N·m] at relative angle z [rad] and its rate [rad/s]."""
    side = 1.0 if z >= 0.0 else -1.0
    depth = side * z - p.half_gap
    closing = side * z_rate
    contact = p.stiffness * depth + p.damping * closing
    if contact > 0.0 and (
        closing <= 0.0
        or p.stiffness * depth >= p.gap_damping * closing  # the decay term only adds
        or side * gap_position(z, z_rate, p) >= p.half_gap
    ):
        return side * contact
    return p.gap_damping * z_rate
