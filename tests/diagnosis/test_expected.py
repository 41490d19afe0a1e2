"""The motion to be expected: the mean of several runs, side by side or one by one."""

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.predict import TOGETHER, expected
from dmptm_ctrl.simulate.compiled import rest
from dmptm_ctrl.simulate.model import Model

DT, COUNT = 1e-3, 150
VOLTS = np.tile(np.r_[np.zeros(10), np.full(COUNT - 10, 0.8)], (2, 1))


def test_side_by_side_is_one_by_one(monkeypatch):
    model = Model()
    x0 = rest(model, 0.1)
    together = expected(model, VOLTS, x0, DT)
    monkeypatch.setitem(expected.__globals__, "TOGETHER", 0)
    one_by_one = expected(model, VOLTS, x0, DT)
    assert np.ptp(together[:, 1]) > 0.01  # it moves
    np.testing.assert_allclose(together, one_by_one, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("most", [0, TOGETHER])
@pytest.mark.parametrize("runs", [1, 4])
def test_only_the_columns_that_are_asked_for(monkeypatch, most, runs):
    model = Model()
    x0 = rest(model, 0.1)
    monkeypatch.setitem(expected.__globals__, "TOGETHER", most)
    whole = expected(model, VOLTS, x0, DT, runs=runs)
    some = expected(model, VOLTS, x0, DT, runs=runs, columns=(1, 0))
    np.testing.assert_array_equal(some, whole[:, [1, 0]])


def test_mean_of_runs_that_differ_in_their_meshes():
    model = Model()
    x0 = rest(model, 0.1)
    single = expected(model, VOLTS, x0, DT, runs=1)
    share = 0.003 * np.random.default_rng(0).standard_normal((1, 2))[0]
    other = model.with_values(
        **{k: model.drive[k] * (1.0 + x) for k, x in zip(("k_m", "c"), share, strict=True)}
    )
    both = 0.5 * (single + expected(other, VOLTS, x0, DT, runs=1))
    np.testing.assert_allclose(expected(model, VOLTS, x0, DT, runs=2), both, rtol=1e-6, atol=1e-9)


def test_runs_begin_anywhere_in_the_count_of_the_encoder():
    """Where what turns with the motors depends on the angle, their mean is another; else not."""
    rounded, x0 = 1e-3, rest(Model(), 0.1)
    cogging = Model().with_effect("cogging", left_cosine=0.05, order=6.0)
    for model, differs in ((Model(), False), (cogging, True)):
        exact = expected(model, VOLTS, x0, DT, runs=4)[:, 1]
        begun = expected(model, VOLTS, x0, DT, runs=4, count=rounded)[:, 1]
        assert (np.abs(begun - exact).max() > 1e-3 * np.ptp(exact)) == differs
