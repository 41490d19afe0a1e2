"""A machine of one body, or of two joined by a shaft or gear: its motion and its readings.

Semi-implicit Euler steps of 20 µs at most. Friction by tanh, LuGre, Maxwell slip or Karnopp's
stick band; a gap whose flanks push and never pull. Everything in SI; torque stands for force
where the body slides.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

FRICTION = ("karnopp", "lugre", "slip", "tanh")
KARNOPP, LUGRE, SLIP, TANH = range(4)
OPEN, SPEED_LOOP, POSITION_LOOP = range(3)
ELEMENTS = 4  # of Maxwell slip
STEP = 2e-5  # s, at most


class Machine(NamedTuple):
    """Zero switches off what is not always there."""

    gain: float = 1.0  # torque per unit of the signal
    j1: float = 1.0
    b1: float = 0.0
    coulomb: float = 0.0
    rise_at_rest: float = 0.0  # static less Coulomb friction
    stribeck_speed: float = 1.0
    asymmetry: float = 0.0  # all friction more (+) or less (-) in the positive direction
    j2: float = 0.0
    b2: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0
    half_gap: float = 0.0
    ratio: float = 1.0
    law: int = TANH
    smooth: float = 1e-3  # speed within which tanh turns, and Karnopp's band
    bristle: float = 1e-5  # deflection of bristles and slip elements
    # what may be lacking in a rig file
    position_friction: float = 0.0
    position_order: float = 1.0
    position_phase: float = 0.0
    spot: float = 0.0
    spot_place: float = 0.0
    spot_width: float = 1.0
    load_friction: float = 0.0
    warm: float = 0.0
    warm_time: float = 1.0
    cogging: float = 0.0
    cogging_order: float = 1.0
    cogging_phase: float = 0.0
    unbalance_cos: float = 0.0  # on the last body, by its own angle
    unbalance_sin: float = 0.0
    cable: float = 0.0
    quadratic: float = 0.0
    vibration: float = 0.0
    vibration_rate: float = 0.0
    vibration_phase: float = 0.0
    lag: float = 0.0
    delay: float = 0.0
    dead_band: float = 0.0
    limit: float = 0.0
    offset: float = 0.0
    gain_error: float = 0.0  # of the speed sensor
    sensor_delay: float = 0.0  # of the speed sensor
    eccentricity: float = 0.0  # of the first encoder
    eccentricity_phase: float = 0.0
    # on no list
    sector: float = 0.0
    sector_place: float = 0.0
    sector_half: float = 0.0
    schedule: float = 0.0
    schedule_time: float = 1.0
    dropout: float = 0.0  # s
    dropout_period: float = 1.0
    command_play: float = 0.0
    sensor_play: float = 0.0


class Loop(NamedTuple):
    """Controller: mode, kp, ki, kv, largest command, resolution of the reading."""

    mode: int = OPEN
    kp: float = 0.0
    ki: float = 0.0
    kv: float = 0.0
    largest: float = 1e9
    count: float = 1e-9


@njit(cache=True)
def wrap(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


@njit(cache=True)
def friction_level(p, q, v, t, shaft):
    """Height of the dry friction of the first body, whose direction is that of v."""
    level = p.coulomb + p.rise_at_rest * np.exp(-abs(v) / p.stribeck_speed)
    level += p.position_friction * np.cos(p.position_order * q + p.position_phase)
    x = wrap(q - p.spot_place) / p.spot_width
    level += p.spot * np.exp(-0.5 * x * x) + p.load_friction * abs(shaft)
    if p.sector != 0.0 and abs(wrap(q - p.sector_place)) < p.sector_half:
        level += p.sector
    return max(0.0, level) * friction_factor(p, v, t)


@njit(cache=True)
def friction_factor(p, v, t):
    """What direction and temperature make of the first body's friction, dry and viscous."""
    way = 1.0 + p.asymmetry if v > 0.0 else 1.0 - p.asymmetry
    return way * (1.0 + p.warm * np.exp(-t / p.warm_time))


@njit(cache=True)
def dry_friction(p, q, v, level, h, push, inertia, held):
    """Friction torque; held: bristle (LuGre) or ends of the springs (Maxwell slip)."""
    if level <= 0.0:
        return 0.0
    if p.law == TANH:
        return level * np.tanh(v / p.smooth)
    if p.law == LUGRE:
        rate = v - abs(v) / p.bristle * held[0]
        held[0] = min(p.bristle, max(-p.bristle, held[0] + h * rate))
        k = level / p.bristle
        damping = np.sqrt(k * inertia) / (1.0 + abs(v) / (10.0 * p.smooth))
        return k * held[0] + damping * rate
    if p.law == SLIP:
        total, share = 0.0, level / ELEMENTS
        for j in range(ELEMENTS):
            reach = p.bristle * (j + 1)
            held[j] = min(q + reach, max(q - reach, held[j]))
            total += share * (q - held[j]) / reach
        return total
    if abs(v) < p.smooth:  # what would stop the body within the step, at most the level
        return min(level, max(-level, push + inertia * v / h))
    return level if v > 0.0 else -level


@njit(cache=True)
def shaft_torque(p, twist, rate):
    """Torque through the shaft, at the first body."""
    if abs(twist) <= p.half_gap:
        return 0.0
    side = p.half_gap if twist > 0.0 else -p.half_gap
    torque = p.stiffness * (twist - side) + p.damping * rate
    return 0.0 if p.half_gap > 0.0 and torque * twist < 0.0 else torque


@njit(cache=True)
def drive_signal(p, u, t, memory):
    """What the drive makes of a command that has arrived."""
    if p.command_play > 0.0:
        u = min(u + p.command_play, max(u - p.command_play, memory[0]))
        memory[0] = u
    u += p.offset
    if p.dead_band > 0.0:
        u = np.sign(u) * max(0.0, abs(u) - p.dead_band)
    if p.limit > 0.0:
        u = min(p.limit, max(-p.limit, u))
    if p.schedule != 0.0 and t > p.schedule_time:
        u *= 1.0 - p.schedule
    if p.dropout > 0.0 and t % p.dropout_period < p.dropout:
        u = 0.0
    return u


@njit(cache=True)
def simulate(p, loop, reference, dt, q0, step):
    """Run one experiment.

    Returns
    -------
    (n, 5) array
        Command; readings of the first encoder, the second and the speed sensor, without
        rounding and noise; true speed of the first body.
    """
    n, fine = reference.size, max(1, round(dt / step))
    h = dt / fine
    out = np.zeros((n, 5))
    history = np.zeros(n * fine + 1)
    held = np.full(ELEMENTS, 0.0 if p.law == LUGRE else q0)
    memory = np.zeros(1)
    q1, v1, q2, v2 = q0, 0.0, q0 / p.ratio, 0.0
    current, integral, speed, shown = 0.0, 0.0, 0.0, q0
    late, late_sensor = round(p.delay / h), round(p.sensor_delay / h)
    last = np.round(q0 / loop.count) * loop.count
    for i in range(n):
        shown = min(q1 + p.sensor_play, max(q1 - p.sensor_play, shown))
        seen = shown + p.eccentricity * np.cos(shown + p.eccentricity_phase)
        here = np.round(seen / loop.count) * loop.count
        speed += 0.5 * ((here - last) / dt - speed)
        last = here
        command = reference[i]
        if loop.mode == SPEED_LOOP:
            error = reference[i] - speed
            integral = min(loop.largest, max(-loop.largest, integral + loop.ki * error * dt))
            command = loop.kp * error + integral
        elif loop.mode == POSITION_LOOP:
            command = loop.kv * (loop.kp * (reference[i] - here) - speed)
        out[i, 0] = min(loop.largest, max(-loop.largest, command))
        out[i, 1], out[i, 2], out[i, 4] = seen, q2, v1
        out[i, 3] = (1.0 + p.gain_error) * history[max(0, i * fine - late_sensor)]
        for j in range(fine):
            at = i * fine + j
            t = at * h
            u = out[(at - late) // fine, 0] if at >= late else 0.0
            goal = p.gain * drive_signal(p, u, t, memory)
            current = goal if p.lag <= 0.0 else current + h / p.lag * (goal - current)
            shaft = shaft_torque(p, q1 - p.ratio * q2, v1 - p.ratio * v2) if p.j2 > 0.0 else 0.0
            q, v = (q2, v2) if p.j2 > 0.0 else (q1, v1)
            outside = p.unbalance_cos * np.cos(q) + p.unbalance_sin * np.sin(q) - p.cable * q
            outside += p.vibration * np.cos(p.vibration_rate * t + p.vibration_phase)
            outside -= p.quadratic * v * abs(v)
            push = current - shaft + p.cogging * np.cos(p.cogging_order * q1 + p.cogging_phase)
            push -= friction_factor(p, v1, t) * p.b1 * v1
            if p.j2 > 0.0:
                v2 += h * (p.ratio * shaft + outside - p.b2 * v2) / p.j2
                q2 += h * v2
            else:
                push += outside
            level = friction_level(p, q1, v1, t, shaft)
            v1 += h * (push - dry_friction(p, q1, v1, level, h, push, p.j1, held)) / p.j1
            q1 += h * v1
            history[at + 1] = v1
    return out
