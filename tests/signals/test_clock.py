"""Time that is not even is refused with the row, or put on even steps on request."""

import numpy as np
import pytest

from dmptm_ctrl import LogError, load_log


def without(columns, rows):
    return {name: np.delete(values, rows) for name, values in columns.items()}


def reordered(columns, order):
    return {name: values[order] for name, values in columns.items()}


@pytest.mark.parametrize(
    ("spoil", "reported"),
    [
        (lambda c: reordered(c, slice(None, None, -1)), "sorted by time"),
        (lambda c: reordered(c, np.r_[0:50, 49, 50:1999]), "repeated rows dropped: 1"),
        (lambda c: without(c, [3]), "1 steps were off, the longest 0.002 s"),
        (
            lambda c: c | {"time_s": c["time_s"] + 1e-4 * np.sin(np.arange(2000) / 7)},
            "resampled to even steps of 0.001",
        ),
    ],
    ids=["reversed", "repeated", "gap", "jitter"],
)
def test_uneven_time_is_mended_and_told(columns, write_csv, spoil, reported):
    even, log = load_log(write_csv(columns)), load_log(write_csv(spoil(columns)))
    np.testing.assert_allclose(log.time, even.time[: len(log)], rtol=2e-5, atol=1e-9)
    np.testing.assert_allclose(log["theta_L"], even["theta_L"][: len(log)], atol=1e-4)
    assert any(reported in warning for warning in log.warnings)


def test_time_steps_that_no_drive_has(columns, write_csv):
    with pytest.raises(LogError, match="time steps of 1e-12 s"):
        load_log(write_csv(columns | {"time_s": columns["time_s"] * 1e-9}))


def test_rounded_time_stamps_are_even(columns, write_csv):
    columns["time_s"] = np.round(np.arange(2000) / 3000, 5)  # 3 kHz in steps of 10 us
    columns["omega_L_deg_s"] = 3 * columns["omega_L_deg_s"]
    assert load_log(write_csv(columns)).sample_time == pytest.approx(1 / 3000, rel=1e-4)


def test_resampling_recovers_the_even_run(columns, write_csv):
    """Linear interpolation of a sine errs by at most (w h)^2 / 8 of its amplitude."""
    even = load_log(write_csv(columns))
    rng = np.random.default_rng(3)
    time = columns["time_s"] + rng.uniform(-3e-4, 3e-4, 2000)
    time[0], time[-1] = 0.0, 1.999
    phase = 2 * np.pi * 0.5 * time
    spoilt = columns | {
        "time_s": time,
        "theta_L_deg": 10 * np.sin(phase),
        "omega_L_deg_s": 10 * np.pi * np.cos(phase),
        "theta_ml_deg": 2062.5 * np.sin(phase),
        "theta_mr_deg": 2062.5 * np.sin(phase),
    }
    spoilt = reordered(without(spoilt, np.r_[600:605]), rng.permutation(1995))
    log = load_log(write_csv(spoilt))
    assert log.sample_time == pytest.approx(1e-3, rel=1e-2)
    expected = np.radians(10) * np.sin(np.pi * log.time)
    longest = 7e-3  # s, five rows lost and jitter
    bound = np.radians(10) * (np.pi * longest) ** 2 / 8
    assert np.abs(log["theta_L"] - expected).max() < bound
    assert abs(len(log) - len(even)) <= 20
    assert log.warnings[0] == "sorted by time"
    assert "resampled to even steps" in log.warnings[1]


def test_resampling_drops_repeated_rows_but_no_contradictions(columns, write_csv):
    order = np.r_[0:50, 49, 50:2000]
    assert len(load_log(write_csv(reordered(columns, order)))) == 2000
    spoilt = reordered(columns, order)
    spoilt["u_left_V"][50] += 1
    with pytest.raises(LogError, match="u_left has two values at time 0.049 s"):
        load_log(write_csv(spoilt))


def test_long_gaps_are_not_bridged(columns, write_csv):
    with pytest.raises(LogError, match=r"gap of 0.012 s after 0.699 s; at most 10 steps"):
        load_log(write_csv(without(columns, np.r_[700:711])))
    assert len(load_log(write_csv(without(columns, np.r_[700:709])))) == 2000
