"""Ordinary imperfections and further laws of the dual rigs, against closed forms."""

import numpy as np
import pytest
from rigs.contact import quadratic
from rigs.drive import motor_torque
from rigs.experiments import GAINS, Experiment, multisine, sine
from rigs.friction import drag_anchors, slip_elements
from rigs.geometry import mesh_stiffness, pitch_error
from rigs.layout import CURRENT, ELEMENTS, MEMORY, RECORD, RING, STATES
from rigs.nominal import DEG, PINION_TEETH, REDUCER_RATIO, RING_RATIO
from rigs.ordinary import ORDINARY
from rigs.plant import advance, record_log
from rigs.rig import draw_plant, plain
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.signal import csd, welch

from rigs import experiments, make_rig, orders, worth


def bare(friction="karnopp", contact="kelvin_voigt"):
    laws = {"friction": friction, "contact": contact}
    return draw_plant(np.random.default_rng(0), laws, spread=0.0)


def raw(record, volts, start=0.1):
    zero = np.zeros(volts.size)
    return record_log(record[0], volts, False, GAINS, 0.0, start, zero, 20)


def test_slip_elements_follow_masing():
    """The loop's branches are the virgin curve, twice as large, from the turning point."""
    p, m, height = bare("gms").view(np.recarray)[0], np.zeros(MEMORY), 20.0
    bend, level = float(p["bristle"][RING]), float(p["coulomb"][RING, 0])

    def torque(angle):
        drag_anchors.py_func(p, m, RING, angle, height)
        return slip_elements.py_func(p, m, RING, angle, height)

    def virgin(angle):
        reach = bend * np.arange(1, ELEMENTS + 1) * height / (ELEMENTS * level)
        return np.sum(np.minimum(height / ELEMENTS, height / ELEMENTS * angle / reach))

    out = np.linspace(0, 0.8 * bend, 50)
    for angle in out:
        assert torque(angle) == pytest.approx(virgin(angle), abs=1e-9)
    for angle in np.linspace(out[-1], -out[-1], 80):
        branch = virgin(out[-1]) - 2 * virgin((out[-1] - angle) / 2)
        assert torque(angle) == pytest.approx(branch, abs=1e-9)
    assert torque(5 * bend) == pytest.approx(height)


def test_a_stiffening_flank_stores_the_energy_of_the_impact():
    """Depth at rest from 1/2 J w^2 = k d^2/2 + (k/5) k d^3/6; the flank pushes, never pulls."""
    gap, k, inertia, speed = 4e-3, 3.6e4, 0.25, 0.3

    def rates(time, y):
        return [y[1], -quadratic.py_func(y[0], y[1], gap, k, 0.0, 0.0) / inertia]

    run = solve_ivp(rates, (0, 0.02), [gap, speed], rtol=1e-10, atol=1e-13, max_step=1e-5)
    deep = brentq(
        lambda d: k * d**2 / 2 + k**2 * d**3 / 30 - inertia * speed**2 / 2, 0, 0.1, xtol=1e-12
    )
    assert run.y[0].max() - gap == pytest.approx(deep, rel=1e-5)
    assert run.y[1, -1] == pytest.approx(-speed, rel=1e-6)
    assert quadratic.py_func(gap + 1e-6, -1.0, gap, k, 5.0, 0.0) == 0.0


def test_pitch_errors_meet_their_teeth_smoothly():
    errors = np.random.default_rng(0).uniform(-1, 1, PINION_TEETH)
    teeth = 2 * np.pi * np.arange(-3, 25) / PINION_TEETH
    at = [pitch_error.py_func(errors, PINION_TEETH, a + 1e-12) for a in teeth]
    assert [e for e, _ in at] == pytest.approx([errors[i % PINION_TEETH] for i in range(-3, 25)])
    for angle in np.random.default_rng(1).uniform(-7, 7, 50):
        low, high = (pitch_error.py_func(errors, PINION_TEETH, angle + h)[0] for h in (-1e-6, 1e-6))
        slope = pitch_error.py_func(errors, PINION_TEETH, angle)[1]
        assert slope == pytest.approx((high - low) / 2e-6, abs=1e-4)


@pytest.mark.long
def test_pitch_errors_show_in_the_transmission_error():
    """A pinion ahead by an error turns the ring gear on by the error over the ratio."""
    record = bare()
    p = record.view(np.recarray)[0]
    ORDINARY["teeth_and_ripple"][0](p, np.random.default_rng(3))
    p["ring_pitch"], p["stiffness_ripple"] = 0.0, 1e-9
    log = raw(record, np.full(6000, 1.0))[:, 3000:]
    pinion = log[4] / REDUCER_RATIO
    error = log[2] - pinion / RING_RATIO
    wave = [pitch_error.py_func(p["pinion_pitch"][0], PINION_TEETH, a)[0] for a in pinion]
    slope = np.polyfit(wave, error, 1)[0]
    # 2 %: the mesh gives way to the pinion's acceleration
    assert slope == pytest.approx(1 / RING_RATIO, rel=0.02)


def test_mesh_stiffness_ripples_at_tooth_passing():
    p = bare().view(np.recarray)[0]
    p.stiffness_ripple = 0.2
    k = np.array([mesh_stiffness.py_func(p, 0, a) for a in 2 * np.pi / 20 * np.arange(64) / 64])
    assert k.mean() == pytest.approx(p.stiffness)
    assert (k.max() / k.min(), np.std(k) / k.mean()) == pytest.approx((1.5, 0.2 / np.sqrt(2)))


def test_usual_cogging_has_its_size_and_no_mean():
    """Two equal waves of 5 mN m: 5 mN m rms, 25 times that at the pinion."""
    p = bare().view(np.recarray)[0]
    ORDINARY["cogging"][0](p, np.random.default_rng(0))
    turn = 2 * np.pi * np.arange(360) / 360
    torque = np.array([motor_torque.py_func(p, 1, 0.0, angle, 0.0) for angle in turn])
    assert torque.mean() == pytest.approx(0.0, abs=1e-12)
    assert np.sqrt(np.mean(torque**2)) == pytest.approx(25 * 5e-3)


@pytest.mark.long
def test_loop_lag_is_one_of_first_order_beside_the_other():
    """Voltage after a time constant of a step: 1 - 1/e of it."""
    p = bare()[0]
    p["loop_lag"], p["lag"] = 1e-3, 2e-3
    y, work = np.zeros(STATES), np.zeros((3, STATES))
    for i in range(120):
        advance(i * 25e-6, 25e-6, y, p, np.zeros(MEMORY), np.ones(2), np.zeros(3), work)
    assert y[CURRENT] == pytest.approx(1 - np.exp(-1), rel=1e-8)


@pytest.mark.long
def test_the_gyro_is_a_low_pass():
    """Against 1/(1 + jf/80) at frequencies that the motion has."""
    record = bare()
    rng = np.random.default_rng(0)
    volts = 0.5 + multisine(rng.uniform(-3, 3, 10), 0.6, 20)
    plain_gyro = raw(record, volts)[3]
    record["gyro_bandwidth"] = 80.0
    filtered = raw(record, volts)[3]
    f, cross = csd(plain_gyro, filtered, fs=1000, nperseg=4000)
    found = cross / welch(plain_gyro, fs=1000, nperseg=4000)[1]
    for line in (2.9, 8.9, 21.1, 37.0):
        at = np.argmin(np.abs(f - line))
        assert found[at] == pytest.approx(1 / (1 + 1j * f[at] / 80), abs=0.01)


def test_viscous_friction_drifts_over_the_log():
    """The speed at the end is that of friction with its viscous part 15 % larger."""
    drift, larger, volts = bare(), bare(), np.full(8000, 0.7)
    drift["viscous_drift"] = 0.3
    larger["viscous"] *= 1.15
    drifted, end = raw(drift, volts)[3], raw(larger, volts)[3, -1]
    assert drifted[-1] == pytest.approx(end, rel=1e-2)  # it follows within 0.2 s of 8 s
    assert drifted[800] > 1.1 * end


def test_commands_within_one_step_are_one():
    record = bare()
    ORDINARY["quantisation"][0](record.view(np.recarray)[0], None)
    step = float(record["command_step"][0])
    logs = [raw(record, np.full(500, volts)) for volts in (150.7 * step, 151.3 * step)]
    np.testing.assert_array_equal(logs[0][2:], logs[1][2:])
    assert step == pytest.approx(20 / 4096)


def test_encoder_interpolation_is_in_the_reading_only():
    record = bare()
    true = raw(record, sine(1.0, 0.5, 3))
    ORDINARY["interpolation"][0](record.view(np.recarray)[0], np.random.default_rng(0))
    read = raw(record, sine(1.0, 0.5, 3))
    np.testing.assert_array_equal(true[3:], read[3:])
    assert np.std(read[2] - true[2]) == pytest.approx(2 / 3600 * DEG / np.sqrt(2), rel=0.1)


@pytest.fixture(scope="module")
def realistic():
    patch = pytest.MonkeyPatch()
    short = {
        "open": Experiment(False, sine(0.8, 1.0, 2), 0.1),
        "closed": Experiment(True, sine(12.0, 0.7, 2), 0.1),
    }
    patch.setattr(experiments, "mixed", lambda rng: short)
    yield make_rig(
        3, [("unbalance", 1.0), ("cogging", 0.5)], "all", "lugre", "quadratic", "mixed",
        logs=("closed_sine_15",), ordinary=True,
    )  # fmt: skip
    patch.undo()


def test_leaving_one_thing_out_leaves_the_others(realistic):
    whole, _ = realistic.recipe.record()
    fields = {}
    for key in realistic.recipe.things():
        other, _ = realistic.recipe.record(without=(key,))
        fields[key] = {
            n for n in RECORD.names if not np.array_equal(whole[n], other[n], equal_nan=True)
        }
    assert fields["unbalance"] == {"unbalance_cos", "unbalance_sin"}
    assert fields["usual_cogging"] == {"usual_cogging", "usual_cogging_phase"}
    assert fields["K_t"] == {"gain_error"}
    assert fields["law_lugre"] == {"law", "bristle"}
    assert fields["contact_quadratic"] == {"contact"}
    assert all(fields.values())


def test_worth_of_what_is_known(realistic):
    """A bias of 0.02 deg/s is an error of as much; what readings only have moves no mesh."""
    label = worth.label(realistic)
    things, floor = label["things"], label["floor_of_twins_deg_s"]
    bias = things["gyro_bias"]["rise_speed_below_30_Hz_deg_s"]
    assert bias == pytest.approx(0.02 - floor, abs=2e-4)
    rise = things["gyro_lag"]["rise_transmission_error_arcsec"]
    assert rise < 0  # no error at all is less than the twins have
    assert things["unbalance"]["material"]
    assert things["unbalance"]["name"] == "unbalance"
    assert not things["interpolation"]["material"]
    assert label["main_effects"] == ["unbalance", "cogging"]
    assert things["usual_cogging"] | {"main": True} != things["cogging"]


def test_an_effect_keeps_its_draw_whatever_stands_beside_it():
    alone, both = (
        make_rig(4, e, logs=("closed_sine_15",), ordinary=True).label["effect_parameters"]
        for e in ([("unbalance", 1.0)], [("unbalance", 1.0), ("cable_spring", 1.0)])
    )
    assert alone["unbalance"] == both["unbalance"]


@pytest.mark.parametrize("kind", orders.BLOCKS)
def test_a_plan_is_balanced_and_starts_the_same(kind):
    plan = orders.plan(kind, 7, 100)
    for lacks in set(orders.BLOCKS[kind]):
        share = orders.BLOCKS[kind].count(lacks)
        assert sum(order.lacks == lacks for order in plan) == 10 * share
    assert orders.plan(kind, 7, 30) == plan[:30]
    assert orders.plan(kind, 8, 30) != plan[:30]
    assert len({order.id for order in plan}) == 100
    counts = {"null": {0}, "single": {1}, "unknown": {1}, "pair": {2}, "triple": {3, 4}}
    assert all(len(order.effects) in counts[order.lacks] for order in plan)


def test_labels_are_plain():
    assert plain({"a": np.float64(1), "b": np.array([1, 2]), "c": np.bool_(True)}) == {
        "a": 1.0, "b": [1, 2], "c": True,
    }  # fmt: skip
