"""Eq. 21 against its two-state original, by hand, and against python-control."""

import control as ct
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from dmptm_ctrl.effects.backlash import (
    Backlash,
    gap_position,
    gap_rate,
    impact_step,
    mesh_region,
    mesh_torque,
    region_torque,
    twist_torque,
)

PAPER = Backlash(stiffness=3.6e4, damping=3.0, gap_damping=0.05, half_gap=0.004)


def torques(z, z_rate, law):
    return np.array([mesh_torque(x, v, law) for x, v in zip(z, z_rate, strict=True)])


@pytest.mark.parametrize("rate", [0.05, -0.4, 2.0, -20.0])
@pytest.mark.parametrize("gap_damping", [0.0, 0.05, 0.5])
def test_position_in_gap_is_the_two_state_models_at_constant_rate(rate, gap_damping):
    """θb as a state, integrated tightly from the flank that it leaves to the other one."""
    law = PAPER._replace(gap_damping=gap_damping)
    side = np.sign(rate)
    start = -side * law.half_gap - law.damping / law.stiffness * rate  # contact torque 0

    def landed(t, y):
        return side * y[0] - law.half_gap

    landed.terminal = True
    run = solve_ivp(
        lambda t, y: [gap_rate(y[0], start + rate * t, rate, law._replace(half_gap=1.0))],
        (0.0, 10.0 * law.half_gap / abs(rate)),
        [-side * law.half_gap],
        method="DOP853",
        events=landed,
        rtol=1e-12,
        atol=1e-15,
    )
    assert run.t_events[0].size == 1
    for t, position in zip(run.t, run.y[0], strict=True):
        assert gap_position(start + rate * t, rate, law) == pytest.approx(position, abs=1e-9)
    arrival = start + rate * run.t_events[0][0]
    assert mesh_region(arrival - 1e-9 * side, rate, law) == 0.0
    assert mesh_region(arrival + 1e-9 * side, rate, law) == side


def test_exponent_as_printed_is_another_model():
    """(z + b)/(ż + k) instead of (z + Δ)/ż + c/k: the transient hardly decays at all."""
    law, rate = PAPER, 0.4
    start = -law.half_gap - law.damping / law.stiffness * rate
    time = 1e-3
    z = start + rate * time
    run = solve_ivp(
        lambda t, y: [gap_rate(y[0], start + rate * t, rate, law)],
        (0.0, time),
        [-law.half_gap],
        method="DOP853",
        rtol=1e-12,
        atol=1e-15,
    )
    relaxation = law.damping + law.gap_damping
    printed = -law.stiffness / relaxation * (z + law.half_gap) / (rate + law.stiffness)
    wrong = z + (relaxation * np.exp(printed) - law.gap_damping) / law.stiffness * rate
    assert gap_position(z, rate, law) == pytest.approx(run.y[0, -1], abs=1e-9)
    assert abs(wrong - run.y[0, -1]) > 1e-5


def test_two_state_torque_is_eq_21_on_the_flank_and_free_of_jumps_on_leaving():
    law, rate = PAPER, -0.3
    deep = law.half_gap + 1e-3
    assert twist_torque(law.half_gap, deep, rate, law) == pytest.approx(
        mesh_torque(deep, rate, law)
    )
    leaving = law.half_gap - law.damping / law.stiffness * rate
    assert twist_torque(law.half_gap, leaving, rate, law) == pytest.approx(0.0, abs=1e-12)
    assert gap_rate(law.half_gap, leaving - 1e-9, rate, law) < 0.0


def test_relaxed_gap_carries_its_damping_only():
    """θs settles where k θs = c_f ż: after 50 time constants both models agree."""
    law, rate = PAPER, 0.1
    relaxed = -0.5 * law.half_gap - law.gap_damping / law.stiffness * rate
    z = -0.5 * law.half_gap
    assert twist_torque(relaxed, z, rate, law) == pytest.approx(law.gap_damping * rate)
    assert mesh_torque(z, rate, law) == law.gap_damping * rate


def test_closed_mesh_by_hand():
    law = Backlash(stiffness=1e4, damping=50.0, gap_damping=0.5, half_gap=0.01)
    assert mesh_torque(0.03, 2.0, law) == pytest.approx(300.0)  # 1e4 · 0.02 + 50 · 2
    assert mesh_torque(-0.03, 2.0, law) == pytest.approx(-100.0)
    assert mesh_torque(0.0, 2.0, law) == pytest.approx(1.0)  # 0.5 · 2
    assert region_torque(0.02, 0.0, 1.0, law) == pytest.approx(100.0)


@pytest.mark.parametrize("amplitude", [0.011, 0.02, 0.1])
def test_first_harmonic_matches_python_control(amplitude):
    """A dead zone is 1 − saturation; python-control owns the saturation's gain."""
    spring = Backlash(stiffness=1.0, damping=0.0, gap_damping=0.0, half_gap=0.01)
    phase = 2 * np.pi * (np.arange(4096) + 0.5) / 4096
    twist = amplitude * np.sin(phase)
    torque = torques(twist, np.zeros_like(twist), spring)
    gain = 2 * np.mean(torque * np.sin(phase)) / amplitude
    saturation = ct.saturation_nonlinearity(spring.half_gap)
    expected = 1 - saturation.describing_function(amplitude)
    assert gain == pytest.approx(expected, abs=2e-6)  # midpoint rule, 4096 points


def test_teeth_push_but_never_pull():
    """Only the damping of the gap may pull, and no more than c_f ż."""
    twist, rate = np.meshgrid(np.linspace(-0.02, 0.02, 201), np.linspace(-50, 50, 201))
    twist, rate = twist.ravel(), rate.ravel()
    dry = torques(twist, rate, PAPER._replace(gap_damping=0.0))
    assert np.all(dry * twist >= 0.0)
    assert np.any(dry[abs(twist) > PAPER.half_gap] == 0.0)  # the grid reached the clip
    torque = torques(twist, rate, PAPER)
    pulls = torque * twist < 0.0
    assert np.any(pulls)
    assert np.all(np.abs(torque[pulls]) <= PAPER.gap_damping * np.abs(rate[pulls]))


def test_symmetric_in_direction():
    rng = np.random.default_rng(7)
    z, rate = rng.normal(0.0, 0.005, 2000), rng.normal(0.0, 5.0, 2000)
    np.testing.assert_array_equal(torques(z, rate, PAPER), -torques(-z, -rate, PAPER))


@settings(max_examples=500, deadline=None, derandomize=True)
@given(
    z=st.floats(-0.02, 0.02),
    rate=st.floats(-50.0, 50.0),
    damping=st.floats(0.1, 10.0),
    gap_damping=st.floats(0.0, 0.5),
)
def test_mesh_never_gives_more_energy_than_its_teeth_hold(z, rate, damping, gap_damping):
    """With ½ k max(|z| − Δ, 0)² stored, stored power plus delivered power is never positive."""
    law = Backlash(3.6e4, damping, gap_damping, 0.004)
    depth = max(abs(z) - law.half_gap, 0.0)
    stored = law.stiffness * depth * np.sign(z) * rate
    delivered = -mesh_torque(z, rate, law) * rate
    scale = law.stiffness * depth * abs(rate) + law.damping * rate**2
    assert stored + delivered <= 1e-12 * scale


@pytest.mark.parametrize("rate", [0.3, -2.0])
def test_impact_has_its_age_and_step(rate):
    """At constant rate: the time since the region changed, and the torque's jump there."""
    side = np.sign(rate)
    flank = PAPER.half_gap + PAPER.gap_damping / PAPER.stiffness * abs(rate)
    before = mesh_torque(side * (flank - 1e-12), rate, PAPER)
    after = mesh_torque(side * (flank + 1e-12), rate, PAPER)
    age, step = impact_step(side * flank + rate * 2e-5, rate, PAPER)
    assert age == pytest.approx(2e-5, rel=1e-6)
    assert step == pytest.approx(after - before, rel=1e-6)
