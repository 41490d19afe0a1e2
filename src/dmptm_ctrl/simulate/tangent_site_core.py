"""The loop of `core.py` for a drive with effects, together with its derivatives.

As in `tangent_core` the run goes by itself, and what a change of a parameter changes in it goes
along to first order, or with branches of its own where the run is about to take another one.
What an effect makes of a change is found by its own kernel, called at the motion and the numbers
of the run and again at the changed ones. No physics is written here.
"""

from math import cos, exp
from typing import NamedTuple

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import Backlash, mesh_torque, region_torque
from dmptm_ctrl.effects.stribeck import stribeck_law
from dmptm_ctrl.simulate.core import (
    MIN_COMPLIANCE,
    UNKNOWN,
    aged,
    bristles_of,
    held_average,
    mesh_step,
    preslide,
    slide_or_stick,
)
from dmptm_ctrl.simulate.elementary import borrowed
from dmptm_ctrl.simulate.row_sites import (
    aged_friction_of,
    drive_voltage_of,
    friction_level_of,
    lag_relaxation_of,
    load_torque_of,
    mesh_shift_of,
    motor_torque_of,
    presliding_law_of,
    sensor_reading_of,
    shaft_compliance_of,
    speed_delay_of,
    voltage_delay_of,
)
from dmptm_ctrl.simulate.sites import active_sites
from dmptm_ctrl.simulate.tangent_core import (
    APART,
    CHANGES,
    D_B0,
    D_B1,
    D_B2,
    D_C,
    D_CF,
    D_G0,
    D_G1,
    D_GAIN,
    D_GAP0,
    D_GAP1,
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
    MARGIN,
    NO_SLOPES,
    RESTING,
    ROUNDING,
    SIZE_OF_CHANGES,
    changed_numbers,
    law_own,
    law_slopes,
    laws_along,
    mesh_change,
    mesh_own,
    mesh_slopes,
    one_of,
    one_way,
    smooth_body,
    stays,
    used,
)

# Rows of changes behind those of `tangent_core`: of motors behind elastic reducers, angles,
# speeds, last changes of the speeds;
D_M0, D_M1, D_O0, D_O1, D_P0, D_P1 = range(SIZE_OF_CHANGES, SIZE_OF_CHANGES + 6 * CHANGES, CHANGES)
# lagged voltages; presliding friction; ages of the contacts.
D_E0, D_E1, D_R0, D_R1, D_R2, D_A0, D_A1, D_A2 = range(
    SIZE_OF_CHANGES + 6 * CHANGES, SIZE_OF_CHANGES + 14 * CHANGES, CHANGES
)
SIZE_WITH_SITES = SIZE_OF_CHANGES + 14 * CHANGES
MOTION, HIDDEN = 9, 14  # rows of state from DQ0 on, and from D_M0 on
# What stays as it is in each run: h/J; reducer's stiffness, damping, h/J of its motor; dead times
# in samples and steps;
F_MOB3, F_MOBL, F_STIFF, F_DAMP, F_EASE, F_DEAD, F_LATE = range(7)
# presliding of the three bodies; slip that makes their contacts new.
F_BRISTLES, F_RENEW = 7, 16
FIXED = 19
# Samples after which it is looked whether the other way is another one, where nothing but a value
# that stays on a kink can make it so; voltages, which may stay on one, are looked at in each.
PROBED = 8


@njit
def law_of(bases, row, first):
    """Friction law from a row of drives' numbers."""
    return stribeck_law(
        bases[row, first],
        bases[row, first + 1],
        bases[row, first + 2],
        bases[row, first + 3],
        bases[row, first + 4],
        bases[row, first + 5],
        bases[row, first + 6],
        bases[row, first + 7],
        bases[row, first + 8],
    )


@njit
def fix(fixed, row, h, dt, bases, on, values):
    """Put what stays as it is in a run into a row."""
    j_2, j_motor = bases[row, 3], bases[row, 5] * (bases[row, 5] * bases[row, 2])
    compliance, damping = shaft_compliance_of(j_motor * j_2 / (j_motor + j_2), on, values, row)
    elastic = compliance > MIN_COMPLIANCE
    fixed[row, F_MOB3] = h / (j_2 if elastic else j_2 + j_motor)
    fixed[row, F_MOBL] = h / bases[row, 4]
    fixed[row, F_STIFF] = 1.0 / compliance if elastic else 0.0
    fixed[row, F_DAMP], fixed[row, F_EASE] = damping, h / j_motor
    fixed[row, F_DEAD] = voltage_delay_of(on, values, row) / dt
    fixed[row, F_LATE] = speed_delay_of(on, values, row) / h
    for body in range(3):
        mobility = fixed[row, F_MOBL if body == 2 else F_MOB3]
        law = law_of(bases, row, 24 if body == 2 else 15)
        site = presliding_law_of(body, on, values, row)
        bristles = bristles_of(site, mobility, h, law)
        for k in range(3):
            fixed[row, F_BRISTLES + 3 * body + k] = bristles[k]
        fixed[row, F_RENEW + body] = aged_friction_of(0.0, body, on, values, row)[1]


@njit
def bristles_in(fixed, row, body):
    """Presliding of a body."""
    first = F_BRISTLES + 3 * body
    return fixed[row, first], fixed[row, first + 1], fixed[row, first + 2]


@njit
def voltage_of(u, kept, t, side, h, has_drive, lagging, on, values, row):
    """Mean voltage over the step behind drive and lag, and what the lag keeps."""
    if has_drive:
        u = drive_voltage_of(u, t, side, on, values, row)
    if lagging:
        aim, tau = lag_relaxation_of(u, side, on, values, row)
        left = (kept - aim) * exp(-h / tau) if tau > 0.0 else 0.0
        return aim + (kept - aim - left) * tau / h, aim + left
    return u, kept


@njit
def mesh_of(x, v, x_2, v_2, side, has_mesh, bases, on, values, row):
    """Shift of a mesh's angle, its rate, and the mesh itself."""
    shift, rate, wider, stiffer = 0.0, 0.0, 0.0, 0.0
    if has_mesh:
        shift, rate, wider, stiffer = mesh_shift_of(x, v, x_2, v_2, side, on, values, row)
    if bases[row, 9] != 0.0:
        stiffer += bases[row, 9] * cos(bases[row, 7] * x + bases[row, 10])
    gap = max(bases[row, 13 + side] + wider, 0.0)
    return shift, rate, Backlash(bases[row, 8] + stiffer, bases[row, 11], bases[row, 12], gap)


@njit
def changed_mesh(m, k, dz, dz_rate, here, there):
    """Change of a mesh's torque by its slopes, with the motion and from one mesh to another."""
    own = mesh_own(
        m,
        k,
        there.stiffness - here.stiffness,
        there.damping - here.damping,
        there.gap_damping - here.gap_damping,
        there.half_gap - here.half_gap,
    )
    return mesh_change(m, dz, dz_rate) + own


@njit
def level_of(x, v, t, torque, age, body, has_friction, ageing, on, values, row):
    """Factor on the declared friction, and Coulomb torque added."""
    level, added = 1.0, 0.0
    if has_friction:
        level, added = friction_level_of(x, v, t, torque, body, on, values, row)
    if ageing:
        added += aged_friction_of(age, body, on, values, row)[0]
    return level, added


@njit
def grow(s, to, count, p):
    """Put what all changes the other way change behind the changes: minus their sum."""
    for k in range(count):
        total = 0.0
        for j in range(p):
            total += s[to + k * CHANGES + j]
        s[to + k * CHANGES + p] = -total


@njit
def same_both_ways(s, first, count, p, size_of_state):
    """Whether what all changes the other way change is minus their sum."""
    for k in range(count):
        row = first + k * CHANGES
        size = abs(s[row + p])
        together = s[row + p]
        for j in range(p):
            together += s[row + j]
            size += abs(s[row + j])
        if abs(together) > APART * size + ROUNDING * size_of_state:
            return False
    return True


class Acting(NamedTuple):
    """What acts in a run at all."""

    volts: bool
    delay: bool
    drive: bool
    lag: bool
    motor: bool
    mesh: bool
    altered: bool  # meshes, by effects or with the teeth
    friction: bool
    ageing: bool
    load: bool
    elastic: bool
    presliding: bool
    numbers: bool  # changes of the meshes' numbers
    laws: bool  # changes of the friction laws


class Body(NamedTuple):
    """A body of the run in a step."""

    v: float  # rad/s, before the step
    v_mid: float
    force: float  # N·m, net but for friction
    new: float  # rad/s, after the step
    slopes: tuple[float, ...]  # of `smooth_body`
    level: float
    added: float
    bristle: float  # N·m, before the step
    bristle_after: float
    age: float  # s
    age_after: float


class Mesh(NamedTuple):
    """A mesh of the run in a step."""

    z: float
    z_rate: float
    shift: float
    shift_rate: float
    law: Backlash
    torque: float
    slopes: tuple[float, ...]
    own: tuple[float, ...]


class Motor(NamedTuple):
    """A motor of the run in a step, seen at the pinion."""

    given: float  # V, behind the dead time
    u: float  # V, behind drive and lag
    kept: float  # V, by the lag before the step
    kept_after: float
    angle: float  # rad
    speed: float
    pull: float  # N·m, what the chain gives on the shaft
    net: float  # N·m, on an elastic reducer's motor


@njit
def mesh_along(s, j, side, here, dz, dz_rate, place, look, h, acting, bases, on, values):
    """Change of a mesh's torque, by slopes or by a branch of its own.

    `place` holds angle and speed of the changed pinion and ring gear.
    """
    row = 1 + j
    region = (D_G1 if side == 1 else D_G0) + j
    if acting.altered or look:
        shift, rate, law = mesh_of(*place, side, acting.mesh, bases, on, values, row)
        dz, dz_rate = dz + (shift - here.shift), dz_rate + (rate - here.shift_rate)
        if look:
            torque, s[region] = mesh_step(here.z + dz, here.z_rate + dz_rate, law, s[region], h)
            return torque - here.torque
        return changed_mesh(here.slopes, here.own, dz, dz_rate, here.law, law)
    change = mesh_change(here.slopes, dz, dz_rate)
    if acting.numbers:
        gap = s[(D_GAP1 if side == 1 else D_GAP0) + j]
        change += mesh_own(here.slopes, here.own, s[D_K + j], s[D_C + j], s[D_CF + j], gap)
    return change


@njit
def body_along(s, j, body, w, c, g, own, place, look, h, acting, here, rows, bases, fixed):
    """Change of a body's speed after the step, by slopes or by a branch of its own.

    w, c, g are the changes of its speed before the step and in the middle and of the torque on it,
    `own` that of its friction law; `rows` where changes of h/J, bristles and ages are.
    """
    row = 1 + j
    mobility = fixed[row, F_MOBL if body == 2 else F_MOB3]
    level, added = place
    first = 24 if body == 2 else 15
    if acting.presliding and fixed[row, F_BRISTLES + 3 * body] > 0.0:
        new, bristle = preslide(
            *(here.v + w, here.v_mid + c, here.force + g, mobility, h, law_of(bases, row, first)),
            *(level, added, bristles_in(fixed, row, body), here.bristle + s[rows[1] + j]),
        )
        s[rows[1] + j] = bristle - here.bristle_after
        change = new - here.new
    elif look:
        law = law_of(bases, row, first)
        new = slide_or_stick(
            here.v + w, here.v_mid + c, here.force + g, mobility, law, level, added
        )
        change = new - here.new
    else:
        f = here.slopes
        own += f[1] * (f[8] * (level - here.level) + (added - here.added))
        base = fixed[0, F_MOBL if body == 2 else F_MOB3]
        change = f[0] * (w + base * (g - f[3] * c - own) + f[2] * s[rows[0] + j])
    if acting.ageing:
        slip = fixed[row, F_RENEW + body]
        s[rows[2] + j] = aged(here.age + s[rows[2] + j], here.new + change, h, slip)
        s[rows[2] + j] -= here.age_after
    return change


@njit
def motor_along(s, j, side, here, a, c, given, t, h, n1, gain, acting, on, values):
    """Change of a motor's torque at the pinion, with those of its angle and speed."""
    row = 1 + j
    change = here.u * s[D_GAIN + j]
    u = here.u
    if acting.volts:
        kept = (D_E1 if side == 1 else D_E0) + j
        u, after = voltage_of(
            *(given, here.kept + s[kept], t, side, h, acting.drive, acting.lag, on, values, row)
        )
        s[kept] = after - here.kept_after
        change += gain * (u - here.u)
    if acting.motor:
        pull = motor_torque_of(
            u, n1 * (here.angle + a), n1 * (here.speed + c), t, side, on, values, row
        )
        change += n1 * (pull - here.pull)
    return change


@njit
def shaft_along(s, j, here, twist, y, r, a, c, drive, h, rows, fixed):
    """Change of an elastic reducer's torque, and the step of its motor.

    `twist` are angle and rate of the motor against the pinion, y, r and a, c changes of both in
    the middle of the step; `rows` hold those of the motor's angle, speed, last change of it.
    """
    row = 1 + j
    torque = fixed[0, F_STIFF] * (y - a) + fixed[0, F_DAMP] * (r - c)
    torque += (fixed[row, F_STIFF] - fixed[0, F_STIFF]) * twist[0]
    torque += (fixed[row, F_DAMP] - fixed[0, F_DAMP]) * twist[1]
    ease = fixed[0, F_EASE]
    push = ease * (drive - torque) + (fixed[row, F_EASE] - ease) * here.net
    s[rows[2] + j] = push
    s[rows[1] + j] += push
    s[rows[0] + j] = y + 0.5 * h * s[rows[1] + j]
    return torque


@njit
def march_site_tangents(
    u, x0, dt, substeps, bases, values, on, steps, s, fixed, out, changes, back, memory
):  # fmt: skip
    """Run a drive with effects and what changes of its numbers and of theirs change.

    bases and values (p + 2, ...) of the run, of each change, of all the other way; on (effects,),
    where any of these has it; s and fixed (p + 2, FIXED) zeros, room to work in; memory is None
    where no effect has a state of its own, which is quicker; the rest, and what is returned, as of
    `march_tangents`.
    """
    n, p = u.shape[1], changes.shape[0]
    h = dt / substeps
    half = 0.5 * h
    left, right = borrowed(u[0]), borrowed(u[1])
    s, fixed = borrowed(s), borrowed(fixed)
    bases, values, on = borrowed(bases), borrowed(values), borrowed(on)
    for row in range(p + 2):
        fix(fixed, row, h, dt, bases, on, values)
    renew0, renew1, renew2 = fixed[0, F_RENEW], fixed[0, F_RENEW + 1], fixed[0, F_RENEW + 2]
    q0, q1, q2 = x0[0], x0[1], x0[2]
    v0, v1, v2 = x0[3], x0[4], x0[5]
    age0, age1 = aged(0.0, v0, half, renew0), aged(0.0, v1, half, renew1)
    age2 = aged(0.0, v2, half, renew2)
    lagging, delayed, late, presliding, ageing, elastic = False, False, False, False, False, False
    varying, longest = False, 0.0
    if memory is not None:
        elastic = fixed[0, F_STIFF] > 0.0
        for row in range(p + 2):
            lagging = lagging or lag_relaxation_of(0.0, 0, on, values, row)[1] > 0.0
            delayed = delayed or fixed[row, F_DEAD] > 0.0
            late = late or fixed[row, F_LATE] > 0.0
            longest = max(longest, fixed[row, F_LATE])
            for body in range(3):
                presliding = presliding or fixed[row, F_BRISTLES + 3 * body] > 0.0
                ageing = ageing or fixed[row, F_RENEW + body] > 0.0
    for row in range(p + 2):
        varying = varying or bases[row, 9] != 0.0
    for j in range(p + 1):
        changed_numbers(s, j, bases[0], bases[1 + j], h)
        s[D_MOB3 + j] = fixed[1 + j, F_MOB3] - fixed[0, F_MOB3]
        s[D_G0 + j] = s[D_G1 + j] = UNKNOWN
        s[D_A0 + j] = aged(0.0, v0, half, fixed[1 + j, F_RENEW]) - age0
        s[D_A1 + j] = aged(0.0, v1, half, fixed[1 + j, F_RENEW + 1]) - age1
        s[D_A2 + j] = aged(0.0, v2, half, fixed[1 + j, F_RENEW + 2]) - age2
    has_drive, has_motor, has_mesh, has_friction, has_load, has_sensor = active_sites(on)
    volts, altered = delayed or has_drive or lagging, has_mesh or varying
    acting = Acting(
        *(volts, delayed, has_drive, lagging, has_motor, has_mesh, altered),
        *(has_friction, ageing, has_load, elastic, presliding),
        *(used(s, D_K, D_MOB3), used(s, D_LAW, D_S0)),
    )
    levelled = has_friction or ageing
    hidden = lagging or elastic or presliding or ageing
    base = bases[0]
    n1, n2 = base[5], base[6]
    gain = n1 * (base[0] * base[1])
    mobility_3, mobility_l = fixed[0, F_MOB3], fixed[0, F_MOBL]
    stiff, damping, ease = fixed[0, F_STIFF], fixed[0, F_DAMP], fixed[0, F_EASE]
    margin = MARGIN * base[8] * max(base[13], base[14], 0.0)
    reducer, bearing = law_of(bases, 0, 15), law_of(bases, 0, 24)
    bristles0, bristles1 = bristles_in(fixed, 0, 0), bristles_in(fixed, 0, 1)
    bristles2 = bristles_in(fixed, 0, 2)
    mesh0 = mesh_of(q0, v0, q2, v2, 0, False, bases, on, values, 0)[2]
    mesh1 = mesh_of(q1, v1, q2, v2, 1, False, bases, on, values, 0)[2]
    d0, d1, d2 = 0.0, 0.0, 0.0
    a0, a1, w0, w1, b0, b1 = q0, q1, v0, v1, 0.0, 0.0  # motors, seen at the pinion
    e0, e1, kept0, kept1 = 0.0, 0.0, 0.0, 0.0  # lagged voltages, before and after the step
    g0, g1, g2 = 0.0, 0.0, 0.0  # presliding frictions
    pull0, pull1, pushed = 0.0, 0.0, 0.0
    region0, region1 = UNKNOWN, UNKNOWN
    m0 = m1 = k0 = k1 = NO_SLOPES
    shift0 = shift1 = rate0 = rate1 = 0.0
    level0, level1, level2, added0, added1, added2 = 1.0, 1.0, 1.0, 0.0, 0.0, 0.0
    way0, way1, way2 = 1.0, 1.0, 1.0  # directions that the bodies move in, or last moved in
    p0, p1, p2 = one_way(way0, reducer), one_way(way1, reducer), one_way(way2, bearing)
    laws_along(s, way0, way1, way2)
    history = np.full((int(longest) + 2, p + 2), v2)
    width = p  # changes that go along; one more once the other way is another one
    split = n
    apart = True  # whether some change is, or may be, on another branch than the run
    top = 0.0  # largest speed so far
    step = 0
    for i in range(n):
        t = i * dt
        for j in range(-1, width):
            row = 1 + j
            dq0, dq1, dq2, dv0, dv1, dv2, da0, da1 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if j >= 0:
                dq0, dq1, dq2 = s[DQ0 + j], s[DQ1 + j], s[DQ2 + j]
                dv0, dv1, dv2 = s[DV0 + j], s[DV1 + j], s[DV2 + j]
                da0, da1 = (s[D_M0 + j], s[D_M1 + j]) if elastic else (dq0, dq1)
            angle, speed = q2 + dq2, v2 + dv2
            if late:
                back_by = int(fixed[row, F_LATE])
                newer = history[(step - back_by) % history.shape[0], row]
                older = history[(step - back_by - 1) % history.shape[0], row]
                speed = newer + (fixed[row, F_LATE] - back_by) * (older - newer)
            if has_sensor:
                angle, speed = sensor_reading_of(angle, speed, t, on, values, row)
            place = (q0 + dq0, v0 + dv0, q2 + dq2, v2 + dv2)
            shift, rate, mesh = mesh_of(*place, 0, has_mesh, bases, on, values, row)
            z, z_rate = q0 - n2 * q2 + (dq0 - n2 * dq2), v0 - n2 * v2 + (dv0 - n2 * dv2)
            torque0 = mesh_torque(z + shift, z_rate + rate, mesh)
            place = (q1 + dq1, v1 + dv1, q2 + dq2, v2 + dv2)
            shift, rate, mesh = mesh_of(*place, 1, has_mesh, bases, on, values, row)
            y, y_rate = q1 - n2 * q2 + (dq1 - n2 * dq2), v1 - n2 * v2 + (dv1 - n2 * dv2)
            torque1 = mesh_torque(y + shift, y_rate + rate, mesh)
            if j < 0:
                out[0, i], out[1, i], out[2, i], out[3, i] = angle, speed, n1 * a0, n1 * a1
                out[4, i], out[5, i], out[6, i], out[7, i] = torque0, torque1, z, y
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
            given0, given1 = left[i], right[i]
            if delayed:
                start = i + k / substeps - fixed[0, F_DEAD]
                given0 = held_average(left, i + 1, start, start + 1.0 / substeps)
                given1 = held_average(right, i + 1, start, start + 1.0 / substeps)
            if acting.volts:
                u0, kept0 = voltage_of(given0, e0, middle, 0, h, has_drive, lagging, on, values, 0)
                u1, kept1 = voltage_of(given1, e1, middle, 1, h, has_drive, lagging, on, values, 0)
            x_0, x_1, x_2 = q0 + half * v0, q1 + half * v1, q2 + half * v2
            s0, s1, s2 = v0 + 0.5 * d0, v1 + 0.5 * d1, v2 + 0.5 * d2
            y0, y1, r0, r1 = x_0, x_1, s0, s1
            if elastic:
                y0, y1, r0, r1 = a0 + half * w0, a1 + half * w1, w0 + 0.5 * b0, w1 + 0.5 * b1
            if acting.altered:
                shift0, rate0, mesh0 = mesh_of(x_0, s0, x_2, s2, 0, has_mesh, bases, on, values, 0)
                shift1, rate1, mesh1 = mesh_of(x_1, s1, x_2, s2, 1, has_mesh, bases, on, values, 0)
                m0, m1 = mesh_slopes(region0, mesh0), mesh_slopes(region1, mesh1)
            z, z_rate = x_0 - n2 * x_2 + shift0, s0 - n2 * s2 + rate0
            y, y_rate = x_1 - n2 * x_2 + shift1, s1 - n2 * s2 + rate1
            torque0 = region_torque(z, z_rate, region0, mesh0)
            torque1 = region_torque(y, y_rate, region1, mesh1)
            look = (
                apart
                or not stays(z, z_rate, torque0, region0, mesh0, margin)
                or not stays(y, y_rate, torque1, region1, mesh1, margin)
            )
            before0, before1 = region0, region1
            if look:
                torque0, region0 = mesh_step(z, z_rate, mesh0, region0, h)
                torque1, region1 = mesh_step(y, y_rate, mesh1, region1, h)
                m0, m1 = mesh_slopes(region0, mesh0), mesh_slopes(region1, mesh1)
            elif acting.altered or acting.numbers:
                k0 = law_slopes(z, z_rate, region0, mesh0)
                k1 = law_slopes(y, y_rate, region1, mesh1)
            drive0, drive1 = gain * u0, gain * u1
            if has_motor:
                pull0 = motor_torque_of(u0, n1 * y0, n1 * r0, middle, 0, on, values, 0)
                pull1 = motor_torque_of(u1, n1 * y1, n1 * r1, middle, 1, on, values, 0)
                drive0, drive1 = drive0 + n1 * pull0, drive1 + n1 * pull1
            net0, net1 = 0.0, 0.0
            if elastic:
                net0, net1 = drive0, drive1
                drive0 = stiff * (y0 - x_0) + damping * (r0 - s0)
                drive1 = stiff * (y1 - x_1) + damping * (r1 - s1)
                net0, net1 = net0 - drive0, net1 - drive1
                b0, b1 = ease * net0, ease * net1
                w0, w1 = w0 + b0, w1 + b1
                a0, a1 = y0 + half * w0, y1 + half * w1
            force0, force1, force2 = drive0 - torque0, drive1 - torque1, n2 * (torque0 + torque1)
            if has_load:
                pushed = load_torque_of(x_2, s2, middle, on, values, 0)
                force2 += pushed
            if levelled:
                level0, added0 = level_of(
                    *(x_0, s0, middle, torque0, age0, 0, has_friction, ageing, on, values, 0)
                )
                level1, added1 = level_of(
                    *(x_1, s1, middle, torque1, age1, 1, has_friction, ageing, on, values, 0)
                )
                carried = abs(torque0) + abs(torque1)
                level2, added2 = level_of(
                    *(x_2, s2, middle, carried, age2, 2, has_friction, ageing, on, values, 0)
                )
            if v0 * way0 < 0.0 or v1 * way1 < 0.0 or v2 * way2 < 0.0:
                way0, way1, way2 = one_of(v0), one_of(v1), one_of(v2)
                p0, p1, p2 = one_way(way0, reducer), one_way(way1, reducer), one_way(way2, bearing)
                laws_along(s, way0, way1, way2)
            after0, after1, after2 = 0.0, 0.0, 0.0
            new0, sure0, f0 = 0.0, True, RESTING
            new1, sure1, f1 = 0.0, True, RESTING
            new2, sure2, f2 = 0.0, True, RESTING
            if presliding and bristles0[0] > 0.0:
                new0, after0 = preslide(
                    *(v0, s0, force0, mobility_3, h, reducer, level0, added0, bristles0, g0)
                )
            else:
                new0, sure0, f0 = smooth_body(
                    v0, s0, force0, mobility_3, reducer, p0, level0, added0
                )
            if presliding and bristles1[0] > 0.0:
                new1, after1 = preslide(
                    *(v1, s1, force1, mobility_3, h, reducer, level1, added1, bristles1, g1)
                )
            else:
                new1, sure1, f1 = smooth_body(
                    v1, s1, force1, mobility_3, reducer, p1, level1, added1
                )
            if presliding and bristles2[0] > 0.0:
                new2, after2 = preslide(
                    *(v2, s2, force2, mobility_l, h, bearing, level2, added2, bristles2, g2)
                )
            else:
                new2, sure2, f2 = smooth_body(
                    v2, s2, force2, mobility_l, bearing, p2, level2, added2
                )
            look_at = look or not (sure0 and sure1 and sure2)
            if look_at:
                if not presliding or bristles0[0] <= 0.0:
                    new0 = slide_or_stick(v0, s0, force0, mobility_3, reducer, level0, added0)
                if not presliding or bristles1[0] <= 0.0:
                    new1 = slide_or_stick(v1, s1, force1, mobility_3, reducer, level1, added1)
                if not presliding or bristles2[0] <= 0.0:
                    new2 = slide_or_stick(v2, s2, force2, mobility_l, bearing, level2, added2)
            aged0, aged1, aged2 = 0.0, 0.0, 0.0
            if ageing:
                aged0, aged1 = aged(age0, new0, h, renew0), aged(age1, new1, h, renew1)
                aged2 = aged(age2, new2, h, renew2)

            probe = width == p and (look_at or (k == 0 and (volts or i % PROBED == 0)))
            if probe:
                grow(s, DQ0, MOTION, p)
                if hidden:
                    grow(s, D_M0, HIDDEN, p)
                s[D_G0 + p], s[D_G1 + p] = before0, before1
            body0 = Body(v0, s0, force0, new0, f0, level0, added0, g0, after0, age0, aged0)
            body1 = Body(v1, s1, force1, new1, f1, level1, added1, g1, after1, age1, aged1)
            body2 = Body(v2, s2, force2, new2, f2, level2, added2, g2, after2, age2, aged2)
            left_mesh = Mesh(z, z_rate, shift0, rate0, mesh0, torque0, m0, k0)
            right_mesh = Mesh(y, y_rate, shift1, rate1, mesh1, torque1, m1, k1)
            motor0 = Motor(given0, u0, e0, kept0, y0, r0, pull0, net0)
            motor1 = Motor(given1, u1, e1, kept1, y1, r1, pull1, net1)
            if look_at:
                apart = False
            for j in range(p + 1 if probe else width):
                row = 1 + j
                o0, o1, o2 = s[DV0 + j], s[DV1 + j], s[DV2 + j]
                i0, i1, i2 = s[DQ0 + j] + half * o0, s[DQ1 + j] + half * o1, s[DQ2 + j] + half * o2
                c0, c1, c2 = o0 + 0.5 * s[DC0 + j], o1 + 0.5 * s[DC1 + j], o2 + 0.5 * s[DC2 + j]
                place = (x_0 + i0, s0 + c0, x_2 + i2, s2 + c2)
                t0 = mesh_along(
                    *(s, j, 0, left_mesh, i0 - n2 * i2, c0 - n2 * c2, place, look, h),
                    *(acting, bases, on, values),
                )
                place = (x_1 + i1, s1 + c1, x_2 + i2, s2 + c2)
                t1 = mesh_along(
                    *(s, j, 1, right_mesh, i1 - n2 * i2, c1 - n2 * c2, place, look, h),
                    *(acting, bases, on, values),
                )
                begin0, begin1 = given0, given1
                if delayed and fixed[row, F_DEAD] != fixed[0, F_DEAD]:
                    start = i + k / substeps - fixed[row, F_DEAD]
                    begin0 = held_average(left, i + 1, start, start + 1.0 / substeps)
                    begin1 = held_average(right, i + 1, start, start + 1.0 / substeps)
                n_0, n_1, l_0, l_1 = i0, i1, c0, c1
                if elastic:
                    n_0, l_0 = s[D_M0 + j] + half * s[D_O0 + j], s[D_O0 + j] + 0.5 * s[D_P0 + j]
                    n_1, l_1 = s[D_M1 + j] + half * s[D_O1 + j], s[D_O1 + j] + 0.5 * s[D_P1 + j]
                h0 = motor_along(
                    *(s, j, 0, motor0, n_0, l_0, begin0, middle, h, n1, gain, acting, on, values)
                )
                h1 = motor_along(
                    *(s, j, 1, motor1, n_1, l_1, begin1, middle, h, n1, gain, acting, on, values)
                )
                if elastic:
                    twist = (y0 - x_0, r0 - s0)
                    rows = (D_M0, D_O0, D_P0)
                    h0 = shaft_along(s, j, motor0, twist, n_0, l_0, i0, c0, h0, h, rows, fixed)
                    twist = (y1 - x_1, r1 - s1)
                    rows = (D_M1, D_O1, D_P1)
                    h1 = shaft_along(s, j, motor1, twist, n_1, l_1, i1, c1, h1, h, rows, fixed)
                h2 = n2 * (t0 + t1)
                if has_load:
                    h2 += load_torque_of(x_2 + i2, s2 + c2, middle, on, values, row) - pushed
                place0, place1, place2 = (level0, added0), (level1, added1), (level2, added2)
                if levelled:
                    load0, load1 = torque0 + t0, torque1 + t1
                    place0 = level_of(
                        *(x_0 + i0, s0 + c0, middle, load0, age0 + s[D_A0 + j], 0),
                        *(has_friction, ageing, on, values, row),
                    )
                    place1 = level_of(
                        *(x_1 + i1, s1 + c1, middle, load1, age1 + s[D_A1 + j], 1),
                        *(has_friction, ageing, on, values, row),
                    )
                    place2 = level_of(
                        *(x_2 + i2, s2 + c2, middle, abs(load0) + abs(load1)),
                        *(age2 + s[D_A2 + j], 2, has_friction, ageing, on, values, row),
                    )
                own0, own1, own2 = 0.0, 0.0, 0.0
                if acting.laws and not look_at:
                    own0 = law_own(f0, s[D_S0 + j], s[D_T0 + j], s[D_W0 + j], s[D_B0 + j])
                    own1 = law_own(f1, s[D_S1 + j], s[D_T1 + j], s[D_W1 + j], s[D_B1 + j])
                    own2 = law_own(f2, s[D_S2 + j], s[D_T2 + j], s[D_W2 + j], s[D_B2 + j])
                rows = (D_MOB3, D_R0, D_A0)
                o0 = body_along(
                    *(s, j, 0, o0, c0, h0 - t0, own0, place0, look_at, h, acting, body0, rows),
                    *(bases, fixed),
                )
                rows = (D_MOB3, D_R1, D_A1)
                o1 = body_along(
                    *(s, j, 1, o1, c1, h1 - t1, own1, place1, look_at, h, acting, body1, rows),
                    *(bases, fixed),
                )
                rows = (D_MOBL, D_R2, D_A2)
                o2 = body_along(
                    *(s, j, 2, o2, c2, h2, own2, place2, look_at, h, acting, body2, rows),
                    *(bases, fixed),
                )
                s[DC0 + j], s[DC1 + j], s[DC2 + j] = (
                    o0 - s[DV0 + j],
                    o1 - s[DV1 + j],
                    o2 - s[DV2 + j],
                )
                s[DV0 + j], s[DV1 + j], s[DV2 + j] = o0, o1, o2
                s[DQ0 + j], s[DQ1 + j], s[DQ2 + j] = i0 + half * o0, i1 + half * o1, i2 + half * o2
                if look_at:
                    apart = apart or s[D_G0 + j] != region0 or s[D_G1 + j] != region1
                    apart = apart or (new0 + o0 == 0.0) != (new0 == 0.0)
                    apart = apart or (new1 + o1 == 0.0) != (new1 == 0.0)
                    apart = apart or (new2 + o2 == 0.0) != (new2 == 0.0)
            d0, d1, d2 = new0 - v0, new1 - v1, new2 - v2
            v0, v1, v2 = new0, new1, new2
            q0, q1, q2 = x_0 + half * v0, x_1 + half * v1, x_2 + half * v2
            if not elastic:
                a0, a1 = q0, q1
            e0, e1, g0, g1, g2 = kept0, kept1, after0, after1, after2
            age0, age1, age2 = aged0, aged1, aged2
            step += 1
            if late:
                for j in range(-1, p + 1):
                    history[step % history.shape[0], 1 + j] = v2 + (s[DV2 + j] if j >= 0 else 0.0)
            top = max(top, abs(v0), abs(v1), abs(v2))
            if probe:
                reach = max(abs(q0), abs(q1), abs(q2))
                same = same_both_ways(s, DQ0, 3, p, reach) and same_both_ways(s, DV0, 6, p, top)
                if not same:
                    width = p + 1
                    split = i + 1
    return split
