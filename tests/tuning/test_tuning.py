import control as ct
import numpy as np
import pytest

from dmptm_ctrl.control import assess_pi, close_speed_loop, common_mode, pi_controller, tune_pi
from dmptm_ctrl.control.tuning import gains_at
from dmptm_ctrl.drive import three_dof_ss

DEG = np.pi / 180
PLANT = three_dof_ss(outputs=("omega_L", "tau_l"))


def test_closed_form_gains_cross_one_with_the_margin():
    response, omega = 0.3 * np.exp(-1.2j), 20.0
    kp, ki = gains_at(response, omega, 55.0)
    crossed = (kp + ki / (1j * omega)) * response
    assert abs(crossed) == pytest.approx(1.0)
    assert 180 + np.degrees(np.angle(crossed)) == pytest.approx(55.0)


@pytest.mark.parametrize(("bandwidth", "margin"), [(1.0, 60.0), (5.0, 60.0), (5.0, 75.0)])
def test_tuning_meets_its_aims(bandwidth, margin):
    found = tune_pi(PLANT, bandwidth, margin)
    assert found.bandwidth_hz == pytest.approx(bandwidth, rel=0.01)
    assert found.phase_margin_deg == pytest.approx(margin, abs=0.5)
    # against python-control on the continuous loop; the hold costs 0.36° per 2 Hz
    loop = common_mode(PLANT) * pi_controller(found.kp, found.ki)
    gain_margin, phase_margin, _, crossover = ct.margin(ct.ss(loop.A, loop.B, loop.C, loop.D))
    assert phase_margin == pytest.approx(margin, abs=1.5)
    assert crossover / (2 * np.pi) == pytest.approx(found.crossover_hz, rel=0.01)
    assert 20 * np.log10(gain_margin) == pytest.approx(found.gain_margin_db, abs=4.0)
    # the hold, absent here, lifts the gain by a per cent
    closed = close_speed_loop(PLANT, found.kp, found.ki)(2j * np.pi * bandwidth)
    assert abs(closed[0, 0]) == pytest.approx(np.sqrt(0.5), rel=0.02)


def test_closed_loop_by_hand():
    """T = G C / (1 + G C), at frequencies on both sides of the bandwidth."""
    kp, ki = 0.08 / DEG, 1.5 / DEG
    closed = close_speed_loop(PLANT, kp, ki)
    assert closed.input_labels == ["ref"]
    assert closed.output_labels == ["omega_L", "u"]
    for w in (3.0, 30.0, 300.0):
        g, c = complex(common_mode(PLANT)(1j * w)), kp + ki / (1j * w)
        expected = [g * c / (1 + g * c), c / (1 + g * c)]
        np.testing.assert_allclose(closed(1j * w).ravel(), expected, rtol=1e-8)


def test_margins_of_the_rigs_gains():
    """The gains of the rigs' README, 0.08 V/(deg/s) and 1.5 V/deg."""
    found = assess_pi(PLANT, 0.08 / DEG, 1.5 / DEG)
    assert found.phase_margin_deg > 55
    assert found.gain_margin_db > 15


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: tune_pi(PLANT, 60.0), "resonance cross 1 again|unstable"),
        (lambda: tune_pi(PLANT, 5.0, 10.0), "between 20 and 90"),
        (lambda: tune_pi(PLANT, 300.0), "quarter of the sample rate"),
        (lambda: assess_pi(PLANT, 200.0, 100.0), "unstable at"),
        (lambda: common_mode(PLANT, "omega_9"), "no output 'omega_9'"),
        (lambda: common_mode(ct.rss(2, 1, 1)), "has y.0.; tune_controller takes a rig"),
        (lambda: common_mode(ct.rss(2, 1, 3)), "two motors make 2"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
