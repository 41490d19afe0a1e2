"""The stages of a step of several drives at once, each a loop over lanes; no physics of its own.

All numbers live in one work array `s`, in rows of LANES: with one base address and constant
distances the compiler sees that nothing overlaps. No stage branches on data, which the compiler
turns into vector instructions; `lane_core` calls them in the order of `core.py`.
"""

from math import cos, exp

from numba import njit

from dmptm_ctrl.effects.backlash import Backlash, mesh_torque, region_torque
from dmptm_ctrl.effects.stribeck import Stribeck
from dmptm_ctrl.simulate.core import UNKNOWN, aged, mesh_step, preslide, slide, stop
from dmptm_ctrl.simulate.elementary import wide
from dmptm_ctrl.simulate.lane_sites import (  # chains
    ageing_lanes,
    drive_lanes,
    friction_lanes,
    lag_lanes,
    load_lanes,
    mesh_lanes,
    motor_lanes,
)

# Two vector registers of doubles with AVX-512: one drive's arithmetic fills the waits of another's,
# and 16 take 1.55 times as long as 8.
LANES = 16
CALM = 3.0  # instead of a region: nothing to look at again
COLUMNS = 10  # outputs of a run, and the two voltages
TORQUE_L, TORQUE_R = 4, 5  # of these

# Rows of the work array; those of several bodies (left, right, ring gear) or meshes (left,
# right) follow each other, so that one loop runs over all of them.
# A: arguments of a site chain, R: its results; voltages, lagged voltages.
A0, A1, A2, A3, R0, R1, U0, U1, E0, E1, SEEN, LEAD = range(0, 12 * LANES, LANES)
# Angles, speeds, last changes of the speeds; the midpoint's angles and speeds.
Q0, Q1, Q2, V0, V1, V2, C0, C1, C2 = range(12 * LANES, 21 * LANES, LANES)
X0, X1, X2, S0, S1, S2 = range(21 * LANES, 27 * LANES, LANES)
# The same of the motors, seen at the pinion; they turn with it unless the reducer is elastic.
M0, M1, W0, W1, B0, B1, Y0, Y1, MS0, MS1 = range(27 * LANES, 37 * LANES, LANES)
# Meshes: relative angle and its rate, law, torque, region, whether it is to be looked at.
Z0, Z1, ZR0, ZR1, K0, K1, D0, D1, DF0, DF1 = range(37 * LANES, 47 * LANES, LANES)
H0, H1, T0, T1, G0, G1, ODD0, ODD1 = range(47 * LANES, 55 * LANES, LANES)
# Results of the mesh chain: of z, its rate, half-gap, stiffness; left, then right.
DZ0, DZ1 = 55 * LANES, 59 * LANES
# Bodies: net torque, h/J, factor on friction and torque added to it, presliding torque and
# distance, speed after the step, whether the body stops.
P0, P1, P2, MOBILITY, SCALE, ADDED = (
    63 * LANES,
    64 * LANES,
    65 * LANES,
    *range(66 * LANES, 75 * LANES, 3 * LANES),
)
BRISTLE, DISTANCE, NEW, STOPS = range(75 * LANES, 87 * LANES, 3 * LANES)
LAW, DELTA = 87 * LANES, 111 * LANES  # 11 numbers, each of 3 bodies; the ninth of them
# Set once per run. NOTHING stays zero.
GAIN, J_MOTOR, DEAD, LATE, COMPLIANCE, SHAFT = range(120 * LANES, 126 * LANES, LANES)
KP, KI, LIMIT, BIAS0, BIAS1, INTEGRAL, NOTHING = range(126 * LANES, 133 * LANES, LANES)
N1, N2, TEETH, K_M, K_A, PHASE, GAP0, GAP1 = range(133 * LANES, 141 * LANES, LANES)
# Bodies: age of the contact in the middle of the step, slip that makes it new; share of viscous
# friction that presliding does not hold back, lag of its bristles.
AGE, RENEW, AT_ONCE, BRISTLE_LAG = range(141 * LANES, 153 * LANES, 3 * LANES)
OUT = 153 * LANES
VALUES = OUT + COLUMNS * LANES


@njit
def law(s, row, exponent):
    """Friction law in a row of the bodies."""
    return Stribeck(
        s[LAW + row],
        s[LAW + 3 * LANES + row],
        s[LAW + 6 * LANES + row],
        s[LAW + 9 * LANES + row],
        s[LAW + 12 * LANES + row],
        s[LAW + 15 * LANES + row],
        s[LAW + 18 * LANES + row],
        s[LAW + 21 * LANES + row],
        exponent,
        s[LAW + 27 * LANES + row],
        s[LAW + 30 * LANES + row],
    )


@njit
def to_middle(s, width, h):
    """Angles half a step on with the old speeds, speeds extrapolated by the last accelerations."""
    wide()
    for row in range(3 * width):
        s[X0 + row] = s[Q0 + row] + 0.5 * h * s[V0 + row]
        s[S0 + row] = s[V0 + row] + 0.5 * s[C0 + row]


@njit
def twist(s, width, x, v):
    """Relative angles of the meshes and their rates."""
    wide()
    for lane in range(width):
        turned = s[N2 + lane] * s[x + 2 * LANES + lane]
        turning = s[N2 + lane] * s[v + 2 * LANES + lane]
        s[Z0 + lane] = s[x + lane] - turned + s[DZ0 + lane]
        s[Z1 + lane] = s[x + LANES + lane] - turned + s[DZ1 + lane]
        s[ZR0 + lane] = s[v + lane] - turning + s[DZ0 + LANES + lane]
        s[ZR1 + lane] = s[v + LANES + lane] - turning + s[DZ1 + LANES + lane]


@njit
def alter_meshes(s, width, x, varying):
    """Half-gaps, and stiffnesses of Eq. 23, where they change."""
    wide()
    for lane in range(width):
        s[H0 + lane] = max(s[GAP0 + lane] + s[DZ0 + 2 * LANES + lane], 0.0)
        s[H1 + lane] = max(s[GAP1 + lane] + s[DZ1 + 2 * LANES + lane], 0.0)
        s[K0 + lane] = s[K_M + lane] + s[DZ0 + 3 * LANES + lane]
        s[K1 + lane] = s[K_M + lane] + s[DZ1 + 3 * LANES + lane]
    if varying:
        for lane in range(width):
            s[K0 + lane] += s[K_A + lane] * cos(s[TEETH + lane] * s[x + lane] + s[PHASE + lane])
        for lane in range(width):
            phase = s[TEETH + lane] * s[x + LANES + lane] + s[PHASE + lane]
            s[K1 + lane] += s[K_A + lane] * cos(phase)


@njit
def shift_mesh(s, width, x, v, x_ring, v_ring, lead, result, side, on):
    """Call the chain of a mesh; `lead` moves what depends on angle to where the sensor is."""
    for lane in range(width):
        s[A0 + lane] = s[x + lane] + s[N2 + lane] * s[lead + lane]
        s[A1 + lane] = s[v + lane]
        s[A2 + lane] = s[x_ring + lane] + s[lead + lane]
        s[A3 + lane] = s[v_ring + lane]
        s[result + lane] = 0.0
        s[result + LANES + lane] = 0.0
        s[result + 2 * LANES + lane] = 0.0
        s[result + 3 * LANES + lane] = 0.0
    mesh_lanes(s, width, result, side, 0.0, on)


@njit
def plain_region(z, z_rate, p):
    """Region of a mesh without the decay term of the gap, and whether that is sure."""
    side = 1.0 if z >= 0.0 else -1.0
    closing = side * z_rate
    pressed = p.stiffness * (side * z - p.half_gap)
    touching = pressed + p.damping * closing > 0.0
    clear = closing <= 0.0 or pressed >= p.gap_damping * closing
    return side if touching and clear else 0.0, clear or not touching


@njit
def mesh_stage(s, width):
    """Torques of the meshes in the middle of the step; how many are to be looked at again."""
    wide()
    odd = 0
    for row in range(2 * width):
        z, z_rate = s[Z0 + row], s[ZR0 + row]
        mesh = Backlash(s[K0 + row], s[D0 + row], s[DF0 + row], s[H0 + row])
        region, sure = plain_region(z, z_rate, mesh)
        landed = region * z_rate > 0.0 and region != s[G0 + row]
        look = landed or not sure
        s[T0 + row] = region_torque(z, z_rate, region, mesh)
        s[ODD0 + row] = s[G0 + row] if look else CALM
        s[G0 + row] = region
        odd += 1 if look else 0
    return odd


@njit
def odd_meshes(s, width, h):
    """The few meshes that reach a flank or are about to."""
    for row in range(2 * width):
        if s[ODD0 + row] != CALM:
            mesh = Backlash(s[K0 + row], s[D0 + row], s[DF0 + row], s[H0 + row])
            s[T0 + row], s[G0 + row] = mesh_step(s[Z0 + row], s[ZR0 + row], mesh, s[ODD0 + row], h)


@njit
def net_torques(s, width, push0, push1, push2):
    """Net torques on the bodies but for friction and what the chains add."""
    wide()
    for lane in range(width):
        left, right = s[T0 + lane], s[T1 + lane]
        s[P0 + lane] = s[GAIN + lane] * s[U0 + lane] - left + push0
        s[P1 + lane] = s[GAIN + lane] * s[U1 + lane] - right + push1
        s[P2 + lane] = s[N2 + lane] * (left + right) + push2


@njit
def read_meshes(s, width):
    """Torques of the meshes at the sample."""
    wide()
    for row in range(2 * width):
        mesh = Backlash(s[K0 + row], s[D0 + row], s[DF0 + row], s[H0 + row])
        region, sure = plain_region(s[Z0 + row], s[ZR0 + row], mesh)
        s[OUT + TORQUE_L * LANES + row] = region_torque(s[Z0 + row], s[ZR0 + row], region, mesh)
        s[ODD0 + row] = CALM if sure else UNKNOWN
    for row in range(2 * width):
        if s[ODD0 + row] != CALM:
            mesh = Backlash(s[K0 + row], s[D0 + row], s[DF0 + row], s[H0 + row])
            s[OUT + TORQUE_L * LANES + row] = mesh_torque(s[Z0 + row], s[ZR0 + row], mesh)


@njit
def slide_stage(s, width):
    """Speeds after the step, friction with exponent 1; how many bodies stop instead."""
    wide()
    stopping = 0
    for row in range(3 * width):
        new, stops = slide(
            s[V0 + row],
            s[S0 + row],
            s[P0 + row],
            s[MOBILITY + row],
            law(s, row, 1.0),
            s[SCALE + row],
            s[ADDED + row],
        )
        s[NEW + row] = new
        s[STOPS + row] = 1.0 if stops else 0.0
        stopping += 1 if stops else 0
    return stopping


@njit
def general_slide_stage(s, width):
    """The same with any exponent, which takes a power."""
    stopping = 0
    for row in range(3 * width):
        new, stops = slide(
            s[V0 + row],
            s[S0 + row],
            s[P0 + row],
            s[MOBILITY + row],
            law(s, row, s[DELTA + row]),
            s[SCALE + row],
            s[ADDED + row],
        )
        s[NEW + row] = new
        s[STOPS + row] = 1.0 if stops else 0.0
        stopping += 1 if stops else 0
    return stopping


@njit
def stop_stage(s, width):
    """The few bodies that come to rest within the step, where friction is no spring."""
    for row in range(3 * width):
        if s[STOPS + row] != 0.0 and s[DISTANCE + row] <= 0.0:
            s[NEW + row] = stop(
                s[V0 + row],
                s[NEW + row],
                s[P0 + row],
                s[MOBILITY + row],
                law(s, row, s[DELTA + row]),
                s[SCALE + row],
                s[ADDED + row],
            )


@njit
def presliding_stage(s, width, h):
    """Where friction is a spring before it slides, that instead; friction with exponent 1."""
    wide()
    for row in range(3 * width):
        distance = s[DISTANCE + row]
        gives = distance > 0.0
        new, bristle = preslide(
            s[V0 + row],
            s[S0 + row],
            s[P0 + row],
            s[MOBILITY + row],
            h,
            law(s, row, 1.0),
            s[SCALE + row],
            s[ADDED + row],
            (distance if gives else 1.0, s[AT_ONCE + row], s[BRISTLE_LAG + row]),
            s[BRISTLE + row],
        )
        s[NEW + row] = new if gives else s[NEW + row]
        s[BRISTLE + row] = bristle if gives else s[BRISTLE + row]


@njit
def general_presliding_stage(s, width, h):
    """The same with any exponent, which takes a power."""
    for row in range(3 * width):
        if s[DISTANCE + row] > 0.0:
            s[NEW + row], s[BRISTLE + row] = preslide(
                s[V0 + row],
                s[S0 + row],
                s[P0 + row],
                s[MOBILITY + row],
                h,
                law(s, row, s[DELTA + row]),
                s[SCALE + row],
                s[ADDED + row],
                (s[DISTANCE + row], s[AT_ONCE + row], s[BRISTLE_LAG + row]),
                s[BRISTLE + row],
            )


@njit
def level_stage(s, width, body, t, on):
    """Call the chain of friction with the mesh torque in A2."""
    at = body * LANES
    for lane in range(width):
        s[A0 + lane] = s[X0 + at + lane] + (1.0 if body == 2 else s[N2 + lane]) * s[LEAD + lane]
        s[A1 + lane] = s[S0 + at + lane]
        s[R0 + lane] = 1.0
        s[R1 + lane] = 0.0
    friction_lanes(s, width, body, t, on)
    for lane in range(width):
        s[SCALE + at + lane] = s[R0 + lane]
        s[ADDED + at + lane] = s[R1 + lane]


@njit
def levels(s, width, t, on):
    """Factor on friction and friction added, of all bodies."""
    for lane in range(width):
        s[A2 + lane] = s[T0 + lane]
    level_stage(s, width, 0, t, on)
    for lane in range(width):
        s[A2 + lane] = s[T1 + lane]
    level_stage(s, width, 1, t, on)
    for lane in range(width):
        s[A2 + lane] = abs(s[T0 + lane]) + abs(s[T1 + lane])
    level_stage(s, width, 2, t, on)


@njit
def ageing_stage(s, width, t, on):
    """Add what the age of the contacts adds to friction."""
    for body in range(3):
        at = body * LANES
        for lane in range(width):
            s[A0 + lane] = s[AGE + at + lane]
            s[R1 + lane] = 0.0
        ageing_lanes(s, width, body, t, on)
        for lane in range(width):
            s[ADDED + at + lane] += s[R1 + lane]


@njit
def grow_older(s, width, h):
    """Ages of the contacts in the middle of the next step."""
    for row in range(3 * width):
        s[AGE + row] = aged(s[AGE + row], s[NEW + row], h, s[RENEW + row])


@njit
def finish(s, width, h):
    """Changes of the speeds, speeds and angles at the end of the step."""
    wide()
    for row in range(3 * width):
        s[C0 + row] = s[NEW + row] - s[V0 + row]
        s[V0 + row] = s[NEW + row]
        s[Q0 + row] = s[X0 + row] + 0.5 * h * s[NEW + row]


@njit
def lag_stage(s, width, u, kept, side, h, on):
    """Mean voltage over the step behind the lag, in place."""
    for lane in range(width):
        s[A0 + lane] = s[u + lane]
    lag_lanes(s, width, side, 0.0, on)
    for lane in range(width):
        aim, tau = s[R0 + lane], s[R1 + lane]
        left = (s[kept + lane] - aim) * exp(-h / tau) if tau > 0.0 else 0.0
        s[u + lane] = aim + (s[kept + lane] - aim - left) * tau / h
        s[kept + lane] = aim + left


@njit
def drive_stage(s, width, side, t, on):
    """Voltage after the drive's effects, in place."""
    for lane in range(width):
        s[A0 + lane] = s[U0 + side * LANES + lane]
    drive_lanes(s, width, side, t, on)
    for lane in range(width):
        s[U0 + side * LANES + lane] = s[A0 + lane]


@njit
def motor_stage(s, width, y, z, force, side, t, on):
    """Add what the chain of the motor gives, seen at the pinion."""
    for lane in range(width):
        s[A0 + lane] = s[N1 + lane] * (s[y + lane] + s[N2 + lane] * s[LEAD + lane])
        s[A1 + lane] = s[N1 + lane] * s[z + lane]
        s[A2 + lane] = s[U0 + side * LANES + lane]
        s[R0 + lane] = 0.0
    motor_lanes(s, width, side, t, on)
    for lane in range(width):
        s[force + lane] += s[N1 + lane] * s[R0 + lane]


@njit
def load_stage(s, width, t, on):
    """Add what the chain of the load gives."""
    for lane in range(width):
        s[A0 + lane] = s[X2 + lane] + s[LEAD + lane]
        s[A1 + lane] = s[S2 + lane]
        s[R0 + lane] = 0.0
    load_lanes(s, width, 2, t, on)
    for lane in range(width):
        s[P2 + lane] += s[R0 + lane]


@njit
def motors_to_middle(s, width, h):
    """Like `to_middle`, of the motors behind elastic reducers."""
    for row in range(2 * width):
        s[Y0 + row] = s[M0 + row] + 0.5 * h * s[W0 + row]
        s[MS0 + row] = s[W0 + row] + 0.5 * s[B0 + row]


@njit
def shaft_stage(s, width, side, h, push):
    """Torque of an elastic reducer instead of the motor's; the motor's step."""
    at = side * LANES
    for lane in range(width):
        row = at + lane
        elastic = s[COMPLIANCE + lane] > 0.0
        drive = s[P0 + row] + s[T0 + row] - push
        shaft = (s[Y0 + row] - s[X0 + row]) / (s[COMPLIANCE + lane] if elastic else 1.0)
        shaft += s[SHAFT + lane] * (s[MS0 + row] - s[S0 + row])
        s[P0 + row] = (shaft if elastic else drive) - s[T0 + row] + push
        s[B0 + row] = h * (drive - shaft) / s[J_MOTOR + lane] if elastic else 0.0
        s[W0 + row] += s[B0 + row]
        s[M0 + row] = s[Y0 + row] + 0.5 * h * s[W0 + row]


@njit
def rigid(s, width, side):
    """Motors turn with their pinions where the reducer is not elastic."""
    at = side * LANES
    for lane in range(width):
        row = at + lane
        elastic = s[COMPLIANCE + lane] > 0.0
        s[M0 + row] = s[M0 + row] if elastic else s[Q0 + row]
        s[W0 + row] = s[W0 + row] if elastic else s[V0 + row]
        s[B0 + row] = s[B0 + row] if elastic else s[C0 + row]
