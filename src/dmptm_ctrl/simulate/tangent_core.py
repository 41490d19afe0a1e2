"""The loop of `core.py` for a drive without effects, together with its derivatives.

What a change of a parameter changes in the run goes along step by step, to first order: each
step is linear in the state it starts from, for the branch that the run itself takes. Where
the run is about to take another branch (a flank is reached or left, a body stops or starts)
the step is taken anew for each change, with branches of its own. The slopes come from the
kernels, which are linear in their torques; no physics is written here.
"""

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import Backlash, mesh_region, mesh_torque, region_torque
from dmptm_ctrl.effects.stribeck import Stribeck, breakaway_torque, sliding_torque, stribeck_law
from dmptm_ctrl.simulate.core import (
    UNKNOWN,
    mesh_step,
    slide_or_stick,
)

CHANGES = 16  # side by side: fifteen parameters, and all of them the other way
# Of a torque, for a mesh of what its whole gap would take: nearer to another branch than this, a
# step is taken anew.
MARGIN = 1e-4
# Of a change, by which those of both ways may differ and count as the same; of the state
APART, ROUNDING = 1e-3, 1e-11

# Rows of the work array: changes of angles, speeds, last changes of the speeds;
DQ0, DQ1, DQ2, DV0, DV1, DV2, DC0, DC1, DC2 = range(0, 9 * CHANGES, CHANGES)
# of what the parameters enter by: motor gain, mesh, gaps, h/J;
D_GAIN, D_K, D_C, D_CF, D_GAP0, D_GAP1, D_MOB3, D_MOBL = range(9 * CHANGES, 17 * CHANGES, CHANGES)
# of the friction laws, four numbers each: reducer forward, backward, ring gear forward, backward;
D_LAW = 17 * CHANGES
# the same in the directions that the bodies move in: reducer left, right, ring gear;
D_S0, D_T0, D_W0, D_B0 = range(33 * CHANGES, 37 * CHANGES, CHANGES)
D_S1, D_T1, D_W1, D_B1 = range(37 * CHANGES, 41 * CHANGES, CHANGES)
D_S2, D_T2, D_W2, D_B2 = range(41 * CHANGES, 45 * CHANGES, CHANGES)
# regions of the meshes.
D_G0, D_G1 = 45 * CHANGES, 46 * CHANGES
SIZE_OF_CHANGES = 47 * CHANGES
NO_SLOPES = (0.0, 0.0, 0.0)
RESTING = (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # what `smooth_body` says of it


@njit
def law_at(base, first):
    """Friction law from the array of a drive's numbers."""
    return stribeck_law(
        base[first],
        base[first + 1],
        base[first + 2],
        base[first + 3],
        base[first + 4],
        base[first + 5],
        base[first + 6],
        base[first + 7],
        base[first + 8],
    )


@njit
def mesh_at(base, gap):
    """Mesh from the array of a drive's numbers."""
    return Backlash(base[8], base[11], base[12], max(base[gap], 0.0))


@njit
def changed_numbers(s, j, now, base, h):
    """Put into column j how a drive's numbers differ from those of the run."""
    s[D_GAIN + j] = base[5] * base[0] * base[1] - now[5] * now[0] * now[1]
    s[D_K + j], s[D_C + j], s[D_CF + j] = base[8] - now[8], base[11] - now[11], base[12] - now[12]
    s[D_GAP0 + j] = max(base[13], 0.0) - max(now[13], 0.0)
    s[D_GAP1 + j] = max(base[14], 0.0) - max(now[14], 0.0)
    s[D_MOB3 + j] = h / (base[3] + base[5] ** 2 * base[2]) - h / (now[3] + now[5] ** 2 * now[2])
    s[D_MOBL + j] = h / base[4] - h / now[4]
    for k in range(8):
        s[D_LAW + k * CHANGES + j] = base[15 + k] - now[15 + k]
        s[D_LAW + (8 + k) * CHANGES + j] = base[24 + k] - now[24 + k]


@njit
def whole_step(q0, q1, q2, v0, v1, v2, d0, d1, d2, region0, region1, u0, u1, h, base):
    """One step of a drive without effects: angles, speeds, changes of the speeds, regions."""
    n1, n2 = base[5], base[6]
    x_0, x_1, x_2 = q0 + 0.5 * h * v0, q1 + 0.5 * h * v1, q2 + 0.5 * h * v2
    s0, s1, s2 = v0 + 0.5 * d0, v1 + 0.5 * d1, v2 + 0.5 * d2
    mesh0, mesh1 = mesh_at(base, 13), mesh_at(base, 14)
    torque0, region0 = mesh_step(x_0 - n2 * x_2, s0 - n2 * s2, mesh0, region0, h)
    torque1, region1 = mesh_step(x_1 - n2 * x_2, s1 - n2 * s2, mesh1, region1, h)
    gain, mobility = n1 * (base[0] * base[1]), h / (base[3] + n1 * n1 * base[2])
    reducer, bearing = law_at(base, 15), law_at(base, 24)
    new0 = slide_or_stick(v0, s0, gain * u0 - torque0, mobility, reducer, 1.0, 0.0)
    new1 = slide_or_stick(v1, s1, gain * u1 - torque1, mobility, reducer, 1.0, 0.0)
    carried = n2 * (torque0 + torque1)
    new2 = slide_or_stick(v2, s2, carried, h / base[4], bearing, 1.0, 0.0)
    return (
        x_0 + 0.5 * h * new0,
        x_1 + 0.5 * h * new1,
        x_2 + 0.5 * h * new2,
        new0,
        new1,
        new2,
        new0 - v0,
        new1 - v1,
        new2 - v2,
        region0,
        region1,
    )


@njit
def stays(z, z_rate, torque, region, p, margin):
    """Whether a mesh is where it was in Eq. 21, and by a margin of torque not elsewhere."""
    if region == 0.0:
        side = 1.0 if z >= 0.0 else -1.0
        if side * region_torque(z, z_rate, side, p) < -margin:
            return True
        if side * z_rate <= 0.0:
            return False
        gap = p.half_gap - margin / p.stiffness
        smaller = Backlash(p.stiffness, p.damping, p.gap_damping, gap)
        return mesh_region(z, z_rate, smaller) == 0.0  # not there yet, though torque would push
    push = region * torque
    return push > margin and push - region * z_rate * (p.damping + p.gap_damping) >= margin


@njit
def mesh_slopes(region, p):
    """Slopes of a mesh's torque in a whole region: by z, its rate, half-gap."""
    zero = region_torque(0.0, 0.0, region, p)
    return (
        region_torque(1.0, 0.0, region, p) - zero,
        region_torque(0.0, 1.0, region, p) - zero,
        region_torque(0.0, 0.0, region, Backlash(p.stiffness, 0.0, 0.0, 1.0)),
    )


@njit
def law_slopes(z, z_rate, region, p):
    """Slopes of a mesh's torque: by stiffness, both dampings."""
    return (
        region_torque(z, z_rate, region, Backlash(1.0, 0.0, 0.0, p.half_gap)),
        region_torque(z, z_rate, region, Backlash(0.0, 1.0, 0.0, p.half_gap)),
        region_torque(z, z_rate, region, Backlash(0.0, 0.0, 1.0, p.half_gap)),
    )


@njit
def one_way(direction, law):
    """Numbers of a friction law in one direction: static, Coulomb, scale, viscous, steepness."""
    if direction > 0.0:
        static, coulomb = law.static_plus, law.coulomb_plus
        return static, coulomb, law.speed_plus, law.viscous_plus, law.steepness_plus
    static, coulomb = law.static_minus, law.coulomb_minus
    return static, coulomb, law.speed_minus, law.viscous_minus, law.steepness_minus


@njit
def smooth_body(v, v_mid, force, mobility, law, own, level, added):
    """Speed of a body after a step in which it goes on sliding or resting, if that is sure.

    `own` holds the numbers of its law in the direction that it moves in, kept from step to step:
    a body seldom turns; friction is `level` times the law, and `added`. Then 0 if it rests, else 1;
    its direction, net torque; slopes of its friction: by speed, static, Coulomb, Stribeck speed,
    viscous, level.
    """
    if v == 0.0:
        hold = level * breakaway_torque(one_of(force), law) + added
        sure = abs(force) < (1.0 - MARGIN) * hold
        return 0.0, sure, RESTING
    direction = one_of(v)
    static, coulomb, scale, viscous, steepness = own
    both = (static, coulomb, scale, viscous)
    p = Stribeck(*both, *both, 1.0, steepness, steepness)
    declared = sliding_torque(v_mid, direction, p)
    friction = level * declared + added
    new = v + force * mobility - friction * (direction * mobility)
    # not within a step of stopping; a law that drives is not smooth at zero
    sure = new * direction > abs(new - v) and friction > 0.0
    # linear in its torques: what is left of the static one at this speed
    one = (1.0, 0.0, scale, 0.0)
    unit = Stribeck(*one, *one, 1.0, steepness, steepness)
    decay = sliding_torque(v_mid, direction, unit)
    speed = max(v_mid * direction, 0.0)
    falls = (static - coulomb) * decay * steepness
    slope = viscous - falls if speed > 0.0 else 0.0
    by_scale = falls * speed * steepness
    slopes = (level * slope, level * decay, level * (1.0 - decay), level * by_scale)
    net = force - direction * friction
    return new, sure, (1.0, direction, net, *slopes, level * speed, declared)


@njit
def laws_along(s, way0, way1, way2):
    """Put changes of laws in the directions that bodies move in where a vector loop finds them."""
    first = D_LAW if way0 > 0.0 else D_LAW + 4 * CHANGES
    second = D_LAW if way1 > 0.0 else D_LAW + 4 * CHANGES
    third = D_LAW + 8 * CHANGES if way2 > 0.0 else D_LAW + 12 * CHANGES
    for k in range(4 * CHANGES):
        s[D_S0 + k], s[D_S1 + k], s[D_S2 + k] = s[first + k], s[second + k], s[third + k]


@njit
def one_of(v):
    """Direction of a speed."""
    return 1.0 if v > 0.0 else -1.0


@njit
def used(s, start, stop):
    """Whether any of some rows has a value."""
    most = 0.0
    for k in range(start, stop):
        most = max(most, abs(s[k]))
    return most > 0.0


@njit
def change_along(
    s, j, h, n2, volts, mobilities, m0, m1, k0, k1, f0, f1, f2, drives, meshes, masses, laws
):  # fmt: skip
    """Take one change a step further, by slopes m, k of the meshes and f of the bodies."""
    w0, w1, w2 = s[DV0 + j], s[DV1 + j], s[DV2 + j]
    a0, a1, a2 = s[DQ0 + j] + 0.5 * h * w0, s[DQ1 + j] + 0.5 * h * w1, s[DQ2 + j] + 0.5 * h * w2
    c0, c1, c2 = w0 + 0.5 * s[DC0 + j], w1 + 0.5 * s[DC1 + j], w2 + 0.5 * s[DC2 + j]
    t0 = mesh_change(m0, a0 - n2 * a2, c0 - n2 * c2)
    t1 = mesh_change(m1, a1 - n2 * a2, c1 - n2 * c2)
    if meshes:
        t0 += mesh_own(m0, k0, s[D_K + j], s[D_C + j], s[D_CF + j], s[D_GAP0 + j])
        t1 += mesh_own(m1, k1, s[D_K + j], s[D_C + j], s[D_CF + j], s[D_GAP1 + j])
    g0, g1, g2 = -t0, -t1, n2 * (t0 + t1)
    if drives:
        g0 += volts[0] * s[D_GAIN + j]
        g1 += volts[1] * s[D_GAIN + j]
    if laws:
        g0 -= law_own(f0, s[D_S0 + j], s[D_T0 + j], s[D_W0 + j], s[D_B0 + j])
        g1 -= law_own(f1, s[D_S1 + j], s[D_T1 + j], s[D_W1 + j], s[D_B1 + j])
        g2 -= law_own(f2, s[D_S2 + j], s[D_T2 + j], s[D_W2 + j], s[D_B2 + j])
    b0 = w0 + mobilities[0] * (g0 - f0[3] * c0)
    b1 = w1 + mobilities[0] * (g1 - f1[3] * c1)
    b2 = w2 + mobilities[1] * (g2 - f2[3] * c2)
    if masses:
        b0 += f0[2] * s[D_MOB3 + j]
        b1 += f1[2] * s[D_MOB3 + j]
        b2 += f2[2] * s[D_MOBL + j]
    b0, b1, b2 = f0[0] * b0, f1[0] * b1, f2[0] * b2
    s[DQ0 + j], s[DQ1 + j], s[DQ2 + j] = a0 + 0.5 * h * b0, a1 + 0.5 * h * b1, a2 + 0.5 * h * b2
    s[DV0 + j], s[DV1 + j], s[DV2 + j] = b0, b1, b2
    s[DC0 + j], s[DC1 + j], s[DC2 + j] = b0 - w0, b1 - w1, b2 - w2


@njit
def march_tangents(u, x0, dt, substeps, bases, steps, out, changes, back, many):
    """Run a drive without effects and what changes of its numbers change.

    u (2, n); bases (p + 2, ...) of the run, of each change, of all the other way; steps (p,);
    out (8, n); changes (p, 8, n) per step; back (8, n), written from where the other way changes
    something else than minus the sum of the changes; many is None for few changes, each alone and
    without what none of them changes. Returns the sample from which `back` is written.
    """
    n, p = u.shape[1], changes.shape[0]
    h = dt / substeps
    half = 0.5 * h
    base = bases[0]
    s = np.zeros(SIZE_OF_CHANGES)
    for j in range(p + 1):
        changed_numbers(s, j, base, bases[1 + j], h)
        s[D_G0 + j] = s[D_G1 + j] = UNKNOWN
    drives = used(s, D_GAIN, D_K)
    meshes = used(s, D_K, D_MOB3)
    masses = used(s, D_MOB3, D_LAW)
    laws = used(s, D_LAW, D_G0)
    n1, n2 = base[5], base[6]
    gain, mobility_3 = n1 * (base[0] * base[1]), h / (base[3] + n1 * n1 * base[2])
    mobility_l = h / base[4]
    mesh0, mesh1 = mesh_at(base, 13), mesh_at(base, 14)
    margin = MARGIN * base[8] * max(base[13], base[14], 0.0)
    reducer, bearing = law_at(base, 15), law_at(base, 24)
    q0, q1, q2 = x0[0], x0[1], x0[2]
    v0, v1, v2 = x0[3], x0[4], x0[5]
    d0, d1, d2 = 0.0, 0.0, 0.0
    region0, region1 = UNKNOWN, UNKNOWN
    m0 = m1 = NO_SLOPES
    width = p  # changes that go along; one more once the other way is another one
    way0, way1, way2 = 1.0, 1.0, 1.0  # directions that the bodies move in, or last moved in
    p0, p1, p2 = one_way(way0, reducer), one_way(way1, reducer), one_way(way2, bearing)
    laws_along(s, way0, way1, way2)
    split = n
    apart = True  # whether some change is, or may be, on another branch than the run
    top = 0.0  # largest speed so far
    for i in range(n):
        z, z_rate = q0 - n2 * q2, v0 - n2 * v2
        y, y_rate = q1 - n2 * q2, v1 - n2 * v2
        out[0, i], out[1, i], out[2, i], out[3, i] = q2, v2, n1 * q0, n1 * q1
        out[6, i], out[7, i] = z, y
        t0 = region_torque(z, z_rate, region0, mesh0)
        t1 = region_torque(y, y_rate, region1, mesh1)
        anew0 = apart or not stays(z, z_rate, t0, region0, mesh0, margin)
        anew1 = apart or not stays(y, y_rate, t1, region1, mesh1, margin)
        out[4, i] = mesh_torque(z, z_rate, mesh0) if anew0 else t0
        out[5, i] = mesh_torque(y, y_rate, mesh1) if anew1 else t1
        k0 = law_slopes(z, z_rate, region0, mesh0) if meshes else NO_SLOPES
        k1 = law_slopes(y, y_rate, region1, mesh1) if meshes else NO_SLOPES
        for j in range(width):
            row = changes[j] if j < p else back
            dz, dz_rate = s[DQ0 + j] - n2 * s[DQ2 + j], s[DV0 + j] - n2 * s[DV2 + j]
            dy, dy_rate = s[DQ1 + j] - n2 * s[DQ2 + j], s[DV1 + j] - n2 * s[DV2 + j]
            per = 1.0 / steps[j] if j < p else 1.0
            mesh = s[D_K + j], s[D_C + j], s[D_CF + j]
            t0 = mesh_change(m0, dz, dz_rate) + mesh_own(m0, k0, *mesh, s[D_GAP0 + j])
            t1 = mesh_change(m1, dy, dy_rate) + mesh_own(m1, k1, *mesh, s[D_GAP1 + j])
            if anew0:
                moved = mesh_at(bases[1 + j], 13)
                t0 = mesh_torque(z + dz, z_rate + dz_rate, moved) - out[4, i]
            if anew1:
                moved = mesh_at(bases[1 + j], 14)
                t1 = mesh_torque(y + dy, y_rate + dy_rate, moved) - out[5, i]
            row[0, i], row[1, i] = s[DQ2 + j] * per, s[DV2 + j] * per
            row[2, i], row[3, i] = n1 * s[DQ0 + j] * per, n1 * s[DQ1 + j] * per
            row[4, i], row[5, i], row[6, i], row[7, i] = t0 * per, t1 * per, dz * per, dy * per
        u0, u1 = u[0, i], u[1, i]
        for _ in range(substeps):
            x_0, x_1, x_2 = q0 + half * v0, q1 + half * v1, q2 + half * v2
            s0, s1, s2 = v0 + 0.5 * d0, v1 + 0.5 * d1, v2 + 0.5 * d2
            z, z_rate = x_0 - n2 * x_2, s0 - n2 * s2
            y, y_rate = x_1 - n2 * x_2, s1 - n2 * s2
            t0 = region_torque(z, z_rate, region0, mesh0)
            t1 = region_torque(y, y_rate, region1, mesh1)
            if v0 * way0 < 0.0 or v1 * way1 < 0.0 or v2 * way2 < 0.0:
                way0, way1, way2 = one_of(v0), one_of(v1), one_of(v2)
                p0, p1, p2 = one_way(way0, reducer), one_way(way1, reducer), one_way(way2, bearing)
                laws_along(s, way0, way1, way2)
            new0, sure0, f0 = smooth_body(v0, s0, gain * u0 - t0, mobility_3, reducer, p0, 1.0, 0.0)
            new1, sure1, f1 = smooth_body(v1, s1, gain * u1 - t1, mobility_3, reducer, p1, 1.0, 0.0)
            new2, sure2, f2 = smooth_body(v2, s2, n2 * (t0 + t1), mobility_l, bearing, p2, 1.0, 0.0)
            if (
                apart
                or not (sure0 and sure1 and sure2)
                or not stays(z, z_rate, t0, region0, mesh0, margin)
                or not stays(y, y_rate, t1, region1, mesh1, margin)
            ):
                state = (q0, q1, q2, v0, v1, v2, d0, d1, d2)
                if width == p:
                    other_way(s, p, region0, region1)
                here = whole_step(*state, region0, region1, u0, u1, h, base)
                apart = anew(s, p, state, here, u0, u1, h, bases)
                region0, region1 = here[9], here[10]
                m0, m1 = mesh_slopes(region0, mesh0), mesh_slopes(region1, mesh1)
                q0, q1, q2, v0, v1, v2 = here[0], here[1], here[2], here[3], here[4], here[5]
                d0, d1, d2 = here[6], here[7], here[8]
                top = max(top, abs(v0), abs(v1), abs(v2))
                if width == p and two_ways(s, p, here, top):
                    width = p + 1
                    split = i + 1
                continue
            k0 = law_slopes(z, z_rate, region0, mesh0) if meshes else NO_SLOPES
            k1 = law_slopes(y, y_rate, region1, mesh1) if meshes else NO_SLOPES
            if many is None:
                for j in range(width):
                    change_along(
                        *(s, j, h, n2, (u0, u1), (mobility_3, mobility_l)),
                        *(m0, m1, k0, k1, f0, f1, f2),
                        *(drives, meshes, masses, laws),
                    )
            else:
                # four at a time, as a vector; those beyond the last are zero
                for j in range((width + 3) // 4 * 4):
                    change_along(
                        *(s, j, h, n2, (u0, u1), (mobility_3, mobility_l)),
                        *(m0, m1, k0, k1, f0, f1, f2),
                        *(True, True, True, True),
                    )
            d0, d1, d2 = new0 - v0, new1 - v1, new2 - v2
            v0, v1, v2 = new0, new1, new2
            q0, q1, q2 = x_0 + half * v0, x_1 + half * v1, x_2 + half * v2
        top = max(top, abs(v0), abs(v1), abs(v2))
    return split


@njit
def mesh_change(slopes, dz, dz_rate):
    """Change of a mesh's torque with that of the motion."""
    return slopes[0] * dz + slopes[1] * dz_rate


@njit
def mesh_own(slopes, own, stiffness, damping, gap_damping, gap):
    """Change of a mesh's torque with its own numbers."""
    return own[0] * stiffness + own[1] * damping + (own[2] * gap_damping + slopes[2] * gap)


@njit
def law_own(slopes, static, coulomb, scale, viscous):
    """Change of a friction with its own numbers."""
    own = slopes[4] * static + slopes[5] * coulomb + (slopes[6] * scale + slopes[7] * viscous)
    return slopes[1] * own


@njit
def other_way(s, p, region0, region1):
    """Put what all changes the other way change behind the changes: minus their sum."""
    for k in range(9):
        total = 0.0
        for j in range(p):
            total += s[k * CHANGES + j]
        s[k * CHANGES + p] = -total
    s[D_G0 + p], s[D_G1 + p] = region0, region1


@njit
def anew(s, p, state, here, u0, u1, h, bases):
    """Take a step for each change with branches of its own; whether any is on another branch."""
    apart = False
    for j in range(p + 1):
        there = whole_step(
            state[0] + s[DQ0 + j],
            state[1] + s[DQ1 + j],
            state[2] + s[DQ2 + j],
            state[3] + s[DV0 + j],
            state[4] + s[DV1 + j],
            state[5] + s[DV2 + j],
            state[6] + s[DC0 + j],
            state[7] + s[DC1 + j],
            state[8] + s[DC2 + j],
            s[D_G0 + j],
            s[D_G1 + j],
            u0,
            u1,
            h,
            bases[1 + j],
        )
        for k in range(9):
            s[k * CHANGES + j] = there[k] - here[k]
        s[D_G0 + j], s[D_G1 + j] = there[9], there[10]
        for k in range(3):
            apart = apart or (there[3 + k] == 0.0) != (here[3 + k] == 0.0)
        apart = apart or there[9] != here[9] or there[10] != here[10]
    return apart


@njit
def two_ways(s, p, here, top):
    """Whether what all changes the other way change is not minus their sum."""
    for k in range(9):
        row = k * CHANGES
        size = abs(s[row + p])
        together = s[row + p]
        for j in range(p):
            together += s[row + j]
            size += abs(s[row + j])
        if abs(together) > APART * size + ROUNDING * (abs(here[k]) if k < 3 else top):
            return True
    return False
