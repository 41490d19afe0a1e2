"""Thermal drift over logs of different length, and model files that mean another trend."""

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.impact_chatter import Chatter
from dmptm_ctrl.effects.thermal_drift import THERMAL_DRIFT, thermal_factor
from dmptm_ctrl.identify.records import predict, record
from dmptm_ctrl.plots.gaps import gap_motion
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.simulate.compiled import march, rest
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


def test_runs_along_a_log_have_its_length():
    """Whatever runs a model along a log of 24 s runs it as if it was made for 24 s."""
    model = Model().with_effect("thermal_drift", viscous_change=CHANGE, time_constant=3.0)
    dt, count = 2e-3, 12_000
    time = dt * np.arange(count)
    volts = 3.0 * np.sin(np.pi * time)
    u = np.array([volts, volts])
    seen = march(model.over(24.0), u, rest(model, 0.1), dt)
    log = Log(
        "long", time, {"u_left": volts, "u_right": volts, "theta_L": seen[:, 0],
                       "omega_L": seen[:, 1]},
    )  # fmt: skip
    rec = record(log, model.drive)
    np.testing.assert_allclose(predict(rec, model)[:, 1], seen[:, 1], atol=1e-12)
    short = march(model, u, rest(model, 0.1), dt)  # as of a log of 10 s
    assert np.abs(short - seen).max() > 1e-3
    places = gap_motion(log, model).place
    gaps = [model.drive["gap_l"], model.drive["gap_r"]]
    np.testing.assert_allclose(places, seen[:, 6:8].T / np.array(gaps)[:, None], atol=1e-9)
    chatter = Chatter([rec], model.drive, 1).ratios([model, model.over(24.0)])
    np.testing.assert_array_equal(chatter[0], chatter[1])
