import control as ct
import numpy as np
import pytest

from dmptm_ctrl.control import common_mode
from dmptm_ctrl.control.pi import loop_response
from dmptm_ctrl.drive import baseline_drive, three_dof_ss
from dmptm_ctrl.identify.frequency_response import from_log, multisine, stepped_sine
from dmptm_ctrl.identify.loop_resonance import closed_loop_peak, resonant_gains
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.linear import linearize, turning
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
LINEAR = baseline_drive().with_values(gap_l=0.0, gap_r=0.0)
HZ = [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]


def sampled(omega, dt=1e-3):
    """Linear model with held input, at z = e^{jωT}, by python-control."""
    plant = common_mode(three_dof_ss(LINEAR))
    held = ct.c2d(ct.ss(plant.A, plant.B, plant.C, plant.D), dt, "zoh")
    return np.array([complex(held(np.exp(1j * w * dt))) for w in omega])


@pytest.mark.parametrize("measure", [stepped_sine, multisine])
def test_linear_drive_against_python_control(measure):
    found = measure(Model(LINEAR), HZ, 0.5)
    assert isinstance(found.response, ct.FrequencyResponseData)
    np.testing.assert_allclose(found.hz, HZ, rtol=1e-9)
    np.testing.assert_allclose(found.values, sampled(found.response.omega), rtol=5e-4)
    np.testing.assert_allclose(found.coherence, 1.0, atol=1e-4)


def test_gain_grows_with_amplitude_under_dry_friction():
    """Dry friction takes a fixed torque: the larger the voltage, the larger the gain."""
    small, large = (stepped_sine(Model(), [1.0, 3.0], a) for a in (0.6, 0.75))
    assert (abs(large.values) > 1.2 * abs(small.values)).all()
    assert (small.coherence < 0.99).all()  # sticking makes harmonics
    assert (large.coherence > small.coherence).all()


@pytest.mark.parametrize("measure", [stepped_sine, multisine])
def test_about_a_preloaded_turn_the_drive_is_linear(measure):
    """Against the linearised blocks behind a hold: no gap opens, no friction turns round."""
    model, hz, sample_time = Model(), np.array([5.0, 20.0]), 5e-4
    state, volts = turning(model, speed=0.35, preload=0.6)
    offset, preload = volts.mean(), 0.5 * (volts[0] - volts[1])
    found = measure(model, hz, 0.05, offset=offset, preload=preload, sample_time=sample_time)
    plant = common_mode(linearize(model, state, volts))
    wanted = [loop_response(plant, 2 * np.pi * f, sample_time) for f in hz]
    np.testing.assert_allclose(found.values, wanted, rtol=0.01)


def test_below_breakaway_nothing_moves():
    found = stepped_sine(Model(), [1.0], 0.2)
    assert found.values[0] == 0.0
    assert found.coherence[0] == 0.0


def test_multisine_agrees_with_stepped_sine_in_order():
    """Not the same quantity where the drive is nonlinear, but the same drive."""
    tones = stepped_sine(Model(), [0.5, 1.0, 2.0], 10 * DEG, loop=Loop(0.08 / DEG, 1.5 / DEG, 10.0))
    lines = multisine(
        Model(), [0.5, 1.0, 2.0], 10 * DEG / 2**0.5, loop=Loop(0.08 / DEG, 1.5 / DEG, 10.0)
    )
    np.testing.assert_allclose(abs(lines.values), abs(tones.values), rtol=0.1)
    assert (lines.coherence > 0.97).all()


def test_from_log_recovers_a_known_filter():
    """White input through a known discrete filter, output noise of known power."""
    rng, dt = np.random.default_rng(5), 1e-3
    u = rng.normal(size=120_000)
    y = np.zeros_like(u)
    for i in range(1, u.size):
        y[i] = 0.95 * y[i - 1] + 0.05 * u[i - 1]
    noisy = y + 0.05 * rng.normal(size=u.size)
    log = Log("filter", dt * np.arange(u.size), {"u_left": u, "u_right": u, "omega_L": noisy})
    found = from_log(log, ("u_left", "u_right"), "omega_L", lines=[5, 10, 40, 100])
    z = np.exp(1j * found.response.omega * dt)
    expected = 0.05 / (z - 0.95)
    segments = 119  # half overlapping Hann: about 1.9 segments of 2 s count as two
    power = abs(expected) ** 2 / (abs(expected) ** 2 + 0.05**2)
    spread = abs(expected) * np.sqrt((1 - power) / power / segments)
    assert (abs(found.values - expected) < 4 * spread + 0.01 * abs(expected)).all()
    np.testing.assert_allclose(found.coherence, power, atol=0.06)


def test_closed_loop_resonance_of_a_linear_drive():
    """Peak of |T| of the linear loop, by python-control on a fine grid."""
    loop, dt = Loop(0.05 / DEG, 5.0 / DEG, 1e3), 1e-3
    hz, peak, inside = closed_loop_peak(Model(LINEAR), loop, 10 * DEG, 5.0)
    assert inside
    omega = 2 * np.pi * np.linspace(3, 9, 2000)
    z = np.exp(1j * omega * dt)
    open_loop = sampled(omega) * (loop.kp + loop.ki * dt / (1 - 1 / z))
    gain = abs(open_loop / (1 + open_loop))
    assert hz == pytest.approx(omega[gain.argmax()] / (2 * np.pi), rel=0.01)
    assert peak == pytest.approx(gain.max(), rel=0.01)


def test_gains_for_the_papers_resonance():
    """5.5 Hz: with kp 0.08 V/(deg/s), ki is near 6 V/deg; twice the kp damps it."""
    found = resonant_gains(Model(), 5.5, 0.08 / DEG, 10 * DEG)
    assert found.hz == pytest.approx(5.5, abs=0.06)
    assert found.ki * DEG == pytest.approx(6.03, abs=0.15)
    assert 1.4 < found.peak < 1.8
    again = stepped_sine(
        Model(), [4.0, found.hz, 7.0], 10 * DEG, loop=Loop(found.kp, found.ki, 10.0), periods=12
    )
    assert abs(again.values).argmax() == 1


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: stepped_sine(Model(), [200.0], 0.5), "up to 125 Hz"),
        (lambda: stepped_sine(Model(), [1.0], 0.5, output="omega_9"), "no output 'omega_9'"),
        (lambda: multisine(Model(), [1.0], 0.5, realisations=1), "at least 2"),
        (lambda: resonant_gains(Model(), 5.5, 5.0 / DEG, 10 * DEG), "no ki puts a resonance"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
