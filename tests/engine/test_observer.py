"""Runs corrected by measurements: any plant, any sensors, against a linear observer of SciPy's."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import expm

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.observer import Observer, observer_gains, rigid_observer
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.run import advance, start_state, structure_for

DT, SUBSTEPS, N = 1e-3, 256, 200
RIG = """
name = "two bodies"
[body.motor]
inertia = 0.002
viscous = 0.004
[body.arm]
inertia = 0.02
viscous = 0.03
{friction}
[shaft.gear]
between = ["motor", "arm"]
ratio = 3
stiffness = 20
damping = 0.02
[input.drive]
column = "u_V"
body = "motor"
gain = "0.5 N m/V"
[sensor.turn]
column = "a_rad"
body = "motor"
[sensor.speed]
column = "w_rad_s"
body = "arm"
[sensor.angle]
column = "q_rad"
body = "arm"
"""
U = 1.4 * np.sin(2 * np.pi * 7.0 * DT * np.arange(N))[None]
RNG = np.random.default_rng(4)
MEASURED = 0.05 * np.sin(9.0 * DT * np.arange(N)) + 1e-3 * RNG.standard_normal((2, N))


def plant_of(friction="", late=0.0):
    effects = (Placed("sensor_delay", "turn", {"delay": late}),) if late else ()
    return RigModel(parse_rig(RIG.format(friction=friction)), effects).plant()


def linear():
    """The same drive as x' = A x + b u, with x = (motor, arm angle, their speeds)."""
    k, c, n = 20.0, 0.02, 3.0
    twist = np.array([1.0, -n])
    inverse = np.diag([1 / 0.002, 1 / 0.02])
    a = np.zeros((4, 4))
    a[:2, 2:] = np.eye(2)
    a[2:, :2] = -inverse @ (k * np.outer(twist, twist))
    a[2:, 2:] = -inverse @ (c * np.outer(twist, twist) + np.diag([0.004, 0.03]))
    both = np.zeros((5, 5))
    both[:4, :4], both[2, 4] = a, 0.5 / 0.002
    both = expm(both * DT)
    return both[:4, :4], both[:4, 4]


def observer_run(plant, observer, measured, begun=None, u=U):
    if begun is None:
        count = plant.inertia.size
        begun = start_state(structure_for(plant), np.zeros(count), np.full(count, 0.3))
    return advance(plant, begun, u, DT, SUBSTEPS, observer=observer, measured=measured)


def test_luenberger_s_observer():
    """Two sensors, gains on all states: x⁺ = A (x + K (y − C x)) + b u."""
    plant = plant_of()
    gains = np.array([[0.2, 0.0], [0.05, 0.1], [3.0, 0.1], [0.5, 0.2]])
    found = observer_run(plant, Observer(np.array([0, 1]), gains, np.ones(2)), MEASURED)
    a, b = linear()
    c = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.0]])
    x, rows = np.array([0.0, 0.0, 0.3, 0.3]), []
    for i in range(N):
        rows.append(c @ x)
        x = x + gains @ (MEASURED[:, i] - rows[-1][:2])
        x = a @ x + b * U[0, i]
    missed = np.abs(found.readings - rows).max(axis=0)
    assert np.all(missed < 1e-4 * np.abs(rows).max(axis=0)), missed


def by_hand(gain, seen):
    """Readings of x⁺ = A (x + gain (y − x[seen])) + b u: turn, speed, angle."""
    a, b = linear()
    x, rows = np.array([0.0, 0.0, 0.3, 0.3]), []
    for i in range(N):
        rows.append([x[0], x[3], x[1]])
        x = a @ (x + gain * (MEASURED[0, i] - x[seen])) + b * U[0, i]
    return rows


@pytest.mark.parametrize("bandwidth_hz", [0.5, 5.0])
def test_a_slow_lead_is_an_observer_of_the_drifting_run(bandwidth_hz):
    """Of a train that turns freely: gains along the rigid mode, by hand."""
    plant, (angle, speed) = plant_of(), observer_gains(bandwidth_hz, DT)
    found = observer_run(plant, rigid_observer(plant, 2, (angle, speed)), MEASURED[:1])
    mode = np.array([3.0, 1.0])
    rows = by_hand(np.concatenate([angle * mode, speed * mode]), 1)
    missed = np.abs(found.readings - rows).max(axis=0)
    assert np.all(missed < 1e-4 * np.abs(rows).max(axis=0)), missed


def test_a_speed_leads_the_speed_alone():
    """By its first gain, and each miss is forgotten: x⁺ = A (x + K (y − C x)) + b u."""
    plant, gains = plant_of(), observer_gains(5.0, DT)
    found = observer_run(plant, rigid_observer(plant, 1, gains), MEASURED[:1])
    rows = by_hand(gains[0] * np.array([0.0, 0.0, 3.0, 1.0]), 3)
    missed = np.abs(found.readings - rows).max(axis=0)
    assert np.all(missed < 1e-4 * np.abs(rows).max(axis=0)), missed


@pytest.mark.parametrize("dt", [1e-4, 1e-2, 1.0])
def test_observers_of_any_sample_time_settle(dt):
    """Poles of [1 dt; 0 1] (I − K [1 0]) are inside the unit circle."""
    angle, speed = observer_gains(5.0, dt)
    closed = np.array([[1.0, dt], [0.0, 1.0]]) @ np.array([[1.0 - angle, 0.0], [-speed, 1.0]])
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0


def test_rigid_mode():
    """From either end of the train; the twist of its link is nothing."""
    plant = plant_of()
    np.testing.assert_allclose(untwisted(plant, 1), [3.0, 1.0])
    np.testing.assert_allclose(untwisted(plant, 0), [1.0, 1.0 / 3.0])


def test_what_rests_stays_at_rest():
    """Stiction holds: a miss moves the angle and no speed."""
    plant = plant_of(friction="coulomb = 0.5\nstatic = 5.0\nstribeck_speed = 0.5")
    begun = start_state(structure_for(plant), np.zeros(2), np.zeros(2))
    observer = rigid_observer(plant, 2, observer_gains(5.0, DT))
    found = observer_run(plant, observer, np.full((1, N), 1e-3), begun, np.zeros((1, N)))
    np.testing.assert_array_equal(found.v[:, 1], 0.0)
    assert found.readings[-1, 2] == pytest.approx(1e-3, abs=1e-8)


def test_a_late_angle_is_followed_where_it_is_read():
    """The angle of two samples ago: its miss moves what is still to be read, too."""
    plant = plant_of(late=2e-3)
    run = observer_run(plant, rigid_observer(plant, 0, (1.0, 0.0)), np.full((1, N), 0.7))
    assert np.abs(run.readings[10:, 0] - 0.7).max() < 0.05  # what it turns in a sample


@pytest.mark.parametrize("late", [0.0, 2e-3])
def test_lanes_are_led_alike(late):
    """Each by measurements of its own, beside each other."""
    plants = [plant_of(late=late)._replace(inertia=np.array([0.002, j])) for j in (0.01, 0.03)]
    observers = [rigid_observer(p, 0, observer_gains(5.0, DT)) for p in plants]
    own = MEASURED[:, None]
    starts = [(np.zeros(2), np.full(2, 0.3))] * 2
    nothing, seen = np.zeros((0, 0)), tuple(f"reading{i}" for i in range(3))
    common = Common(DT, SUBSTEPS, N, U[None], np.zeros((1, 1)), nothing, seen, measured=own)
    models = [SimpleNamespace(plant=lambda p=p: p) for p in plants]
    runs, _ = run_many(models, starts, common, observers=observers)
    for plant, observer, measured, run in zip(plants, observers, own, runs, strict=True):
        expected = observer_run(plant, observer, measured).readings.T
        np.testing.assert_allclose(run, expected, atol=1e-9)
