"""Effects too small for the balances, told by keeping step; on rigs of another program."""

import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.decide import FIRST
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.race import race
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_square_15")
SOME = ("drive_offset", "unbalance")


def raced(effects, friction):
    """What the balances reach, and who wins, on a rig without motor encoders."""
    laws = {"friction": friction, "contact": "kelvin_voigt"}
    rig = make_rig(5500014, effects, sensors="load", logs=LOGS, **laws)
    drive = paper_drive()
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, drive)
    left = residual(measured, Model(drive))
    trials = trace(left, only=SOME)
    start = rattled(measured.fit, left.base, drive, 2)
    told = rig.label["effect_parameters"]
    return trials, race(measured.fit, measured.held, start, trials), told


def test_offset_that_hides_in_the_preload():
    """22 mV on one motor: common to both it is friction's to take up, the rest is preload."""
    trials, winner, told = raced((("drive_offset", 1.0),), "karnopp")
    assert max(trial.evidence for trial in trials) < FIRST
    assert winner.name == "drive_offset"
    assert winner.seconds >= 0.15
    values = winner.model.effects["drive_offset"]
    true = told["drive_offset"]
    assert true["location"] == "right"
    assert values["right"] - values["left"] == pytest.approx(true["offset_V"], rel=0.15)


def test_nobody_wins_on_a_rig_of_another_friction_law():
    assert raced((), "tanh")[1] is None
