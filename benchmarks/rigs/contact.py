"""Torque between a pinion and the ring gear's teeth, at the pinion, in N·m.

Five laws for the same gap, because no one knows which a real mesh obeys. Each
returns (torque, rate of the position in the gap); only `two_state` has the latter.
Positive torque drives the ring gear. Source: Eq. 21 and the physical model behind
it (Nordin & Gutman, Automatica 38 (2002) 1633): elastic tooth (k, c) in series
with a gap of +-half_gap that has damping c_f.
"""

import math

from numba import njit

from rigs.layout import EQ21, HUNT_CROSSLEY, QUADRATIC, TWO_STATE

# Deflection at which Hunt-Crossley damping equals the linear damping: that of a
# mesh torque of 5 N·m, which is usual here.
_USUAL_TORQUE = 5.0
# Where the gap varies, a flank that withdraws in a step by less still touches: it does by 1e-9 rad.
_TOUCH = 2e-8  # rad


@njit(inline="always")
def tolerance(p):
    """Return the distance within which a flank still touches [rad]."""
    return _TOUCH if p.gap_variation != 0.0 else 0.0


@njit(inline="always")
def two_state(z, rate, place, gap, k, c, cf, touch=0.0):
    """The tooth's twist is z - place; place moves only inside the gap."""
    place_rate = (k * (z - place) + c * rate) / (c + cf)
    if place >= gap - touch:
        place_rate = min(0.0, place_rate)
    elif place <= touch - gap:
        place_rate = max(0.0, place_rate)
    return k * (z - place) + c * (rate - place_rate), place_rate


@njit(inline="always")
def eq21(z, rate, gap, k, c, cf):
    """Regions of Eq. 21 with the exponent put right: (z + gap)/rate + c/k."""
    above = k * (z - gap) + c * rate
    below = k * (z + gap) + c * rate
    if rate > 0.0:
        if below <= 0.0:
            return below
        if above >= 0.0:
            relax = (c + cf) / k
            left = math.exp(-((z + gap) / rate + c / k) / relax)
            if z - cf / k * rate + relax * rate * left >= gap:
                return above
    elif rate < 0.0:
        if above >= 0.0:
            return above
        if below <= 0.0:
            relax = (c + cf) / k
            left = math.exp(-((z - gap) / rate + c / k) / relax)
            if z - cf / k * rate + relax * rate * left <= -gap:
                return below
    elif above > 0.0:
        return above
    elif below < 0.0:
        return below
    return cf * rate


@njit(inline="always")
def kelvin_voigt(z, rate, gap, k, c, cf):
    """Spring and damper that push and never pull."""
    if z > gap:
        return max(0.0, k * (z - gap) + c * rate)
    if z < -gap:
        return min(0.0, k * (z + gap) + c * rate)
    return cf * rate


@njit(inline="always")
def hunt_crossley(z, rate, gap, k, c, cf):
    """Damping that grows with the deflection: no jump at the touch."""
    if z > gap:
        return max(0.0, k * (z - gap) * (1.0 + c / _USUAL_TORQUE * rate))
    if z < -gap:
        return min(0.0, k * (z + gap) * (1.0 - c / _USUAL_TORQUE * rate))
    return cf * rate


@njit(inline="always")
def quadratic(z, rate, gap, k, c, cf):
    """Spring that stiffens: by a half where the torque is usual; pushes and never pulls."""
    depth = abs(z) - gap
    if depth <= 0.0:
        return cf * rate
    side = math.copysign(1.0, z)
    elastic = k * depth * (1.0 + 0.5 * depth * k / _USUAL_TORQUE)
    return side * max(0.0, elastic + side * c * rate)


@njit(inline="always")
def mesh_torque(z, rate, place, gap, law, k, c, cf, touch=0.0):
    if law == TWO_STATE:
        return two_state(z, rate, place, gap, k, c, cf, touch)
    if law == EQ21:
        return eq21(z, rate, gap, k, c, cf), 0.0
    if law == HUNT_CROSSLEY:
        return hunt_crossley(z, rate, gap, k, c, cf), 0.0
    if law == QUADRATIC:
        return quadratic(z, rate, gap, k, c, cf), 0.0
    return kelvin_voigt(z, rate, gap, k, c, cf), 0.0
