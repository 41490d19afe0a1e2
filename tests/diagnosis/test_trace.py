"""What a torque on the ring gear would explain, beside what the drive's parameters explain."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import lsq_linear

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.trace import Trace, effect_columns, pair_gains, total_columns
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE
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
    reported = pair_gains(traced, *pairs)
    for k, gain in enumerate(reported):
        whole = np.zeros((traced.base.weights.size, 2))
        whole[traced.totals] = np.column_stack([pair[:, k] for pair in pairs])
        g = traced.project(whole)
        _, left, *_ = np.linalg.lstsq(g, traced.target, rcond=None)
        assert gain == pytest.approx(traced.target @ traced.target - float(left[0]), rel=1e-6)


@pytest.mark.parametrize("name", ["quadratic_drag", "unbalance", "ring_gear_eccentricity"])
def test_gains_inside_the_ranges_are_those_of_bounded_regressions(traced, name):
    """By another solver, on all rows; half of the parameters stand at an end of their range."""
    known = tuple(
        replace(k, high=p) if j % 2 else replace(k, low=p - 0.1)
        for j, (k, p) in enumerate(zip(traced.base.unknowns, traced.base.p, strict=True))
    )
    inside = Trace(replace(traced.left, base=replace(traced.base, unknowns=known)))
    low, high = np.array([(k.low, k.high) for k in known]).T - inside.base.p
    effect = CATALOGUE[name]
    columns = effect_columns(inside, effect, {})
    left = np.concatenate([inside.base.weights * inside.base.missing, inside.prior @ inside.base.p])

    def cost(table, free):
        bounds = np.append(low, np.full(free, -np.inf)), np.append(high, np.full(free, np.inf))
        bounds = bounds[0], np.maximum(bounds[1], bounds[0] + 1e-12)
        scale = np.linalg.norm(table, axis=0)
        scaled = tuple(b * scale for b in bounds)
        found = lsq_linear(table / scale, -left, scaled, method="trf", tol=1e-15, max_iter=2000)
        return 2.0 * found.cost

    tall = np.pad(columns, [(0, inside.rows), (0, 0)])
    fall = cost(inside.derivatives, 0) - cost(
        np.hstack([inside.derivatives, tall]), columns.shape[1]
    )
    assert inside.bounded_gain(columns) == pytest.approx(fall, rel=1e-6, abs=1e-8)
