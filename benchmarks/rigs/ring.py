"""What acts on the ring gear beside the meshes and its plain friction."""

import math

from numba import njit

from rigs.geometry import wrap
from rigs.layout import DETENTS, GRABBED, HEAT, HOOKED, REST_TIME, RING, SLIP, SLIPPED, TOOTH

# A bearing forgets its rest after this slip at the ring gear [rad].
_FORGET = 2e-4
_HOOK_REACH = 0.5  # rad past the release angle where the hook slips off


@njit(inline="always")
def external_torque(p, m, time, angle, speed, voltage, slosh, slosh_rate):
    """Torque on the ring gear [N·m], positive forward."""
    torque = 0.0
    if p.unbalance_cos != 0.0 or p.unbalance_sin != 0.0:
        torque += p.unbalance_cos * math.cos(angle) + p.unbalance_sin * math.sin(angle)
    if p.cable_stiffness != 0.0:
        torque -= p.cable_stiffness * (angle - p.cable_rest)
    if p.vibration != 0.0:
        torque += p.vibration * math.cos(p.vibration_rate * time + p.vibration_phase)
    if p.quadratic != 0.0:
        torque -= p.quadratic * speed * abs(speed)
    if p.ripple != 0.0:
        torque += p.ripple * abs(voltage) * math.cos(p.ripple_order * angle + p.ripple_phase)
    if p.detent != 0.0:
        for i in range(DETENTS):
            x = wrap(angle - p.detent_place[i]) / p.detent_width
            if abs(x) < 6.0:
                torque -= p.detent * x * math.exp(0.5 - 0.5 * x * x)
    if p.sector_brake != 0.0:
        away = abs(wrap(angle - p.sector_place))
        torque -= p.sector_brake * speed / (1.0 + math.exp((away - p.sector_half) / 0.02))
    if p.slosh_inertia != 0.0:
        spring = p.slosh_rate * p.slosh_rate * (slosh - angle)
        damper = 2.0 * p.slosh_damping * p.slosh_rate * (slosh_rate - speed)
        torque += p.slosh_inertia * (spring + damper)
    if p.hook != 0.0 and m[HOOKED] == 1.0:
        torque -= p.hook * wrap(angle - p.hook_off)
    if p.howl != 0.0:
        x = (abs(speed) - p.howl_speed) / p.howl_width
        swing = math.cos(p.howl_order * angle + p.howl_phase)
        torque += p.howl * math.exp(-0.5 * x * x) * swing
    if p.wall != 0.0:
        past = wrap(angle) - p.wall_place
        if past * p.wall_place > 0.0:
            torque -= p.wall * past
    if p.knock != 0.0 and time >= p.knock_start:
        since = (time - p.knock_start) % p.knock_period
        if since < p.knock_length:
            torque += p.knock * math.sin(math.pi * since / p.knock_length)
    return torque


@njit(inline="always")
def extra_friction(p, m, time, angle, speed):
    """Friction on top of Stribeck's [N·m], without direction."""
    extra = 0.0
    if p.position_friction != 0.0:
        extra += p.position_friction * math.cos(p.position_order * angle + p.position_phase)
    if p.spot != 0.0:
        x = wrap(angle - p.spot_place) / p.spot_width
        extra += p.spot * math.exp(-0.5 * x * x)
    if p.dwell_rise != 0.0:
        aged = math.log(1.0 + m[REST_TIME + RING] / p.dwell_time)
        extra += p.dwell_rise * aged * math.exp(-m[SLIP + RING] / _FORGET)
    if p.flash_rise != 0.0:
        extra += p.flash_rise * m[HEAT] / (m[HEAT] + p.flash_heat)
    if m[GRABBED] == 1.0:
        extra += p.grab
    if p.bump != 0.0:
        x = (abs(speed) - p.bump_speed) / p.bump_width
        extra += p.bump * math.exp(-0.5 * x * x)
    if time < p.late_brake_time:
        extra += p.late_brake
    return extra


@njit(inline="always")
def remember(p, m, angle, speed, step):
    """Advance what the mechanics remember by one fine step."""
    if p.dwell_rise != 0.0:
        if abs(speed) < 1e-3:
            if m[SLIP + RING] > 3.0 * _FORGET:
                m[REST_TIME + RING] = 0.0
                m[SLIP + RING] = 0.0
            m[REST_TIME + RING] += step
        m[SLIP + RING] += abs(speed) * step
    if p.flash_rise != 0.0:
        power = p.coulomb[RING, 0] * abs(speed)
        m[HEAT] += step * (power - m[HEAT] / p.flash_time)
    if p.grab != 0.0:
        if abs(speed) > p.grab_on:
            m[GRABBED] = 1.0
        elif abs(speed) < p.grab_off:
            m[GRABBED] = 0.0
    if p.slip_torque > 0.0:
        for i in range(2):
            over = abs(m[TOOTH + i]) - p.slip_torque
            if over > 0.0:
                m[SLIPPED + i] += step * math.copysign(over / p.slip_damping, m[TOOTH + i])
    if p.hook != 0.0:
        past = wrap(angle - p.hook_off)
        if past < 0.0 or past > _HOOK_REACH:
            m[HOOKED] = 0.0
        elif past > p.hook_on:
            m[HOOKED] = 1.0
