"""The proposed experiment separates what the logs at hand hardly do."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from tests.export.test_plant import RIG

from dmptm_ctrl.diagnosis.experiment import (
    SAMPLE_TIME,
    SECONDS,
    next_experiment,
    rig_experiment,
    separation,
)
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.diagnosis.select import Entry, Selection
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march as march_rig

LARGEST = 0.8  # V


def contested(one, other, volts, twist):
    """What :func:`next_experiment` reads: two fitted models that the logs hardly tell apart."""
    fits = [SimpleNamespace(fit=SimpleNamespace(model=model)) for _, model in (one, other)]
    keys = [f"{name}@here" for name, _ in (one, other)]
    rival = SimpleNamespace(keys=(keys[1],), fitted=(fits[1],))
    entry = SimpleNamespace(key=keys[0], rivals=(rival,), confusable_with=(keys[1],))
    rec = SimpleNamespace(u=volts, dt=SAMPLE_TIME, theta=np.zeros(volts.shape[1]))
    logs = SimpleNamespace(motions=[SimpleNamespace(rec=rec)])
    base = SimpleNamespace(left=SimpleNamespace(balance=logs, held=SimpleNamespace(motions=[])))
    final = SimpleNamespace(left=SimpleNamespace(base=fits[0].fit))
    selection = SimpleNamespace(entries=[entry], base=base, final=final)
    return next_experiment(selection, SimpleNamespace(has_motor_encoders=twist))


def alike(u):
    """Logs in which both motors get the same: a mismatch of opposite signs does not show."""
    return np.array([u, u])


def test_opposite_mismatch_against_nothing_needs_unlike_voltages():
    model = Model()
    mismatch = model.with_effect("torque_constant_mismatch", error=0.1, pattern=2.0)
    time = SAMPLE_TIME * np.arange(4000)
    logs = alike(LARGEST * np.sin(2 * np.pi * 0.5 * time))
    rivals = ("torque_constant_mismatch", mismatch), ("drive_offset", model)
    chosen = contested(*rivals, logs, False)
    assert chosen.against == ("torque_constant_mismatch", "drive_offset")
    left, right = chosen.volts
    assert np.abs(left - right).max() > 0.2
    assert np.abs(chosen.volts).max() <= LARGEST
    assert chosen.gain > 3.0 * chosen.so_far  # landing a little apart is all that these logs show


def test_table_is_a_signal_that_can_be_driven():
    model = Model()
    drag = model.with_effect("quadratic_drag", coefficient=20.0)
    logs = alike(LARGEST * np.ones(1000))
    chosen = contested(("quadratic_drag", drag), ("back_emf", model), logs, True)
    table = chosen.table()
    assert list(table.columns) == ["time_s", "u_left_V", "u_right_V"]
    assert len(table) == round(SECONDS / SAMPLE_TIME)
    np.testing.assert_allclose(np.diff(table["time_s"]), SAMPLE_TIME, rtol=1e-9)
    assert np.isfinite(table.to_numpy()).all()


def test_nothing_contested_needs_no_experiment():
    assert next_experiment(Selection(None, None), None) is None


def test_a_model_is_not_told_from_itself():
    model = Model()
    volts = alike(LARGEST * np.ones(500))
    one, other = (march(m, volts, rest(m, 0.0), SAMPLE_TIME) for m in (model, model))
    assert separation(one, other, SAMPLE_TIME, True) == 0.0


def test_of_a_rig_it_has_the_logs_sample_time_and_keeps_their_largest_signal():
    """At one steady speed drag and an offset are alike; at others they differ."""
    dt, size = 4e-3, 3.0
    rig = parse_rig(RIG, "rig.toml")
    drag = RigModel(rig).with_effect(Placed("quadratic_drag", "load", {"coefficient": 0.01}))
    u = np.full((1, 5000), size)
    run = march_rig(drag, u, dt)
    rng = np.random.default_rng(1)
    channels = {
        "in_voltage": u[0],
        "out_angle": run.reading("angle") + 1e-5 * rng.standard_normal(5000),
        "out_speed": run.speed("load") + 1.0 * rng.standard_normal(5000),
    }
    log = Log("steady", dt * np.arange(5000), channels)
    sensor = rig.sensors[1]
    runs = Runs(0.0, sensor, 20.0, (log,), (np.ones(5000, bool),), None, None, 0.0, 1)
    runs = replace(runs, after=[runs.seen(run.reading("speed"), dt)])
    balance = balance_of(rig, [log])
    evidence = RigEvidence(balance.part("fit"), balance.part("held-out"), 1)
    base = evidence.base(State(RigModel(rig)))
    keys = "quadratic_drag@load", "drive_offset@voltage"
    speed = 8.79  # rad/s of the load, where the drag leaves it; by the belt 5 times, 0.1 N·m/V
    offset = Placed("drive_offset", "voltage", {"offset": -0.01 * speed**2 / (5 * 0.1)})
    models = drag, RigModel(rig).with_effect(offset)
    found = {c.keys[0]: c for c in evidence.candidates(base, keys)}
    own, rival = (
        replace(one, fitted=(one.fitted[0], replace(one.fitted[1], state=State(model))))
        for one, model in zip((found[k] for k in keys), models, strict=True)
    )
    entry = Entry(keys[0], rival.gain, rival.held_gain, (replace(rival, objection=""),), base)
    selection = Selection(base, evidence.beside(base, own), [entry])
    chosen = rig_experiment(selection, runs)
    table = chosen.table()
    assert list(table.columns) == ["time_s", "voltage_V"]
    np.testing.assert_allclose(np.diff(table["time_s"]), dt, rtol=1e-9)
    assert 0.9 * size < np.abs(table["voltage_V"]).max() <= size
    assert chosen.against == keys
    assert chosen.gain > 2.0 * chosen.so_far
    assert rig_experiment(Selection(None, None), runs) is None
