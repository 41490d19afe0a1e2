"""Gaps that vary, by reversals each taken alone."""

import numpy as np
import pytest

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
from dmptm_ctrl.identify.records import record
from dmptm_ctrl.identify.segments import reversals
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import FINE_SUBSTEPS, OUTPUTS, Loop, close_loop
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DT = 1e-3
LOOP = Loop(0.08 / DEG, 1.5 / DEG, 10.0, 0.15, -0.15)


def logged(model, seed):
    """Records that swing slowly over some 120 degrees and reverse on the way."""
    rng, several = np.random.default_rng(seed), []
    time = DT * np.arange(12000)
    for name, shift in (("out", 0.0), ("late", 0.7), ("later", 1.4), ("back", 2.1)):
        setpoint = 30.0 * np.sin(0.5 * time + shift) + 20.0 * np.sign(np.sin(5.0 * time))
        u, out = close_loop(model, LOOP, setpoint * DEG, DT, substeps=FINE_SUBSTEPS)
        columns = {n: out[:, OUTPUTS.index(n)].copy() for n in OUTPUTS[:2]}
        columns["omega_L"] += 0.05 * DEG * rng.standard_normal(time.size)
        log = Log(name, time, {"u_left": u[0], "u_right": u[1], **columns})
        several.append(record(log, model.drive))
    return several


def test_waves_keep_to_what_is_declared_and_differ():
    plain = Model(paper_drive())
    records = logged(plain.with_effect(VARYING, cosine=2e-3, sine=1e-3), 3)
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
    turned = reversals(logged(plain, 3), plain, 0.07)
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
