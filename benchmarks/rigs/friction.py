"""Stribeck friction of one body by three laws: sticking, bristles, steep tanh.

    level(v) = T_c + (T_s - T_c) exp(-|v|/Omega), its own values per direction (Eq. 25, delta = 1)

`scale` multiplies the whole of it (temperature); `extra` [N·m] adds to the level
(load, place on the ring gear).
"""

import math

from numba import njit

from rigs.layout import KARNOPP, LUGRE

_BRISTLE_DAMPING = 0.4  # of critical, about the body's own inertia


@njit(inline="always")
def level(p, body, speed, forward):
    way = 0 if forward else 1
    drop = p.static[body, way] - p.coulomb[body, way]
    return p.coulomb[body, way] + drop * math.exp(-abs(speed) / p.stribeck[body, way])


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
def friction(p, body, inertia, speed, net, mode, deflection, scale, extra):
    """(torque against positive motion [N·m], rate of the bristle [rad/s])."""
    if p.law[body] == KARNOPP:
        if mode == 0.0:
            return net, 0.0
        height = max(0.0, scale * level(p, body, speed, mode > 0.0) + extra)
        return mode * height + scale * viscous(p, body, speed), 0.0
    height = max(1e-6, scale * level(p, body, speed, speed > 0.0) + extra)
    drag = scale * viscous(p, body, speed)
    if p.law[body] == LUGRE:
        stiffness = p.coulomb[body, 0] / p.bristle[body]
        rate = speed - stiffness * abs(speed) / height * deflection
        slow = p.stribeck[body, 0] / (p.stribeck[body, 0] + abs(speed))
        damping = 2.0 * _BRISTLE_DAMPING * math.sqrt(stiffness * inertia) * slow
        return stiffness * deflection + damping * rate + drag, rate
    return height * math.tanh(speed / p.smooth[body]) + drag, 0.0
