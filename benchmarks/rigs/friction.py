"""Stribeck friction of one body: sticking, bristles, slip elements, steep tanh.

    level(v) = T_c + (T_s - T_c) exp(-|v|/Omega), its own values per direction (Eq. 25, delta = 1;
    "stribeck": another exponent of |v|/Omega)

`scale` multiplies the whole of it (temperature); `extra` [N·m] adds to the level
(load, place on the ring gear); `fluid` multiplies the viscous part.
"""

import math

from numba import njit

from rigs.layout import ANCHOR, ELEMENTS, KARNOPP, LUGRE, SLIP_ELEMENTS

_BRISTLE_DAMPING = 0.4  # of critical, about the body's own inertia


@njit(inline="always")
def level(p, body, speed, forward):
    way = 0 if forward else 1
    drop = p.static[body, way] - p.coulomb[body, way]
    x = abs(speed) / p.stribeck[body, way]
    if p.exponent > 0.0:
        x = x**p.exponent
    return p.coulomb[body, way] + drop * math.exp(-x)


@njit(inline="always")
def viscous(p, body, speed):
    return (p.viscous[body, 0] if speed > 0.0 else p.viscous[body, 1]) * speed


@njit(inline="always")
def breakaway(p, body, net, scale, extra):
    """Direction in which a body at rest starts to move: -1, 0 or 1."""
    if net > scale * p.static[body, 0] + extra:
        return 1.0
    if net < -scale * p.static[body, 1] - extra:
        return -1.0
    return 0.0


@njit(inline="always")
def slip_elements(p, m, body, angle, height):
    """Generalised Maxwell slip whose elements slip at once: springs in parallel, each held by
    an equal share of the level, the softest slipping at the body's bristle deflection."""
    total, share = 0.0, height / ELEMENTS
    for j in range(ELEMENTS):
        stiffness = p.coulomb[body, 0] / (p.bristle[body] * (j + 1.0))
        total += min(share, max(-share, stiffness * (angle - m[ANCHOR + ELEMENTS * body + j])))
    return total


@njit(inline="always")
def drag_anchors(p, m, body, angle, height):
    """Where an element slips its end follows the body."""
    share = height / ELEMENTS
    for j in range(ELEMENTS):
        reach = share * p.bristle[body] * (j + 1.0) / p.coulomb[body, 0]
        at = ANCHOR + ELEMENTS * body + j
        m[at] = min(angle + reach, max(angle - reach, m[at]))


@njit(inline="always")
def friction(p, m, body, inertia, angle, speed, net, mode, deflection, scale, fluid, extra, decide):
    """(torque against positive motion [N·m], rate of the bristle [rad/s])."""
    if p.law[body] == KARNOPP:
        if mode == 0.0:
            return net, 0.0
        height = max(0.0, scale * level(p, body, speed, mode > 0.0) + extra)
        return mode * height + fluid * scale * viscous(p, body, speed), 0.0
    height = max(1e-6, scale * level(p, body, speed, speed > 0.0) + extra)
    drag = fluid * scale * viscous(p, body, speed)
    if p.law[body] == SLIP_ELEMENTS:
        if decide:
            drag_anchors(p, m, body, angle, height)
        return slip_elements(p, m, body, angle, height) + drag, 0.0
    if p.law[body] == LUGRE:
        stiffness = p.coulomb[body, 0] / p.bristle[body]
        rate = speed - stiffness * abs(speed) / height * deflection
        slow = p.stribeck[body, 0] / (p.stribeck[body, 0] + abs(speed))
        damping = 2.0 * _BRISTLE_DAMPING * math.sqrt(stiffness * inertia) * slow
        return stiffness * deflection + damping * rate + drag, rate
    return height * math.tanh(speed / p.smooth[body]) + drag, 0.0
