"""Gaps that vary, by reversals each taken alone."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "identify"))

from test_ensemble import DT, logged

from dmptm_ctrl.diagnosis.local_gaps import (
    APART,
    PLACES,
    VARYING,
    by_angle,
    losses_of_gaps,
    waves_of_gaps,
)
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects.backlash_variation import BacklashVariation, varied_gap
from dmptm_ctrl.identify.segments import reversals
from dmptm_ctrl.simulate.model import Model

TIME = DT * np.arange(12000)
# deg/s; slowly over some 120 degrees, with reversals on the way
SWINGS = {
    shift: 30.0 * np.sin(0.5 * TIME + shift) + 20.0 * np.sign(np.sin(5.0 * TIME))
    for shift in (0.0, 0.7, 1.4, 2.1)
}
SETPOINTS = {f"{shift} rad ahead": setpoint for shift, setpoint in SWINGS.items()}


def test_waves_keep_to_what_is_declared_and_differ():
    plain = Model(paper_drive())
    plant = plain.with_effect(VARYING, cosine=2e-3, sine=1e-3)
    records = logged((plant, None), 3, SETPOINTS)
    models = waves_of_gaps(records, plain, paper_drive(), 2, 0)
    assert 1 < len(models) <= PLACES
    for gap in ("gap_l", "gap_r"):
        low, high = paper_drive().quantities[gap].range
        assert all(low <= model.drive[gap] <= high for model in models)
    steps = np.array([[*model.effects[VARYING].values()] for model in models]) / 1e-4
    for i, one in enumerate(steps):
        assert all(np.abs(one - other).max() > APART for other in steps[:i])
    again = waves_of_gaps(records, plain, paper_drive(), 1, 0)
    assert [model.effects for model in again] == [model.effects for model in models]


def test_a_gap_that_is_right_costs_least_at_each_reversal():
    plain = Model(paper_drive())
    turned = reversals(logged((plain, None), 3, SETPOINTS), plain, 0.07)
    assert len(turned) > 5
    tables = losses_of_gaps(turned, plain, 1)
    near = tables[:, 5:7, 5:7].mean(axis=(1, 2))  # a little less and more than the gaps
    assert np.all(near.sum() < tables.sum(axis=0)[[0, 0, -1, -1], [0, -1, 0, -1]])
    assert waves_of_gaps([], plain, paper_drive(), 1, 0) == []


def test_change_of_gaps_is_the_kernel_s():
    amplitudes = np.array([1e-3, -2e-3, 3e-4, 4e-4])
    angles = np.array([-0.3, 0.0, 1.1])
    gaps = by_angle(angles) @ amplitudes
    for angle, pair in zip(angles, gaps, strict=True):
        for side in (0, 1):
            own = varied_gap(0.0, 0.0, angle, 0.0, side, BacklashVariation(*amplitudes))[2]
            assert pair[side] == pytest.approx(own, rel=1e-12)
