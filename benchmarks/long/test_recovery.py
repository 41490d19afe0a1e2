"""Recoveries too long for CI: ``python -m pytest benchmarks/long`` (some minutes)."""

import pytest
from tests.recovery.test_recovery import (
    MULTISINE,
    TURN,
    named_and_gone,
    no_false_alarm,
    nothing_lacks,
)

from dmptm_ctrl import diagnose, load_log
from rigs import make_rig


@pytest.mark.parametrize(
    ("name", "strength", "friction", "sensors", "more", "left"),
    [
        ("thermal_drift", 1.0, "karnopp", "all", TURN, 0.5),
        ("current_lag", 1.0, "tanh", "all", MULTISINE, 0.8),
    ],
)
def test_named_and_gone(name, strength, friction, sensors, more, left):
    named_and_gone(name, strength, friction, sensors, more, left)


def test_nothing_lacks_but_the_friction_law_is_another():
    nothing_lacks(3, "lugre", "all", TURN)


def test_bristles_that_only_creep_get_no_name_and_make_no_prediction_worse():
    """They met the first landings on gears of another law, and predicted half as well again."""
    rig = make_rig(770100412, (), sensors="load", friction="karnopp", contact="hunt_crossley")
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    found = diagnose(logs)
    assert found.verdict == "none"
    assert found.error["after"]["rmse"] <= found.error["before"]["rmse"]


def test_no_false_alarm_on_any_of_four_nulls(capsys):
    no_false_alarm(range(4000, 4004), capsys)
