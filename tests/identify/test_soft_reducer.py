"""A soft reducer in the balances: it carries what the motor gives, before the pinion's friction."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.decide import LEAVES, adopt
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.diagnosis.unknown import unexplained
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "open_multisine_preload")


@pytest.mark.parametrize("strength", [0.5, 1.0])
def test_stiffness_of_another_programs_rig(strength):
    laws = {"friction": "karnopp", "contact": "kelvin_voigt"}
    effects = (("reducer_compliance", strength),)
    rig = make_rig(9400001, effects, sensors="all", logs=LOGS, **laws)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    left = residual(measured, Model(paper_drive()))
    (trial,) = trace(left, only=("reducer_compliance",))
    after = adopt(measured, trial, 2)
    stiffness = 1.0 / after.base.model.effects["reducer_compliance"]["compliance"]
    true = rig.label["effect_parameters"]["reducer_compliance"]["stiffness_N_m_rad"]
    assert stiffness == pytest.approx(true, rel=0.2)
    assert unexplained(left, after, trial.evidence, leave=LEAVES["reducer_compliance"]) is None


def test_motors_that_differ_wind_up_soft_reducers_by_as_much():
    """What acts at a motor goes through its shaft: else it would stand in for that, too large."""
    effects = (("reducer_compliance", 3.0), ("torque_constant_mismatch", 1.0))
    rig = make_rig(380100006, effects, sensors="all", friction="karnopp", contact="eq21")
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    left = residual(measured, Model(paper_drive()))
    (first,) = trace(left, only=("reducer_compliance",))
    (second,) = trace(adopt(measured, first, 2), only=("torque_constant_mismatch",))
    error = abs(second.fit.model.effects["torque_constant_mismatch"]["error"])
    true = rig.label["effect_parameters"]["torque_constant_mismatch"]["left_share"]
    assert error == pytest.approx(abs(true), rel=0.1)
    assert second.held_gain > 0.0
