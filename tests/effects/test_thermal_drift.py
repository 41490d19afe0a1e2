"""Thermal drift over logs of different length, and model files that mean another trend."""

import numpy as np
import pytest

from dmptm_ctrl.effects.thermal_drift import THERMAL_DRIFT, thermal_factor
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import from_toml, to_toml

CHANGE = 3.0  # N·m·s/rad over a log


@pytest.mark.parametrize("seconds", [5.0, 40.0])
def test_viscous_friction_changes_alike_over_any_log_and_keeps_its_mean(seconds):
    model = Model().with_effect("thermal_drift", viscous_change=CHANGE, time_constant=3.0)
    reported = model.over(seconds).effects["thermal_drift"]
    p = THERMAL_DRIFT.values(rise=0.0, ring_extra=0.0, **reported)
    times = np.linspace(0.0, seconds, 11)
    added = [thermal_factor(0.0, -2.0, t, 0.0, 2, p)[1] for t in times]
    assert added[-1] - added[0] == pytest.approx(2.0 * CHANGE)
    assert np.mean(added) == pytest.approx(0.0, abs=1e-12)


def test_a_model_file_with_the_former_trend_is_refused_with_the_name_that_holds():
    text = to_toml(Model().with_effect("thermal_drift", viscous_change=CHANGE))
    with pytest.raises(LogError, match="viscous_trend.*viscous_change"):
        from_toml(text.replace("viscous_change", "viscous_trend"))
