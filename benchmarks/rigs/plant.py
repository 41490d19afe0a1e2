"""The rig as ordinary differential equations, and one log of it.

Three bodies (physics: Eqs. 15 to 18, 21, 25), five with reducer compliance.
Classical Runge-Kutta of fourth order with a fixed fine step; sticking bodies
change their mode only between steps.
"""

import math

import numpy as np
from numba import njit

from rigs.contact import mesh_torque, tolerance
from rigs.drive import amplifier, motor_torque
from rigs.friction import breakaway, friction
from rigs.geometry import half_gap, mesh_stiffness, soft_flank, twist
from rigs.layout import (
    AGE,
    ANCHOR,
    ANGLE,
    BRISTLE,
    CURRENT,
    ELEMENTS,
    GAP,
    KARNOPP,
    MEMORY,
    MOTOR_ANGLE,
    MOTOR_SPEED,
    RING,
    SLOSH_ANGLE,
    SLOSH_SPEED,
    SPEED,
    STATES,
    TOOTH,
    TWO_STATE,
)
from rigs.nominal import REDUCER_RATIO, RING_RATIO
from rigs.ring import external_torque, extra_friction, remember

SAMPLE = 1e-3  # s, period of the loop and of the log
CLIP = 10.0  # V, limit of the controller's output
ENCODER_LINES = 2048  # signal periods per turn of the ring gear's encoder
HISTORY = 4096  # fine steps of speed kept for a late gyro


@njit(cache=True)
def derivative(time, y, dy, p, m, volts, mode, decide):
    """Rates of the state; with `decide`, bodies at rest may break away first."""
    ring, ring_speed = y[ANGLE + RING], y[SPEED + RING]
    warmth = math.exp(-time / p.warm_time) if p.warm_time > 0.0 else 0.0
    fluid = 1.0 + p.viscous_drift * (m[AGE] - 0.5)
    lag = p.lag + p.loop_lag
    load = 0.0
    for i in range(2):
        pinion, speed = y[ANGLE + i], y[SPEED + i]
        z, rate = twist(p, m, i, pinion, ring, speed, ring_speed)
        gap = half_gap(p, i, ring)
        z, rate = soft_flank(p, z, rate, gap)
        law, c, cf = p.contact, p.damping, p.gap_damping
        k = mesh_stiffness(p, i, pinion)
        tooth, dy[GAP + i] = mesh_torque(z, rate, y[GAP + i], gap, law, k, c, cf, tolerance(p))
        if decide:
            m[TOOTH + i] = tooth
        load += RING_RATIO * tooth

        voltage = volts[i]
        if lag > 0.0:
            dy[CURRENT + i] = (voltage - y[CURRENT + i]) / lag
            voltage = y[CURRENT + i]
        inertia = p.pinion_inertia
        if p.reducer_stiffness > 0.0:
            motor, motor_speed = y[MOTOR_ANGLE + i], y[MOTOR_SPEED + i]
            torque = motor_torque(p, i, voltage, REDUCER_RATIO * motor, REDUCER_RATIO * motor_speed)
            shaft = p.reducer_stiffness * (motor - pinion)
            shaft += p.reducer_damping * (motor_speed - speed)
            dy[MOTOR_ANGLE + i] = motor_speed
            dy[MOTOR_SPEED + i] = (torque - shaft) / p.motor_inertia
            inertia -= p.motor_inertia
            net = shaft - tooth
        else:
            torque = motor_torque(p, i, voltage, REDUCER_RATIO * pinion, REDUCER_RATIO * speed)
            net = torque - tooth
        scale = 1.0 + p.warm_reducer * warmth
        extra = p.load_friction * abs(tooth)
        if decide and p.law[i] == KARNOPP and mode[i] == 0.0:
            mode[i] = breakaway(p, i, net, scale, extra)
        drag, dy[BRISTLE + i] = friction(
            p, m, i, inertia, pinion, speed, net, mode[i], y[BRISTLE + i],
            scale, fluid, extra, decide,
        )  # fmt: skip
        dy[ANGLE + i] = speed
        dy[SPEED + i] = (net - drag) / inertia

    mean_voltage = 0.5 * (volts[0] + volts[1])
    net = load + external_torque(
        p, m, time, ring, ring_speed, mean_voltage, y[SLOSH_ANGLE], y[SLOSH_SPEED]
    )
    scale = 1.0 + p.warm_ring * warmth
    extra = extra_friction(p, m, time, ring, ring_speed)
    if decide and p.law[RING] == KARNOPP and mode[RING] == 0.0:
        mode[RING] = breakaway(p, RING, net, scale, extra)
    drag, dy[BRISTLE + RING] = friction(
        p, m, RING, p.ring_inertia, ring, ring_speed, net, mode[RING], y[BRISTLE + RING],
        scale, fluid, extra, decide,
    )  # fmt: skip
    dy[ANGLE + RING] = ring_speed
    dy[SPEED + RING] = (net - drag) / p.ring_inertia
    if p.slosh_inertia != 0.0:
        spring = p.slosh_rate * p.slosh_rate * (y[SLOSH_ANGLE] - ring)
        damper = 2.0 * p.slosh_damping * p.slosh_rate * (y[SLOSH_SPEED] - ring_speed)
        dy[SLOSH_ANGLE] = y[SLOSH_SPEED]
        dy[SLOSH_SPEED] = -spring - damper


@njit(cache=True)
def advance(time, step, y, p, m, volts, mode, work):
    """One Runge-Kutta step in place; work is (3, STATES) of scratch."""
    trial, total, k = work[0], work[1], work[2]
    for j in range(STATES):
        trial[j], total[j] = y[j], 0.0
    for stage in range(4):
        first, last = stage == 0, stage == 3
        ahead = 0.0 if first else step if last else 0.5 * step
        # called at one place and not at four: it is long to compile
        derivative(time + ahead, trial, k, p, m, volts, mode, first)
        ahead = 0.5 * step if stage < 2 else step
        for j in range(STATES):
            total[j] += k[j] if first or last else 2.0 * k[j]
            trial[j] = y[j] + ahead * k[j]
    for j in range(STATES):
        y[j] += step / 6.0 * total[j]
    for i in range(3):
        if mode[i] != 0.0 and mode[i] * y[SPEED + i] <= 0.0:
            y[SPEED + i] = 0.0
            mode[i] = 0.0
    if p.contact == TWO_STATE:
        for i in range(2):
            gap, place = half_gap(p, i, y[ANGLE + RING]), y[GAP + i]
            if abs(place) > gap - tolerance(p):
                y[GAP + i] = math.copysign(gap, place)


@njit(cache=True)
def at_rest(start):
    """State, memory and sticking modes of a rig whose ring gear rests at `start` [rad]."""
    y, m, mode = np.zeros(STATES), np.zeros(MEMORY), np.zeros(3)
    y[ANGLE + RING] = y[SLOSH_ANGLE] = start
    for i in range(2):
        y[ANGLE + i] = y[MOTOR_ANGLE + i] = RING_RATIO * start
    for j in range(ELEMENTS):
        m[ANCHOR + ELEMENTS * RING + j] = start
        for i in range(2):
            m[ANCHOR + ELEMENTS * i + j] = RING_RATIO * start
    return y, m, mode


@njit(cache=True)
def read(p, y, filtered, seen):
    """Write ring angle [rad], gyro [rad/s] and both motor angles [rad] as sensors give them."""
    ring = y[ANGLE + RING]
    seen[0] = ring
    if p.encoder_eccentricity != 0.0:
        seen[0] += p.encoder_eccentricity * math.cos(ring + p.encoder_phase)
    if p.interpolation != 0.0:
        seen[0] += p.interpolation * math.cos(ENCODER_LINES * ring + p.interpolation_phase)
    seen[1] = (1.0 + p.gyro_gain_error) * filtered + p.gyro_bias
    motor = MOTOR_ANGLE if p.reducer_stiffness > 0.0 else ANGLE
    seen[2] = REDUCER_RATIO * y[motor]
    seen[3] = REDUCER_RATIO * y[motor + 1]


@njit(cache=True)
def hold(p, y, m, mode, sent, k, n, substeps, history, filtered, work):
    """Advance by sample `k` of `n` under the commands `sent` (2, n); the gyro's filtered speed."""
    step = SAMPLE / substeps
    late_gyro = min(HISTORY - 1, round(p.gyro_delay / step))
    late_drive = round(p.delay / step)
    kept = math.exp(-2.0 * math.pi * p.gyro_bandwidth * step) if p.gyro_bandwidth > 0.0 else 0.0
    volts = np.zeros(2)
    for fine in range(k * substeps, (k + 1) * substeps):
        time = fine * step
        m[AGE] = time / (n * SAMPLE)
        effective = fine - late_drive
        for i in range(2):
            u = sent[i, effective // substeps] if effective >= 0 else 0.0
            volts[i] = amplifier(p, m, i, u, time, step)
        advance(time, step, y, p, m, volts, mode, work)
        remember(p, m, y[ANGLE + RING], y[SPEED + RING], step)
        history[(fine + 1) % HISTORY] = y[SPEED + RING]
        seen = history[(fine + 1 - late_gyro) % HISTORY]
        filtered = seen + kept * (filtered - seen)
    return filtered


@njit(cache=True)
def record_log(p, signal, closed, gains, preload, start, noise, substeps):
    """Run one experiment; columns of the log before quantisation, in SI units.

    Parameters
    ----------
    p : record of layout.RECORD
    signal : (n,) array
        Voltage common to both motors [V], or setpoint of the speed [deg/s].
    closed : bool
        Whether the PI controller turns the setpoint into the voltage.
    gains : (2,) array
        k_p [V s/deg], k_i [V/deg].
    preload : float
        Voltage added on the left and taken off on the right [V].
    start : float
        Angle of the ring gear at rest [rad].
    noise : (n,) array
        Of the gyro [rad/s].
    substeps : int
        Fine steps per sample.

    Returns
    -------
    (6, n) array
        u_left, u_right [V], ring angle [rad], gyro [rad/s], motor angles [rad].
    """
    n = signal.size
    out, seen = np.empty((6, n)), np.empty(4)
    y, m, mode = at_rest(start)
    work, history = np.zeros((3, STATES)), np.zeros(HISTORY)
    filtered, integral = 0.0, 0.0
    for k in range(n):
        read(p, y, filtered, seen)
        seen[1] += noise[k]
        command = signal[k]
        if closed:
            error = signal[k] - seen[1] * 180.0 / math.pi
            integral += SAMPLE * error
            command = min(CLIP, max(-CLIP, gains[0] * error + gains[1] * integral))
        out[0, k] = command + preload
        out[1, k] = command - preload
        for i in range(4):
            out[2 + i, k] = seen[i]
        filtered = hold(p, y, m, mode, out, k, n, substeps, history, filtered, work)
    return out
