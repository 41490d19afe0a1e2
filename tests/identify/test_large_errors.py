"""Errors of teeth and gears as large as the gap: the flank is not where the angles have it."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.decide import adopt
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "open_multisine_preload")


def of_chains(left):
    """How many windows tell what a chain carries."""
    return sum(int(e.used.sum()) for e in left.balance.equations if e.kind != "total")


@pytest.mark.parametrize(
    ("name", "cosine", "sine"),
    [("mesh_error", "left_cosine", "left_sine"), ("ring_gear_eccentricity", "cosine", "sine")],
)
def test_size_of_another_programs_error(name, cosine, sine):
    """What was found is taken off the twist, so that windows with it count as the others do."""
    effects = ((name, 5.0),)
    rig = make_rig(7050, effects, sensors="all", logs=LOGS, friction="karnopp", contact="eq21")
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    left = residual(measured, Model(paper_drive()))
    (trial,) = trace(left, only=(name,))
    after = adopt(measured, trial, 2)
    values = after.base.model.effects[name]
    size = np.rad2deg(np.hypot(values[cosine], values[sine])) * 60.0
    true = rig.label["effect_parameters"][name]["amplitude_arcmin"]
    assert size == pytest.approx(true, rel=0.02)
    assert of_chains(after) > 1.5 * of_chains(left)
