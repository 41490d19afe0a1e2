"""The meshes' damping of rigs of another program is identified by how strongly they chatter."""

import numpy as np
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.impact_chatter import (
    bands,
    fed_back,
    powers,
    quiet,
    tie,
    with_chatter,
)
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.records import record
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_sine_0v75", "closed_square_10", "closed_square_15")


@pytest.mark.parametrize(("seed", "friction"), [(904, "karnopp"), (910, "tanh")])
def test_damping_from_rattle(seed, friction):
    """Twice the declared 3 N·m·s/rad and more; all else is fitted too."""
    rig = make_rig(seed, friction=friction, contact="two_state", sensors="all", logs=LOGS)
    true = rig.label["plant"]["damping"]
    drive = paper_drive()
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, drive)
    start = residual(measured, Model(drive)).base
    values, spread = start.p.copy(), start.covariance.copy()
    done = with_chatter(measured.fit, start, drive, 2)
    np.testing.assert_array_equal(start.p, values)  # it is left as it was
    np.testing.assert_array_equal(start.covariance, spread)
    found = done.model.drive["c"]
    (j,) = (j for j, k in enumerate(done.unknowns) if k.name == "c")
    error = done.unknowns[j].scale * np.sqrt(done.covariance[j, j])
    assert abs(found - true) < 2.0 * error
    assert abs(np.log(found / true)) < 0.6 * abs(np.log(drive["c"] / true))
    held = measured.held_logs
    as_declared = done.model.with_values(c=drive["c"])
    assert speed_error(done.model, held)["rmse"] < speed_error(as_declared, held)["rmse"]


def test_known_damping_is_left_alone():
    rig = make_rig(901, friction="karnopp", contact="two_state", sensors="all", logs=LOGS)
    drive = paper_drive().with_values(c=2.0)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, drive)
    start = residual(measured, Model(drive)).base
    fixed = tuple(k for k in start.unknowns if k.name not in ("c", "c_f"))
    known = residual(measured, Model(drive), unknowns=fixed).base
    done = with_chatter(measured.fit, known, drive, 2)
    assert done.model.drive["c"] == 2.0
    np.testing.assert_allclose(done.p, known.p, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(done.covariance, known.covariance)


def test_a_closed_loop_is_told_by_the_voltages():
    """They follow from the speed reading, noise and all; those of an open loop do not."""
    rig = make_rig(904, friction="karnopp", contact="two_state", sensors="all", logs=LOGS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    reported = {log.name: fed_back(record(log, paper_drive())) for log in logs}
    assert reported == {name: name.startswith("closed") for name in LOGS}


def test_noise_is_taken_from_the_quietest_windows_without_bias():
    """3e-3 rad/s of noise, white to 500 Hz, and a rattle in two of every ten seconds."""
    generator = np.random.default_rng(1)
    dt, deviation = 1e-3, 3e-3
    times = np.arange(60_000) * dt
    noise = deviation * generator.standard_normal(times.size)
    loud = 0.1 * np.sin(2 * np.pi * 90.0 * times) + 0.1 * np.sin(2 * np.pi * 300.0 * times)
    speed = noise + np.where(times % 10.0 < 2.0, loud, 0.0)
    white = [2.0 * dt * deviation**2 * (b - a) for a, b in bands(dt)]
    np.testing.assert_allclose(quiet(powers(speed, dt), dt), white, rtol=0.1)


def test_an_unknown_that_follows_others():
    generator = np.random.default_rng(2)
    root = generator.standard_normal((4, 4))
    covariance = root @ root.T
    before = covariance.copy()
    rest, slopes = [0, 1, 3], np.array([0.5, -2.0, 0.0, 1.0])
    tie(covariance, 2, slopes, 0.3)
    np.testing.assert_array_equal(covariance[np.ix_(rest, rest)], before[np.ix_(rest, rest)])
    follows = np.linalg.solve(covariance[np.ix_(rest, rest)], covariance[rest, 2])
    np.testing.assert_allclose(follows, slopes[rest], atol=1e-12)
    np.testing.assert_allclose(covariance[2, 2] - follows @ covariance[rest, 2], 0.3)
    tie(covariance, 2, np.zeros(4), covariance[2, 2])
    assert not covariance[2, rest].any()
