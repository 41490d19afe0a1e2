"""What the report says of a sensor's error is what the model has."""

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.sensors import Reading as Readings
from dmptm_ctrl.diagnosis.sensors import SensorCheck, cross_check, sensor_effect
from dmptm_ctrl.identify.fit import Fit, effect_unknowns, position
from dmptm_ctrl.simulate.model import Model

SEEN = SensorCheck(
    {"encoder_eccentricity": {"cosine": 2.9e-4, "sine": -6.3e-5}, "sensor_gain": {"error": 0.01}},
    {"encoder_eccentricity": {"cosine": 2e-5, "sine": 2e-5}, "sensor_gain": {"error": 1e-3}},
)
FITTED = {"cosine": 2.63e-4, "sine": -7.7e-5}  # rad


@pytest.fixture(scope="module")
def fit():
    """A fit in which the twist has identified the ring encoder's error."""
    model = (
        Model().with_effect("encoder_eccentricity", **FITTED).with_effect("sensor_gain", error=0.01)
    )
    unknowns = effect_unknowns("encoder_eccentricity")
    return Fit(model, unknowns, position(model, unknowns), 1e-4 * np.eye(2))


def test_a_fitted_error_of_an_encoder_is_reported_as_fitted(fit):
    reported = sensor_effect("encoder_eccentricity", SEEN, fit, 0.4)
    assert reported.material
    reported = reported.parameters
    for name, value in FITTED.items():
        assert reported[name]["value"] == pytest.approx(value, rel=1e-12)
        assert reported[name]["se"] == pytest.approx(fit.value("encoder_eccentricity", name)[1])


def test_what_no_fit_tells_is_reported_as_the_sensors_tell_it(fit):
    reported = sensor_effect("sensor_gain", SEEN, fit, 0.0).parameters["error"]
    assert (reported["value"], reported["se"]) == (0.01, 1e-3)
    assert reported["value"] == fit.model.effects["sensor_gain"]["error"]


@pytest.mark.parametrize("eccentric", [0.0, 3e-4])
def test_an_unbalance_that_speeds_up_and_slows_down_is_no_eccentricity(eccentric):
    """Fifteen turns a second, by closed forms: what both sensors see is faster than the filter."""
    t = 2e-3 * np.arange(5000)
    turn, rate = 75.0 * (1.0 - np.cos(1.25 * t)), 94.0 * np.sin(1.25 * t)
    theta = turn + 0.02 * np.sin(turn)
    omega = rate * (1.0 + 0.02 * np.cos(turn)) + np.random.default_rng(1).normal(0, 0.02, t.size)
    found = cross_check([Readings(2e-3, theta + eccentric * np.cos(theta), omega)])
    assert found.significant("encoder_eccentricity") == (eccentric > 0.0)
    assert not found.significant("sensor_gain")
    values = found.values["encoder_eccentricity"]
    assert values["cosine"] == pytest.approx(eccentric, abs=6e-5)
