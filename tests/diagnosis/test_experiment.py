"""The proposed experiment separates what the logs at hand hardly do."""

from types import SimpleNamespace

import numpy as np

from dmptm_ctrl.diagnosis.experiment import SAMPLE_TIME, SECONDS, apart, next_experiment
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model

LARGEST = 0.8  # V


def decision(one, other, volts):
    """What :func:`next_experiment` reads of a decision between two fitted models."""
    trials = [SimpleNamespace(name=name, fit=SimpleNamespace(model=m)) for name, m in (one, other)]
    found = SimpleNamespace(
        name=one[0], trial=trials[0], rivals=trials[1:], confusable_with=(other[0],)
    )
    rec = SimpleNamespace(u=volts, dt=SAMPLE_TIME, theta=np.zeros(volts.shape[1]))
    balance = SimpleNamespace(motions=[SimpleNamespace(rec=rec)])
    empty = SimpleNamespace(motions=[])
    return SimpleNamespace(found=[found], before=SimpleNamespace(balance=balance, held=empty))


def alike(u):
    """Logs in which both motors get the same: a mismatch of opposite signs does not show."""
    return np.array([u, u])


def test_opposite_mismatch_against_nothing_needs_unlike_voltages():
    model = Model()
    mismatch = model.with_effect("torque_constant_mismatch", error=0.1, pattern=2.0)
    time = SAMPLE_TIME * np.arange(4000)
    logs = alike(LARGEST * np.sin(2 * np.pi * 0.5 * time))
    chosen = next_experiment(
        decision(("torque_constant_mismatch", mismatch), ("drive_offset", model), logs), False
    )
    left, right = chosen.volts
    assert np.abs(left - right).max() > 0.2
    assert np.abs(chosen.volts).max() <= LARGEST
    assert chosen.gain > 3.0 * chosen.so_far  # landing a little apart is all that these logs show


def test_table_is_a_signal_that_can_be_driven():
    model = Model()
    drag = model.with_effect("quadratic_drag", coefficient=20.0)
    logs = alike(LARGEST * np.ones(1000))
    chosen = next_experiment(decision(("quadratic_drag", drag), ("back_emf", model), logs), True)
    table = chosen.table()
    assert list(table.columns) == ["time_s", "u_left_V", "u_right_V"]
    assert len(table) == round(SECONDS / SAMPLE_TIME)
    np.testing.assert_allclose(np.diff(table["time_s"]), SAMPLE_TIME, rtol=1e-9)
    assert np.isfinite(table.to_numpy()).all()


def test_nothing_contested_needs_no_experiment():
    assert next_experiment(SimpleNamespace(found=[]), True) is None


def test_a_model_is_not_told_from_itself():
    model = Model()
    volts = alike(LARGEST * np.ones(500))
    one, other = (march(m.arrays(), volts, rest(m, 0.0), SAMPLE_TIME) for m in (model, model))
    assert apart(one, other, SAMPLE_TIME, True) == 0.0
