"""Stribeck friction by hand, Eq. 25 in SI and magnitudes."""

from math import exp

import pytest

from dmptm_ctrl.effects.stribeck import breakaway_torque, sliding_torque, stribeck_law

LAW = stribeck_law(
    static_plus=2.8,
    coulomb_plus=2.5,
    speed_plus=0.04,
    viscous_plus=0.6,
    static_minus=2.0,
    coulomb_minus=1.8,
    speed_minus=0.03,
    viscous_minus=0.5,
    exponent=1.0,
)


def test_breakaway_is_static_friction_of_the_direction():
    assert breakaway_torque(1.0, LAW) == 2.8
    assert breakaway_torque(-1.0, LAW) == 2.0


@pytest.mark.parametrize(("direction", "static"), [(1.0, 2.8), (-1.0, 2.0)])
def test_sliding_starts_at_static_friction(direction, static):
    """No jump on breaking away: a drive that starts does not start twice."""
    assert sliding_torque(0.0, direction, LAW) == static


@pytest.mark.parametrize("omega", [0.01, 0.04, 1.0])
def test_sliding_by_equation_25(omega):
    expected = 2.5 + 0.3 * exp(-omega / 0.04) + 0.6 * omega
    assert sliding_torque(omega, 1.0, LAW) == pytest.approx(expected, rel=1e-15)
    expected = 1.8 + 0.2 * exp(-omega / 0.03) + 0.5 * omega
    assert sliding_torque(-omega, -1.0, LAW) == pytest.approx(expected, rel=1e-15)


def test_exponent_shapes_the_fall_from_static_to_coulomb():
    squared = LAW._replace(exponent=2.0)
    expected = 2.5 + 0.3 * exp(-((0.02 / 0.04) ** 2)) + 0.6 * 0.02
    assert sliding_torque(0.02, 1.0, squared) == pytest.approx(expected, rel=1e-15)


def test_branch_is_the_directions_also_against_the_speed():
    """A body about to turn back: its own branch, at speed zero."""
    assert sliding_torque(-0.5, 1.0, LAW) == 2.8
