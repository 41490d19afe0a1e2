"""Time that is not even is refused with the row, or put on even steps on request."""

import numpy as np
import pytest

from dmptm_ctrl import LogError, load_log


def without(columns, rows):
    return {name: np.delete(values, rows) for name, values in columns.items()}


def reordered(columns, order):
    return {name: values[order] for name, values in columns.items()}


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda c: reordered(c, slice(None, None, -1)), "time runs backwards; reverse the rows"),
        (
            lambda c: reordered(c, np.r_[0:50, 49, 50:1999]),
            r"time repeats in row 51 \(0.049 s, then 0.049 s\)",
        ),
        (
            lambda c: reordered(c, np.r_[0:50, 10:1999]),
            r"time goes back in row 51 \(0.049 s, then 0.01 s\)",
        ),
        (
            lambda c: without(c, np.r_[700:720, 900]),
            r"2 gaps in time, the longest after row 700 \(0.699 s\): 0.021 s, 20 samples lost",
        ),
        (
            lambda c: without(c, [3]),
            r"1 gap in time, the longest after row 3 \(0.002 s\): 0.002 s, 1 sample lost",
        ),
        (
            lambda c: c | {"time_s": c["time_s"] + 1e-4 * np.sin(np.arange(2000) / 7)},
            "uneven sample rate, steps 0.000985",
        ),
        (lambda c: c | {"time_s": c["time_s"] ** 1.2}, "uneven sample rate"),
        (lambda c: c | {"time_s": c["time_s"] * 1e-9}, "time steps of 1e-12 s"),
    ],
    ids=["reversed", "repeated", "shuffled", "gaps", "gap", "jitter", "drifting", "tiny"],
)
def test_uneven_time_is_refused(columns, write_csv, spoil, message):
    with pytest.raises(LogError, match=message):
        load_log(write_csv(spoil(columns)))


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
    log = load_log(write_csv(spoilt), resample=True)
    assert log.sample_time == pytest.approx(1e-3, rel=1e-2)
    expected = np.radians(10) * np.sin(np.pi * log.time)
    longest = 7e-3  # s, five rows lost and jitter
    bound = np.radians(10) * (np.pi * longest) ** 2 / 8
    assert np.abs(log["theta_L"] - expected).max() < bound
    assert abs(len(log) - len(even)) <= 20
    assert log.warnings[0] == "sorted by time"
    assert "resampled to even steps" in log.warnings[1]


def test_resampling_an_even_run_changes_nothing(columns, write_csv):
    path = write_csv(columns)
    even, again = load_log(path), load_log(path, resample=True)
    assert len(again) == len(even)
    np.testing.assert_allclose(again["theta_L"], even["theta_L"], rtol=0, atol=1e-12)


def test_resampling_drops_repeated_rows_but_no_contradictions(columns, write_csv):
    order = np.r_[0:50, 49, 50:2000]
    assert len(load_log(write_csv(reordered(columns, order)), resample=True)) == 2000
    spoilt = reordered(columns, order)
    spoilt["u_left_V"][50] += 1
    with pytest.raises(LogError, match="u_left has two values at time 0.049 s"):
        load_log(write_csv(spoilt), resample=True)


def test_long_gaps_are_not_bridged(columns, write_csv):
    with pytest.raises(LogError, match=r"gap of 0.012 s after 0.699 s; at most 10 steps"):
        load_log(write_csv(without(columns, np.r_[700:711])), resample=True)
    assert len(load_log(write_csv(without(columns, np.r_[700:709])), resample=True)) == 2000
