"""Friction that gives, or an effect that lets the drive leave rest as early."""

import pytest
from test_race import measured_rig

from dmptm_ctrl.diagnosis.at_rest import NAME, presliding
from dmptm_ctrl.diagnosis.giving import giving_or_not
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.trace import trace


@pytest.mark.parametrize(("friction", "sticking"), [("karnopp", True), ("lugre", False)])
def test_the_nearer_law_goes_on(friction, sticking):
    """57 mV on both motors, beside either law; a little pre-sliding alone helps beside both."""
    name = "drive_offset"
    measured, left, _ = measured_rig(((name, 3.0),), friction, 700100039, "paper", "eq21")
    assert presliding(left, 2).gives
    begun = rattled(measured.fit, left.base, measured.drive, 2)
    trials = trace(left, only=(name,))
    start, (trial,), sticks = giving_or_not(measured.fit, begun, trials, 2)
    assert sticks == sticking
    for fit in (start, trial.fit):
        assert (NAME in fit.model.effects) != sticking
    assert (start is begun) == sticking
