"""Pre-sliding told by keeping step, on rigs of another program whose friction has bristles."""

import numpy as np
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.at_rest import MATTERS, NAME, presliding
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_square_15")


def told(seed, effects, friction):
    """What keeping step tells of pre-sliding, and the rig's own label."""
    laws = {"friction": friction, "contact": "kelvin_voigt"}
    rig = make_rig(seed, effects, sensors="all", logs=LOGS, **laws)
    drive = paper_drive()
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, drive)
    left = residual(measured, Model(drive))
    before = augment(measured.fit, left.base, drive)
    return before, presliding(left, before, 2), rig.label["effect_parameters"]


def test_half_of_a_typical_effect():
    before, shown, true = told(9200, ((NAME, 0.5),), "karnopp")
    assert before.horizon <= 0.1
    assert shown.convincing
    assert shown.in_step >= 0.15
    # bristles as long as Coulomb friction over their stiffness; here it is Dahl's distance, at
    # the level of friction as a whole, which breaks away above Coulomb's
    bristle = np.deg2rad(true[NAME]["deflection_deg"])
    assert shown.fit.model.effects[NAME]["ring_distance"] == pytest.approx(bristle, rel=0.5)
    assert shown.fit.model.effects[NAME]["reducer_distance"] < MATTERS


def test_bristles_too_short_for_a_name():
    """The same law of friction, as a rig has it that lacks nothing."""
    before, shown, _ = told(8200157, (), "lugre")
    assert before.horizon <= 0.1
    assert shown.in_step >= 0.15
    assert not shown.convincing


def test_nothing_where_the_model_keeps_step():
    before, shown, _ = told(4000, (), "karnopp")
    assert before.horizon >= 0.3
    assert shown.evidence == 0.0
    assert shown.fit is before
