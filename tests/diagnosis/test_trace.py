"""What a torque on the ring gear would explain, beside what the drive's parameters explain."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import Trace, pair_gains, total_columns
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

FREQUENCIES = np.array([0.7, 2.0, 5.5, 11.0])  # Hz


@pytest.fixture(scope="module", params=["all", "load"])
def traced(request):
    rig = make_rig(77, (), sensors=request.param, logs=("open_sine_0v60", "closed_sine_10"))
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    return Trace(residual(measure(logs, paper_drive()), Model(paper_drive())))


def waves(traced, function):
    rows = [function(2.0 * np.pi * FREQUENCIES[:, None] * mo.time) for mo in traced.balance.motions]
    return total_columns(traced, rows)


def test_gains_of_pairs_are_those_of_regressions(traced):
    pairs = waves(traced, np.cos), waves(traced, np.sin)
    told = pair_gains(traced, *pairs)
    for k, gain in enumerate(told):
        whole = np.zeros((traced.base.weights.size, 2))
        whole[traced.totals] = np.column_stack([pair[:, k] for pair in pairs])
        g = traced.project(whole)
        _, left, *_ = np.linalg.lstsq(g, traced.target, rcond=None)
        assert gain == pytest.approx(traced.target @ traced.target - float(left[0]), rel=1e-6)
