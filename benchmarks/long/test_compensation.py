"""What a compensation gains on machines of other programs, too long for CI."""

import numpy as np
from compensation import results_of
from rig_compensation import gains

LEAST, WORST = 0.4, -0.02  # share of the tracking error that it takes off: median, and any


def test_it_pays_on_machines_of_rig_files():
    measured = gains(10, 20405)[:, 1]
    assert np.median(measured) >= LEAST
    assert measured.min() >= WORST


def test_it_pays_on_dual_motor_rigs_of_ordinary_imperfections(tmp_path):
    rows = results_of(tmp_path, 10, 57, 64)
    measured = np.array([row["measured"] for row in rows])
    assert len(rows) == 10
    assert np.median(measured) >= LEAST
    assert measured.min() >= WORST
