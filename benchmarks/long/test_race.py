"""A race that rounding may end early, so not in CI: ``python -m pytest benchmarks/long``."""

import pytest
from tests.recovery.test_race import measured_rig

from dmptm_ctrl.diagnosis.decide import FIRST
from dmptm_ctrl.diagnosis.finish import KEEPS_SECONDS
from dmptm_ctrl.diagnosis.race import Race
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.trace import trace
from dmptm_ctrl.parallel import small_matrices


@small_matrices
def test_what_shows_after_the_model_as_it_is_has_kept_step_for_long():
    """A friction by load that free runs tell, and the first 0.6 s of the logs do not."""
    name = "load_dependent_friction"
    rig = ((name, 1.0),), "karnopp", 330100035, "paper", "eq21"
    measured, left, told = measured_rig(*rig)
    trials = trace(left, only=(name, "torque_constant_mismatch"))
    assert max(trial.evidence for trial in trials) < FIRST
    start = rattled(measured.fit, left.base, measured.drive, 2)
    winner = Race(measured.fit, measured.held, start, trials).run()
    assert winner.name == name
    assert winner.seconds > KEEPS_SECONDS
    share = winner.model.effects[name]["coefficient"] / told[name]["coefficient"]
    assert share == pytest.approx(1.0, abs=0.25)
