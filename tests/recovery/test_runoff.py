"""Names that the balances take for one another, told by keeping step; rigs of another program."""

import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.decide import adopt
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.runoff import run_off
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_square_15")
TRUE, RIVAL = "back_emf", "load_dependent_friction"


def told(friction, winner):
    """What runs tell of a name and its rival, on a rig that lacks its back-EMF."""
    laws = {"friction": friction, "contact": "kelvin_voigt"}
    rig = make_rig(8300001, ((TRUE, 1.0),), sensors="all", logs=LOGS, **laws)
    drive = paper_drive()
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, drive)
    trials = {t.name: t for t in trace(residual(measured, Model(drive)), only=(TRUE, RIVAL))}
    assert min(t.evidence for t in trials.values()) > 0.0
    base = adopt(measured, trials[winner], 2).base
    after = augment(measured.fit, base, drive)
    rivals = tuple(t for t in trials.values() if t.name != winner)
    return run_off(measured.fit, measured.held, trials[winner], base, after, rivals)


@pytest.mark.parametrize("winner", [TRUE, RIVAL])
def test_only_the_effect_that_is_there_keeps_step(winner):
    """Whichever of the two the balances prefer."""
    runs = told("karnopp", winner)
    assert runs.out == (RIVAL,)
    assert (runs.better.name if runs.better else winner) == TRUE


def test_nothing_is_told_on_a_rig_of_another_friction_law():
    assert told("tanh", TRUE) is None
