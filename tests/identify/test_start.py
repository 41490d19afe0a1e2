"""Where a run begins that a sensor reads at another angle."""

import numpy as np
import pytest

from dmptm_ctrl.identify.records import RING_COUNT, record, started, true_angle
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Model

ERROR = {"cosine": 2.6e-4, "sine": -7.7e-5}  # rad
ANGLE = -0.236  # rad


def at_rest(model, aside=0.0):
    """A log at rest, its pinions `aside` of mid-gap [rad], as the sensors of a model read it."""
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    reading = ANGLE + ERROR["cosine"] * np.cos(ANGLE) + ERROR["sine"] * np.sin(ANGLE)
    count = 50
    channels = dict.fromkeys(("u_left", "u_right", "omega_L"), np.zeros(count))
    channels["theta_L"] = np.full(count, reading)
    channels |= dict.fromkeys(("theta_ml", "theta_mr"), np.full(count, n1 * (n2 * ANGLE + aside)))
    return Log("rest", 1e-3 * np.arange(count), channels)


@pytest.fixture
def model():
    return Model().with_effect("encoder_eccentricity", **ERROR)


def test_angle_behind_a_reading(model):
    reading = float(at_rest(model)["theta_L"][0])
    assert reading != pytest.approx(ANGLE, abs=1e-5)
    assert true_angle(model, reading) == pytest.approx(ANGLE, abs=1e-12)
    assert true_angle(Model(), reading) == reading


def test_pinions_start_in_the_middle_of_their_gaps(model):
    """By the reading alone they would be aside by ten counts."""
    n2 = model.drive["N_2"]
    rec = record(at_rest(model), model.drive)
    assert abs(rec.x0[0] - n2 * rec.x0[2]) > 8.0 * n2 * RING_COUNT
    begun = started(rec, model)
    np.testing.assert_allclose(begun.x0[:3], [n2 * ANGLE, n2 * ANGLE, ANGLE], atol=1e-9)
    assert rec.x0[2] != begun.x0[2]


def test_pinions_start_aside_where_the_encoders_say_so(model):
    aside = 2e-3
    rec = started(record(at_rest(model, aside), model.drive), model)
    n2 = model.drive["N_2"]
    np.testing.assert_allclose(rec.x0[:2] - n2 * rec.x0[2], aside, rtol=1e-6)


def quantised(left=0.0):
    """A log that begins at rest, then turns, as a plant's encoders of 2^18 and 10 000 count it.

    `left` is how far the left motor is ahead at first, in its counts.
    """
    drive, time = Model().drive, 1e-3 * np.arange(400)
    ratio, count = drive["N_1"] * drive["N_2"], 2 * np.pi / 10_000
    angle = ANGLE + 0.05 * np.maximum(time - 0.1, 0.0) ** 2
    motors = [count * (np.round(ratio * angle / count) + more) for more in (left, 0.0)]
    channels = dict.fromkeys(("u_left", "u_right", "omega_L"), 0.0 * time)
    channels["theta_L"] = RING_COUNT * np.round(angle / RING_COUNT)
    channels |= {"theta_ml": motors[0], "theta_mr": motors[1]}
    return Log("turns", time, channels), drive


def test_motors_tell_the_angle_more_finely_than_the_ring_encoder():
    log, drive = quantised()
    finer = np.pi / 10_000 / (drive["N_1"] * drive["N_2"])  # rad, half a count of theirs
    assert abs(log["theta_L"][0] - ANGLE) > 3.0 * finer
    rec = record(log, drive)
    assert rec.x0[2] == pytest.approx(ANGLE, abs=1.01 * finer)
    np.testing.assert_allclose(rec.x0[:2], drive["N_2"] * rec.x0[2])


def test_motors_that_disagree_do_not():
    log, drive = quantised(left=2.0)
    assert record(log, drive).x0[2] == log["theta_L"][0]
