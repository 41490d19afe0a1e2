"""Recoveries too long for CI: ``python -m pytest benchmarks/long`` (some minutes)."""

import pytest
from tests.recovery.test_recovery import MULTISINE, TURN, named_and_gone, no_false_alarm


@pytest.mark.parametrize(
    ("name", "strength", "friction", "sensors", "more", "left"),
    [
        ("unbalance", 3.0, "karnopp", "load", TURN, 0.5),
        ("thermal_drift", 1.0, "karnopp", "all", TURN, 0.5),
        ("current_lag", 1.0, "tanh", "all", MULTISINE, 0.8),
        ("base_vibration", 1.0, "tanh", "load", MULTISINE, 0.8),
    ],
)
def test_named_and_gone(name, strength, friction, sensors, more, left):
    named_and_gone(name, strength, friction, sensors, more, left)


def test_no_false_alarm_on_any_of_four_nulls(capsys):
    no_false_alarm(range(4000, 4004), capsys)
