"""One step of a drive with effects, of one of several drives whose numbers are in rows.

It is the step of `core.py`. The loop of `tangent_site_core` takes it where a run, or what a
change makes of it, may take another branch. No physics is written here.
"""

from math import cos, exp
from typing import NamedTuple

from numba import njit

from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.effects.stribeck import stribeck_law
from dmptm_ctrl.simulate.core import (
    MIN_COMPLIANCE,
    aged,
    bristles_of,
    friction_step,
    mesh_step,
)
from dmptm_ctrl.simulate.row_sites import (
    aged_friction_of,
    drive_voltage_of,
    friction_level_of,
    lag_relaxation_of,
    load_torque_of,
    mesh_shift_of,
    motor_torque_of,
    presliding_law_of,
    shaft_compliance_of,
    speed_delay_of,
    voltage_delay_of,
)
from dmptm_ctrl.simulate.tangent_core import (
    APART,
    CHANGES,
    D_G0,
    D_G1,
    DQ0,
    ROUNDING,
    SIZE_OF_CHANGES,
)

# A state: angles, speeds, last changes of the speeds; the same of motors behind elastic reducers;
X_Q, X_V, X_D, X_A, X_W, X_B = 0, 3, 6, 9, 11, 13
# lagged voltages, presliding friction, ages of the contacts; regions of the meshes
X_E, X_F, X_AGE, X_REGION = 15, 17, 20, 23
SMOOTH, STATE = 23, 25
# Rows of changes behind those of `tangent_core`, in the same order.
MOTION = 9  # rows of state from DQ0 on
D_HIDDEN = SIZE_OF_CHANGES
D_A0, D_A1, D_O0, D_O1, D_P0, D_P1 = range(D_HIDDEN, D_HIDDEN + 6 * CHANGES, CHANGES)
D_E0, D_E1, D_F0, D_F1, D_F2 = range(D_HIDDEN + 6 * CHANGES, D_HIDDEN + 11 * CHANGES, CHANGES)
D_AGE0, D_AGE1, D_AGE2 = range(D_HIDDEN + 11 * CHANGES, D_HIDDEN + 14 * CHANGES, CHANGES)
HIDDEN = SMOOTH - MOTION
# What stays as it is in each run: h/J; reducer's stiffness, damping, h/J of its motor; dead times
# in samples and steps;
F_MOB3, F_MOBL, F_STIFF, F_DAMP, F_EASE, F_DEAD, F_LATE = range(7)
# presliding of the three bodies; slip that makes their contacts new.
F_BRISTLES, F_RENEW = 7, 16
FIXED = 19


class Acting(NamedTuple):
    """What acts in a run at all."""

    drive: bool
    lag: bool
    motor: bool
    mesh: bool
    friction: bool
    ageing: bool
    load: bool
    elastic: bool
    presliding: bool


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
def lagged(aim, tau, kept, h):
    """Mean over the step of a voltage that relaxes to `aim`, and what is kept of it after."""
    left = (kept - aim) * exp(-h / tau)
    return aim + (kept - aim - left) * tau / h, aim + left


@njit
def toothed(x, k_a, z_3, phi_r):
    """Stiffness that a mesh has more where a tooth is [N·m/rad], at an angle of the pinion."""
    return k_a * cos(z_3 * x + phi_r)


@njit
def voltage_of(u, kept, t, side, h, acting, on, values, row):
    """Mean voltage over the step behind drive and lag, and what the lag keeps."""
    if acting.drive:
        u = drive_voltage_of(u, t, side, on, values, row)
    if acting.lag:
        aim, tau = lag_relaxation_of(u, side, on, values, row)
        if tau > 0.0:
            return lagged(aim, tau, kept, h)
        return aim, aim
    return u, kept


@njit
def mesh_of(x, v, x_2, v_2, side, has_mesh, bases, on, values, row):
    """Shift of a mesh's angle, its rate, and the mesh itself."""
    shift, rate, wider, stiffer = 0.0, 0.0, 0.0, 0.0
    if has_mesh:
        shift, rate, wider, stiffer = mesh_shift_of(x, v, x_2, v_2, side, on, values, row)
    if bases[row, 9] != 0.0:
        stiffer += toothed(x, bases[row, 9], bases[row, 7], bases[row, 10])
    gap = max(bases[row, 13 + side] + wider, 0.0)
    return shift, rate, Backlash(bases[row, 8] + stiffer, bases[row, 11], bases[row, 12], gap)


@njit
def level_of(x, v, t, torque, age, body, acting, on, values, row):
    """Factor on the declared friction, and Coulomb torque added."""
    level, added = 1.0, 0.0
    if acting.friction:
        level, added = friction_level_of(x, v, t, torque, body, on, values, row)
    if acting.ageing:
        added += aged_friction_of(age, body, on, values, row)[0]
    return level, added


@njit
def row_step(x, u0, u1, t, h, acting, bases, on, values, fixed, row):
    """Take a state one step further: pinions and their motors, then the ring gear."""
    n1, n2 = bases[row, 5], bases[row, 6]
    theta_l, omega_l = x[X_Q + 2] + 0.5 * h * x[X_V + 2], x[X_V + 2] + 0.5 * x[X_D + 2]
    push, load = 0.0, 0.0  # on the ring gear, and what its friction may grow with
    for body in range(3):
        theta = x[X_Q + body] + 0.5 * h * x[X_V + body]
        omega = x[X_V + body] + 0.5 * x[X_D + body]
        mobility, first = (F_MOBL, 24) if body == 2 else (F_MOB3, 15)
        if body == 2:
            force, torque = n2 * push, load
            if acting.load:
                force += load_torque_of(theta, omega, t, on, values, row)
        else:
            shift, rate, mesh = mesh_of(
                theta, omega, theta_l, omega_l, body, acting.mesh, bases, on, values, row
            )
            z, z_rate = theta - n2 * theta_l + shift, omega - n2 * omega_l + rate
            torque, x[X_REGION + body] = mesh_step(z, z_rate, mesh, x[X_REGION + body], h)
            push, load = push + torque, load + abs(torque)
            u, x[X_E + body] = voltage_of(
                u1 if body == 1 else u0, x[X_E + body], t, body, h, acting, on, values, row
            )
            force = motor_step(
                x, body, theta, omega, u, t, h, acting, n1, n1 * (bases[row, 0] * bases[row, 1]),
                on, values, fixed, row
            ) - torque  # fmt: skip
        level, added = level_of(
            theta, omega, t, torque, x[X_AGE + body], body, acting, on, values, row
        )
        law, bristles = law_of(bases, row, first), bristles_in(fixed, row, body)
        v = x[X_V + body]
        new, x[X_F + body] = friction_step(
            v, omega, force, fixed[row, mobility], h, law, level, added, bristles, x[X_F + body]
        )
        if acting.ageing:
            x[X_AGE + body] = aged(x[X_AGE + body], new, h, fixed[row, F_RENEW + body])
        x[X_V + body], x[X_D + body] = new, new - v
        x[X_Q + body] = theta + 0.5 * h * new
        if body < 2 and not acting.elastic:
            x[X_A + body] = x[X_Q + body]


@njit
def motor_step(x, side, theta, omega, u, t, h, acting, n1, gain, on, values, fixed, row):
    """Torque of a motor on the pinion, and the step of one behind an elastic reducer."""
    angle, speed = theta, omega
    if acting.elastic:
        angle = x[X_A + side] + 0.5 * h * x[X_W + side]
        speed = x[X_W + side] + 0.5 * x[X_B + side]
    force = gain * u
    if acting.motor:
        force += n1 * motor_torque_of(u, n1 * angle, n1 * speed, t, side, on, values, row)
    if not acting.elastic:
        return force
    twist = fixed[row, F_STIFF] * (angle - theta) + fixed[row, F_DAMP] * (speed - omega)
    x[X_B + side] = fixed[row, F_EASE] * (force - twist)
    x[X_W + side] += x[X_B + side]
    x[X_A + side] = angle + 0.5 * h * x[X_W + side]
    return twist


@njit
def place_of(k):
    """Row of changes of a part of the state."""
    return DQ0 + k * CHANGES if k < MOTION else D_HIDDEN + (k - MOTION) * CHANGES


@njit
def row_steps(s, room, p, volts, t, h, acting, bases, on, values, fixed):
    """Take the run's state, room[0], a step further, and each change with branches of its own.

    `volts` (p + 2, 2) of the run and of each change. Whether any is on another branch.
    """
    here, there, before = room[0], room[1], room[2]
    for k in range(STATE):
        before[k] = here[k]
    apart = False
    for j in range(-1, p + 1):
        row = 1 + j
        for k in range(STATE):
            there[k] = before[k]
        if j >= 0:
            for k in range(SMOOTH):
                there[k] += s[place_of(k) + j]
            there[X_REGION], there[X_REGION + 1] = s[D_G0 + j], s[D_G1 + j]
        row_step(there, volts[row, 0], volts[row, 1], t, h, acting, bases, on, values, fixed, row)
        if j < 0:
            for k in range(STATE):
                here[k] = there[k]
            continue
        for k in range(SMOOTH):
            s[place_of(k) + j] = there[k] - here[k]
        s[D_G0 + j], s[D_G1 + j] = there[X_REGION], there[X_REGION + 1]
        apart = apart or there[X_REGION] != here[X_REGION]
        apart = apart or there[X_REGION + 1] != here[X_REGION + 1]
        for k in range(X_V, X_V + 3):
            apart = apart or (there[k] == 0.0) != (here[k] == 0.0)
    return apart


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
