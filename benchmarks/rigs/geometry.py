"""Twist of one mesh: what the teeth see of the angles, with errors of manufacture.

The errors are arc-minutes: their reaction on the torques (order times amplitude,
below 2 %) is left out.
"""

import math

from numba import njit

from rigs.layout import SLIPPED
from rigs.nominal import PINION_SPACING, PINION_TEETH, RING_RATIO, RING_TEETH


@njit(inline="always")
def wrap(angle):
    """Into [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@njit(inline="always")
def twist(p, m, side, pinion, ring, pinion_speed, ring_speed):
    """(z [rad], its rate [rad/s]) at the pinion."""
    z = pinion - RING_RATIO * ring
    rate = pinion_speed - RING_RATIO * ring_speed
    if p.slip_torque > 0.0:
        z -= m[SLIPPED + side]
    if p.runout[side] != 0.0:
        angle = pinion + p.runout_phase[side]
        z += p.runout[side] * math.cos(angle)
        rate -= p.runout[side] * math.sin(angle) * pinion_speed
    if p.eccentricity != 0.0:
        angle = ring + side * PINION_SPACING + p.eccentricity_phase
        z += p.eccentricity * math.cos(angle)
        rate -= p.eccentricity * math.sin(angle) * ring_speed
    if p.tooth_error != 0.0:
        angle = PINION_TEETH * pinion + p.tooth_phase[side]
        z += p.tooth_error * math.cos(angle)
        rate -= p.tooth_error * math.sin(angle) * PINION_TEETH * pinion_speed
    if p.stiffness_ripple > 0.0:  # comes with the pitch errors: both belong to the teeth
        e, slope = pitch_error(p.pinion_pitch[side], PINION_TEETH, pinion)
        z += e
        rate += slope * pinion_speed
        e, slope = pitch_error(p.ring_pitch, RING_TEETH, ring + side * PINION_SPACING)
        z += e
        rate += slope * ring_speed
    return z, rate


@njit(inline="always")
def pitch_error(errors, teeth, angle):
    """(error, its slope over the angle): from tooth to tooth along half a cosine wave."""
    place = angle * teeth / (2.0 * math.pi)
    tooth = math.floor(place)
    here, there = errors[int(tooth) % teeth], errors[int(tooth + 1.0) % teeth]
    turned = math.pi * (place - tooth)
    slope = 0.25 * teeth * (there - here) * math.sin(turned)
    return here + 0.5 * (there - here) * (1.0 - math.cos(turned)), slope


@njit(inline="always")
def mesh_stiffness(p, side, pinion):
    """Ripples at tooth passing."""
    if p.stiffness_ripple == 0.0:
        return p.stiffness
    turned = PINION_TEETH * pinion + p.stiffness_phase[side]
    return p.stiffness * (1.0 + p.stiffness_ripple * math.cos(turned))


@njit(inline="always")
def half_gap(p, side, ring):
    gap = p.half_gap[side]
    if p.gap_variation != 0.0:
        turned = p.gap_order * (ring + side * PINION_SPACING) + p.gap_phase
        gap *= 1.0 + p.gap_variation * math.cos(turned)
    return gap


@njit(inline="always")
def soft_flank(p, z, rate, gap):
    """Twist and rate with a forward flank that hardens: d becomes d^2/(d + softness)."""
    d = z - gap
    if p.soft_tooth == 0.0 or d <= 0.0:
        return z, rate
    whole = d + p.soft_tooth
    return gap + d * d / whole, rate * d * (d + 2.0 * p.soft_tooth) / (whole * whole)
