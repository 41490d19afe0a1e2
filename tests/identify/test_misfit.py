"""What several models miss on whole records, side by side."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from test_ensemble import drawn, logged

from dmptm_ctrl.identify.fit import (
    AT_ONCE,
    Misfit,
    drive_unknowns,
    jogged,
    place,
    position,
)
from dmptm_ctrl.identify.lock import cut
from dmptm_ctrl.identify.records import difference, predict


@pytest.mark.parametrize("bandwidth_hz", [0.0, 6.0])
@pytest.mark.parametrize("several", [1, AT_ONCE + 3])
def test_models_side_by_side_miss_what_each_alone_does(bandwidth_hz, several):
    """With encoders and without, led by the angle and free; rounding differs, no more."""
    plant = drawn(5)
    records = [cut(rec, 0.1) for rec in logged(plant, 6)]
    turned = np.zeros((records[1].omega.size, 2))
    records[1] = replace(records[1], twist=turned)
    models = [model for k in range(5) for model in jogged(plant[0], 0.01 * (k + 1))][:several]
    together = Misfit(records, bandwidth_hz).differences(models)
    for rec, rows in zip(records, together, strict=True):
        assert len(rows) == len(models)
        for model, row in zip(models, rows, strict=True):
            run = predict(rec, model.arrays(), bandwidth_hz)
            alone = difference(rec, run, model.drive["N_1"], model.drive["N_2"])
            np.testing.assert_allclose(row, alone, rtol=0.0, atol=1e-10)


def test_columns_are_differences_of_vectors():
    """One at a time, away from a bound."""
    plant = drawn(5)
    records = [cut(rec, 0.3) for rec in logged(plant, 6)]
    misfit = Misfit(records, 6.0, 1)
    unknowns = drive_unknowns(plant[0])
    r0 = misfit.vector(plant[0])
    columns = misfit.columns(plant[0], unknowns, r0, 0.3)
    assert columns.shape == (r0.size, len(unknowns))
    p0 = position(plant[0], unknowns)
    for j, unknown in enumerate(unknowns):
        step = 0.3 if p0[j] + 0.3 <= unknown.high else -0.3
        p = p0.copy()
        p[j] += step
        moved = misfit.vector(place(plant[0], unknowns, p))
        np.testing.assert_allclose(columns[:, j], (r0 - moved) / step, rtol=0.0, atol=1e-6)
    assert misfit.columns(plant[0], (), r0).shape == (r0.size, 0)
