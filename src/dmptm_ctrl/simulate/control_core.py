"""Pieces of the sampled controller inside the time-stepping loop; `law_text.py` calls them.

PI on the speed error, two second-order sections behind it, feed-forward along the setpoint
through a design model, and the signal that undoes that model's drive. With all extras off
it is the plain PI loop. `law` (L_SIZE,) holds its numbers in the order below, `memory` what it
remembers from sample to sample.
"""

from math import exp

from numba import njit

from dmptm_ctrl.effects.presliding import build_up_distance
from dmptm_ctrl.effects.stribeck import sliding_torque, viscous_torque

L_KP, L_KI, L_LIMIT, L_BIAS_L, L_BIAS_R, L_CLOSED, L_TRACKING = 0, 1, 2, 3, 4, 5, 6
L_SECTIONS = 7  # two of (b0, b1, b2, a1, a2)
L_INERTIA, L_FRICTION, L_EFFECTS, L_LEAD, L_LATE, L_ACCELERATION = 17, 18, 19, 20, 21, 22
L_SOFTNESS, L_INVERT, L_RELIEF_FROM, L_RELIEF_TO, L_SIZE = 23, 24, 25, 26, 27
M_INTEGRAL, M_DELAYS, M_LAST, M_STARTED, M_LEFT, M_RIGHT, M_ANGLE = 0, 1, 5, 6, 7, 8, 9
M_BRISTLES = 10  # friction so far of each coordinate, where it takes a distance
INVERSIONS = 8  # of the amplifier's effects; each leaves a share of what they change
READINGS = 3  # the same for the sensors


@njit
def section(x, first, at, law, memory):
    """Second-order difference equation, transposed direct form II."""
    y = law[first] * x + memory[at]
    memory[at] = law[first + 1] * x - law[first + 3] * y + memory[at + 1]
    memory[at + 1] = law[first + 2] * x - law[first + 4] * y
    return y


@njit
def direction_of(speed, softness):
    """Sign of the setpoint's speed; a ramp through 0 within `softness` [rad/s]."""
    if softness > 0.0 and abs(speed) < softness:
        return speed / softness
    return 1.0 if speed > 0.0 else -1.0 if speed < 0.0 else 0.0


@njit
def signed(way, reach):
    """Direction of a body that moves by `reach` per motion of the setpoint's."""
    return way if reach > 0.0 else -way


@njit
def rubbing(omega, way, scale, added, law):
    """Friction of a body that moves at `omega` [N·m] and its viscous part, with their sign."""
    if way == 0.0:
        return 0.0, 0.0
    sign = 1.0 if way > 0.0 else -1.0
    whole = max(scale * (sliding_torque(omega, sign, law) + added), 0.0)
    return way * whole, way * scale * viscous_torque(omega, sign, law)


@njit
def built_up(friction, viscous, omega, dt, distance, share, law, at, memory):
    """Friction that takes a distance to build up [N·m]; memory holds what does."""
    at_once = share * viscous
    level = friction - at_once
    distance = build_up_distance(distance, level, law)
    kept = (memory[at] - level) * exp(-abs(omega) * dt / distance)
    memory[at] = level + kept
    return memory[at] + at_once
