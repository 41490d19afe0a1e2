"""Trials of a fit as arrays, without a model of each."""

import numpy as np
from numpy.testing import assert_array_equal

from dmptm_ctrl.diagnosis.trace import unknowns_of
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.fit import arrays_at, drive_unknowns, place, position
from dmptm_ctrl.identify.lock import axes
from dmptm_ctrl.simulate.model import Model


def test_arrays_of_trials_are_those_of_their_models():
    model = Model(paper_drive()).with_effect("unbalance", cosine=1.0, sine=0.0)
    unknowns = (*drive_unknowns(model), *unknowns_of("unbalance"), *unknowns_of("cogging"))
    rng = np.random.default_rng(3)
    several = [position(model, unknowns), *rng.normal(size=(5, len(unknowns)))]
    several[1][-12:] = 0.0  # an effect without an amplitude is switched off
    for p, arrays in zip(several, arrays_at(model, unknowns, several), strict=True):
        for ours, theirs in zip(arrays, place(model, unknowns, p).arrays(), strict=True):
            assert_array_equal(ours, theirs)


def test_axes_span_what_is_known():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(6, 6)) * 0.1
    spread = root @ root.T
    rows = axes(spread)
    np.testing.assert_allclose(rows.T @ rows, spread, atol=1e-9)
    wide = spread.copy()
    wide[0, 0] = 1e9  # nothing known: no farther than one unit of it
    assert np.abs(axes(wide)[:, 0]).max() <= 1.0 + 1e-9
