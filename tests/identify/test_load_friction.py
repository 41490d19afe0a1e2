"""Friction that grows with the load in the balances, across steps of the voltage too."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.balance import surprise
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

NAME = "load_dependent_friction"
LOGS = ("open_square_0v60", "open_square_0v75", "closed_sine_10", "open_multisine_preload")


def test_no_log_objects_to_friction_that_is_there():
    """What the mesh carries as the voltage steps decides: half a sample late, squares object."""
    laws = {"friction": "karnopp", "contact": "eq21"}
    rig = make_rig(9600001, ((NAME, 3.0),), sensors="all", logs=LOGS, **laws)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    left = residual(measure(logs, paper_drive()), Model(paper_drive()))
    (trial,) = trace(left, only=(NAME,))
    true = rig.label["effect_parameters"][NAME]["coefficient"]
    assert trial.fit.model.effects[NAME]["coefficient"] == pytest.approx(true, rel=0.15)
    for balance in (left.balance, left.held):
        before, after = (balance.missing(m) for m in (left.base.model, trial.fit.model))
        for e, a, b in zip(balance.equations, before, after, strict=True):
            name = balance.motions[e.motion].rec.name
            assert surprise([b], [e.kind]) < surprise([a], [e.kind]) + 3.0, (name, e.kind)
