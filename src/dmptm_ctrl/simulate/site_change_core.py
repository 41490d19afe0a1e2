"""What meshes, voltages and frictions with effects on them change by in a step, to first order.

The loop of `tangent_site_core` calls these: the run's own values with their slopes, of kernels
written from their source (`slopes`), and what a moved number of an effect changes by itself. No
physics is written here.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import Backlash, mesh_torque, region_torque
from dmptm_ctrl.simulate.bristle_core import D_N0, D_R0, SIZE_WITH_BRISTLES
from dmptm_ctrl.simulate.row_step_core import grow, mesh_of
from dmptm_ctrl.simulate.slope_sites import (
    R_MOVES,
    R_NUMBERS,
    R_OWN,
    aged_slopes,
    drive_slopes_of,
    lag_slopes_of,
    lagged_slopes,
    mesh_slopes_of,
    toothed_slopes,
)
from dmptm_ctrl.simulate.tangent_core import (
    CHANGES,
    D_C,
    D_CF,
    D_GAP0,
    D_K,
    NO_SLOPES,
    law_slopes,
    mesh_own,
    mesh_slopes,
    stays,
)

# Rows behind those of presliding: what numbers of effects change by themselves in a step, of
# voltages, lagged voltages in the step and after it, torques of motors, meshes, on the ring gear.
D_OWN, OWN = SIZE_WITH_BRISTLES, 11
D_U0, D_U1, D_L0, D_L1, D_K0, D_K1, D_H0, D_H1, D_M0, D_M1, D_LOAD = range(
    D_OWN, D_OWN + OWN * CHANGES, CHANGES
)
# Of the lag of either motor: time constant, and as of `lagged_slopes` from 1 to none.
W_LAG, LAG = D_OWN + OWN * CHANGES, 8
SIZE_WITH_SITES = W_LAG + 2 * LAG
# Sites as numbers, in the order of `contract.SITES`
AT_DRIVE, AT_DELAY, AT_LAG, AT_MOTOR, AT_SHAFT, AT_MESH, AT_FRICTION = range(7)
AT_PRESLIDING, AT_AGEING, AT_LOAD = 7, 8, 9
WHOLE = 1e-6  # of a step: dead times nearer to whole steps than this are on a kink


class Moving(NamedTuple):
    """Which numbers some change moves."""

    volts: bool
    dead: bool
    gain: bool
    motor: bool
    shaft: bool
    mesh: bool
    numbers: bool  # of the meshes
    teeth: bool
    friction: bool  # numbers of effects on it
    laws: bool
    mass: bool
    load: bool
    ages: bool


class MeshOf(NamedTuple):
    """A mesh of the run."""

    z: float
    z_rate: float
    law: Backlash
    torque: float
    slopes: tuple[float, ...]  # by angle and speed of the pinion, of the ring gear
    own: tuple[float, ...]  # by stiffness and both dampings
    numbers: tuple[float, ...]  # by shift, its rate, half-gap, stiffness
    teeth: tuple[float, ...]  # of its stiffness, by angle and numbers of the teeth
    sure: bool


@njit
def mesh_along(x, v, x_2, v_2, side, region, varying, acting, moving, bases, r):
    """A mesh of the run in a region of Eq. 21, with what its effects make of it."""
    n2 = bases[0, 6]
    c, e, sure = (0.0,) * 4, (0.0,) * 16, True
    if acting.mesh:
        c, e, sure = mesh_slopes_of(x, v, x_2, v_2, side, moving.mesh, r)
    stiff, teeth = c[3], (0.0,) * 4
    if varying:
        more = toothed_slopes(x, bases[0, 9], bases[0, 7], bases[0, 10])
        stiff, teeth = stiff + more[0][0], more[1]
    wide = bases[0, 13 + side] + c[2]
    law = Backlash(bases[0, 8] + stiff, bases[0, 11], bases[0, 12], max(wide, 0.0))
    z, z_rate = x - n2 * x_2 + c[0], v - n2 * v_2 + c[1]
    m, k = mesh_slopes(region, law), law_slopes(z, z_rate, region, law)
    w = (m[0], m[1], m[2] if wide > 0.0 else 0.0, k[0])
    slopes = (
        w[0] * (1.0 + e[0]) + w[1] * e[4] + w[2] * e[8] + w[3] * (e[12] + teeth[0]),
        w[0] * e[1] + w[1] * (1.0 + e[5]) + w[2] * e[9] + w[3] * e[13],
        w[0] * (e[2] - n2) + w[1] * e[6] + w[2] * e[10] + w[3] * e[14],
        w[0] * e[3] + w[1] * (e[7] - n2) + w[2] * e[11] + w[3] * e[15],
    )
    torque = region_torque(z, z_rate, region, law)
    return MeshOf(z, z_rate, law, torque, slopes, k, w, teeth, sure and wide != 0.0)


@njit
def moved_by(r, slot, first, weights):
    """What a number of a site's effects changes by itself, moved by one."""
    total = 0.0
    for o in range(len(weights)):
        total += weights[o] * r[R_OWN + (first + o) * R_NUMBERS + slot]
    return total


@njit
def own_of(s, to, site, first, weights, moved, r):
    """Put what moved numbers of a site's effects change by themselves into a row."""
    for m in range(moved[0, site], moved[0, site + 1]):
        s[to + moved[1, m]] = moved_by(r, moved[2, m], first, weights) * r[R_MOVES + m]


@njit
def own_of_bodies(s, to, site, weights0, weights1, weights2, moved, r):
    """The same of the three bodies, into as many rows: where each number is, is found once."""
    n = len(weights0)
    for m in range(moved[0, site], moved[0, site + 1]):
        at, slot, step = to + moved[1, m], moved[2, m], r[R_MOVES + m]
        s[at] = moved_by(r, slot, 0, weights0) * step
        s[at + CHANGES] = moved_by(r, slot, n, weights1) * step
        s[at + 2 * CHANGES] = moved_by(r, slot, 2 * n, weights2) * step


@njit
def own_of_mesh(s, side, mesh, p, width, moving, bases, moved, r):
    """The same of a mesh, with the numbers of its teeth."""
    to = D_M0 + side * CHANGES
    if moving.teeth:
        for j in range(p):
            s[to + j] = 0.0
            for k in range(3):
                number = (9, 7, 10)[k]
                slope = mesh.numbers[3] * mesh.teeth[1 + k]
                s[to + j] += slope * (bases[1 + j, number] - bases[0, number])
    if moving.mesh:
        own_of(s, to, AT_MESH, 4 * side, mesh.numbers, moved, r)
    if width > p:
        grow(s, to, 1, p)


@njit
def meshes_along(
    x_0, x_1, x_2, v_0, v_1, v_2, region0, region1, side0,
    varying, acting, moving, p, width, bases, moved, s, r,
):  # fmt: skip
    """Both meshes of the run, and what their own numbers change by themselves into rows."""
    mesh_l = mesh_along(x_0, v_0, x_2, v_2, side0, region0, varying, acting, moving, bases, r)
    own_of_mesh(s, side0, mesh_l, p, width, moving, bases, moved, r)
    mesh_r = mesh_along(x_1, v_1, x_2, v_2, side0 + 1, region1, varying, acting, moving, bases, r)
    own_of_mesh(s, side0 + 1, mesh_r, p, width, moving, bases, moved, r)
    return mesh_l, mesh_r


@njit
def sliding(f, mobility):
    """Slopes of a speed after a step, of a body that slides or rests.

    By speed before the step and in the middle, torque, level, added torque, presliding.
    """
    by = f[0] * mobility
    return f[0], -by * f[3], by, -by * f[1] * f[8], -by * f[1], 0.0


@njit
def plain_mesh(z, z_rate, region, law, m, n2, moving):
    """A mesh of the run in a region of Eq. 21 that nothing acts on; m as of `mesh_slopes`."""
    k = law_slopes(z, z_rate, region, law) if moving.numbers else NO_SLOPES
    slopes, numbers = (m[0], m[1], -n2 * m[0], -n2 * m[1]), (m[0], m[1], m[2], k[0])
    torque = region_torque(z, z_rate, region, law)
    return MeshOf(z, z_rate, law, torque, slopes, k, numbers, (0.0,) * 4, True)


@njit
def is_same(mesh, region, margin):
    """Whether a mesh of the run, and all that changes of it, goes on in a region."""
    return mesh.sure and stays(mesh.z, mesh.z_rate, mesh.torque, region, mesh.law, margin)


@njit
def torque_at(x, v, x_2, v_2, side, acting, bases, on, values, row):
    """Torque of a mesh by its own branch."""
    n2 = bases[row, 6]
    shift, rate, law = mesh_of(x, v, x_2, v_2, side, acting.mesh, bases, on, values, row)
    return mesh_torque(x - n2 * x_2 + shift, v - n2 * v_2 + rate, law)


@njit
def with_level(slopes, level, age):
    """Slopes of a speed, or of a presliding friction, with those through the level of friction.

    `slopes` as of `sliding`; `level` of the sites' effects by angle, speed and torque of the mesh,
    `age` of ageing. By speed before the step and in the middle, torque, angle, torque of the mesh,
    age, presliding.
    """
    x, added = slopes[3], slopes[4]
    return (
        slopes[0],
        slopes[1] + (x * level[1] + added * level[4]),
        slopes[2],
        x * level[0] + added * level[3],
        x * level[2] + added * level[5],
        added * age,
        slopes[5],
    )


@njit
def without_level(slopes):
    """The same where nothing acts on the level of friction."""
    return slopes[0], slopes[1], slopes[2], 0.0, 0.0, 0.0, slopes[5]


@njit
def change_of_mesh(s, j, mesh, x, v, x_2, v_2, side, moving):
    """Change of a mesh's torque with that of the motion and with its own numbers."""
    by, gap = mesh.slopes, D_GAP0 + side * CHANGES
    change = by[0] * x + by[1] * v + (by[2] * x_2 + by[3] * v_2)
    if moving.numbers:
        open_by = (0.0, 0.0, mesh.numbers[2])
        change += mesh_own(open_by, mesh.own, s[D_K + j], s[D_C + j], s[D_CF + j], s[gap + j])
    if moving.mesh or moving.teeth:
        change += s[D_M0 + side * CHANGES + j]
    return change


@njit
def older_by(by, age, v, slip):
    """Change of an age over a step; `by` as of `grown`."""
    return by[0] * age + by[1] * v + by[2] * slip


@njit
def grown(age, v, h, slip):
    """Age of a contact after a step, and its slopes by age, speed and slip; whether sure."""
    if slip <= 0.0:
        return 0.0, (0.0, 0.0, 0.0), True
    after, by, _, _, _, sure = aged_slopes(age, v, h, slip)
    return after[0], by, sure


@njit
def volts_along(s, given, kept, t, side, h, acting, p, width, moved, r):
    """Voltage of the run behind drive and lag, what the lag keeps, and their slopes.

    By what is given, and by what is kept; whether they are sure.
    """
    u, by_given, sure = given, 1.0, True
    to = side * CHANGES
    if acting.drive:
        u, by_given, sure = drive_slopes_of(given, t, side, True, r)
        own_of(s, D_U0 + to, AT_DRIVE, side, (1.0,), moved, r)
    after, mean, late = kept, (by_given, 0.0), (0.0, 1.0)
    if acting.lag:
        c, e, good = lag_slopes_of(u, side, True, r)
        at = W_LAG + side * LAG
        if s[at] != c[1]:  # linear in both voltages: the rest stays as it is
            _, d, _, _, _, smooth = lagged_slopes(0.0, c[1], 1.0, h)
            s[at], s[at + 7] = c[1], 1.0 if smooth else 0.0
            for k in range(6):
                s[at + 1 + k] = d[k]
        sure = sure and good and s[at + 7] > 0.0
        off = kept - c[0]
        d = s[at + 1], s[at + 2] * off, s[at + 3], s[at + 4], s[at + 5] * off, s[at + 6]
        u, after = c[0] + d[2] * off, c[0] + d[5] * off
        mean, late = (d[0] * e[0] + d[1] * e[1], d[2]), (d[3] * e[0] + d[4] * e[1], d[5])
        own_of(s, D_L0 + to, AT_LAG, 2 * side, (d[0], d[1]), moved, r)
        own_of(s, D_K0 + to, AT_LAG, 2 * side, (d[3], d[4]), moved, r)
    if width > p:
        for k in range(0, D_H0 - D_U0, 2 * CHANGES):
            grow(s, D_U0 + to + k, 1, p)
    return u, after, by_given, mean, late, sure


@njit
def frictions_own(s, by0, by1, by2, more0, more1, more2, p, width, acting, moved, r):
    """Put what numbers of friction's effects change by themselves into the rows of the bodies.

    by, more of each body as of `sliding`, of the speed and of the presliding friction.
    """
    levels = (by0[3], by0[4]), (by1[3], by1[4]), (by2[3], by2[4])
    own_of_bodies(s, D_N0, AT_FRICTION, *levels, moved, r)
    if acting.ageing:
        own_of_bodies(s, D_N0, AT_AGEING, (by0[4],), (by1[4],), (by2[4],), moved, r)
    if acting.presliding:
        levels = (more0[3], more0[4]), (more1[3], more1[4]), (more2[3], more2[4])
        own_of_bodies(s, D_R0, AT_FRICTION, *levels, moved, r)
        own_of_bodies(s, D_R0, AT_AGEING, (more0[4],), (more1[4],), (more2[4],), moved, r)
    if width > p:
        grow(s, D_N0, 6, p)


@njit
def kink(fixed, row, number, per):
    """Whether a change moves a delay that is as good as whole; `per` are its units per whole.

    Held voltages have corners at the samples, readings between steps.
    """
    whole = fixed[0, number] * per
    return fixed[row, number] != fixed[0, number] and abs(whole - np.floor(whole + 0.5)) < WHOLE
