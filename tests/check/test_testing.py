"""The assertions for tests of others."""

import control as ct
import numpy as np
import pytest

import dmptm_ctrl as dm
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.drive.rigfile import load_rig
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.testing import assert_margins, assert_tracks

MASS, FORCE, DT = 4.0, 8.0, 1e-3  # kg, N/V, s
SLIDE = f"""
[body.table]
mass = "{MASS} kg"
[input.motor]
column = "u_V"
body = "table"
gain = "{FORCE} N/V"
[sensor.tape]
column = "v_mm_s"
body = "table"
"""


@pytest.fixture
def slide(tmp_path):
    """Drive of a rig file: a mass and nothing else, which every closed form knows."""
    (tmp_path / "rig.toml").write_text(SLIDE, encoding="utf-8")
    return RigModel(load_rig(tmp_path / "rig.toml"))


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


def test_margins_of_a_rig_file_s_drive_in_closed_form(slide):
    """PI on a mass: with its zero at ω₁ the phase margin is 60° where ω = √3 ω₁."""
    zero = 4.0
    kp = 3**0.5 * zero * (1 + 1 / 3) ** -0.5 * MASS / FORCE
    loop = dm.linearize(slide) * Controller(kp, kp * zero, model=slide).to_ss()
    assert_margins(loop, phase_deg=59.99)
    with pytest.raises(AssertionError, match="phase margin is 60 deg"):
        assert_margins(loop, phase_deg=60.01)
    with pytest.raises(AssertionError, match="unstable"):
        assert_margins(-1.0 * loop)


def test_margins_of_the_dual_motor_drive_by_its_frequency_response():
    """The crossover is looked up on a fine grid of frequencies."""
    pi = dm.tune_pi(dm.three_dof(dm.paper_drive()), bandwidth_hz=10.0, phase_margin_deg=60.0)
    plant = dm.common_mode(dm.three_dof(dm.paper_drive()))
    loop = plant * Controller(pi.kp, pi.ki).to_ss()
    response = loop(2j * np.pi * np.linspace(5.0, 20.0, 15_001))
    phase = 180.0 + np.rad2deg(np.angle(response[np.argmin(np.abs(np.abs(response) - 1.0))]))
    assert_margins(loop, phase_deg=phase - 0.05)
    with pytest.raises(AssertionError, match="phase margin is"):
        assert_margins(loop, phase_deg=phase + 0.05)


def test_tracking_error_of_a_rig_file_s_drive_in_closed_form(slide, tmp_path):
    """Held for a sample, P on a mass takes the same share off the error each time."""
    kp, speed = 2.0, 0.3
    left = (1.0 - kp * FORCE / MASS * DT) ** np.arange(800)
    rms = speed * np.sqrt(np.mean(left**2))
    target = np.full(left.size, speed)
    Controller(kp, 0.0, sample_time=DT, model=slide).save(tmp_path / "controller.toml")
    found = assert_tracks(slide, tmp_path / "controller.toml", target, rms=1.001 * rms)
    assert found == pytest.approx(rms, rel=1e-6)
    with pytest.raises(AssertionError, match=rf"is {rms:.4g} m/s rms; {0.999 * rms:.4g} is"):
        assert_tracks(slide, tmp_path / "controller.toml", target, rms=0.999 * rms)
