"""The time-stepping loop of `core.py` over several drives at once; no physics of its own.

The same scheme stage by stage (`lane_stages_core`). Branches on what acts at all are outside the
loops over lanes and the same for all; lanes without an effect that others have evaluate it at its
neutral parameters.
"""

import numpy as np
from numba import njit

from dmptm_ctrl.effects.stribeck import stribeck_law
from dmptm_ctrl.simulate.control_core import M_LEFT, M_RIGHT, MEMORY, command
from dmptm_ctrl.simulate.core import MIN_COMPLIANCE, UNKNOWN, aged, bristles_of, held_average
from dmptm_ctrl.simulate.elementary import wide
from dmptm_ctrl.simulate.lane_sites import (  # chains
    sensor_lanes,
)
from dmptm_ctrl.simulate.lane_stages_core import (
    A0,
    A1,
    ADDED,
    AGE,
    AT_ONCE,
    B0,
    BIAS0,
    BIAS1,
    BRISTLE_LAG,
    C0,
    COLUMNS,
    COMPLIANCE,
    D0,
    DEAD,
    DELTA,
    DF0,
    DISTANCE,
    DZ0,
    DZ1,
    E0,
    E1,
    G0,
    GAIN,
    GAP0,
    H0,
    INTEGRAL,
    J_MOTOR,
    K0,
    K_A,
    KI,
    KP,
    LANES,
    LATE,
    LAW,
    LEAD,
    LIMIT,
    M0,
    M1,
    MOBILITY,
    MS0,
    MS1,
    N1,
    N2,
    NOTHING,
    OUT,
    P0,
    P1,
    Q0,
    Q1,
    Q2,
    R0,
    R1,
    RENEW,
    S0,
    S1,
    S2,
    SCALE,
    SEEN,
    SHAFT,
    TORQUE_L,
    TORQUE_R,
    U0,
    U1,
    V0,
    V1,
    V2,
    VALUES,
    W0,
    W1,
    X0,
    X1,
    X2,
    Y0,
    Y1,
    ageing_stage,
    alter_meshes,
    drive_stage,
    finish,
    general_presliding_stage,
    general_slide_stage,
    grow_older,
    lag_stage,
    law,
    levels,
    load_stage,
    mesh_stage,
    motor_stage,
    motors_to_middle,
    net_torques,
    odd_meshes,
    presliding_stage,
    read_meshes,
    rigid,
    shaft_stage,
    shift_mesh,
    slide_stage,
    stop_stage,
    to_middle,
    twist,
)
from dmptm_ctrl.simulate.sites import (  # chains
    active_sites,
    aged_friction,
    lag_relaxation,
    presliding_law,
    shaft_compliance,
    speed_delay,
    voltage_delay,
)


@njit
def law_of(bases, row, first):
    """Friction law from a row of drives' numbers."""
    k, r = first, bases
    return stribeck_law(
        r[row, k], r[row, k + 1], r[row, k + 2], r[row, k + 3], r[row, k + 4], r[row, k + 5],
        r[row, k + 6], r[row, k + 7], r[row, k + 8],
    )  # fmt: skip


@njit
def fill(s, lane, x0, loop, h, dt, bases, drive, on, values):
    """Put one drive into a lane: its numbers, its start, what follows from both."""
    base = bases[drive]
    for k in range(values.size):
        s[VALUES + k * LANES + lane] = values[k]
    for k in range(5):
        s[KP + k * LANES + lane] = loop[k]
    for k in range(6):
        s[Q0 + k * LANES + lane] = x0[k]
        s[N1 + k * LANES + lane] = base[5 + k]
    s[M0 + lane], s[M1 + lane], s[W0 + lane], s[W1 + lane] = x0[0], x0[1], x0[3], x0[4]
    s[GAIN + lane] = base[5] * (base[0] * base[1])
    j_motor = base[5] * base[5] * base[2]
    compliance, damping = shaft_compliance(j_motor * base[3] / (j_motor + base[3]), on, values)
    elastic = compliance > MIN_COMPLIANCE
    s[COMPLIANCE + lane], s[SHAFT + lane] = compliance if elastic else 0.0, damping
    s[J_MOTOR + lane] = j_motor
    s[DEAD + lane] = voltage_delay(on, values) / dt
    s[LATE + lane] = speed_delay(on, values) / h
    s[R1 + lane] = lag_relaxation(0.0, 0, on, values)[1]
    for side in range(2):
        row = side * LANES + lane
        s[G0 + row] = UNKNOWN
        s[D0 + row], s[DF0 + row] = base[11], base[12]
        s[GAP0 + row] = base[13 + side]
        s[K0 + row], s[H0 + row] = base[8], max(base[13 + side], 0.0)
    for body in range(3):
        row = body * LANES + lane
        s[SCALE + row] = 1.0
        s[RENEW + row] = aged_friction(0.0, body, on, values)[1]
        s[AGE + row] = aged(0.0, x0[3 + body], 0.5 * h, s[RENEW + row])
        s[MOBILITY + row] = h / (
            base[4] if body == 2 else base[3] if elastic else base[3] + j_motor
        )
        own = law_of(bases, drive, 24 if body == 2 else 15)
        for k in range(11):
            s[LAW + 3 * k * LANES + row] = own[k]
        s[DISTANCE + row], s[AT_ONCE + row], s[BRISTLE_LAG + row] = bristles_of(
            presliding_law(body, on, values), s[MOBILITY + row], h, law(s, row, 1.0)
        )


@njit
def largest(s, width, row):
    """Largest of a row."""
    most = s[row]
    for lane in range(width):
        most = max(most, s[row + lane])
    return most


@njit
def read(s, width, t, has_sensor, on):
    """Outputs of the sample into the rows of OUT, but for the meshes' torques."""
    wide()
    for lane in range(width):
        s[A0 + lane] = s[Q2 + lane]
        s[A1 + lane] = s[SEEN + lane]
    if has_sensor:
        sensor_lanes(s, width, 0, t, on)
    for lane in range(width):
        s[OUT + lane] = s[A0 + lane]
        s[OUT + LANES + lane] = s[A1 + lane]
        s[OUT + 2 * LANES + lane] = s[N1 + lane] * s[M0 + lane]
        s[OUT + 3 * LANES + lane] = s[N1 + lane] * s[M1 + lane]
        s[OUT + 6 * LANES + lane] = s[Q0 + lane] - s[N2 + lane] * s[Q2 + lane]
        s[OUT + 7 * LANES + lane] = s[Q1 + lane] - s[N2 + lane] * s[Q2 + lane]


@njit
def control(s, width, dt):
    """PI loop at the sample: error in R0, voltages into U0, U1."""
    for lane in range(width):
        s[INTEGRAL + lane] += s[R0 + lane] * dt
        common = s[KP + lane] * s[R0 + lane] + s[KI + lane] * s[INTEGRAL + lane]
        common = max(min(common, s[LIMIT + lane]), -s[LIMIT + lane])
        s[U0 + lane] = common + s[BIAS0 + lane]
        s[U1 + lane] = common + s[BIAS1 + lane]


@njit
def correct(s, width, angle_gain, speed_gain):
    """Feed the miss in R0 back to the rigid mode; a body at rest keeps its speed."""
    for lane in range(width):
        miss = s[R0 + lane]
        turn = angle_gain * miss
        s[LEAD + lane] = (1.0 - angle_gain) * miss
        s[Q2 + lane] += turn
        turn *= s[N2 + lane]
        s[Q0 + lane] += turn
        s[Q1 + lane] += turn
        s[M0 + lane] += turn
        s[M1 + lane] += turn
        push = speed_gain * miss if s[V2 + lane] != 0.0 else 0.0
        s[V2 + lane] += push
        push *= s[N2 + lane]
        push0 = push if s[V0 + lane] != 0.0 else 0.0
        push1 = push if s[V1 + lane] != 0.0 else 0.0
        s[V0 + lane] += push0
        s[W0 + lane] += push0
        s[V1 + lane] += push1
        s[W1 + lane] += push1


@njit
def let_go(s, width, finer):
    """Go on in steps of another length, `finer` times as long as the last."""
    wide()
    for row in range(3 * width):
        s[C0 + row] *= finer
        s[MOBILITY + row] *= finer
    for row in range(2 * width):
        s[B0 + row] *= finer


@njit
def summarise(s, width, stats):
    """Least, greatest, sum and sum of squares of each output so far."""
    for k in range(COLUMNS):
        for lane in range(width):
            value = s[OUT + k * LANES + lane]
            stats[0, k, lane] = min(stats[0, k, lane], value)
            stats[1, k, lane] = max(stats[1, k, lane], value)
            stats[2, k, lane] += value
            stats[3, k, lane] += value * value


@njit
def march_lanes(
    u, target, measured, pick, laws, design, observer, extra, begin, dt, substeps, on, s, columns,
    every, out, stats
):  # fmt: skip
    """Run LANES drives over all samples.

    u (k, 2, n), or (0, 2, n) under the loop; target (k, n) or (0, 0); measured (k, n), for
    the observer also shorter, or (0, 0);
    pick (3, LANES) the rows of these that each lane takes; laws (LANES, SIZE) or (0, 0) the
    controllers of `control_core` with the arrays of their model in design; observer (angle
    gain, speed gain, steps per sample while it leads); extra (n, 3) or (0, 3); begin the time of
    the first sample; on (effects,), where any lane has it; s as from `fill`; out (up to LANES,
    columns.size, samples kept), every `every`-th sample; stats
    (4, COLUMNS, LANES).
    """
    n = u.shape[2]
    led = measured.shape[1] if observer[0] > 0.0 else 0
    steps = int(observer[2]) if led > 0 else substeps
    h = dt / steps
    width = (
        pick.shape[1] // LANES * LANES
    )  # of the loops; not a constant, or short ones are unrolled
    closed = u.shape[0] == 0
    has_drive, has_motor, has_mesh, has_friction, has_load, has_sensor = active_sites(on)
    lagging = largest(s, width, R1) > 0.0
    delayed = largest(s, width, DEAD) > 0.0
    late = largest(s, width, LATE) > 0.0
    elastic = largest(s, width, COMPLIANCE) > 0.0
    presliding = largest(s, 3 * width, DISTANCE) > 0.0
    ageing = largest(s, 3 * width, RENEW) > 0.0
    varying, general, sliding = False, False, False
    for lane in range(width):
        varying = varying or s[K_A + lane] != 0.0
    for row in range(3 * width):
        general = general or s[DELTA + row] != 1.0
        sliding = sliding or s[DISTANCE + row] <= 0.0
    torques = stats.size > 0  # whether those of the meshes are wanted at the samples
    for k in range(columns.size):
        torques = torques or columns[k] == TORQUE_L or columns[k] == TORQUE_R
    past = np.zeros((2, LANES, int(largest(s, width, DEAD)) + 3))  # voltages at the last samples
    history = np.empty((int(largest(s, width, LATE)) + 2, LANES))  # speeds at the last steps
    for lane in range(width):
        history[:, lane] = s[V2 + lane]
    held = np.empty((2, LANES))
    memory = np.zeros((LANES, MEMORY))
    step = 0
    kept = 0
    for i in range(n):
        t = begin + i * dt
        if i == led and steps != substeps:
            let_go(s, width, steps / substeps)
            steps = substeps
            h = dt / steps
        for lane in range(width):
            s[SEEN + lane] = s[V2 + lane]
        if late:
            for lane in range(width):
                back = int(s[LATE + lane])
                newer = history[(step - back) % history.shape[0], lane]
                older = history[(step - back - 1) % history.shape[0], lane]
                s[SEEN + lane] = newer + (s[LATE + lane] - back) * (older - newer)
        read(s, width, t, has_sensor, on)
        if torques:
            if has_mesh:
                shift_mesh(s, width, Q0, V0, Q2, V2, NOTHING, DZ0, 0, on)
                shift_mesh(s, width, Q1, V1, Q2, V2, NOTHING, DZ1, 1, on)
            if has_mesh or varying:
                alter_meshes(s, width, Q0, varying)
            twist(s, width, Q0, V0)
            read_meshes(s, width)
        if laws.shape[0] > 0:
            for lane in range(width):
                speed = s[OUT + LANES + lane] + measured[pick[2, lane], i]
                command(
                    *(target[pick[1, lane], i], s[OUT + lane], speed),
                    *(s[OUT + 2 * LANES + lane], s[OUT + 3 * LANES + lane]),
                    *(t, dt, laws[lane], memory[lane], design),
                )
                s[U0 + lane], s[U1 + lane] = memory[lane, M_LEFT], memory[lane, M_RIGHT]
        elif closed:
            for lane in range(width):
                seen = s[OUT + LANES + lane] + measured[pick[2, lane], i]
                s[R0 + lane] = target[pick[1, lane], i] - seen
            control(s, width, dt)
        else:
            for lane in range(width):
                s[U0 + lane] = u[pick[0, lane], 0, i]
                s[U1 + lane] = u[pick[0, lane], 1, i]
            if i < led:
                for lane in range(width):
                    s[R0 + lane] = measured[pick[2, lane], i] - s[OUT + lane]
                correct(s, width, observer[0], observer[1])
        for lane in range(width):
            s[OUT + 8 * LANES + lane] = s[U0 + lane]
            s[OUT + 9 * LANES + lane] = s[U1 + lane]
            held[0, lane], held[1, lane] = s[U0 + lane], s[U1 + lane]
        if delayed:
            for lane in range(width):
                past[0, lane, i % past.shape[2]] = s[U0 + lane]
                past[1, lane, i % past.shape[2]] = s[U1 + lane]
        if stats.size > 0:
            summarise(s, width, stats)
        if columns.size > 0 and i % every == 0:
            for k in range(columns.size):
                for lane in range(out.shape[0]):  # lanes that only fill up have no row
                    out[lane, k, kept] = s[OUT + columns[k] * LANES + lane]
            kept += 1
        push0, push1, push2 = 0.0, 0.0, 0.0
        if extra.shape[0] > 0:
            push0, push1, push2 = extra[i, 0], extra[i, 1], extra[i, 2]

        for k in range(steps):
            middle = t + (k + 0.5) * h
            if delayed or has_drive or lagging:
                for lane in range(width):
                    s[U0 + lane], s[U1 + lane] = held[0, lane], held[1, lane]
            if delayed:
                for lane in range(width):
                    start = i + k / steps - s[DEAD + lane]
                    end = start + 1.0 / steps
                    s[U0 + lane] = held_average(past[0, lane], i + 1, start, end)
                    s[U1 + lane] = held_average(past[1, lane], i + 1, start, end)
            if has_drive:
                drive_stage(s, width, 0, middle, on)
                drive_stage(s, width, 1, middle, on)
            if lagging:
                lag_stage(s, width, U0, E0, 0, h, on)
                lag_stage(s, width, U1, E1, 1, h, on)
            to_middle(s, width, h)
            if has_mesh:
                shift_mesh(s, width, X0, S0, X2, S2, LEAD, DZ0, 0, on)
                shift_mesh(s, width, X1, S1, X2, S2, LEAD, DZ1, 1, on)
            if has_mesh or varying:
                alter_meshes(s, width, X0, varying)
            twist(s, width, X0, S0)
            odd = mesh_stage(s, width)
            if odd > 0:
                odd_meshes(s, width, h)
            net_torques(s, width, push0, push1, push2)
            if elastic:
                motors_to_middle(s, width, h)
                if has_motor:
                    motor_stage(s, width, Y0, MS0, P0, 0, middle, on)
                    motor_stage(s, width, Y1, MS1, P1, 1, middle, on)
                shaft_stage(s, width, 0, h, push0)
                shaft_stage(s, width, 1, h, push1)
            elif has_motor:
                motor_stage(s, width, X0, S0, P0, 0, middle, on)
                motor_stage(s, width, X1, S1, P1, 1, middle, on)
            if has_load:
                load_stage(s, width, middle, on)
            if has_friction:
                levels(s, width, middle, on)
            if ageing:
                if not has_friction:
                    for row in range(3 * width):
                        s[ADDED + row] = 0.0
                ageing_stage(s, width, middle, on)
            if sliding:
                stopping = general_slide_stage(s, width) if general else slide_stage(s, width)
                if stopping > 0:
                    stop_stage(s, width)
            if presliding and general:
                general_presliding_stage(s, width, h)
            elif presliding:
                presliding_stage(s, width, h)
            if ageing:
                grow_older(s, width, h)
            finish(s, width, h)
            if elastic:
                rigid(s, width, 0)
                rigid(s, width, 1)
            step += 1
            if late:
                for lane in range(width):
                    history[step % history.shape[0], lane] = s[V2 + lane]
        if not elastic:
            rigid(s, width, 0)
            rigid(s, width, 1)
    return step


@njit
def march_groups(
    u, target, measured, laws, design, observer, extra, begin, dt, substeps, base, on, values, x0,
    loops, s, columns, every, out, stats
):  # fmt: skip
    """Run any number of drives, LANES at a time; lanes left over repeat the last of them.

    base, on, values, x0 (6,), loops (5,) of each drive in rows; laws (drives, SIZE) or (0, 0);
    u, target and measured of each drive, or one for all; s room for one group; out (drives,
    columns.size, samples kept); stats (4, COLUMNS, drives) or none; the rest as of
    `march_lanes`.
    """
    count = base.shape[0]
    leads = observer[0] > 0.0 and measured.shape[1] > 0
    h = dt / (observer[2] if leads else substeps)  # of the first step
    used = np.empty_like(on[0])
    pick = np.empty((3, LANES), np.int64)
    own = np.empty((LANES if laws.shape[0] > 0 else 0, laws.shape[1]))
    part = np.empty((4, COLUMNS, LANES) if stats.size > 0 else (0, 0, 0))
    for first in range(0, count, LANES):
        s[:] = 0.0
        used[:] = 0
        for lane in range(LANES):
            k = min(first + lane, count - 1)
            for effect in range(used.size):
                used[effect] |= on[k, effect]
            fill(s, lane, x0[k], loops[k], h, dt, base, k, on[k], values[k])
            pick[0, lane] = k if u.shape[0] > 1 else 0
            pick[1, lane] = k if target.shape[0] > 1 else 0
            pick[2, lane] = k if measured.shape[0] > 1 else 0
            for number in range(own.shape[1]):  # numba compiles the copy of a slice for seconds
                own[lane, number] = laws[k, number]
        if stats.size > 0:
            part[:] = 0.0
            part[0] = np.inf
            part[1] = -np.inf
        end = min(first + LANES, count)
        march_lanes(
            *(u, target, measured, pick, own, design, observer, extra, begin, dt, substeps),
            *(used, s, columns, every, out[first:end], part),
        )
        if stats.size > 0:
            for what in range(4):
                for column in range(COLUMNS):
                    for k in range(first, end):
                        stats[what, column, k] = part[what, column, k - first]
