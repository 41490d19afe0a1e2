"""The proposed experiment separates what the logs at hand hardly do."""

from types import SimpleNamespace

import numpy as np

from dmptm_ctrl.diagnosis.experiment import SAMPLE_TIME, SECONDS, apart, next_experiment
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model

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
    assert apart(one, other, SAMPLE_TIME, True) == 0.0
