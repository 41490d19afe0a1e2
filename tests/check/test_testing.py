"""The assertions for tests of others."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.testing import assert_margins, assert_tracks


def test_margins_of_a_loop_known_in_closed_form():
    """K / (s (s + 1)²) is stable up to K = 2; at K = 0.5 its gain margin is 12 dB."""
    loop = ct.tf([0.5], [1.0, 2.0, 1.0, 0.0])
    assert_margins(loop, gain_db=12.0, phase_deg=30.0)
    with pytest.raises(AssertionError, match=r"gain margin is 12 dB; it must be at least 12.1 dB"):
        assert_margins(loop, gain_db=12.1)
    with pytest.raises(AssertionError, match="phase margin is"):
        assert_margins(loop, phase_deg=80.0)
    with pytest.raises(AssertionError, match="sensitivity peaks"):
        assert_margins(loop, peak=1.1)
    with pytest.raises(AssertionError, match="unstable"):
        assert_margins(2.0 * loop * 2.2)


def test_margin_of_a_gain_that_may_fall():
    """K (s + 1)² / s³ is stable from K = 1/2 on: at K = 5 the gain may fall by 20 dB."""
    loop = ct.tf([5.0, 10.0, 5.0], [1.0, 0.0, 0.0, 0.0])
    assert_margins(loop, gain_db=19.9, phase_deg=60.0)
    with pytest.raises(AssertionError, match="gain margin is 20 dB"):
        assert_margins(loop, gain_db=20.1)


@pytest.mark.parametrize("loop", [3.0, ct.ss([[-1.0]], [[1.0, 1.0]], [[1.0]], 0.0)])
def test_what_is_no_loop_is_refused(loop):
    with pytest.raises(TypeError, match="from one to one signal"):
        assert_margins(loop)


def test_margins_of_a_sampled_loop():
    """K / (z − 1) is stable up to K = 2: at K = 0.5 the gain margin is 12 dB."""
    assert_margins(ct.tf([0.5], [1.0, -1.0], 1e-3), gain_db=12.0)
    with pytest.raises(AssertionError, match="unstable"):
        assert_margins(ct.tf([2.1], [1.0, -1.0], 1e-3))


def test_tracking_error_is_that_of_the_simulated_loop(tmp_path):
    controller = Controller(8.0, 100.0, preload=0.3)
    time = 1e-3 * np.arange(1500)
    target = 0.2 * np.sin(2 * np.pi * time)
    error = assert_tracks(Model(), controller, target, rms=0.5)
    from dmptm_ctrl.simulate.compiled import close_loop

    _, out = close_loop(Model(), controller.law(), target, 1e-3)
    assert error == pytest.approx(np.sqrt(np.mean((target - out[:, 1]) ** 2)))
    with pytest.raises(AssertionError, match="tracking error is"):
        assert_tracks(Model(), controller, target, rms=0.5 * error)
    controller.save(tmp_path / "controller.toml")
    assert assert_tracks(Model(), tmp_path / "controller.toml", target, rms=0.5) == error
