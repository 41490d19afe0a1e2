"""What the balances tell nothing of, too long for CI: ``python -m pytest benchmarks/long``."""

import numpy as np
import pytest
from tests.recovery.test_unseen import fitted

from dmptm_ctrl.diagnosis.decide import Decision
from dmptm_ctrl.diagnosis.diagnose import uncovered


def test_eccentric_ring_without_motor_encoders():
    """The twist is not measured; the times of the impacts tell its size within a tenth."""
    name = "ring_gear_eccentricity"
    before, left, true = fitted(402, ((name, 0.5),), "load")
    assert before.horizon <= 0.1
    decision = Decision(left, left)
    fit = uncovered(decision, np.inf, before, left.measured.held_logs, 2, 0)
    (found,) = decision.found
    assert found.name == name
    assert found.rivals == ()
    # How large they are hangs on rounding: an impact met one sample later is worth ten
    assert min(found.trial.gain, found.trial.held_gain) > 0.0
    assert found.evidence > found.threshold
    assert fit.horizon >= 0.4
    values = fit.model.effects[name]
    size = np.hypot(values["cosine"], values["sine"])
    wanted = np.deg2rad(true[name]["amplitude_arcmin"] / 60.0)
    assert size == pytest.approx(wanted, rel=0.1)
