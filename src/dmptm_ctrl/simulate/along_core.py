"""What effects and friction do along a recorded motion; no physics of its own.

Nothing is integrated but a lag and pre-sliding: samples do not wait for each other, and each
effect acts on a block of them at once, which lies in rows of a work array.
"""

from math import exp, floor

import numpy as np
from numba import njit

from dmptm_ctrl.effects.presliding import build_up_distance
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law, viscous_torque
from dmptm_ctrl.simulate.elementary import borrowed
from dmptm_ctrl.simulate.sample_sites import (
    drive_samples,
    friction_samples,
    load_samples,
    mesh_samples,
    motor_samples,
)
from dmptm_ctrl.simulate.sites import (  # chains
    active_sites,
    lag_relaxation,
    sensor_reading,
    voltage_delay,
)

BLOCK = 64  # samples; the rows of a block stay in the fastest cache
X_TIME = 0
X_VOLTS = X_TIME + BLOCK
X_MOTOR = X_VOLTS + BLOCK  # angle
X_MOTOR_SPEED = X_MOTOR + BLOCK
X_RING = X_MOTOR_SPEED + BLOCK  # angle
X_RING_SPEED = X_RING + BLOCK
X_ANGLE = X_RING_SPEED + BLOCK  # of the body whose friction it is
X_SPEED = X_ANGLE + BLOCK
X_WAY = X_SPEED + BLOCK  # sign of the speed
X_MESH = X_WAY + BLOCK  # torque that it carries
X_CARRIED = X_MESH + BLOCK  # by both
X_ADDED_TORQUE = X_CARRIED + BLOCK
X_SCALE = X_ADDED_TORQUE + BLOCK  # on the friction
X_ADDED = X_SCALE + BLOCK  # friction
X_SHIFT = X_ADDED + BLOCK  # of z
X_GAP = X_SHIFT + BLOCK  # wider
X_TORQUE = X_GAP + BLOCK
ROWS = X_TORQUE + BLOCK


@njit
def held_average(u, n, start, end):
    """Mean of a sample-and-hold signal between two times in samples; zero before the log.

    `u` holds the samples up to `n`, or the last of them in a ring.
    """
    first = floor(start)
    last = floor(end)
    if last == first or end == last:
        return held(u, n, first)
    total = 0.0
    for i in range(first, last + 1):
        width = min(end, i + 1.0) - max(start, float(i))
        total += width * held(u, n, i)
    return total / (end - start)


@njit
def held(u, n, i):
    """Sample i of such a signal."""
    if i < 0:
        return 0.0
    i = min(i, n - 1)
    return u[i] if i < u.size else u[i % u.size]  # to divide takes long


@njit
def along(u, run, load, passes, dt, base, on, values, torque, shift):
    """Disturbance that the effects in use exert along a recorded run.

    `run` (n, 8) as from `march`, `load` (n, 2) the torque of the meshes without the effects;
    writes `torque` (n, 3) on the pinions and the ring gear and `shift` (n, 2) of z at the flank
    it is nearest to. The pinions turn with the ring gear. The meshes carry what friction leaves,
    which may depend on what they carry: it is asked `passes` times more.
    """
    work = np.empty(ROWS)
    in_blocks(work, u, run, load, passes, dt, base, on, values, torque, shift)


@njit
def in_blocks(s, u, run, load, passes, dt, base, on, values, torque, shift):
    """Do the same; `s` (ROWS,) is room to work in, which the caller keeps."""
    gain = base[0] * base[1]
    n1, n2 = base[5], base[6]
    reducer = stribeck_law(
        base[15], base[16], base[17], base[18], base[19], base[20], base[21], base[22], base[23]
    )
    bearing = stribeck_law(
        base[24], base[25], base[26], base[27], base[28], base[29], base[30], base[31], base[32]
    )
    dead_time = voltage_delay(on, values) / dt
    lagging = lag_relaxation(0.0, 0, on, values)[1] > 0.0
    lagged = np.zeros(2)
    # what is counted for each call of a site takes longer than what acts there
    u, run, torque, shift = borrowed(u), borrowed(run), borrowed(torque), borrowed(shift)
    on, values, load, s = borrowed(on), borrowed(values), borrowed(load), borrowed(s)
    has_drive, has_motor, has_mesh, has_friction, has_load, _ = active_sites(on)
    for first in range(0, u.shape[1], BLOCK):
        width = min(BLOCK, u.shape[1] - first)
        for i in range(width):
            omega = run[first + i, 1]
            s[X_TIME + i] = (first + i + 0.5) * dt
            s[X_RING + i] = run[first + i, 0]
            s[X_RING_SPEED + i] = omega
            s[X_MOTOR_SPEED + i] = n1 * n2 * omega
            s[X_WAY + i] = 1.0 if omega > 0.0 else -1.0 if omega < 0.0 else 0.0
            s[X_CARRIED + i] = 0.0
        for side in range(2):
            for i in range(width):
                s[X_VOLTS + i] = u[side, first + i]
                s[X_MOTOR + i] = run[first + i, 2 + side]
                s[X_ANGLE + i] = run[first + i, 2 + side] / n1
                s[X_SPEED + i] = n2 * s[X_RING_SPEED + i]
                s[X_ADDED_TORQUE + i] = 0.0
            if dead_time > 0.0:
                for i in range(width):
                    k = first + i
                    s[X_VOLTS + i] = held_average(u[side], k + 1, k - dead_time, k + 1 - dead_time)
            if has_drive:
                drive_samples(s, width, side, on, values)
            if lagging:
                for i in range(width):
                    aim, tau = lag_relaxation(s[X_VOLTS + i], side, on, values)
                    kept = (lagged[side] - aim) * exp(-dt / tau)
                    s[X_VOLTS + i] = aim + (lagged[side] - aim - kept) * tau / dt
                    lagged[side] = aim + kept
            if has_motor:
                motor_samples(s, width, side, on, values)
            for i in range(width):
                pull = gain * (s[X_VOLTS + i] - u[side, first + i]) + s[X_ADDED_TORQUE + i]
                s[X_ADDED_TORQUE + i] = n1 * pull
                s[X_TORQUE + i] = s[X_ADDED_TORQUE + i]
            if has_friction:
                for again in range(1 + passes):
                    for i in range(width):
                        s[X_MESH + i] = load[first + i, side]
                        if again > 0:
                            s[X_MESH + i] += s[X_TORQUE + i]
                    rub(s, width, side, reducer, on, values)
                for i in range(width):
                    s[X_CARRIED + i] += abs(s[X_MESH + i])
            for i in range(width):
                torque[first + i, side] = s[X_TORQUE + i]
                s[X_SHIFT + i], s[X_GAP + i] = 0.0, 0.0
            if has_mesh:
                mesh_samples(s, width, side, on, values)
            for i in range(width):
                # on a flank, a wider gap is a shift of z away from it
                wider = s[X_GAP + i] if run[first + i, 6 + side] > 0.0 else -s[X_GAP + i]
                shift[first + i, side] = s[X_SHIFT + i] - wider
        for i in range(width):
            s[X_ADDED_TORQUE + i] = 0.0
            s[X_ANGLE + i], s[X_SPEED + i] = s[X_RING + i], s[X_RING_SPEED + i]
            s[X_MESH + i] = s[X_CARRIED + i]
        if has_load:
            load_samples(s, width, 0, on, values)
        for i in range(width):
            s[X_TORQUE + i] = s[X_ADDED_TORQUE + i]
        if has_friction:
            rub(s, width, 2, bearing, on, values)
        for i in range(width):
            torque[first + i, 2] = s[X_TORQUE + i]


@njit
def rub(s, width, body, law, on, values):
    """Write the torque on a body that friction other than the declared leaves of what is added."""
    for i in range(width):
        s[X_SCALE + i], s[X_ADDED + i] = 1.0, 0.0
    friction_samples(s, width, body, on, values)
    scaled = 0.0
    for i in range(width):
        scaled = max(scaled, abs(s[X_SCALE + i] - 1.0))
    if scaled > 0.0:
        if law.exponent == 1.0:
            scale(s, width, without_power(law))
        else:
            scale(s, width, law)
    for i in range(width):
        s[X_TORQUE + i] = s[X_ADDED_TORQUE + i] - s[X_WAY + i] * s[X_ADDED + i]


@njit
def scale(s, width, law):
    """Add what a factor on the friction makes of it."""
    for i in range(width):
        sliding = sliding_torque(s[X_SPEED + i], s[X_WAY + i], law)
        s[X_ADDED + i] += (s[X_SCALE + i] - 1.0) * sliding


@njit
def without_power(law):
    """Return a law whose exponent the compiler knows to be 1: a power is no vector's operation."""
    return stribeck_law(
        law.static_plus,
        law.coulomb_plus,
        law.speed_plus,
        law.viscous_plus,
        law.static_minus,
        law.coulomb_minus,
        law.speed_minus,
        law.viscous_minus,
        1.0,
    )


@njit
def sliding_along(speed, law, out):
    """Write the friction of sliding along a recorded speed, negative when forward.

    `law` (9,) as in the base array.
    """
    own = stribeck_law(law[0], law[1], law[2], law[3], law[4], law[5], law[6], law[7], law[8])
    work = np.empty(ROWS)
    if own.exponent == 1.0:
        slide_along(work, speed, without_power(own), out)
    else:
        slide_along(work, speed, own, out)


@njit
def slide_along(s, speed, law, out):
    """Write the friction of a law along a speed; `s` (ROWS,) is the caller's room to work in."""
    s, speed, out = borrowed(s), borrowed(speed), borrowed(out)
    for first in range(0, speed.size, BLOCK):
        width = min(BLOCK, speed.size - first)
        for i in range(width):
            s[X_SPEED + i] = speed[first + i]
        for i in range(width):
            way = 1.0 if s[X_SPEED + i] > 0.0 else -1.0
            s[X_TORQUE + i] = -way * sliding_torque(s[X_SPEED + i], way, law)
        for i in range(width):
            out[first + i] = s[X_TORQUE + i]


@njit
def presliding_along(speed, angle, begins, distance, at_once, law, out):
    """Turn friction of sliding into that of pre-sliding along angles, exact for their steps.

    `begins` are the first samples of what was recorded at once, `at_once` the share of viscous
    friction that is not built up over the distance.
    """
    own = stribeck_law(law[0], law[1], law[2], law[3], law[4], law[5], law[6], law[7], law[8])
    force, part = 0.0, 0
    for i in range(angle.size):
        direction = 1.0 if speed[i] > 0.0 else -1.0
        viscous = -direction * at_once * viscous_torque(speed[i], direction, own)
        sliding = out[i] - viscous
        if part < begins.size and i == begins[part]:
            force, moved = 0.0, 0.0
            part += 1
        else:
            moved = angle[i] - angle[i - 1]
        if moved != 0.0:
            # where the speed has the other sign, there is nothing to slide against yet
            goal = sliding if sliding * moved < 0.0 else 0.0
            over = build_up_distance(distance, goal, own)
            force = goal + (force - goal) * exp(-abs(moved) / over)
        out[i] = force + viscous


@njit
def readings(angle, speed, dt, on, values, theta, omega):
    """Pass a motion through a sensor chain."""
    for i in range(angle.size):
        theta[i], omega[i] = sensor_reading(angle[i], speed[i], i * dt, on, values)
