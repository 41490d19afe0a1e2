"""Linear design: margins kept, and no controller beats mixsyn."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.control import assess_pi, common_mode
from dmptm_ctrl.control.sections import notch, sampled_notch
from dmptm_ctrl.control.shaping import (
    SampledPlant,
    essential,
    fastest_pi,
    linear_reference,
)
from dmptm_ctrl.design.linear import level, linear_plant
from dmptm_ctrl.drive import three_dof_ss
from dmptm_ctrl.simulate.model import Model

PLANT = three_dof_ss()
DT = 1e-3


@pytest.mark.parametrize("hz", [60.0, 61.37])  # python-control allows no point in a name
def test_sampled_notch_is_tustin_with_prewarping(hz):
    depth, width = 0.1, 0.4
    expected = ct.c2d(notch(hz, depth, width), DT, "bilinear", prewarp_frequency=2 * np.pi * hz)
    b0, b1, b2, a1, a2 = sampled_notch(hz, depth, width, DT)
    found = ct.tf([b0, b1, b2], [1.0, a1, a2], DT)
    z = np.exp(1j * np.geomspace(1.0, 3000.0, 50) * DT)
    np.testing.assert_allclose(found(z), expected(z), rtol=1e-9)
    assert abs(found(np.exp(2j * np.pi * hz * DT))) == pytest.approx(depth)


@pytest.mark.parametrize(("phase", "gain"), [(45.0, 6.0), (60.0, 10.0)])
def test_fastest_pi_keeps_its_margins_and_a_faster_one_does_not(phase, gain):
    found = fastest_pi(PLANT, phase, gain)
    assert found.phase_margin_deg == pytest.approx(phase, abs=0.3)
    assert found.gain_margin_db >= gain
    sampled = SampledPlant(PLANT)
    hz = 1.05 * found.crossover_hz
    assert sampled.tightest(*sampled.gains(hz, phase), hz)[0] < gain


def test_gains_are_of_the_sampled_loop():
    kp, ki = SampledPlant(PLANT).gains(8.0, 50.0)
    found = assess_pi(PLANT, kp, ki)
    assert found.phase_margin_deg == pytest.approx(50.0, abs=0.1)
    assert found.crossover_hz == pytest.approx(8.0, rel=1e-3)


def test_no_linear_controller_beats_mixsyn():
    gains = fastest_pi(PLANT, 55.0, 9.0)
    found = linear_reference(PLANT, gains)
    assert 0.1 < found.optimal < found.reached
    drive = essential(common_mode(PLANT))
    poles = ct.feedback(drive * found.controller, 1).poles()
    assert poles.real.max() < 0.0


@pytest.mark.parametrize(
    ("effect", "numbers"),
    [
        ("unbalance", {"cosine": -8.6, "sine": 2.7}),  # linearised it pushes away
        ("cable_spring", {"stiffness": 7.4, "offset": 1.3}),  # linearised no speed lasts
    ],
)
def test_torques_by_angle_leave_the_reference_an_answer(effect, numbers):
    """The synthesis has none with them; without them it is that of the drive alone."""
    model = Model().with_effect(effect, **numbers)
    gains = fastest_pi(linear_plant(model), 55.0, 9.0)
    with pytest.raises(ArithmeticError):
        linear_reference(linear_plant(model), gains)
    found = linear_reference(linear_plant(level(model)), gains)
    expected = linear_reference(linear_plant(Model()), gains)
    assert found.optimal == pytest.approx(expected.optimal)
    assert 0.1 < found.optimal < found.reached


def test_smaller_systems_answer_alike():
    drive = three_dof_ss(states="angles")
    small = common_mode(drive)
    assert small.nstates == drive.nstates - 1
    assert small.A[0, 0] == 0.0  # what is left is as it was, not turned
    s = 1j * np.geomspace(0.1, 3e3, 60)
    both = drive(s).sum(axis=1)[0]
    np.testing.assert_allclose(small(s), both, rtol=1e-6)
    smaller = essential(small)  # the pinions against each other: not moved by a common voltage
    assert smaller.nstates == 3
    np.testing.assert_allclose(smaller(s), both, rtol=1e-4)


def test_refusals():
    with pytest.raises(ValueError, match="must be > 0"):
        notch(60.0, -0.1, 0.5)
    with pytest.raises(ValueError, match="half the sample rate"):
        sampled_notch(600.0, 0.1, 0.5, DT)
    with pytest.raises(ValueError, match="no PI keeps"):
        fastest_pi(PLANT, 60.0, 200.0)
