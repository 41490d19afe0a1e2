"""Responses from logs against filters whose response is known in closed form."""

import warnings
from contextlib import suppress

import numpy as np
import pytest
from scipy.signal import lfilter

from dmptm_ctrl.identify.frequency_response import from_log
from dmptm_ctrl.signals import Log

DT = 1e-3
TONES = np.array([0.7, 1.3, 2.9, 5.3, 8.9, 13.7, 21.1, 37.0])


def known(hz):
    """Of y[k] = 0.95 y[k−1] + 0.05 u[k−1]."""
    return 0.05 / (np.exp(2j * np.pi * np.asarray(hz) * DT) - 0.95)


def plant(u):
    return lfilter([0.0, 0.05], [1.0, -0.95], u)


def log(u, y, **more):
    return Log("run", DT * np.arange(u.size), {"u": u, "y": y, **more})


def multisine(seconds, tones=TONES, seed=0):
    t = DT * np.arange(round(seconds / DT))
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi, len(tones))
    return np.sin(2 * np.pi * np.outer(t, tones) + phase).sum(axis=1)


@pytest.mark.parametrize("segment", [10 / 3, 4.1])
def test_lines_between_the_bins_are_exact(segment):
    """No line is a whole number of cycles per segment."""
    u = multisine(20.0)
    found = from_log(log(u, plant(u)), "u", "y", lines=TONES, segment=segment)
    np.testing.assert_allclose(found.hz, TONES, rtol=1e-12)
    np.testing.assert_allclose(found.values, known(TONES), rtol=2e-3)
    assert (found.coherence > 0.999).all()


def test_a_periodic_log_gives_its_own_lines_and_no_others():
    """Rounded as loggers round, with a distortion that puts power where nothing excites."""
    u = np.round(multisine(40.0), 5)
    y = plant(u) + 0.02 * plant(u) ** 3
    found = from_log(log(u, y), "u", "y")
    np.testing.assert_allclose(found.hz, TONES, rtol=1e-9)
    linear = from_log(log(u, plant(u)), "u", "y")
    np.testing.assert_allclose(linear.values, known(TONES), rtol=1e-4)
    assert 20 * np.log10(np.abs(found.values)).max() < 1.0


def test_a_period_gives_no_line_to_which_nothing_answers():
    """Harmonics of a sine in few steps are excited, and far below the noise of the output."""
    t = DT * np.arange(20_000)
    u = np.round(8.0 * np.sin(2.0 * np.pi * 3.0 * t)) / 8.0
    y = plant(u) + 1e-2 * np.random.default_rng(5).normal(size=u.size)
    found = from_log(log(u, y), "u", "y")
    assert np.abs(found.hz - 3.0).min() < 1e-9
    assert 20 * np.log10(np.abs(found.values / known(found.hz))).max() < 6.0


def test_nothing_beyond_the_band_of_a_noise():
    """Excited below 20 Hz only; the output has noise of its own at all frequencies."""
    rng = np.random.default_rng(2)
    u = multisine(60.0, np.sort(rng.uniform(0.3, 20.0, 200)))  # without a common period
    y = plant(u) + 1e-2 * rng.normal(size=u.size)
    found = from_log(log(u, y), "u", "y")
    assert found.hz.max() < 23.0
    assert found.hz.size > 25
    clear = found.coherence > 0.99
    assert clear.mean() > 0.8
    np.testing.assert_allclose(found.values[clear], known(found.hz[clear]), rtol=0.1)


def test_noise_in_and_noise_out_gives_hardly_a_line():
    """Two noises that know nothing of each other: in twenty logs, one line by chance."""
    rng = np.random.default_rng(4)
    passed = 0
    for _ in range(20):
        run = log(*rng.normal(size=(2, 20_000)))
        with suppress(ValueError):  # no line is left
            passed += from_log(run, "u", "y", segment=1.0).hz.size
    assert passed <= 5


def test_asked_lines_that_nothing_excites_are_named():
    u = multisine(20.0)
    with pytest.warns(UserWarning, match="run: nothing excites 3.7 Hz; left out"):
        found = from_log(log(u, plant(u)), "u", "y", lines=[1.3, 3.7, 5.3], segment=5.0)
    np.testing.assert_allclose(found.hz, [1.3, 5.3])


def test_closed_loop_by_way_of_the_set_point():
    """Y/U of a loop whose noise is as large as its signal is the controller's; Y/R over U/R not."""
    rng = np.random.default_rng(8)
    ref = multisine(120.0, seed=3)
    noise = lfilter([1.0], [1.0, -0.9], rng.normal(size=ref.size))
    u, y, x = np.zeros(ref.size), np.zeros(ref.size), 0.0
    for k in range(ref.size):
        y[k] = x + noise[k]
        u[k] = 4.0 * (ref[k] - y[k])
        x = 0.95 * x + 0.05 * u[k]
    run = log(u, y, ref=ref)
    with pytest.warns(UserWarning, match="run is of a closed loop; the response of u is taken"):
        found = from_log(run, "u", "y", lines=TONES, segment=10.0)
    np.testing.assert_allclose(found.values, known(TONES), rtol=0.2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        from_log(run, "ref", "y", lines=TONES, segment=10.0)  # of the loop: nothing to warn of
    named = log(u, y, speed_setpoint=ref)
    with pytest.warns(UserWarning, match="taken by way of speed_setpoint"):
        from_log(named, "u", "y", lines=TONES, segment=10.0)
    still = log(u - 4.0 * ref, noise, ref=np.zeros(ref.size))
    with pytest.warns(UserWarning, match="ref stands still"):
        from_log(still, "u", "y")


@pytest.mark.parametrize(
    ("more", "said"),
    [
        ({"lines": [1.0, 1.2]}, "lines 0.2 Hz apart, or from 0, need segments of at least 5 s"),
        ({"lines": [600.0]}, "below 500 Hz"),
        ({"segment": 30.0, "lines": [1.0]}, "no two segments of 30 s"),
        ({"lines": [60.0]}, "no line from u to y is left"),
    ],
)
@pytest.mark.filterwarnings("ignore:run. nothing excites")
def test_refusals(more, said):
    u = multisine(20.0)
    with pytest.raises(ValueError, match=said):
        from_log(log(u, plant(u)), "u", "y", **more)


def test_a_still_input_is_refused():
    with pytest.raises(ValueError, match="run: u does not move"):
        from_log(log(np.ones(5000), np.zeros(5000)), "u", "y")
