"""From the commanded voltage to the torque of one motor."""

import math

from numba import njit

from rigs.geometry import wrap
from rigs.layout import PLAYED, SAG_UNTIL, SLEWED
from rigs.nominal import REDUCER_RATIO

USUAL_ORDERS = (6.0, 12.0)  # of cogging, per motor turn


@njit(inline="always")
def amplifier(p, m, side, u, time, step):
    """Voltage that takes effect during one fine step [V]; u is the delayed command."""
    if p.command_step > 0.0:
        u = p.command_step * math.floor(u / p.command_step + 0.5)
    if p.slew > 0.0:
        limit = p.slew * step
        u = m[SLEWED + side] + min(limit, max(-limit, u - m[SLEWED + side]))
        m[SLEWED + side] = u
    if p.play > 0.0:
        u = min(u + p.play, max(u - p.play, m[PLAYED + side]))
        m[PLAYED + side] = u
    if p.dead_band > 0.0:
        u = math.copysign(max(0.0, abs(u) - p.dead_band), u)
    u += p.offset[side]
    if p.saturation > 0.0:
        u = min(p.saturation, max(-p.saturation, u))
    if p.sag > 0.0:
        # Up again, the supply holds for as long as it was down.
        if abs(u) > p.sag_voltage and time >= m[SAG_UNTIL] + p.sag_time:
            m[SAG_UNTIL] = time + p.sag_time
        if time < m[SAG_UNTIL]:
            u *= 1.0 - p.sag
    if p.cut_length > 0.0 and side == p.cut_motor and time >= p.cut_start:
        u *= (time - p.cut_start) % p.cut_period >= p.cut_length
    if p.polarity > 0.0 and u < 0.0:
        u *= 1.0 - p.polarity
    if p.fade > 0.0:
        u *= 1.0 - p.fade * (1.0 - math.exp(-time / p.fade_time))
    return u


@njit(inline="always")
def motor_torque(p, side, voltage, angle, speed):
    """Torque at the pinion [N·m]; angle and speed are the motor's, at the motor."""
    gain = p.torque_per_volt * (1.0 + p.gain_error[side])
    if p.back_emf > 0.0:
        voltage -= p.back_emf * speed
    if p.dead_sector > 0.0:
        away = wrap(angle - p.dead_sector_place)
        if abs(away) < p.dead_sector_half:
            gain *= 1.0 - p.dead_sector
    if p.torque_ripple > 0.0:
        turned = p.torque_ripple_order * angle + p.torque_ripple_phase[side]
        gain *= 1.0 + p.torque_ripple * math.cos(turned)
    if p.regeneration > 0.0:
        gain *= 1.0 - p.regeneration * 0.5 * (1.0 - math.tanh(voltage * speed / 0.5))
    torque = gain * voltage
    if p.cog_amplitude[side] != 0.0:
        torque += p.cog_amplitude[side] * math.cos(p.cog_order * angle + p.cog_phase[side])
    if p.usual_cogging > 0.0:
        for i in range(2):
            turned = USUAL_ORDERS[i] * angle + p.usual_cogging_phase[side, i]
            torque += p.usual_cogging * math.cos(turned)
    return REDUCER_RATIO * torque
