"""Balances of several logs at once are those of each alone."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.residual import balances
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import records
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_square_0v60", "closed_sine_10", "open_multisine_preload")
NAMES = ("load_dependent_friction", "current_lag", "cogging", "mesh_error", "presliding")


@pytest.fixture(scope="module")
def recorded():
    """Three logs of a rig, one of them without motor encoders."""
    rig = make_rig(41, (), sensors="all", logs=LOGS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    some = records(logs, paper_drive())
    return some[0], replace(some[1], twist=None), some[2]


@pytest.mark.parametrize("name", NAMES)
def test_logs_do_not_know_of_each_other(recorded, name):
    """Nothing of an effect is carried from one log into the next, whatever their sensors are."""
    declared, effect = Model(paper_drive()), CATALOGUE[name]
    sizes = {p.name: p.step for p in effect.parameters if p.name in effect.amplitudes}
    model = declared.with_effect(name, **{**effect.absent(), **sizes})

    def parts(some):
        balance = balances(some, declared, declared, 1)
        names = [(balance.motions[e.motion].rec.name, e.kind) for e in balance.equations]
        return dict(zip(names, balance.missing(model), strict=True))

    together = parts(recorded)
    alone = {key: part for one in recorded for key, part in parts((one,)).items()}
    # a log with motor encoders has a fast part beside one without only
    assert len(alone) > 3
    assert set(alone) <= set(together)
    for key, part in alone.items():
        np.testing.assert_allclose(together[key], part, rtol=1e-9, atol=1e-9, err_msg=key)
