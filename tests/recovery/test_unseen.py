"""What the balances tell nothing of, told by keeping step on rigs of another program."""

import numpy as np
import pytest

from dmptm_ctrl import diagnose, load_log
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.unseen import AGEING, names, unseen
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig


def measured_logs(seed, effects, sensors, friction, contact):
    laws = {"friction": friction, "contact": contact}
    rig = make_rig(seed, effects, sensors=sensors, **laws)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    return logs, rig.label["effect_parameters"]


def told(seed, effects, sensors, friction="karnopp", contact="eq21"):
    """The model as it is, what keeping step shows, and the rig's own label."""
    logs, true = measured_logs(seed, effects, sensors, friction, contact)
    drive = paper_drive()
    measured = measure(logs, drive)
    left = residual(measured, Model(drive))
    before = augment(measured.fit, left.base, drive)
    return before, unseen(left, before), true, left


def test_eccentric_ring_without_motor_encoders():
    """The twist is not measured; the times of the impacts tell its size within a tenth."""
    before, shown, true, _ = told(402, (("ring_gear_eccentricity", 0.5),), "load")
    assert before.horizon <= 0.1
    assert shown.name == "ring_gear_eccentricity"
    assert shown.rivals == ()
    assert min(shown.gain, shown.held_gain) > 50.0
    values = shown.fit.model.effects[shown.name]
    size = np.hypot(values["cosine"], values["sine"])
    wanted = np.deg2rad(true[shown.name]["amplitude_arcmin"] / 60.0)
    assert size == pytest.approx(wanted, rel=0.1)


def test_friction_that_grows_at_rest_is_unknown_by_its_variable():
    """On nobody's list: no name, but what it depends on."""
    logs, _ = measured_logs(301, (("dwell_breakaway", 1.0),), "all", "karnopp", "kelvin_voigt")
    result = diagnose(logs)
    assert result.verdict == "unknown"
    assert result.depends_on == ("time_at_rest",)
    assert [effect.name for effect in result.effects] in ([], ["unknown"])


def test_another_law_of_contact_shows_nothing():
    before, shown, _, _ = told(411, (), "load", contact="hunt_crossley")
    assert before.horizon <= 0.15
    assert shown is None


def test_nothing_where_the_model_keeps_step():
    before, shown, _, left = told(4000, (), "all")
    assert before.horizon >= 0.3
    assert shown is None
    assert names(left) == (AGEING,)  # with motor encoders the balances tell the rest
