"""Channels that contradict each other are refused, suspect ones are reported."""

import numpy as np
import pytest

from dmptm_ctrl import LogError, data, load_log, load_logs
from dmptm_ctrl.signals.counters import unwrapped_counts
from dmptm_ctrl.signals.plausible import refuse_inconsistent, suspects

from .conftest import RATIO

DEG = np.pi / 180


def load(columns):
    import pandas as pd

    return load_log(pd.DataFrame(columns))


@pytest.mark.parametrize(
    ("column", "factor", "message"),
    [
        ("theta_L_deg", DEG, "theta_L changes 0.01745 times .* degrees and radians are mixed up"),
        ("theta_L_deg", 1 / DEG, "theta_L changes 57.3 times .* radians and degrees"),
        ("omega_L_deg_s", DEG, "theta_L changes 57.3 times .* radians and degrees"),
        ("omega_L_deg_s", 1 / 6, "rpm and deg/s are mixed up"),
        ("omega_L_deg_s", -1.0, "theta_L .* omega_L .* wrong sign"),
        ("theta_L_deg", -1.0, "theta_L .* omega_L .* wrong sign"),
        ("theta_ml_deg", DEG, "theta_ml changes 0.01745 times what theta_mr does"),
        ("theta_mr_deg", -1.0, "theta_ml changes against what theta_mr does"),
        ("theta_L_deg", 3.3, "theta_L changes 3.3 times .* a wrong unit"),
        ("time_s", 1e3, "milliseconds and seconds"),
    ],
)
def test_mistaken_unit_or_sign(columns, column, factor, message):
    columns[column] = columns[column] * factor
    with pytest.raises(LogError, match=message):
        load(columns)


def test_motor_angles_against_the_ratio(columns):
    refuse_inconsistent(load(columns), RATIO)
    columns["theta_ml_deg"] = columns["theta_ml_deg"] * DEG
    columns["theta_mr_deg"] = columns["theta_mr_deg"] * DEG
    load(columns)  # they agree with each other
    with pytest.raises(LogError, match="theta_ml changes 0.01745 times what 206.25 times theta_L"):
        refuse_inconsistent(load(columns), RATIO)


def test_motors_that_would_take_energy_out_of_friction(columns):
    columns["u_left_V"] = -columns["u_left_V"]
    columns["u_right_V"] = -columns["u_right_V"]
    with pytest.raises(LogError, match="turns against u_left"):
        load(columns)


def test_a_late_drive_that_swings_against_its_commands_is_no_mistake():
    t = 1e-3 * np.arange(6000)
    omega = 15.0 * np.sin(2 * np.pi * 1.5 * t)  # deg/s, a limit cycle
    late = np.where(t < 0.1, 1.0, -np.sin(2 * np.pi * 1.5 * t + 0.6))  # volts that lead it by far
    columns = {"time_s": t, "omega_L_deg_s": omega, "theta_L_deg": np.cumsum(omega) * 1e-3}
    columns |= {"u_left_V": late, "u_right_V": late}
    assert np.corrcoef(late, omega)[0, 1] < -0.5
    load(columns)


def test_a_sensor_gain_is_for_the_diagnosis(columns):
    columns["omega_L_deg_s"] = 1.3 * columns["omega_L_deg_s"]
    assert load(columns).warnings == ()


def test_gyro_bias_is_no_mistake(columns):
    columns["omega_L_deg_s"] = columns["omega_L_deg_s"] + 20.0
    assert load(columns).warnings == ()


@pytest.mark.parametrize("rig", ["demo_rig", "null_rig"])
def test_good_logs_raise_no_suspicion(rig):
    for log in load_logs(data.path(rig)):
        refuse_inconsistent(log, RATIO)
        assert log.warnings == ()


def test_an_encoder_between_its_steps_is_not_clipped():
    """A clock that jitters leaves readings between the steps where it was interpolated."""
    table = load_log(data.path("demo_rig") / "closed_sine_10.csv.gz").to_frame()
    jitter = np.random.default_rng(0).normal(0.0, 8e-5, len(table))
    (warning,) = load(table.assign(time_s=table["time_s"] + jitter)).warnings
    assert "resampled to even steps of 0.001 s" in warning


@pytest.mark.parametrize(
    ("channel", "level"), [("u_left", 0.8), ("omega_L", 0.8), ("omega_L", 0.95), ("theta_L", 0.9)]
)
def test_clipped_channel(channel, level):
    log = load_log(data.path("null_rig") / "open_sine_0v60.csv.gz")
    values = log[channel] - log[channel].mean()
    limit = level * np.abs(values).max()
    clipped = log.with_channels(**{channel: np.clip(values, -limit, limit)})
    assert any(f"{channel} is clipped" in warning for warning in suspects(clipped))


def test_constant_channels(columns):
    columns["u_left_V"] = columns["u_right_V"] = np.zeros(2000)
    warnings = load(columns).warnings
    assert "u_left is 0 V all the time: no excitation" in warnings
    columns["theta_L_deg"] = np.full(2000, 3.0)
    assert any("theta_L stays at" in warning for warning in load(columns).warnings)


def test_left_and_right_swapped():
    log = load_log(data.path("null_rig") / "open_multisine_preload.csv.gz")
    swapped = log.with_channels(theta_ml=log["theta_mr"], theta_mr=log["theta_ml"])
    assert suspects(log) == []
    assert any("left and right may be swapped" in warning for warning in suspects(swapped))


def test_foreign_speed_sensor(columns):
    columns["omega_L_deg_s"] = np.random.default_rng(5).normal(size=2000)
    columns["u_left_V"] = columns["u_right_V"] = np.sin(np.arange(2000.0))
    assert any("omega_L does not follow theta_L" in warning for warning in load(columns).warnings)


@pytest.mark.parametrize("width", [180.0, 360.0])
def test_wrapped_angle_is_unwrapped(columns, width):
    plain = 40 * columns["theta_L_deg"]
    columns["omega_L_deg_s"] = 40 * columns["omega_L_deg_s"]
    columns["theta_L_deg"] = (plain + width) % 360 - width
    del columns["theta_ml_deg"], columns["theta_mr_deg"]
    log = load(columns)
    np.testing.assert_allclose(np.diff(log["theta_L"]), np.diff(np.radians(plain)), atol=1e-12)
    assert any("theta_L_deg jumped by whole turns" in w for w in log.warnings)


def test_fast_shaft_is_not_unwrapped():
    """4 rad a sample is 2.3 rad backwards to np.unwrap; we leave it alone."""
    no_turn = np.r_[np.zeros(50), np.full(50, 4.0)]
    for angle in (4.0 * np.arange(100), no_turn):
        assert unwrapped_counts("q", angle, 2 * np.pi)[1] == ""
