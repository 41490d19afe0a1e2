"""The sampled controller inside the time-stepping loop; torques come from the kernels.

PI on the speed error, two second-order sections behind it, feed-forward along the setpoint
through a design model, and the voltage that undoes that model's drive. With all extras off
it is the plain PI loop. `law` (L_SIZE,) holds its numbers in the order below, `memory`
(MEMORY,) what it remembers from sample to sample; both of `law.py`.
"""
# ruff: noqa: F821 (some names are those of the text in front of this)

from collections.abc import Callable
from math import exp
from typing import Any

from numba import njit

from dmptm_ctrl.effects.presliding import build_up_distance
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law, viscous_torque

# Of each site the kernels that act there; `law.py` writes them in front of this text.
active_sites: Callable[..., Any]  # whether any does at motors, in friction, on the load
drive_voltage: Callable[..., Any]
motor_torque: Callable[..., Any]
friction_level: Callable[..., Any]
presliding_law: Callable[..., Any]
load_torque: Callable[..., Any]
sensor_reading: Callable[..., Any]

L_KP, L_KI, L_LIMIT, L_BIAS_L, L_BIAS_R, L_CLOSED, L_TRACKING = 0, 1, 2, 3, 4, 5, 6
L_SECTIONS = 7  # two of (b0, b1, b2, a1, a2)
L_INERTIA, L_FRICTION, L_EFFECTS, L_LEAD, L_LATE, L_ACCELERATION = 17, 18, 19, 20, 21, 22
L_SOFTNESS, L_INVERT, L_RELIEF_FROM, L_RELIEF_TO, L_SIZE = 23, 24, 25, 26, 27
M_INTEGRAL, M_DELAYS, M_LAST, M_STARTED, M_LEFT, M_RIGHT = 0, 1, 5, 6, 7, 8
M_BRISTLES, MEMORY = 9, 12  # friction so far of the three bodies, where it takes a distance
INVERSIONS = 8  # of the drive's chain; each leaves a share of what the chain changes
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
def friction_along(omega, way, theta, t, mesh, body, law, active, on, values):
    """Friction of a body that moves at `omega` [N·m] and its viscous part, with their sign."""
    if way == 0.0:
        return 0.0, 0.0
    scale, added = 1.0, 0.0
    if active:
        scale, added = friction_level(theta, omega, t, mesh, body, on, values)
    sign = 1.0 if way > 0.0 else -1.0
    whole = max(scale * (sliding_torque(omega, sign, law) + added), 0.0)
    return way * whole, way * scale * viscous_torque(omega, sign, law)


@njit
def built_up(friction, omega, dt, body, law, memory, on, values):
    """Friction that takes a distance to build up [N·m]; memory holds what does, per body."""
    distance, share, _ = presliding_law(body, on, values)
    if distance <= 0.0:
        return friction[0]
    at_once = share * friction[1]
    level = friction[0] - at_once
    distance = build_up_distance(distance, level, law)
    kept = (memory[M_BRISTLES + body] - level) * exp(-abs(omega) * dt / distance)
    memory[M_BRISTLES + body] = level + kept
    return memory[M_BRISTLES + body] + at_once


@njit
def feed_forward(speed, rate, angle, theta_ml, theta_mr, t, dt, law, memory, base, on, values):
    """Write the voltages that the design model needs to follow the setpoint.

    `speed` is the setpoint's at the time when they will act; the angles get there, too.
    """
    gain = base[5] * (base[0] * base[1])  # N·m/V at the pinion
    n1, n2 = base[5], base[6]
    pulls, rubs, loads = active_sites(on)
    angle += law[L_LEAD] * speed
    reducer = stribeck_law(
        base[15], base[16], base[17], base[18], base[19], base[20], base[21], base[22], base[23]
    )
    bearing = stribeck_law(
        base[24], base[25], base[26], base[27], base[28], base[29], base[30], base[31], base[32]
    )
    way = direction_of(speed, law[L_SOFTNESS])
    press = 0.5 * gain * (law[L_BIAS_L] - law[L_BIAS_R])  # preload in each mesh, N·m
    rub = friction_along(speed, way, angle, t, 2.0 * abs(press), 2, bearing, rubs, on, values)
    held = built_up(rub, speed, dt, 2, bearing, memory, on, values)
    load = law[L_INERTIA] * base[4] * rate + law[L_FRICTION] * held
    if loads:
        load -= law[L_EFFECTS] * load_torque(angle, speed, t, on, values)
    share = load / (2.0 * n2)  # of the load in each mesh
    swing = law[L_INERTIA] * (n1 * n1 * base[2] + base[3]) * n2 * rate
    for side in range(2):
        motor = (theta_ml if side == 0 else theta_mr) + law[L_LEAD] * n1 * n2 * speed
        mesh = share + (press if side == 0 else -press)
        rub = friction_along(n2 * speed, way, motor / n1, t, mesh, side, reducer, rubs, on, values)
        held = built_up(rub, n2 * speed, dt, side, reducer, memory, on, values)
        torque = share + swing + law[L_FRICTION] * held
        if pulls:
            u = torque / gain
            own = motor_torque(u, motor, n1 * n2 * speed, t, side, on, values)
            torque -= law[L_EFFECTS] * n1 * own
        memory[M_LEFT + side] = torque / gain


@njit
def undone(wanted, t, side, on, values):
    """Voltage that the drive's chain turns into the wanted one, by fixed-point iteration."""
    u = wanted
    for _ in range(INVERSIONS):
        u += wanted - drive_voltage(u, t, side, on, values)
    return u


@njit
def command(ref, angle, speed, theta_ml, theta_mr, t, dt, law, memory, design):
    """Advance the controller by one sample; voltages in memory[M_LEFT], memory[M_RIGHT]."""
    base, on, values = design
    rate = (ref - memory[M_LAST]) / dt if memory[M_STARTED] > 0.0 else 0.0
    rate = max(min(rate, law[L_ACCELERATION]), -law[L_ACCELERATION])
    memory[M_LAST], memory[M_STARTED] = ref, 1.0
    true_angle, true_speed = angle, speed
    for _ in range(READINGS):
        read_angle, read_speed = sensor_reading(true_angle, true_speed, t, on, values)
        true_angle += angle - read_angle
        true_speed += speed - read_speed
    error = ref - law[L_LATE] * rate - true_speed
    memory[M_INTEGRAL] += error * dt
    common = law[L_KP] * error + law[L_KI] * memory[M_INTEGRAL]
    common = section(common, L_SECTIONS, M_DELAYS, law, memory)
    common = section(common, L_SECTIONS + 5, M_DELAYS + 2, law, memory)
    memory[M_LEFT], memory[M_RIGHT] = 0.0, 0.0
    if law[L_INERTIA] != 0.0 or law[L_FRICTION] != 0.0 or law[L_EFFECTS] != 0.0:
        feed_forward(
            *(ref + law[L_LEAD] * rate, rate, true_angle, theta_ml, theta_mr, t, dt),
            *(law, memory, base, on, values),
        )
    drive = abs(common + 0.5 * (memory[M_LEFT] + memory[M_RIGHT]))
    press = 1.0
    if law[L_RELIEF_TO] > law[L_RELIEF_FROM]:
        press = (law[L_RELIEF_TO] - drive) / (law[L_RELIEF_TO] - law[L_RELIEF_FROM])
        press = max(min(press, 1.0), 0.0)
    lost = 0.0
    for side in range(2):
        wanted = common + press * law[L_BIAS_L + side] + memory[M_LEFT + side]
        u = undone(wanted, t, side, on, values) if law[L_INVERT] > 0.0 else wanted
        u = max(min(u, law[L_LIMIT]), -law[L_LIMIT])
        memory[M_LEFT + side] = u
        if law[L_INVERT] > 0.0:
            u = drive_voltage(u, t, side, on, values)
        lost += 0.5 * (u - wanted)
    if law[L_KI] > 0.0:
        memory[M_INTEGRAL] += law[L_TRACKING] * dt * lost / law[L_KI]
