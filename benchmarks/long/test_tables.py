"""Curves without a name, too long for CI: ``python -m pytest benchmarks/long``."""

import numpy as np
import pytest
from tests.recovery.test_tables import decided, halved, table

from dmptm_ctrl.drive import paper_drive


def test_ripple_in_proportion_to_the_voltage():
    decision, true = decided(503, (("voltage_ripple", 1.0),), "load", "eq21")
    true = true["voltage_ripple"]
    assert decision.unexplained.variables[:2] == ("theta_L", "u")
    drive = paper_drive()
    ratio = drive["N_1"] * drive["N_2"]
    _, places, knots = table(decision)
    phase = true["order"] * places / ratio
    basis = np.column_stack([np.cos(phase), np.sin(phase)])
    size = np.hypot(*np.linalg.lstsq(basis, knots, rcond=None)[0])
    # of the mean voltage, at the ring gear, from both motors
    assert 2.0 * ratio * size == pytest.approx(true["N_m_per_V"], rel=0.3)
    assert halved(decision)
