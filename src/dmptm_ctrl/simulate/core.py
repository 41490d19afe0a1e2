"""The time-stepping loop; no physics of its own.

Every torque comes from a kernel in `effects/`, through the site chains that
`compiled.py` writes from the catalogue and puts before this text.

Scheme, per step h, second order where the motion is smooth:
half a step of the angles with the old speed; torques at the midpoint, with the speed
extrapolated by the last acceleration; speed update with friction as a set-valued law
(Moreau & Jean: a body whose speed would change sign within the step stops, and stays while
its breakaway torque holds the net torque); half a step of the angles with the new speed.
The jump of the mesh torque at a flank is weighted by its share of the step, which keeps the
order through contacts.
"""

from math import cos, exp, floor

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import (
    Backlash,
    landing,
    mesh_region,
    mesh_torque,
    region_torque,
)
from dmptm_ctrl.effects.presliding import bristle_lag, build_up_distance, fading
from dmptm_ctrl.effects.stribeck import (
    breakaway_torque,
    sliding_torque,
    stribeck_law,
    viscous_torque,
)
from dmptm_ctrl.simulate.control_core import L_CLOSED, M_LEFT, M_RIGHT, MEMORY, command
from dmptm_ctrl.simulate.elementary import borrowed
from dmptm_ctrl.simulate.sites import (  # chains
    active_sites,
    aged_friction,
    drive_voltage,
    friction_level,
    lag_relaxation,
    load_torque,
    mesh_shift,
    motor_torque,
    presliding_law,
    sensor_reading,
    shaft_compliance,
    speed_delay,
    voltage_delay,
)

UNKNOWN = 2.0  # region of a mesh before the first step
MIN_COMPLIANCE = 1e-6  # rad/(N·m); below, the reducer's own mode is beyond the step and rigid


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
def slide_or_stick(v, v_mid, force, mobility, law, scale, added):
    """Speed after one step under `force` and set-valued friction; `mobility` is h/J."""
    new, stops = slide(v, v_mid, force, mobility, law, scale, added)
    if stops:
        return stop(v, new, force, mobility, law, scale, added)
    return new


@njit
def slide(v, v_mid, force, mobility, law, scale, added):
    """Speed of a body that keeps its direction, or stays at rest; and whether it stops instead."""
    free = v + force * mobility
    if v != 0.0:
        direction = 1.0 if v > 0.0 else -1.0
    else:
        direction = 1.0 if free > 0.0 else -1.0
    if v == 0.0 and abs(force) <= max(scale * breakaway_torque(direction, law) + added, 0.0):
        return 0.0, False
    friction = max(scale * sliding_torque(v_mid, direction, law) + added, 0.0)
    new = free - friction * (direction * mobility)
    return new, new * direction < 0.0


@njit
def stop(v, new, force, mobility, law, scale, added):
    """Speed of a body that comes to rest within the step, if it does not stay."""
    direction = 1.0 if new > 0.0 else -1.0
    hold = max(scale * breakaway_torque(direction, law) + added, 0.0)
    if force * direction <= hold:
        return 0.0
    stopped = abs(v) / (abs(v) + abs(new)) if v != 0.0 else 0.0
    friction = max(scale * sliding_torque(0.0, direction, law) + added, 0.0)
    return max((1.0 - stopped) * (force * direction - friction) * mobility, 0.0) * direction


@njit
def mesh_step(z, z_rate, law, before, h):
    """Mean torque of the mesh [N·m] over one step, and its region of Eq. 21.

    The torque jumps where a flank is reached. Since the midpoint before, the jump has acted
    for as long as the flank has been reached, the midpoint rule takes half a step.
    """
    region = mesh_region(z, z_rate, law)
    torque = region_torque(z, z_rate, region, law)
    if (before == 0.0 or before == -region) and region * z_rate > 0.0:
        age, step = landing(z, z_rate, law)
        torque += (min(max(age / h, 0.0), 1.0) - 0.5) * step
    return torque, region


@njit
def march(
    u, loop, design, target, observer, measured, extra, x0, begin, dt, substeps, base, on, values,
    out
):  # fmt: skip
    """Run the plant over all samples; see `compiled.march` for the meaning.

    u (2, n) is read, or written when the loop is closed; `loop` (kp, ki, limit, bias_l,
    bias_r, closed) and, where closed is 2, what else `control_core` takes, with the arrays of
    its model in `design`; `observer` (angle gain, speed gain, steps per sample while it
    leads); `measured` is the angle that the observer follows for as long as it lasts, or (n,)
    the speed noise of the closed loop;
    `extra` (n, 3) or (0, 3) torques on the pinions and the ring gear; `begin` the time of the
    first sample; `base` in the order of `compiled.BASE`;
    `out` (n, 8), or (n, 4) without the columns of the meshes.
    """
    n = u.shape[1]
    led = measured.size if observer[0] > 0.0 else 0
    steps = int(observer[2]) if led > 0 else substeps
    h = dt / steps
    on, values = borrowed(on), borrowed(values)
    gain = base[0] * base[1]
    j_m, j_2, j_l = base[2], base[3], base[4]
    n1, n2, z3 = base[5], base[6], base[7]
    k_m, k_a, phi_r, c, c_f = base[8], base[9], base[10], base[11], base[12]
    gap = (base[13], base[14])
    reducer = stribeck_law(
        base[15], base[16], base[17], base[18], base[19], base[20], base[21], base[22], base[23]
    )
    bearing = stribeck_law(
        base[24], base[25], base[26], base[27], base[28], base[29], base[30], base[31], base[32]
    )
    # Local flags: an absent site costs one well-predicted branch per step.
    has_drive, has_motor, has_mesh, has_friction, has_load, has_sensor = active_sites(on)
    dz, dz_rate, dgap, dk = 0.0, 0.0, 0.0, 0.0
    scale, added = 1.0, 0.0
    j_motor = n1 * n1 * j_m
    compliance, shaft_damping = shaft_compliance(j_motor * j_2 / (j_motor + j_2), on, values)
    elastic = compliance > MIN_COMPLIANCE
    mobility_3 = h / (j_2 if elastic else j_2 + j_motor)
    mobility_l = h / j_l
    dead_time = voltage_delay(on, values) / dt
    lag_time = speed_delay(on, values) / h
    lagging = lag_relaxation(0.0, 0, on, values)[1] > 0.0
    bristles = (
        bristles_of(presliding_law(0, on, values), mobility_3, h, reducer),
        bristles_of(presliding_law(1, on, values), mobility_3, h, reducer),
        bristles_of(presliding_law(2, on, values), mobility_l, h, bearing),
    )

    q0, q1, q2 = x0[0], x0[1], x0[2]
    v0, v1, v2 = x0[3], x0[4], x0[5]
    m0, m1 = q0, q1  # motors, seen at the pinion
    w0, w1 = v0, v1
    d0, d1, d2 = 0.0, 0.0, 0.0  # last changes of the speeds
    b0, b1 = 0.0, 0.0
    e0, e1 = 0.0, 0.0  # lagged voltages
    f0, f1, f2 = 0.0, 0.0, 0.0  # presliding friction
    renew = (
        aged_friction(0.0, 0, on, values)[1],
        aged_friction(0.0, 1, on, values)[1],
        aged_friction(0.0, 2, on, values)[1],
    )
    ageing = max(renew[0], renew[1], renew[2]) > 0.0
    # in the middle of the step, as the torques
    age0 = aged(0.0, v0, 0.5 * h, renew[0])
    age1 = aged(0.0, v1, 0.5 * h, renew[1])
    age2 = aged(0.0, v2, 0.5 * h, renew[2])
    integral = 0.0
    region0, region1 = UNKNOWN, UNKNOWN  # of each mesh in the step before
    late = lag_time > 0.0
    history = np.full(int(lag_time) + 2, v2)
    left, right = borrowed(u[0]), borrowed(u[1])
    memory = np.zeros(MEMORY)
    step = 0
    lead = 0.0
    meshes = out.shape[1] > 4  # whether the columns of the meshes are wanted
    for i in range(n):
        t = begin + i * dt
        if i == led and steps != substeps:  # let go: from here on in steps of another length
            finer = steps / substeps
            steps = substeps
            h = dt / steps
            mobility_3 *= finer
            mobility_l *= finer
            d0, d1, d2 = d0 * finer, d1 * finer, d2 * finer
        seen = v2
        if late:
            back = int(lag_time)
            newer = history[(step - back) % history.size]
            older = history[(step - back - 1) % history.size]
            seen = newer + (lag_time - back) * (older - newer)
        angle, speed = q2, seen
        if has_sensor:
            angle, speed = sensor_reading(q2, seen, t, on, values)
        out[i, 0], out[i, 1] = angle, speed
        out[i, 2], out[i, 3] = n1 * m0, n1 * m1
        if meshes:
            if has_mesh:
                dz, dz_rate, dgap, dk = mesh_shift(q0, v0, q2, v2, 0, on, values)
            stiff = k_m + dk + (k_a * cos(z3 * q0 + phi_r) if k_a != 0.0 else 0.0)
            out[i, 4] = mesh_torque(
                q0 - n2 * q2 + dz,
                v0 - n2 * v2 + dz_rate,
                Backlash(stiff, c, c_f, max(gap[0] + dgap, 0.0)),
            )
            if has_mesh:
                dz, dz_rate, dgap, dk = mesh_shift(q1, v1, q2, v2, 1, on, values)
            stiff = k_m + dk + (k_a * cos(z3 * q1 + phi_r) if k_a != 0.0 else 0.0)
            out[i, 5] = mesh_torque(
                q1 - n2 * q2 + dz,
                v1 - n2 * v2 + dz_rate,
                Backlash(stiff, c, c_f, max(gap[1] + dgap, 0.0)),
            )
            out[i, 6], out[i, 7] = q0 - n2 * q2, q1 - n2 * q2
        if loop[L_CLOSED] > 1.0:
            seen = speed + measured[i]
            command(target[i], angle, seen, n1 * m0, n1 * m1, t, dt, loop, memory, design)
            left[i], right[i] = memory[M_LEFT], memory[M_RIGHT]
        elif loop[L_CLOSED] > 0.0:
            error = target[i] - (speed + measured[i])
            integral += error * dt
            common = loop[0] * error + loop[1] * integral
            if abs(common) > loop[2]:
                common = loop[2] if common > 0.0 else -loop[2]
            left[i] = common + loop[3]
            right[i] = common + loop[4]
        elif i < led:
            miss = measured[i] - angle
            # what depends on angle is where the sensor says, not where the run has drifted to
            lead = (1.0 - observer[0]) * miss
            q2 += observer[0] * miss
            q0 += observer[0] * miss * n2
            q1 += observer[0] * miss * n2
            m0 += observer[0] * miss * n2
            m1 += observer[0] * miss * n2
            if v2 != 0.0:
                v2 += observer[1] * miss
                if v0 != 0.0:
                    v0 += observer[1] * miss * n2
                    w0 += observer[1] * miss * n2
                if v1 != 0.0:
                    v1 += observer[1] * miss * n2
                    w1 += observer[1] * miss * n2
        push0, push1, push2 = 0.0, 0.0, 0.0
        if extra.shape[0] > 0:
            push0, push1, push2 = extra[i, 0], extra[i, 1], extra[i, 2]
        for k in range(steps):
            middle = t + (k + 0.5) * h
            if dead_time > 0.0:
                start = i + k / steps - dead_time
                u0 = held_average(left, i + 1, start, start + 1.0 / steps)
                u1 = held_average(right, i + 1, start, start + 1.0 / steps)
            else:
                u0, u1 = left[i], right[i]
            if has_drive:
                u0 = drive_voltage(u0, middle, 0, on, values)
                u1 = drive_voltage(u1, middle, 1, on, values)
            if lagging:
                aim, tau = lag_relaxation(u0, 0, on, values)
                kept = (e0 - aim) * exp(-h / tau)
                u0 = aim + (e0 - aim - kept) * tau / h  # mean over the step
                e0 = aim + kept
                aim, tau = lag_relaxation(u1, 1, on, values)
                kept = (e1 - aim) * exp(-h / tau)
                u1 = aim + (e1 - aim - kept) * tau / h
                e1 = aim + kept
            x_0, x_1, x_2 = q0 + 0.5 * h * v0, q1 + 0.5 * h * v1, q2 + 0.5 * h * v2
            s0, s1, s2 = v0 + 0.5 * d0, v1 + 0.5 * d1, v2 + 0.5 * d2
            if elastic:
                y0, y1 = m0 + 0.5 * h * w0, m1 + 0.5 * h * w1
                r0, r1 = w0 + 0.5 * h * b0, w1 + 0.5 * h * b1
            else:
                y0, y1, r0, r1 = x_0, x_1, s0, s1

            if has_mesh:
                dz, dz_rate, dgap, dk = mesh_shift(
                    x_0 + n2 * lead, s0, x_2 + lead, s2, 0, on, values
                )
            stiff = k_m + dk + (k_a * cos(z3 * x_0 + phi_r) if k_a != 0.0 else 0.0)
            torque0, region0 = mesh_step(
                x_0 - n2 * x_2 + dz,
                s0 - n2 * s2 + dz_rate,
                Backlash(stiff, c, c_f, max(gap[0] + dgap, 0.0)),
                region0,
                h,
            )
            if has_mesh:
                dz, dz_rate, dgap, dk = mesh_shift(
                    x_1 + n2 * lead, s1, x_2 + lead, s2, 1, on, values
                )
            stiff = k_m + dk + (k_a * cos(z3 * x_1 + phi_r) if k_a != 0.0 else 0.0)
            torque1, region1 = mesh_step(
                x_1 - n2 * x_2 + dz,
                s1 - n2 * s2 + dz_rate,
                Backlash(stiff, c, c_f, max(gap[1] + dgap, 0.0)),
                region1,
                h,
            )

            drive0, drive1 = n1 * gain * u0, n1 * gain * u1
            if has_motor:
                rotor0, rotor1 = n1 * (y0 + n2 * lead), n1 * (y1 + n2 * lead)
                drive0 += n1 * motor_torque(u0, rotor0, n1 * r0, middle, 0, on, values)
                drive1 += n1 * motor_torque(u1, rotor1, n1 * r1, middle, 1, on, values)
            force0, force1 = drive0, drive1
            if elastic:
                force0 = (y0 - x_0) / compliance + shaft_damping * (r0 - s0)
                force1 = (y1 - x_1) / compliance + shaft_damping * (r1 - s1)
                b0, b1 = (drive0 - force0) / j_motor, (drive1 - force1) / j_motor
                w0 += h * b0
                w1 += h * b1
                m0 = y0 + 0.5 * h * w0
                m1 = y1 + 0.5 * h * w1
            force0 += push0 - torque0
            force1 += push1 - torque1
            force2 = n2 * (torque0 + torque1) + push2
            if has_load:
                force2 += load_torque(x_2 + lead, s2, middle, on, values)

            if has_friction:
                scale, added = friction_level(x_0 + n2 * lead, s0, middle, torque0, 0, on, values)
            if ageing:
                added = (added if has_friction else 0.0) + aged_friction(age0, 0, on, values)[0]
            new0, f0 = friction_step(
                v0, s0, force0, mobility_3, h, reducer, scale, added, bristles[0], f0
            )
            if has_friction:
                scale, added = friction_level(x_1 + n2 * lead, s1, middle, torque1, 1, on, values)
            if ageing:
                added = (added if has_friction else 0.0) + aged_friction(age1, 1, on, values)[0]
            new1, f1 = friction_step(
                v1, s1, force1, mobility_3, h, reducer, scale, added, bristles[1], f1
            )
            if has_friction:
                carried = abs(torque0) + abs(torque1)
                scale, added = friction_level(x_2 + lead, s2, middle, carried, 2, on, values)
            if ageing:
                added = (added if has_friction else 0.0) + aged_friction(age2, 2, on, values)[0]
            new2, f2 = friction_step(
                v2, s2, force2, mobility_l, h, bearing, scale, added, bristles[2], f2
            )
            if ageing:
                age0 = aged(age0, new0, h, renew[0])
                age1 = aged(age1, new1, h, renew[1])
                age2 = aged(age2, new2, h, renew[2])
            d0, d1, d2 = new0 - v0, new1 - v1, new2 - v2
            v0, v1, v2 = new0, new1, new2
            q0, q1, q2 = x_0 + 0.5 * h * v0, x_1 + 0.5 * h * v1, x_2 + 0.5 * h * v2
            if not elastic:
                m0, m1, w0, w1 = q0, q1, v0, v1
            step += 1
            if late:
                history[step % history.size] = v2
    return step


@njit
def friction_step(v, v_mid, force, mobility, h, law, scale, added, bristles, bristle):
    """Speed and presliding torque after one step; `bristles` as of `bristles_of`."""
    if bristles[0] <= 0.0:
        return slide_or_stick(v, v_mid, force, mobility, law, scale, added), 0.0
    return preslide(v, v_mid, force, mobility, h, law, scale, added, bristles, bristle)


@njit
def bristles_of(site, mobility, h, law):
    """Distance, share of viscous friction at once and lag [s] of a body's bristles.

    So short a distance that the step cannot follow the body on it has no more damping than the
    step can take.
    """
    distance, share, damping = site
    inertia = h / mobility
    lag = bristle_lag(distance, damping, inertia, law)
    return distance, share, min(lag, bristle_lag(distance, 0.5, inertia, law) ** 2 / h)


@njit
def aged(age, v, h, slip):
    """Age of a contact a time `h` later [s]: it grows with time, and `slip` [rad] makes it new."""
    if slip <= 0.0:
        return 0.0
    turned = abs(v) * h / slip
    if turned == 0.0:
        return age + h
    left = exp(-turned)
    return age * left + h * (1.0 - left) / turned


@njit
def preslide(v, v_mid, force, mobility, h, law, scale, added, bristles, bristle):
    """Speed and friction after one step where friction is a spring before it slides."""
    direction = 1.0 if v_mid > 0.0 else -1.0
    at_once = direction * bristles[1] * scale * viscous_torque(v_mid, direction, law)
    level = direction * max(scale * sliding_torque(v_mid, direction, law) + added, 0.0) - at_once
    # of what is left to build up, after half of the step; one at rest, where nothing does
    half = exp(-0.5 * abs(v_mid) * h / build_up_distance(bristles[0], level, law))
    middle = bristle + (level - bristle) * (1.0 - half)
    built = (level - bristle) * (1.0 - half * half)
    damping = bristles[2] * fading(v_mid, direction, law) * built / h
    return v + (force - middle - damping - at_once) * mobility, bristle + built
