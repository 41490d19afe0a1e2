"""Recoveries too long for CI: ``python -m pytest benchmarks/long`` (some minutes)."""

import pytest
from tests.recovery.test_recovery import no_false_alarm

from dmptm_ctrl import diagnose, load_log
from rigs import make_rig

PAIRS = ("open_sine_0v60", "open_sine_0v75", "closed_sine_10", "closed_sine_15")
TURN, MULTISINE = "closed_turn_20", "open_multisine_preload"
TURN_ENDS = 19.0  # s, of the turn only the way there
TWINS = {"current_lag": "drive_delay", "drive_delay": "current_lag"}


def logs_of(rig):
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    return [log.segment(0.0, TURN_ENDS) if log.name == TURN else log for log in logs]


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
    """The error with it in the model is `left` times that without."""
    rig = make_rig(3, [(name, strength)], sensors=sensors, friction=friction, logs=(*PAIRS, more))
    found = diagnose(logs_of(rig))
    assert found.verdict == "explained"
    first = found.effects[0]
    if name in TWINS and first.name == TWINS[name]:
        assert name in first.confusable_with
    else:
        assert first.name == name
    assert [e.name for e in found.effects if e.material] == [first.name]
    for kind in ("speed", "torque"):
        before, after = (found.error[side][kind]["rmse"] for side in ("before", "after"))
        assert after < left * before, kind


def test_no_false_alarm_on_any_of_four_nulls(capsys):
    no_false_alarm(range(4000, 4004), capsys)
