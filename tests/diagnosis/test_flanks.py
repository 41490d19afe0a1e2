"""Which law the flanks follow is told by the first landings."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl.diagnosis.flanks import damp_by_depth
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.signals import load_log
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig


@pytest.mark.parametrize(
    ("contact", "friction", "sensors", "told"),
    [
        ("hunt_crossley", "karnopp", "all", True),
        ("hunt_crossley", "tanh", "load", True),  # friction gives as well
        ("eq21", "tanh", "all", False),  # that friction gives is no matter of the flanks
        ("two_state", "lugre", "load", False),
    ],
)
def test_told_by_the_first_landings(contact, friction, sensors, told):
    rig = make_rig(610, (), sensors=sensors, friction=friction, contact=contact)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    assert damp_by_depth(residual(measured, Model(paper_drive())), 2) is told
