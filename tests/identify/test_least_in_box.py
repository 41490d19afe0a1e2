"""Bounded least squares by products of columns, against SciPy's by the columns themselves."""

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from dmptm_ctrl.identify.fit import least_in_box


@pytest.mark.parametrize("seed", range(12))
def test_least_in_a_box(seed):
    rng = np.random.default_rng(seed)
    k = int(rng.integers(1, 40))
    a = rng.normal(size=(k + 60, k)) @ (np.eye(k) + 0.9 * rng.normal(size=(k, k)) / np.sqrt(k))
    b = rng.normal(size=k + 60) + a @ rng.normal(size=k)
    low, high = -np.abs(rng.normal(size=k)), np.abs(rng.normal(size=k))
    low[rng.random(k) < 0.3], high[rng.random(k) < 0.3] = -np.inf, np.inf
    found = least_in_box(a.T @ a, a.T @ b, low, high)
    expected = lsq_linear(a, b, (low, high), method="bvls", tol=1e-14)
    assert np.all((found >= low) & (found <= high))
    left = 0.5 * float(np.sum((a @ found - b) ** 2))
    assert left == pytest.approx(expected.cost, rel=1e-10)
    np.testing.assert_allclose(found, expected.x, atol=1e-6)


def test_numbers_that_cannot_move_stay():
    a = np.array([[1.0, 0.5], [0.0, 1.0], [0.3, 0.2]])
    b = np.array([1.0, 2.0, 0.5])
    found = least_in_box(a.T @ a, a.T @ b, np.zeros(2), np.array([0.0, 10.0]))
    assert found[0] == 0.0
    assert found[1] == pytest.approx(a[:, 1] @ b / (a[:, 1] @ a[:, 1]), rel=1e-9)


def test_directions_that_nothing_determines_stay_put():
    rng = np.random.default_rng(3)
    a = rng.normal(size=(30, 4))
    a[:, 2], a[:, 3] = 0.0, a[:, 0]
    b = rng.normal(size=30)
    found = least_in_box(a.T @ a, a.T @ b, np.full(4, -5.0), np.full(4, 5.0))
    assert found[2] == 0.0
    assert np.abs(found).max() < 1.0  # two that are alike do not run against each other
    least = np.linalg.lstsq(a, b, rcond=None)[0]
    np.testing.assert_allclose(a @ found, a @ least, atol=1e-6)
    np.testing.assert_array_equal(
        least_in_box(np.zeros((3, 3)), np.zeros(3), -np.ones(3), np.ones(3)), np.zeros(3)
    )
