"""Correlations and orders of a residual, against processes whose answers are known."""

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.signal import lfilter

from dmptm_ctrl.diagnosis.quality import autocorrelation, cross_correlation, order_amplitudes
from dmptm_ctrl.diagnosis.summary import correlated
from dmptm_ctrl.plots.quality import Orders, plot_correlation, plot_orders

STEP = 1 / 60


def noises(*sizes, seed=3):
    numbers = np.random.default_rng(seed)
    return [numbers.normal(size=n) for n in sizes]


def test_noise_stays_in_the_band():
    """1 % of many lags lie outside 99 %: binomial, 2000 of them, four standard deviations."""
    found = autocorrelation(noises(20_000, 30_000), 2000, STEP)
    assert abs(found.outside_percent - 1.0) < 4 * 100 * np.sqrt(0.01 * 0.99 / 2000)
    across = cross_correlation(noises(20_000), noises(20_000, seed=4), 1000, STEP)
    assert abs(across.outside_percent - 1.0) < 4 * 100 * np.sqrt(0.01 * 0.99 / 2001)
    assert found.lag[0] == pytest.approx(STEP)
    assert across.lag[1000] == 0.0


def test_autocorrelation_of_a_first_order_process():
    """x_k = 0.8 x_(k−1) + e has correlation 0.8^lag."""
    (noise,) = noises(200_000)
    found = autocorrelation([lfilter([1.0], [1.0, -0.8], noise)], 10, STEP)
    np.testing.assert_allclose(found.value, 0.8 ** np.arange(1, 11), atol=0.02)
    assert found.outside_percent == 100.0


def test_band_of_two_coloured_signals_that_have_nothing_to_do_with_each_other():
    """Slow signals correlate by chance; Bartlett's band knows, that of white noise does not."""
    one, other = (lfilter([1.0], [1.0, -0.9], e) for e in noises(40_000, 40_000))
    found = cross_correlation([one], [other], 300, STEP)
    white = 2.576 / np.sqrt(40_000)
    # Σ 0.9^|k| 0.9^|k| = (1 + 0.81) / (1 − 0.81)
    assert found.band[0] == pytest.approx(white * np.sqrt(1.81 / 0.19), rel=0.1)
    assert found.largest < 1.5
    assert np.abs(found.value).max() > 1.5 * white


def test_residual_that_follows_the_input_late():
    (u,) = noises(30_000)
    (e,) = noises(30_000, seed=8)
    found = cross_correlation([np.r_[np.zeros(7), u[:-7]] + e], [u], 20, STEP)
    assert found.lag[np.argmax(found.value)] == pytest.approx(7 * STEP)
    assert found.value.max() == pytest.approx(1 / np.sqrt(2), abs=0.02)


def test_orders_are_amplitudes_whatever_the_speed():
    """3 sin(2α) + 0.5 cos(7α + 1), run through at a speed that varies fourfold."""
    t = np.linspace(0.0, 1.0, 40_001)
    angle = 2 * np.pi * 10 * (t + 0.6 / (2 * np.pi) * np.sin(2 * np.pi * t))
    signal = 5.0 + 3.0 * np.sin(2 * angle) + 0.5 * np.cos(7 * angle + 1.0)
    weight = np.abs(np.gradient(angle))
    found = order_amplitudes(angle, signal, weight, 1.0, 7)[[0, 1, 4, 6]]
    np.testing.assert_allclose(found, [0.0, 3.0, 0.0, 0.5], atol=1e-3)


def test_correlated_parameters_are_named():
    covariance = np.array([[4.0, -5.7, 0.1], [-5.7, 9.0, 0.0], [0.1, 0.0, 1.0]])
    assert correlated(["J_m", "J_2", "c"], covariance) == [("J_2", "J_m", pytest.approx(-0.95))]


def test_pictures():
    found = autocorrelation(noises(1000), 30, STEP)
    panel = plot_correlation(found, found, ax=Figure().subplots())
    assert panel.get_xlabel() == "lag [s]"
    bank = np.linspace(0.1, 12, 50)
    panel = plot_orders(Orders(bank, bank, bank, "x [deg]", {"turn": 1.0}), ax=Figure().subplots())
    assert "[deg]" in panel.get_ylabel()
    assert [text.get_text() for text in panel.texts] == ["turn"]
