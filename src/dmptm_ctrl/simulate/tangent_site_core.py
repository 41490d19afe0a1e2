"""The loop of `core.py` for a drive with effects, together with its derivatives.

As in `tangent_core` the run goes by itself, and what a change of a parameter changes in it goes
along to first order, or with branches of its own where the run is about to take another one.
The slopes of kernels are written from their source (`slopes`), those by numbers of an effect
used for the changes that move these. No physics is written here.
"""

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.simulate.bristle_core import (
    D_N0,
    D_N1,
    D_N2,
    D_R0,
    D_R1,
    D_R2,
    W_ADDED,
    W_BRISTLE,
    W_FORCE,
    W_LEVEL,
    W_MID,
    W_V,
    bristle_change,
    bristle_numbers,
    bristled,
    bristles_along,
    bristles_along_with_own,
    bristles_own,
    bristling,
)
from dmptm_ctrl.simulate.core import UNKNOWN, aged, held_average
from dmptm_ctrl.simulate.elementary import borrowed
from dmptm_ctrl.simulate.row_sites import lag_relaxation_of, sensor_reading_of
from dmptm_ctrl.simulate.row_step_core import (
    D_A0,
    D_A1,
    D_AGE0,
    D_AGE1,
    D_AGE2,
    D_E0,
    D_E1,
    D_F0,
    D_F1,
    D_F2,
    D_HIDDEN,
    D_O0,
    D_O1,
    D_P0,
    D_P1,
    F_BRISTLES,
    F_DAMP,
    F_DEAD,
    F_EASE,
    F_LATE,
    F_MOB3,
    F_MOBL,
    F_RENEW,
    F_STIFF,
    HIDDEN,
    MOTION,
    STATE,
    Acting,
    bristles_in,
    fix,
    grow,
    law_of,
    row_steps,
    same_both_ways,
    voltage_of,
)
from dmptm_ctrl.simulate.site_change_core import (
    AT_AGEING,
    AT_DRIVE,
    AT_FRICTION,
    AT_LAG,
    AT_LOAD,
    AT_MESH,
    AT_MOTOR,
    D_H0,
    D_H1,
    D_K0,
    D_K1,
    D_L0,
    D_L1,
    D_LOAD,
    D_U0,
    D_U1,
    Moving,
    change_of_mesh,
    frictions_own,
    grown,
    is_same,
    kink,
    meshes_along,
    older_by,
    own_of,
    plain_mesh,
    sliding,
    torque_at,
    volts_along,
    with_level,
    without_level,
)
from dmptm_ctrl.simulate.sites import active_sites
from dmptm_ctrl.simulate.slope_sites import (
    ageing_slopes_of,
    friction_slopes_of,
    load_slopes_of,
    motor_slopes_of,
)
from dmptm_ctrl.simulate.tangent_core import (
    CHANGES,
    D_B0,
    D_B1,
    D_B2,
    D_G0,
    D_G1,
    D_GAIN,
    D_K,
    D_LAW,
    D_MOB3,
    D_MOBL,
    D_S0,
    D_S1,
    D_S2,
    D_T0,
    D_T1,
    D_T2,
    D_W0,
    D_W1,
    D_W2,
    DC0,
    DC1,
    DC2,
    DQ0,
    DQ1,
    DQ2,
    DV0,
    DV1,
    DV2,
    NO_SLOPES,
    RESTING,
    changed_numbers,
    law_own,
    laws_along,
    mesh_slopes,
    one_of,
    one_way,
    smooth_body,
    used,
)

# As `MARGIN`, where it is known how far the changes are: of the gap's torque at least, and times
# what they move torques of meshes at a sample. In a vector loop that sum would take longer.
LEAST_MARGIN, TIMES = 1e-5, 10.0


@njit
def march_site_tangents(
    u, x0, dt, substeps, bases, values, on, moved, steps, s, fixed, room, r,
    out, changes, back, motors, meshes, frictions, loads, delays, lags, shafts, lates, ages,
    bristles
):  # fmt: skip
    """Run a drive with effects and what changes of its numbers and of theirs change.

    bases and values (p + 2, ...) of the run, of each change, of all the other way; on (effects,),
    where any of these has it; moved (3, 13 + m) where each site begins, behind that the change and
    number of each number of an effect that is moved; s, fixed (p + 2, FIXED), room (3, STATE)
    zeros, room to work in; r as of `slope_sites`; the last ten are None where no effect acts at a
    kind of sites, which leaves that out of what is compiled: motors, meshes, friction, load, delay
    of the voltage, lag, shaft, delay of a reading, age of the contacts, presliding; the rest, and
    what is returned, as of `march_tangents`.
    """
    n, p = u.shape[1], changes.shape[0]
    h = dt / substeps
    half = 0.5 * h
    # not literals, for each of which the chains would be compiled once more
    side0 = 0 * substeps
    side1, ring = side0 + 1, side0 + 2
    left, right = borrowed(u[0]), borrowed(u[1])
    s, fixed, room = borrowed(s), borrowed(fixed), borrowed(room)
    bases, values, on, moved = borrowed(bases), borrowed(values), borrowed(on), borrowed(moved)
    r = borrowed(r)
    volts = np.zeros((p + 2, 2))
    for row in range(p + 2):
        fix(fixed, row, h, dt, bases, on, values)
    renew0, renew1, renew2 = fixed[0, F_RENEW], fixed[0, F_RENEW + 1], fixed[0, F_RENEW + 2]
    q0, q1, q2 = x0[0], x0[1], x0[2]
    v0, v1, v2 = x0[3], x0[4], x0[5]
    age0, age1 = aged(0.0, v0, half, renew0), aged(0.0, v1, half, renew1)
    age2 = aged(0.0, v2, half, renew2)
    lagging, delayed, late, presliding, ageing, elastic = False, False, False, False, False, False
    longest, farthest, dead, shaft, kinked = 0.0, 0.0, False, False, False
    has_drive, has_motor, has_mesh, has_friction, has_load, has_sensor = active_sites(on)
    if motors is None:
        has_motor = False
    if meshes is None:
        has_mesh = False
    if frictions is None:
        has_friction = False
    if loads is None:
        has_load = False
    numbered, sloped = False, False
    if ages is not None:
        for row in range(p + 2):
            for body in range(3):
                ageing = ageing or fixed[row, F_RENEW + body] > 0.0
    if bristles is not None:
        for row in range(p + 2):
            for body in range(3):
                presliding = presliding or fixed[row, F_BRISTLES + 3 * body] > 0.0
        if presliding:
            numbered, sloped = bristled(s, p, bases, fixed)
        for row in range(p + 1):
            bristle_numbers(s, row, bases, fixed)
    if delays is not None:
        for row in range(p + 2):
            delayed = delayed or fixed[row, F_DEAD] > 0.0
            farthest = max(farthest, abs(fixed[row, F_DEAD] - fixed[0, F_DEAD]))
            kinked = kinked or kink(fixed, row, F_DEAD, 1.0 * substeps)
    if lags is not None:
        for row in range(p + 2):
            lagging = lagging or lag_relaxation_of(0.0, 0, on, values, row)[1] > 0.0
    if shafts is not None:
        elastic = fixed[0, F_STIFF] > 0.0
        for row in range(p + 2):
            for k in (F_STIFF, F_DAMP, F_EASE):
                shaft = shaft or fixed[row, k] != fixed[0, k]
    if lates is not None:
        for row in range(p + 2):
            late = late or fixed[row, F_LATE] > 0.0
            longest = max(longest, fixed[row, F_LATE])
            kinked = kinked or kink(fixed, row, F_LATE, 1.0)
    varying, teeth = False, False
    dead = farthest > 0.0
    if meshes is not None:
        for row in range(p + 2):
            varying = varying or bases[row, 9] != 0.0
            for k in (7, 9, 10):
                teeth = teeth or bases[row, k] != bases[0, k]
    for j in range(p + 1):
        changed_numbers(s, j, bases[0], bases[1 + j], h)
        s[D_MOB3 + j] = fixed[1 + j, F_MOB3] - fixed[0, F_MOB3]
        s[D_G0 + j] = s[D_G1 + j] = UNKNOWN
        s[D_AGE0 + j] = aged(0.0, v0, half, fixed[1 + j, F_RENEW]) - age0
        s[D_AGE1 + j] = aged(0.0, v1, half, fixed[1 + j, F_RENEW + 1]) - age1
        s[D_AGE2 + j] = aged(0.0, v2, half, fixed[1 + j, F_RENEW + 2]) - age2
    at = moved[0, 1:13] > moved[0, :12]
    acting = Acting(
        *(has_drive, lagging, has_motor, has_mesh, has_friction, ageing, has_load),
        *(elastic, presliding),
    )
    own_volts = at[AT_DRIVE] or at[AT_LAG] or dead
    own_level = (has_friction and at[AT_FRICTION]) or (ageing and at[AT_AGEING])
    own_teeth = varying and teeth
    moving = Moving(
        own_volts,
        dead,
        used(s, D_GAIN, D_K),
        has_motor and at[AT_MOTOR],
        shaft,
        has_mesh and at[AT_MESH],
        used(s, D_K, D_MOB3),
        own_teeth,
        own_level,
        used(s, D_LAW, D_S0),
        used(s, D_MOB3, D_LAW),
        has_load and at[AT_LOAD],
        ageing and at[AT_AGEING],
    )
    steered = delayed or has_drive or lagging
    altered, levelled = has_mesh or varying, has_friction or ageing
    own_friction = moving.friction or numbered
    base = bases[0]
    n1, n2 = base[5], base[6]
    gain = n1 * (base[0] * base[1])
    mobility_3, mobility_l = fixed[0, F_MOB3], fixed[0, F_MOBL]
    stiff, damping, ease = fixed[0, F_STIFF], fixed[0, F_DAMP], fixed[0, F_EASE]
    least = LEAST_MARGIN * base[8] * max(base[13], base[14], 0.0)
    by_twist, by_rate = TIMES * base[8], TIMES * (base[11] + base[12])
    margin = least
    reducer, bearing = law_of(bases, 0, 15), law_of(bases, 0, 24)
    bristles0, bristles1 = bristles_in(fixed, 0, 0), bristles_in(fixed, 0, 1)
    bristles2 = bristles_in(fixed, 0, 2)
    mesh0 = Backlash(base[8], base[11], base[12], max(base[13], 0.0))
    mesh1 = Backlash(base[8], base[11], base[12], max(base[14], 0.0))
    d0, d1, d2 = 0.0, 0.0, 0.0
    a0, a1, w0, w1, b0, b1 = q0, q1, v0, v1, 0.0, 0.0  # motors, seen at the pinion
    e0, e1, kept0, kept1 = 0.0, 0.0, 0.0, 0.0  # lagged voltages, before and after the step
    g0, g1, g2 = 0.0, 0.0, 0.0  # presliding frictions
    region0, region1 = UNKNOWN, UNKNOWN
    m0 = m1 = NO_SLOPES
    nothing, nowhere = (0.0,) * 6, (0.0,) * 3
    given_by0, given_by1, mean0, mean1 = 1.0, 1.0, (1.0, 0.0), (1.0, 0.0)
    late0, late1 = (0.0, 1.0), (0.0, 1.0)
    way0, way1, way2 = 1.0, 1.0, 1.0  # directions that the bodies move in, or last moved in
    p0, p1, p2 = one_way(way0, reducer), one_way(way1, reducer), one_way(way2, bearing)
    laws_along(s, way0, way1, way2)
    history, newest = np.full((int(longest) + 2, p + 2), v2), 0
    width = p  # changes that go along; one more once the other way is another one
    split = n
    if kinked:
        width, split = p + 1, 0
    apart = True  # whether some change is, or may be, on another branch than the run
    top = 0.0  # largest speed so far
    for i in range(n):
        t = i * dt
        if altered:
            mesh_l, mesh_r = meshes_along(
                *(q0, q1, q2, v0, v1, v2, region0, region1, side0),
                *(varying, acting, moving, p, width, bases, moved, s, r),
            )
        else:
            mesh_l = plain_mesh(q0 - n2 * q2, v0 - n2 * v2, region0, mesh0, m0, n2, moving)
            mesh_r = plain_mesh(q1 - n2 * q2, v1 - n2 * v2, region1, mesh1, m1, n2, moving)
        anew0 = apart or not is_same(mesh_l, region0, margin)
        anew1 = apart or not is_same(mesh_r, region1, margin)
        margin = least
        for j in range(-1, width):
            row = 1 + j
            dq0, dq1, dq2, dv0, dv1, dv2, da0, da1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if j >= 0:
                dq0, dq1, dq2 = s[DQ0 + j], s[DQ1 + j], s[DQ2 + j]
                dv0, dv1, dv2 = s[DV0 + j], s[DV1 + j], s[DV2 + j]
                da0, da1 = (s[D_A0 + j], s[D_A1 + j]) if elastic else (dq0, dq1)
                margin += by_twist * (abs(dq0 - n2 * dq2) + abs(dq1 - n2 * dq2))
                margin += by_rate * (abs(dv0 - n2 * dv2) + abs(dv1 - n2 * dv2))
            angle, speed = q2 + dq2, v2 + dv2
            if late:
                back_by = int(fixed[row, F_LATE])
                newer = history[(newest - back_by) % history.shape[0], row]
                older = history[(newest - back_by - 1) % history.shape[0], row]
                speed = newer + (fixed[row, F_LATE] - back_by) * (older - newer)
            if has_sensor:
                angle, speed = sensor_reading_of(angle, speed, t, on, values, row)
            torque0, torque1 = mesh_l.torque, mesh_r.torque
            if j >= 0 and not anew0:
                torque0 += change_of_mesh(s, j, mesh_l, dq0, dv0, dq2, dv2, side0, moving)
            elif anew0:
                torque0 = torque_at(
                    *(q0 + dq0, v0 + dv0, q2 + dq2, v2 + dv2, side0, acting, bases, on, values, row)
                )
            if j >= 0 and not anew1:
                torque1 += change_of_mesh(s, j, mesh_r, dq1, dv1, dq2, dv2, side1, moving)
            elif anew1:
                torque1 = torque_at(
                    *(q1 + dq1, v1 + dv1, q2 + dq2, v2 + dv2, side1, acting, bases, on, values, row)
                )
            if j < 0:
                out[0, i], out[1, i], out[2, i], out[3, i] = angle, speed, n1 * a0, n1 * a1
                out[4, i], out[5, i] = torque0, torque1
                out[6, i], out[7, i] = q0 - n2 * q2, q1 - n2 * q2
            else:
                line = changes[j] if j < p else back
                per = 1.0 / steps[j] if j < p else 1.0
                line[0, i], line[1, i] = per * (angle - out[0, i]), per * (speed - out[1, i])
                line[2, i], line[3, i] = per * n1 * da0, per * n1 * da1
                line[4, i], line[5, i] = per * (torque0 - out[4, i]), per * (torque1 - out[5, i])
                line[6, i], line[7, i] = per * (dq0 - n2 * dq2), per * (dq1 - n2 * dq2)
        u0, u1 = left[i], right[i]
        for k in range(substeps):
            middle = t + (k + 0.5) * h
            given0, given1, start, crossing = left[i], right[i], 0.0, False
            sure = True
            if delayed:
                start = i + k / substeps - fixed[0, F_DEAD]
                given0 = held_average(left, i + 1, start, start + 1.0 / substeps)
                given1 = held_average(right, i + 1, start, start + 1.0 / substeps)
                end = start + 1.0 / substeps + farthest
                crossing = dead and np.floor(start - farthest) != np.floor(end)
            if steered:
                if not (has_drive or lagging):
                    u0, u1 = given0, given1
                elif moving.volts:
                    u0, kept0, given_by0, mean0, late0, sure0 = volts_along(
                        *(s, given0, e0, middle, side0, h, acting, p, width, moved, r)
                    )
                    u1, kept1, given_by1, mean1, late1, sure1 = volts_along(
                        *(s, given1, e1, middle, side1, h, acting, p, width, moved, r)
                    )
                    sure = sure0 and sure1
                else:
                    u0, kept0 = voltage_of(given0, e0, middle, side0, h, acting, on, values, side0)
                    u1, kept1 = voltage_of(given1, e1, middle, side1, h, acting, on, values, side0)
            x_0, x_1, x_2 = q0 + half * v0, q1 + half * v1, q2 + half * v2
            s0, s1, s2 = v0 + 0.5 * d0, v1 + 0.5 * d1, v2 + 0.5 * d2
            y0, y1, r0, r1 = x_0, x_1, s0, s1
            if elastic:
                y0, y1, r0, r1 = a0 + half * w0, a1 + half * w1, w0 + 0.5 * b0, w1 + 0.5 * b1
            if altered:
                mesh_l, mesh_r = meshes_along(
                    *(x_0, x_1, x_2, s0, s1, s2, region0, region1, side0),
                    *(varying, acting, moving, p, width, bases, moved, s, r),
                )
            else:
                mesh_l = plain_mesh(x_0 - n2 * x_2, s0 - n2 * s2, region0, mesh0, m0, n2, moving)
                mesh_r = plain_mesh(x_1 - n2 * x_2, s1 - n2 * s2, region1, mesh1, m1, n2, moving)
            torque0, torque1 = mesh_l.torque, mesh_r.torque
            sure = sure and is_same(mesh_l, region0, margin) and is_same(mesh_r, region1, margin)
            drive0, drive1 = gain * u0, gain * u1
            push0 = push1 = (gain, 0.0, 0.0)  # by voltage, angle and speed of the motor
            if has_motor:
                pull, e, good = motor_slopes_of(
                    u0, n1 * y0, n1 * r0, middle, side0, moving.motor, r
                )
                drive0 += n1 * pull
                push0 = (gain + n1 * e[0], n1 * n1 * e[1], n1 * n1 * e[2])
                pull, e, fine = motor_slopes_of(
                    u1, n1 * y1, n1 * r1, middle, side1, moving.motor, r
                )
                drive1 += n1 * pull
                push1 = (gain + n1 * e[0], n1 * n1 * e[1], n1 * n1 * e[2])
                sure = sure and good and fine
                if moving.motor:
                    own_of(s, D_H0, AT_MOTOR, side0, (n1,), moved, r)
                    own_of(s, D_H0 + side1 * CHANGES, AT_MOTOR, side1, (n1,), moved, r)
                    if width > p:
                        grow(s, D_H0, 2, p)
            net0, net1 = drive0, drive1
            if elastic:
                drive0 = stiff * (y0 - x_0) + damping * (r0 - s0)
                drive1 = stiff * (y1 - x_1) + damping * (r1 - s1)
                net0, net1 = net0 - drive0, net1 - drive1
            force0, force1, force2 = drive0 - torque0, drive1 - torque1, n2 * (torque0 + torque1)
            load = (0.0, 0.0)
            if has_load:
                pushed, load, good = load_slopes_of(x_2, s2, middle, moving.load, r)
                force2 += pushed
                sure = sure and good
                if moving.load:
                    own_of(s, D_LOAD, AT_LOAD, 0, (1.0,), moved, r)
                    if width > p:
                        grow(s, D_LOAD, 1, p)
            level0, level1, level2, added0, added1, added2 = 1.0, 1.0, 1.0, 0.0, 0.0, 0.0
            by0 = by1 = by2 = nothing
            old0 = old1 = old2 = 0.0
            grown0 = grown1 = grown2 = nowhere
            aged0, aged1, aged2 = 0.0, 0.0, 0.0
            if has_friction:
                carried = abs(torque0) + abs(torque1)
                found0, found1, found2, good = friction_slopes_of(
                    *(x_0, s0, torque0, side0, x_1, s1, torque1, side1, x_2, s2, carried, ring),
                    *(middle, moving.friction, r),
                )
                (level0, added0), by0 = found0
                (level1, added1), by1 = found1
                (level2, added2), by2 = found2
                sure = sure and good
                # no torque has no direction, but in a gap there is no change of it either
                none0 = torque0 == 0.0 and mesh_l.slopes[0] != 0.0
                none1 = torque1 == 0.0 and mesh_r.slopes[0] != 0.0
                level_by = abs(by2[2]) + abs(by2[5])
                sure = sure and (level_by == 0.0 or not (none0 or none1))
            if ageing:
                found0, found1, found2, good = ageing_slopes_of(
                    *(age0, side0, age1, side1, age2, ring, moving.friction, r)
                )
                old0, old1, old2 = found0[1], found1[1], found2[1]
                added0, added1, added2 = added0 + found0[0], added1 + found1[0], added2 + found2[0]
                sure = sure and good
            if v0 * way0 < 0.0 or v1 * way1 < 0.0 or v2 * way2 < 0.0:
                way0, way1, way2 = one_of(v0), one_of(v1), one_of(v2)
                p0, p1, p2 = one_way(way0, reducer), one_way(way1, reducer), one_way(way2, bearing)
                laws_along(s, way0, way1, way2)
            f0 = f1 = f2 = RESTING
            after0, after1, after2, more0, more1, more2 = 0.0, 0.0, 0.0, nothing, nothing, nothing
            if presliding:
                s[W_V], s[W_V + 1], s[W_V + 2] = v0, v1, v2
                s[W_MID], s[W_MID + 1], s[W_MID + 2] = s0, s1, s2
                s[W_FORCE], s[W_FORCE + 1], s[W_FORCE + 2] = force0, force1, force2
                s[W_LEVEL], s[W_LEVEL + 1], s[W_LEVEL + 2] = level0, level1, level2
                s[W_ADDED], s[W_ADDED + 1], s[W_ADDED + 2] = added0, added1, added2
                s[W_BRISTLE], s[W_BRISTLE + 1], s[W_BRISTLE + 2] = g0, g1, g2
                if sloped:
                    bristles_along_with_own(s, h)
                else:
                    bristles_along(s, h)
                if numbered:
                    bristles_own(s, h, p, width)
            if presliding and bristles0[0] > 0.0:
                new0, after0, s_0, more0, good = bristling(s, side0)
            else:
                new0, good, f0 = smooth_body(
                    v0, s0, force0, mobility_3, reducer, p0, level0, added0
                )
                s_0 = sliding(f0, mobility_3)
            sure = sure and good
            if presliding and bristles1[0] > 0.0:
                new1, after1, s_1, more1, good = bristling(s, side1)
            else:
                new1, good, f1 = smooth_body(
                    v1, s1, force1, mobility_3, reducer, p1, level1, added1
                )
                s_1 = sliding(f1, mobility_3)
            sure = sure and good
            if presliding and bristles2[0] > 0.0:
                new2, after2, s_2, more2, good = bristling(s, ring)
            else:
                new2, good, f2 = smooth_body(
                    v2, s2, force2, mobility_l, bearing, p2, level2, added2
                )
                s_2 = sliding(f2, mobility_l)
            if moving.friction:
                frictions_own(
                    *(s, s_0, s_1, s_2, more0, more1, more2),
                    *(p, width, acting, moved, r),
                )
            sure = sure and good
            if ageing:
                aged0, grown0, good = grown(age0, new0, h, renew0)
                aged1, grown1, fine = grown(age1, new1, h, renew1)
                aged2, grown2, well = grown(age2, new2, h, renew2)
                sure = sure and good and fine and well
            if apart or not sure:
                state = (
                    *(q0, q1, q2, v0, v1, v2, d0, d1, d2, a0, a1, w0, w1, b0, b1),
                    *(e0, e1, g0, g1, g2, age0, age1, age2, region0, region1),
                )
                for m in range(STATE):
                    room[0, m] = state[m]
                for row in range(p + 2):
                    volts[row, 0], volts[row, 1] = left[i], right[i]
                    if delayed:
                        start = i + k / substeps - fixed[row, F_DEAD]
                        volts[row, 0] = held_average(left, i + 1, start, start + 1.0 / substeps)
                        volts[row, 1] = held_average(right, i + 1, start, start + 1.0 / substeps)
                if width == p:
                    grow(s, DQ0, MOTION, p)
                    grow(s, D_HIDDEN, HIDDEN, p)
                    s[D_G0 + p], s[D_G1 + p] = region0, region1
                apart = row_steps(s, room, p, volts, middle, h, acting, bases, on, values, fixed)
                x = room[0]
                q0, q1, q2, v0, v1, v2, d0, d1 = x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7]
                d2, a0, a1, w0, w1, b0, b1 = x[8], x[9], x[10], x[11], x[12], x[13], x[14]
                e0, e1 = x[15], x[16]
                g0, g1, g2, age0, age1, age2 = x[17], x[18], x[19], x[20], x[21], x[22]
                if not altered and (region0 != x[23] or region1 != x[24]):
                    m0, m1 = mesh_slopes(x[23], mesh0), mesh_slopes(x[24], mesh1)
                region0, region1 = x[23], x[24]
                if width == p:
                    reach = max(abs(q0), abs(q1), abs(q2))
                    top = max(top, abs(v0), abs(v1), abs(v2))
                    if not (
                        same_both_ways(s, DQ0, 3, p, reach) and same_both_ways(s, DV0, 6, p, top)
                    ):
                        width, split = p + 1, i + 1
            else:
                z_0, z_1, z_2 = without_level(s_0), without_level(s_1), without_level(s_2)
                y_0, y_1, y_2 = without_level(more0), without_level(more1), without_level(more2)
                if levelled:
                    z_0, y_0 = with_level(s_0, by0, old0), with_level(more0, by0, old0)
                    z_1, y_1 = with_level(s_1, by1, old1), with_level(more1, by1, old1)
                    z_2, y_2 = with_level(s_2, by2, old2), with_level(more2, by2, old2)
                for j in range(width):
                    row = 1 + j
                    o0, o1, o2 = s[DV0 + j], s[DV1 + j], s[DV2 + j]
                    i0, i1 = s[DQ0 + j] + half * o0, s[DQ1 + j] + half * o1
                    i2 = s[DQ2 + j] + half * o2
                    c0, c1, c2 = o0 + 0.5 * s[DC0 + j], o1 + 0.5 * s[DC1 + j], o2 + 0.5 * s[DC2 + j]
                    t0 = change_of_mesh(s, j, mesh_l, i0, c0, i2, c2, side0, moving)
                    t1 = change_of_mesh(s, j, mesh_r, i1, c1, i2, c2, side1, moving)
                    h0, h1 = 0.0, 0.0
                    if moving.gain:
                        h0, h1 = u0 * s[D_GAIN + j], u1 * s[D_GAIN + j]
                    if moving.volts:
                        begin0, begin1 = 0.0, 0.0
                        if crossing and fixed[row, F_DEAD] != fixed[0, F_DEAD]:
                            start = i + k / substeps - fixed[row, F_DEAD]
                            end = start + 1.0 / substeps
                            begin0 = held_average(left, i + 1, start, end) - given0
                            begin1 = held_average(right, i + 1, start, end) - given1
                        begin0 = given_by0 * begin0 + s[D_U0 + j]
                        begin1 = given_by1 * begin1 + s[D_U1 + j]
                        if lagging:
                            was0, was1 = s[D_E0 + j], s[D_E1 + j]
                            s[D_E0 + j] = late0[0] * begin0 + late0[1] * was0 + s[D_K0 + j]
                            s[D_E1 + j] = late1[0] * begin1 + late1[1] * was1 + s[D_K1 + j]
                            begin0 = mean0[0] * begin0 + mean0[1] * was0 + s[D_L0 + j]
                            begin1 = mean1[0] * begin1 + mean1[1] * was1 + s[D_L1 + j]
                        h0 += push0[0] * begin0
                        h1 += push1[0] * begin1
                    l_0, l_1, o_0, o_1 = i0, i1, c0, c1
                    if elastic:
                        l_0, o_0 = s[D_A0 + j] + half * s[D_O0 + j], s[D_O0 + j] + 0.5 * s[D_P0 + j]
                        l_1, o_1 = s[D_A1 + j] + half * s[D_O1 + j], s[D_O1 + j] + 0.5 * s[D_P1 + j]
                    if has_motor:
                        h0 += push0[1] * l_0 + push0[2] * o_0
                        h1 += push1[1] * l_1 + push1[2] * o_1
                        if moving.motor:
                            h0 += s[D_H0 + j]
                            h1 += s[D_H1 + j]
                    if elastic:
                        shaft0 = stiff * (l_0 - i0) + damping * (o_0 - c0)
                        shaft1 = stiff * (l_1 - i1) + damping * (o_1 - c1)
                        eased0, eased1 = 0.0, 0.0
                        if moving.shaft:
                            stiffer = fixed[row, F_STIFF] - stiff
                            damped = fixed[row, F_DAMP] - damping
                            shaft0 += stiffer * (y0 - x_0) + damped * (r0 - s0)
                            shaft1 += stiffer * (y1 - x_1) + damped * (r1 - s1)
                            eased0 = (fixed[row, F_EASE] - ease) * net0
                            eased1 = (fixed[row, F_EASE] - ease) * net1
                        s[D_P0 + j] = ease * (h0 - shaft0) + eased0
                        s[D_P1 + j] = ease * (h1 - shaft1) + eased1
                        s[D_O0 + j] += s[D_P0 + j]
                        s[D_O1 + j] += s[D_P1 + j]
                        s[D_A0 + j] = l_0 + half * s[D_O0 + j]
                        s[D_A1 + j] = l_1 + half * s[D_O1 + j]
                        h0, h1 = shaft0, shaft1
                    h0, h1, h2 = h0 - t0, h1 - t1, n2 * (t0 + t1)
                    if has_load:
                        h2 += load[0] * i2 + load[1] * c2
                        if moving.load:
                            h2 += s[D_LOAD + j]
                    new_0 = z_0[0] * o0 + z_0[1] * c0 + z_0[2] * h0
                    new_1 = z_1[0] * o1 + z_1[1] * c1 + z_1[2] * h1
                    new_2 = z_2[0] * o2 + z_2[1] * c2 + z_2[2] * h2
                    t2 = 0.0
                    if levelled:
                        t2 = (t0 if torque0 > 0.0 else -t0) + (t1 if torque1 > 0.0 else -t1)
                        new_0 += z_0[3] * i0 + z_0[4] * t0
                        new_1 += z_1[3] * i1 + z_1[4] * t1
                        new_2 += z_2[3] * i2 + z_2[4] * t2
                    if moving.laws:
                        law = s[D_S0 + j], s[D_T0 + j], s[D_W0 + j], s[D_B0 + j]
                        new_0 -= z_0[2] * law_own(f0, *law)
                        law = s[D_S1 + j], s[D_T1 + j], s[D_W1 + j], s[D_B1 + j]
                        new_1 -= z_1[2] * law_own(f1, *law)
                        law = s[D_S2 + j], s[D_T2 + j], s[D_W2 + j], s[D_B2 + j]
                        new_2 -= z_2[2] * law_own(f2, *law)
                    if moving.mass:
                        new_0 += f0[0] * f0[2] * s[D_MOB3 + j]
                        new_1 += f1[0] * f1[2] * s[D_MOB3 + j]
                        new_2 += f2[0] * f2[2] * s[D_MOBL + j]
                    if own_friction:
                        new_0 += s[D_N0 + j]
                        new_1 += s[D_N1 + j]
                        new_2 += s[D_N2 + j]
                    y = s[D_AGE0 + j], s[D_AGE1 + j], s[D_AGE2 + j]
                    if presliding:
                        was = s[D_F0 + j], s[D_F1 + j], s[D_F2 + j]
                        new_0 += z_0[6] * was[0]
                        new_1 += z_1[6] * was[1]
                        new_2 += z_2[6] * was[2]
                        s[D_F0 + j] = bristle_change(y_0, o0, c0, h0, i0, t0, y[0], was[0])
                        s[D_F1 + j] = bristle_change(y_1, o1, c1, h1, i1, t1, y[1], was[1])
                        s[D_F2 + j] = bristle_change(y_2, o2, c2, h2, i2, t2, y[2], was[2])
                        if own_friction:
                            s[D_F0 + j] += s[D_R0 + j]
                            s[D_F1 + j] += s[D_R1 + j]
                            s[D_F2 + j] += s[D_R2 + j]
                    if ageing:
                        new_0 += z_0[5] * y[0]
                        new_1 += z_1[5] * y[1]
                        new_2 += z_2[5] * y[2]
                        slip = fixed[row, F_RENEW] - renew0
                        s[D_AGE0 + j] = older_by(grown0, y[0], new_0, slip)
                        slip = fixed[row, F_RENEW + 1] - renew1
                        s[D_AGE1 + j] = older_by(grown1, y[1], new_1, slip)
                        slip = fixed[row, F_RENEW + 2] - renew2
                        s[D_AGE2 + j] = older_by(grown2, y[2], new_2, slip)
                    s[DQ0 + j], s[DQ1 + j] = i0 + half * new_0, i1 + half * new_1
                    s[DQ2 + j] = i2 + half * new_2
                    s[DV0 + j], s[DV1 + j], s[DV2 + j] = new_0, new_1, new_2
                    s[DC0 + j], s[DC1 + j], s[DC2 + j] = new_0 - o0, new_1 - o1, new_2 - o2
                d0, d1, d2 = new0 - v0, new1 - v1, new2 - v2
                v0, v1, v2 = new0, new1, new2
                q0, q1, q2 = x_0 + half * v0, x_1 + half * v1, x_2 + half * v2
                if elastic:
                    b0, b1 = ease * net0, ease * net1
                    w0, w1 = w0 + b0, w1 + b1
                    a0, a1 = y0 + half * w0, y1 + half * w1
                else:
                    a0, a1 = q0, q1
                e0, e1, g0, g1, g2 = kept0, kept1, after0, after1, after2
                age0, age1, age2 = aged0, aged1, aged2
            if late:
                newest = newest + 1 if newest + 1 < history.shape[0] else 0
                history[newest, 0] = v2
                for j in range(p + 1):
                    history[newest, 1 + j] = v2 + s[DV2 + j]
        top = max(top, abs(v0), abs(v1), abs(v2))
    return split
