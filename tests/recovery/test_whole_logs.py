"""The last refit: turns over whole logs, and nothing that meets them worse than before."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "identify"))

from test_ensemble import astray, drawn, logged

from dmptm_ctrl.diagnosis.augment import missed, moved, nearest, onto_whole
from dmptm_ctrl.identify.fit import position


@pytest.fixture(scope="module")
def plant():
    return drawn(8)


@pytest.fixture(scope="module")
def records(plant):
    return logged(plant, 9)


def test_a_refit_that_meets_logs_worse_than_its_start_is_none(plant, records):
    wrong, _ = astray(plant)
    right = moved(wrong, position(plant[0], wrong.unknowns))
    np.testing.assert_allclose(right.p, plant[1], atol=1e-12)
    np.testing.assert_allclose(position(right.model, right.unknowns), right.p, atol=1e-12)
    for tried in ((wrong, right), (right, wrong)):
        miss, kept = nearest(tried, records, 2)
        assert kept is right
        assert miss == missed(right.model, records)


def test_turns_bring_whole_logs_within_reach(plant, records):
    """Drag on the way back, wrong by a fifth of its range: the first turn is not the last."""
    wrong, known = astray(plant)
    before, truth = missed(wrong.model, records), missed(plant[0], records)
    done = onto_whole(records, (before, wrong), known, 2)
    after = missed(done.model, records)
    assert after - truth < 0.2 * (before - truth)
    assert np.linalg.norm(done.p - plant[1]) < 0.25 * np.linalg.norm(wrong.p - plant[1])
    again = onto_whole(records, (before, wrong), known, 1)
    np.testing.assert_array_equal(again.p, done.p)
