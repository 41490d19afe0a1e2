"""The time-stepping loop of chains and branched trains; no physics of its own.

Torques come from the kernels in `effects/`, through the functions that `chain_compose.py`
writes from the chain catalogue and puts in place of the import of `chain_sites`.

Scheme, per step h, as in `core.py`: half a step of the coordinates with the old speed;
torques at the midpoint, with the speed extrapolated by the last acceleration; speed update
with friction as a set-valued law; half a step of the coordinates with the new speed.
"""

from math import exp, floor

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import Backlash, mesh_torque
from dmptm_ctrl.effects.stribeck import breakaway_torque, sliding_torque, stribeck_law
from dmptm_ctrl.simulate.chain_sites import (
    drive_signal,
    effect_torque,
    friction_change,
)

TINY = 1e-300  # a speed that has a direction and no size


@njit
def held(u, start, end):
    """Mean of a sample-and-hold signal between two times in samples; before the log its first."""
    first = floor(start)
    last = floor(end)
    n = u.size
    if last == first or end == last:
        return u[min(max(first, 0), n - 1)]
    total = 0.0
    for i in range(first, last + 1):
        width = min(end, i + 1.0) - max(start, float(i))
        total += width * u[min(max(i, 0), n - 1)]
    return total / (end - start)


@njit
def link_torque(z, z_rate, row, gap):
    """Torque of a link at its first body [N·m]."""
    if gap == 0:
        return row[1] * z + row[2] * z_rate
    return mesh_torque(z, z_rate, Backlash(row[1], row[2], row[3], row[4]))


@njit
def friction_of(group, q, speed, direction, breakaway, t, load, plant):
    """Magnitude of all friction on a coordinate, seen from it, moving in `direction`."""
    total = 0.0
    for b in range(plant.body_coordinate.size):
        if plant.body_coordinate[b] != group:
            continue
        r = plant.body_ratio[b]
        way = direction if r > 0.0 else -direction
        size = abs(r * speed)
        omega = way * max(size, TINY)
        row = plant.law[b]
        law = stribeck_law(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])
        if breakaway:
            level = breakaway_torque(way, law)
        else:
            level = sliding_torque(omega, way, law)
        factor = 1.0
        for e in range(plant.friction_place.shape[0]):
            if plant.friction_place[e, 1] == b:
                f, added = friction_change(
                    plant.friction_place[e, 0], r * q, omega, t, load[b], plant.friction_values[e]
                )
                factor *= f
                level += added
        total += abs(r) * max(factor * level, 0.0)
    return total


@njit
def slide_or_stick(group, q, v, v_mid, force, mobility, t, load, plant):
    """Speed after one step under `force` and set-valued friction; `mobility` is h/J."""
    if v == 0.0:
        direction = 1.0 if force > 0.0 else -1.0
        if abs(force) <= friction_of(group, q, 0.0, direction, True, t, load, plant):
            return 0.0
    else:
        direction = 1.0 if v > 0.0 else -1.0
    speed = max(v_mid * direction, 0.0)
    friction = friction_of(group, q, speed, direction, False, t, load, plant)
    new = v + (force - direction * friction) * mobility
    if new * direction >= 0.0:
        return new
    # The body comes to rest within the step; does it stay?
    direction = -direction
    if force * direction <= friction_of(group, q, 0.0, direction, True, t, load, plant):
        return 0.0
    stopped = abs(v) / (abs(v) + abs(new)) if v != 0.0 else 0.0
    friction = friction_of(group, q, 0.0, direction, False, t, load, plant)
    return max((1.0 - stopped) * (force * direction - friction) * mobility, 0.0) * direction


@njit
def march(plant, u, dt, substeps, q0, v0, given_q, given_v, control, reference, added, out):
    """Run the plant over all samples; see `chain.march` for the meaning.

    `out` (n, 2 · coordinates + links): coordinates, their speeds, torques of the links.
    `control`: kind (0 open, 1 PI on speed, 2 cascade), input, body, kp, ki, kv, limit.
    """
    samples = u.shape[1]
    count = plant.inertia.size
    links = plant.link_gap.size
    bodies = plant.body_coordinate.size
    inputs = plant.input_body.size
    h = dt / substeps
    q, v = q0.copy(), v0.copy()
    a = np.zeros(count)
    x, s = np.zeros(count), np.zeros(count)
    force, bristle = np.zeros(count), np.zeros(count)
    load = np.zeros(bodies)
    lagged = np.zeros(inputs)
    for j in range(inputs):
        lagged[j] = u[j, 0]
    integral, last_q, older_q = 0.0, 0.0, 0.0
    kind, loop_input, loop_body = int(control[0]), int(control[1]), int(control[2])
    any_given = given_q.shape[1] > 0
    for i in range(samples):
        t = i * dt
        for g in range(count):
            if any_given and plant.given[g] == 1:
                q[g], v[g] = given_q[g, i], given_v[g, i]
            out[i, g] = q[g]
            out[i, count + g] = v[g]
        for k in range(links):
            b1, b2 = plant.link_body[k, 0], plant.link_body[k, 1]
            row = plant.link_values[k]
            g1, g2 = plant.body_coordinate[b1], plant.body_coordinate[b2]
            r1, r2 = plant.body_ratio[b1], plant.body_ratio[b2] * row[0]
            z, z_rate = r1 * q[g1] - r2 * q[g2], r1 * v[g1] - r2 * v[g2]
            out[i, 2 * count + k] = link_torque(z, z_rate, row, plant.link_gap[k])
        if kind > 0:
            group, r = plant.body_coordinate[loop_body], plant.body_ratio[loop_body]
            if kind == 1:
                error = reference[i] - r * v[group]
                integral += error * dt
                command = control[3] * error + control[4] * integral
            else:
                here = r * q[group]
                if i == 0:
                    last_q, older_q = here - r * v[group] * dt, here - 2.0 * r * v[group] * dt
                speed = (here - older_q) / (2.0 * dt)  # 2-sample mean, then difference
                older_q, last_q = last_q, here
                command = control[5] * (control[3] * (reference[i] - here) - speed)
            command += added[i]
            if abs(command) > control[6]:
                command = control[6] if command > 0.0 else -control[6]
            u[loop_input, i] = command
        for k in range(substeps):
            middle = t + (k + 0.5) * h
            part = (k + 0.5) / substeps
            for g in range(count):
                if plant.given[g] == 1 and any_given:
                    nxt = min(i + 1, samples - 1)
                    x[g] = given_q[g, i] + part * (given_q[g, nxt] - given_q[g, i])
                    s[g] = given_v[g, i] + part * (given_v[g, nxt] - given_v[g, i])
                else:
                    x[g] = q[g] + 0.5 * h * v[g]
                    s[g] = v[g] + 0.5 * h * a[g]
                force[g] = 0.0
            for b in range(bodies):
                load[b] = 0.0
            for j in range(inputs):
                dead = plant.input_values[j, 1] / dt
                if dead > 0.0:
                    start = i + k / substeps - dead
                    signal = held(u[j, : i + 1], start, start + 1.0 / substeps)
                else:
                    signal = u[j, i]
                for e in range(plant.drive_place.shape[0]):
                    if plant.drive_place[e, 1] == j:
                        signal = drive_signal(
                            plant.drive_place[e, 0], signal, middle, plant.drive_values[e]
                        )
                limit = plant.input_values[j, 3]
                if limit > 0.0:
                    signal = min(limit, max(-limit, signal))
                tau = plant.input_values[j, 2]
                if tau > 0.0:
                    kept = (lagged[j] - signal) * exp(-h / tau)
                    mean = signal + (lagged[j] - signal - kept) * tau / h
                    lagged[j] = signal + kept
                    signal = mean
                b = plant.input_body[j]
                torque = plant.input_values[j, 0] * signal
                force[plant.body_coordinate[b]] += plant.body_ratio[b] * torque
                load[b] += abs(torque)
            for k2 in range(links):
                b1, b2 = plant.link_body[k2, 0], plant.link_body[k2, 1]
                row = plant.link_values[k2]
                g1, g2 = plant.body_coordinate[b1], plant.body_coordinate[b2]
                r1, r2 = plant.body_ratio[b1], plant.body_ratio[b2] * row[0]
                z, z_rate = r1 * x[g1] - r2 * x[g2], r1 * s[g1] - r2 * s[g2]
                torque = link_torque(z, z_rate, row, plant.link_gap[k2])
                force[g1] -= r1 * torque
                force[g2] += r2 * torque
                load[b1] += abs(torque)
                load[b2] += abs(row[0] * torque)
            for e in range(plant.torque_place.shape[0]):
                b = plant.torque_place[e, 1]
                g, r = plant.body_coordinate[b], plant.body_ratio[b]
                force[g] += r * effect_torque(
                    plant.torque_place[e, 0], r * x[g], r * s[g], middle, plant.torque_values[e]
                )
            for g in range(count):
                if plant.given[g] == 1 and any_given:
                    continue
                mobility = h / plant.inertia[g]
                if plant.distance[g] > 0.0:
                    new = v[g] + (force[g] - bristle[g]) * mobility
                    if s[g] != 0.0:
                        direction = 1.0 if s[g] > 0.0 else -1.0
                        level = direction * friction_of(
                            g, x[g], abs(s[g]), direction, False, middle, load, plant
                        )
                        decay = exp(-0.5 * abs(s[g]) * h / plant.distance[g])
                        half = level + (bristle[g] - level) * decay
                        new = v[g] + (force[g] - half) * mobility
                        bristle[g] = level + (half - level) * decay
                else:
                    new = slide_or_stick(
                        g, x[g], v[g], s[g], force[g], mobility, middle, load, plant
                    )
                a[g] = (new - v[g]) / h
                v[g] = new
                q[g] = x[g] + 0.5 * h * new
    return 0


@njit
def torque_along(kind, theta, omega, t, values, out):
    """Torque of one effect along signals."""
    for i in range(theta.size):
        out[i] = effect_torque(kind, theta[i], omega[i], t[i], values)


@njit
def friction_along(kind, theta, omega, t, load, values, factor, added):
    """Factor and added magnitude of one friction effect along signals."""
    for i in range(theta.size):
        factor[i], added[i] = friction_change(kind, theta[i], omega[i], t[i], load[i], values)


@njit
def drive_along(kind, u, t, values, out):
    """Signal of an input after one drive effect, along signals."""
    for i in range(u.size):
        out[i] = drive_signal(kind, u[i], t[i], values)


@njit
def law_along(omega, row, out):
    """Friction of a declared law along a speed, signed against the motion."""
    law = stribeck_law(row[0], row[1], row[2], row[3], row[4], row[5], row[6], row[7], row[8])
    for i in range(omega.size):
        way = 1.0 if omega[i] > 0.0 else -1.0
        out[i] = way * sliding_torque(omega[i], way, law) if omega[i] != 0.0 else 0.0


@njit
def bristle_along(travel, level, distance, out):
    """Dahl's friction along a motion: `level` is the signed sliding friction."""
    state = 0.0
    for i in range(travel.size):
        decay = exp(-abs(travel[i]) / distance)
        state = level[i] + (state - level[i]) * decay
        out[i] = state
