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
def mesh_region(z, z_rate, p):
    """Where Eq. 21 is: 1 in A⁺, −1 in A⁻ (the teeth touch), 0 in A0 (in the gap)."""
    side = 1.0 if z >= 0.0 else -1.0
    depth = side * z - p.half_gap
    closing = side * z_rate
    if p.stiffness * depth + p.damping * closing > 0.0 and (
        closing <= 0.0
        or p.stiffness * depth >= p.gap_damping * closing  # the decay term only adds
        or side * gap_position(z, z_rate, p) >= p.half_gap
    ):
        return side
    return 0.0


@njit
def region_torque(z, z_rate, region, p):
    """Torque [N·m] by the branch of Eq. 21 that belongs to `region`."""
    if region == 0.0:
        return p.gap_damping * z_rate
    return p.stiffness * (z - region * p.half_gap) + p.damping * z_rate


@njit
def impact_step(z, z_rate, p):
    """How long ago a closing flank was reached [s] at constant rate, and the step of torque.

    From A0 to A⁺ or A⁻ the torque of Eq. 21 jumps by c ż (gap transient died out); the step
    [N·m] is towards positive z_rate. A time stepper needs both to keep its order there.
    """
    depth = abs(z) - p.half_gap
    return depth / abs(z_rate) - p.gap_damping / p.stiffness, p.damping * z_rate


@njit
def mesh_torque(z, z_rate, p):
    """Torque of the mesh [N·m] at relative angle z [rad] and its rate [rad/s]."""
    return region_torque(z, z_rate, mesh_region(z, z_rate, p), p)


@njit
def gap_rate(position, z, z_rate, p):
    """Rate of the position in the gap θb [rad/s]: the two-state original of Eq. 21.

    θb is a state, the elastic twist is θs = z − θb, and k θs + c θ̇s = c_f θ̇b holds between
    the flanks; at a flank θb stays while the teeth push. Needs c + c_f > 0.
    Source: Kranawetter et al. 2019, from which the paper takes Eq. 21 for constant ż.
    """
    rate = (p.stiffness * (z - position) + p.damping * z_rate) / (p.damping + p.gap_damping)
    if position >= p.half_gap and rate > 0.0:
        return 0.0
    if position <= -p.half_gap and rate < 0.0:
        return 0.0
    return rate


@njit
def twist_torque(position, z, z_rate, p):
    """Torque of the mesh [N·m] with the position in the gap as a state, k θs + c θ̇s."""
    return p.stiffness * (z - position) + p.damping * (z_rate - gap_rate(position, z, z_rate, p))


@njit
def impact_torque(z, z_rate, p):
    """Torque of the mesh [N·m] by Hunt & Crossley: damping grows with the depth of contact.

    k δ (1 + χ δ̇), δ the depth beyond the flank; teeth push, never pull. The record's damping is
    χ [s/rad], its gap damping acts between the flanks.
    Source: Hunt & Crossley, J. Appl. Mech. 42 (1975) 440, with exponent 1.
    """
    side = 1.0 if z >= 0.0 else -1.0
    depth = side * z - p.half_gap
    push = p.stiffness * depth * max(1.0 + p.damping * side * z_rate, 0.0)
    return side * push if depth > 0.0 else p.gap_damping * z_rate
