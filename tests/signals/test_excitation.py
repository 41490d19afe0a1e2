"""Against scipy.signal, closed forms and the FFT."""

import numpy as np
import pytest
from scipy import signal

from dmptm_ctrl.signals import excitation


def test_sine():
    time, u = excitation.sine(2.0, 5.0, 1.0, sample_time=1e-3)
    assert time.shape == u.shape == (1000,)
    np.testing.assert_allclose(u, 2.0 * np.sin(10 * np.pi * time), atol=1e-12)


@pytest.mark.parametrize("frequency", [0.3, 0.5, 5.0, 7.0])
def test_square_is_scipys(frequency):
    time, u = excitation.square(0.6, frequency, 6.0)
    expected = 0.6 * signal.square(2 * np.pi * frequency * time + 1e-9)
    np.testing.assert_array_equal(u, expected)


def test_chirp_is_scipys():
    time, u = excitation.chirp(1.5, 0.5, 40.0, 10.0)
    expected = 1.5 * signal.chirp(time, 0.5, 10.0, 40.0, method="logarithmic", phi=-90)
    np.testing.assert_allclose(u, expected, atol=1e-10)


def test_chirp_downwards():
    time, u = excitation.chirp(1.0, 40.0, 0.5, 10.0)
    expected = signal.chirp(time, 40.0, 10.0, 0.5, method="logarithmic", phi=-90)
    np.testing.assert_allclose(u, expected, atol=1e-10)


@pytest.mark.parametrize("seed", [None, 4])
def test_multisine_has_equal_lines_and_nothing_else(seed):
    lines = np.arange(3, 60, 2) * 0.5
    _, u = excitation.multisine(lines, 0.4, 2.0, seed=seed)
    assert np.sqrt(np.mean(u**2)) == pytest.approx(0.4, rel=1e-12)
    spectrum = np.abs(np.fft.rfft(u)) / (u.size / 2)
    frequency = np.fft.rfftfreq(u.size, 1e-3)
    at_line = np.isin(np.round(2 * frequency), np.round(2 * lines))
    np.testing.assert_allclose(spectrum[at_line], 0.4 * np.sqrt(2 / lines.size), rtol=1e-9)
    assert spectrum[~at_line].max() < 1e-12


def test_schroeder_phases_beat_random_ones():
    """Schroeder's crest factor stays near 1.7 for many lines; random phases are above 2.5."""
    lines = np.arange(1, 101)

    def crest(seed):
        _, u = excitation.multisine(lines, 1.0, 1.0, sample_time=1e-4, seed=seed)
        return np.abs(u).max()

    assert crest(None) < 1.9
    assert min(crest(seed) for seed in range(20)) > 1.9


def test_seed_decides():
    one, two, other = (excitation.multisine([1, 2, 3], 1.0, 1.0, seed=s)[1] for s in (1, 1, 2))
    np.testing.assert_array_equal(one, two)
    assert not np.array_equal(one, other)


def test_stepped_sine_joins_at_zero():
    time, u = excitation.stepped_sine(1.0, [2.0, 5.0, 10.0], 3, sample_time=1e-4)
    assert time.size == round((3 / 2 + 3 / 5 + 3 / 10) / 1e-4)
    first = time < 1.5 - 1e-9
    np.testing.assert_allclose(u[first], np.sin(4 * np.pi * time[first]), atol=1e-12)
    last = time > 2.1 + 1e-9
    np.testing.assert_allclose(u[last], np.sin(20 * np.pi * (time[last] - 2.1)), atol=1e-9)
    assert np.abs(np.diff(u)).max() < 2 * np.pi * 10 * 1e-4 * 1.01  # no jump at the joints


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: excitation.sine(1, 500.0, 1.0), "500 Hz is not between 0 and 500 Hz"),
        (lambda: excitation.sine(1, 1.0, 0.0), "do not make one sample"),
        (lambda: excitation.sine(1, 1.0, np.inf), "do not make one sample"),
        (lambda: excitation.square(1, -1.0, 1.0), "-1 Hz is not between"),
        (lambda: excitation.multisine([], 1, 1.0), "no frequency"),
        (lambda: excitation.chirp(1, 0.0, 5.0, 1.0), "0 Hz is not between"),
        (lambda: excitation.chirp(1, 5.0, 5.0, 1.0), "is a sine"),
        (lambda: excitation.stepped_sine(1, [1.0], 0), "0 periods"),
        (lambda: excitation.sine(1, np.nan, 1.0), "nan Hz"),
    ],
)
def test_bad_parameters(call, message):
    with pytest.raises(ValueError, match=message):
        call()
