"""Cogging in the gyro's fast part, against a linear model, plain regression and other rigs."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from scipy.signal import freqz

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState, key_of
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import Trace, fast_gains
from dmptm_ctrl.drive import paper_drive, pinion_inertia
from dmptm_ctrl.identify.motion import motion
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.identify.ripple import FINER, WHITE, Ripple, answers, closed, order_gains
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

DT = 1e-3  # s
LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_turn_20", "open_sine_0v75")
LAWS = {"friction": "karnopp", "contact": "eq21"}
SEED = 9700001


def left_by(effects, sensors="load"):
    """What the declared model leaves of a rig's logs, and the rig's label."""
    rig = make_rig(SEED, effects, sensors=sensors, logs=LOGS, **LAWS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    return residual(measured, Model(paper_drive())), rig.label


@pytest.fixture(scope="module")
def cogging():
    return left_by((("cogging", 0.5),))


@pytest.fixture(scope="module")
def nothing():
    return left_by(())[0]


def test_answers_like_the_linear_drive():
    """A torque on either pinion turns the ring gear, both alike, as three bodies with springs."""
    drive = Model(paper_drive())
    jl, n2, k, c = (drive.drive[name] for name in ("J_L", "N_2", "k_m", "c"))
    mass = np.diag([pinion_inertia(drive.drive)] * 2 + [jl])
    twist = np.array([[1.0, 0.0, -n2], [0.0, 1.0, -n2]])
    spring = twist.T @ twist
    f = np.array([20.0, 60.0, 120.0, 200.0, 231.0, 300.0])  # Hz
    both = np.array([0.5, 0.5, 0.0]) / n2  # as a torque of 1 N·m at the ring gear
    w = 2.0 * np.pi * f
    exact = [
        1j * x * np.linalg.solve(-x * x * mass + (1j * x * c + k) * spring, both)[2] for x in w
    ]
    step = DT / FINER
    _, found = freqz(*answers(closed(drive.plant()), DT), w * step)
    # straight lines between points of a sine have sinc² of it
    assert found == pytest.approx(np.array(exact) * np.sinc(f * step) ** 2, rel=0.02)


def neighbours(row):
    """Largest correlation of a row's bulk with itself, some samples later."""
    bent = np.clip(row, *np.quantile(row, (0.01, 0.99)))
    return max(abs(bent[k:] @ bent[:-k]) / (bent @ bent) for k in range(1, WHITE + 1))


def test_what_nothing_explains_is_white(nothing):
    fast, coloured = nothing.fast, []
    for e, part in zip(fast.balance.equations, fast.base.parts, strict=True):
        if e.kind == "ripple":
            coloured.append(neighbours(fast.balance.ripples[e.motion].measured[e.used]))
            assert neighbours(part) < 0.15
    assert max(coloured) > 0.3


def test_scan_is_the_regression(cogging):
    """To first order the gain of an order is that of four columns made one by one."""
    plain = Trace(cogging[0])
    fast = plain.fast
    orders = (7, 15, 30, 47)
    found = fast_gains(fast, orders)
    without = plain.base.missing.size  # rows of the windows stand first
    for order, gain in zip(orders, found, strict=True):
        columns = []
        for name in ("left_cosine", "left_sine", "right_cosine", "right_sine"):
            model = fast.base.model.with_effect("cogging", order=float(order), **{name: 1e-3})
            moved = np.concatenate(fast.balance.missing(model)) - fast.base.missing
            columns.append((fast.base.weights * moved)[without:] / 1e-3)
        target = -(fast.base.weights * fast.base.missing)[without:]
        solved, *_ = np.linalg.lstsq(np.array(columns).T, target, rcond=None)
        exact = float(target @ np.array(columns).T @ solved)
        assert gain == pytest.approx(exact, rel=0.15, abs=2.0)


@pytest.mark.long
def test_names_it_without_motor_encoders(cogging):
    left, label = cogging
    reported = label["effect_parameters"]["cogging"]
    evidence, base = DualEvidence(left.measured), DualState(left)
    (found,) = evidence.candidates(base, [key_of("cogging")])
    assert found.acceptable
    after = evidence.closed(evidence.adopt(base, found))
    values = after.left.base.model.effects["cogging"]
    assert values["order"] == reported["order"]
    side = reported["location"]
    size = np.hypot(values[f"{side}_cosine"], values[f"{side}_sine"])
    assert size == pytest.approx(reported["amplitude_N_m"], rel=0.3)
    # nothing else lives on what it leaves
    others = ("base_vibration", "back_emf", "torque_constant_mismatch", "drive_delay")
    assert not any(c.acceptable for c in evidence.candidates(after, list(map(key_of, others))))


def test_logs_without_noise_or_without_calm_tell_nothing_wrong():
    """A speed that never ripples is white enough; no calm stretch, no gain."""
    model = Model(paper_drive())
    n = 2000
    speed = 0.2 * np.ones(n)
    angle = 0.2 * DT * np.arange(n)
    twist = 1.1 * model.drive["gap_l"] * np.ones((n, 2))
    still = np.zeros((2, n)), angle, speed, twist, np.zeros(6), DT * np.arange(n)
    rec = Record("still", DT, *still)
    ripple = Ripple(motion(rec, model))
    assert ripple.usable
    assert np.abs(ripple.missing(model.plant())).max() < 1e-9
    assert np.isfinite(ripple.colour).all()
    np.testing.assert_array_equal(order_gains([], 5), np.zeros(5))


def test_none_where_there_is_none(nothing):
    gains = fast_gains(Trace(nothing).fast, range(1, 97))
    # of 96 chances with four degrees of freedom each, 16 is exceeded in one rig of four
    assert gains.max() < 30.0
    (found,) = DualEvidence(nothing.measured).candidates(DualState(nothing), [key_of("cogging")])
    assert found.evidence < LEVEL
