"""The rigs' plant against closed forms and another integrator."""

import numpy as np
import pytest
from rigs.contact import eq21, two_state
from rigs.layout import ANGLE, GAP, MEMORY, RING, SPEED, STATES
from rigs.plant import advance, derivative, record_log
from rigs.rig import RING_ENCODER, draw_plant
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from rigs import experiments, nominal

DRIVE = 0.7  # V, both motors, forward


def table_rig(friction, contact):
    """The paper's values without any draw but the damping's."""
    return draw_plant(
        np.random.default_rng(0), {"friction": friction, "contact": contact}, spread=0.0
    )


def running(p, speed):
    """Both forward flanks in touch, everything turning at one speed [rad/s]."""
    y = np.zeros(STATES)
    twist = p["half_gap"] + 4.0 / p["stiffness"]  # 4 N·m in each mesh
    y[ANGLE : ANGLE + 2] = twist
    y[GAP : GAP + 2] = p["half_gap"]
    y[SPEED : SPEED + 2], y[SPEED + RING] = nominal.RING_RATIO * speed, speed
    return y


def rates(p):
    """The plant as a plain function of time and state."""
    volts, mode, m = np.full(2, DRIVE), np.zeros(3), np.zeros(MEMORY)

    def function(time, y):
        dy = np.zeros(STATES)
        derivative(time, y, dy, p, m, volts, mode, False)
        return dy

    return function


@pytest.mark.parametrize(
    "contact", ["two_state", "eq21", "kelvin_voigt", "hunt_crossley", "quadratic"]
)
def test_fourth_order_while_the_flanks_touch(contact):
    """Against DOP853 of scipy; friction by tanh, away from its turn."""
    p = table_rig("tanh", contact)[0]
    start, end = running(p, 0.3), 0.05
    exact = solve_ivp(rates(p), (0, end), start, "DOP853", rtol=1e-13, atol=1e-15).y[:, -1]
    errors = []
    for step in (2e-4, 1e-4, 5e-5):
        y, mode, work = start.copy(), np.zeros(3), np.zeros((3, STATES))
        for i in range(round(end / step)):
            advance(i * step, step, y, p, np.zeros(MEMORY), np.full(2, DRIVE), mode, work)
        errors.append(np.max(np.abs(y - exact)[SPEED : SPEED + 3]))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert np.all((orders > 3.75) & (orders < 4.75))


def test_resonances_of_the_closed_meshes():
    """Closed forms: sqrt(k/J3) and sqrt(k/J3 + 2 k N2^2/JL); damping moves them by < 1 %."""
    p = table_rig("tanh", "kelvin_voigt")[0]
    p["damping"] = 1.0
    y, function, small = running(p, 0.3), rates(p), 1e-7
    jacobian = np.empty((6, 6))
    for j in range(6):
        change = np.zeros(STATES)
        change[j] = small
        jacobian[:, j] = (function(0.0, y + change) - function(0.0, y - change))[:6] / (2 * small)
    found = np.abs(np.linalg.eigvals(jacobian)[np.abs(np.linalg.eigvals(jacobian).imag) > 1])
    k, pinion, ring = nominal.MESH_STIFFNESS, nominal.PINION_INERTIA, nominal.RING_INERTIA
    low = np.sqrt(k / pinion)
    high = np.sqrt(k / pinion + 2 * k * nominal.RING_RATIO**2 / ring)
    assert np.sort(found)[::2] == pytest.approx([low, high], rel=1e-2)


@pytest.mark.parametrize("friction", ["karnopp", "lugre", "tanh", "gms", "stribeck"])
@pytest.mark.parametrize("way", [1, -1])
def test_final_speed_balances_the_torques(friction, way):
    p = table_rig(friction, "two_state")[0]
    exponent = 0.5 if friction == "stribeck" else 1.0
    p["exponent"] = exponent
    log = run_constant(p, way * DRIVE, seconds=8.0)
    side = 0 if way > 0 else 1
    motor = nominal.REDUCER_RATIO * nominal.TORQUE_PER_VOLT * DRIVE

    def balance(speed):
        pinion = nominal.RING_RATIO * speed
        reducer = stribeck(nominal.REDUCER_FRICTION, side, pinion, exponent)
        ring = stribeck(nominal.RING_FRICTION, side, speed, exponent)
        return 2 * nominal.RING_RATIO * (motor - reducer) - ring

    assert log[3, -1] == pytest.approx(way * brentq(balance, 1e-3, 5.0), rel=1e-6)


def stribeck(table, side, speed, exponent=1.0):
    static, coulomb = table["static"][side], table["coulomb"][side]
    level = coulomb + (static - coulomb) * np.exp(-((speed / table["stribeck"][side]) ** exponent))
    return level + table["viscous"][side] * speed


def run_constant(p, volts, seconds):
    n = round(seconds * 1000)
    return record_log(p, np.full(n, volts), False, experiments.GAINS, 0.0, 0.1, np.zeros(n), 40)


@pytest.mark.parametrize(("friction", "drift"), [("karnopp", 0), ("lugre", 0.02), ("gms", 0.1)])
def test_held_by_friction(friction, drift):
    """0.1 V give 0.98 N·m at a pinion, its breakaway takes 2.8; drift in encoder counts."""
    log = run_constant(table_rig(friction, "eq21")[0], 0.1, seconds=5.0)
    pinion = log[4] / nominal.REDUCER_RATIO
    late = np.ptp(pinion[1000:]) / nominal.RING_RATIO
    assert late <= drift * RING_ENCODER


@pytest.mark.parametrize("speed", [0.05, 0.4, 2.0])
def test_both_gap_laws_touch_at_the_same_twist(speed):
    """At constant speed Eq. 21 is the solution of the two-state law."""
    gap, k, c, cf = 4e-3, 3.6e4, 5.0, 0.3
    z = -gap - c / k * speed  # where the other flank lets go
    end = 2 * gap / speed

    def place_rate(time, place):
        return [two_state.py_func(z + speed * time, speed, place[0], gap, k, c, cf)[1]]

    def reached(time, place):
        return place[0] - gap

    reached.terminal = True
    free = solve_ivp(
        place_rate, (0, 2 * end), [-gap * (1 - 1e-12)], "LSODA", events=reached,
        rtol=1e-12, atol=1e-18, first_step=1e-9,
    )  # fmt: skip
    touch = z + speed * free.t_events[0][0]
    below, above = (eq21.py_func(touch + d, speed, gap, k, c, cf) for d in (-1e-9, 1e-9))
    assert below == pytest.approx(cf * speed)
    assert above == pytest.approx(k * (touch + 1e-9 - gap) + c * speed, rel=1e-9)
