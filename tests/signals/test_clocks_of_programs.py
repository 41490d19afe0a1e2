"""Clocks as programs write them: dates, ticks, roll-over, coarse and irregular stamps."""

import numpy as np
import pandas as pd
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError

ROWS = 300
STEP = 0.01
INDEX = np.arange(ROWS)
T = STEP * INDEX
U = np.sin(3 * T)
Q = np.cos(2 * T)


def rig(unit="s", more=""):
    return parse_rig(f"""
[body.a]
inertia = "0.02 kg m^2"
[input.u]
column = "u"
unit = "N m"
[sensor.q]
column = "q"
unit = "rad"
[data]
time = {{ column = "t", unit = "{unit}" }}
{more}
""")


def stamps(time):
    return pd.Timestamp("2025-11-09T23:59:59Z") + pd.to_timedelta(np.round(1e6 * time), unit="us")


TEXTS = {
    "ISO, Z": lambda s: s.strftime("%Y-%m-%dT%H:%M:%S.%f")[:-3] + "Z",
    "ISO, blank": lambda s: s.strftime("%Y-%m-%d %H:%M:%S.%f"),
    "ISO, zone": lambda s: s.strftime("%Y-%m-%dT%H:%M:%S.%f+01:00"),
    "ISO, decimal comma": lambda s: s.strftime("%Y-%m-%d %H:%M:%S,%f")[:-3],
    "ISO, slashes": lambda s: s.strftime("%Y/%m/%d %H:%M:%S.%f"),
    "basic ISO": lambda s: s.strftime("%Y%m%dT%H%M%S.%f"),
    "basic ISO, dash": lambda s: s.strftime("%Y%m%d-%H%M%S.%f"),
    "UTC": lambda s: s.strftime("%Y-%m-%d %H:%M:%S.%f UTC"),
    "zone in brackets": lambda s: s.strftime("%Y-%m-%dT%H:%M:%S.%f+02:00[Europe/Berlin]"),
    "ISO, underscore": lambda s: s.strftime("%Y-%m-%d_%H:%M:%S.%f"),
    "ctime": lambda s: s.strftime("%a %b %d %H:%M:%S.%f %Y"),
    "German": lambda s: s.strftime("%d.%m.%Y %H:%M:%S.%f"),
    "American": lambda s: s.strftime("%m/%d/%Y %I:%M:%S.%f %p"),
    "time of day": lambda s: s.strftime("%H:%M:%S.%f")[:-3],
    "time of day, colon": lambda s: s.strftime("%H:%M:%S:%f")[:-3],
    "minutes": lambda s: f"{(s.minute + 1) % 60:02d}:{s.second:02d}.{s.microsecond // 1000:03d}",
    "timedelta of pandas": lambda s: "0 days " + s.strftime("%H:%M:%S.%f"),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_text(tmp_path, kind):
    moments = stamps(T)  # over midnight
    if kind in ("minutes", "timedelta of pandas"):  # they know no day
        moments = moments + pd.Timedelta(hours=5)
    frame = pd.DataFrame({"t": [TEXTS[kind](m) for m in moments], "u": U, "q": Q})
    frame.to_csv(tmp_path / "run.csv", index=False, sep=";" if "comma" in kind else ",")
    (log,) = rig("ms").read(tmp_path / "run.csv")  # a date is a date, whatever the unit
    np.testing.assert_allclose(log.time, T, atol=1e-9)
    np.testing.assert_allclose(log["in_u"], U, atol=1e-12)


def test_whole_seconds_without_a_fraction(tmp_path):
    """Programs leave out a fraction of nothing."""
    texts = [s.strftime("%d.%m.%Y %H:%M:%S.%f")[:-3].removesuffix(".000") for s in stamps(T)]
    assert len({len(text) for text in texts}) == 2
    path = tmp_path / "run.csv"
    pd.DataFrame({"t": texts, "u": U, "q": Q}).to_csv(path, index=False)
    (log,) = rig().read(path)
    np.testing.assert_allclose(log.time, T, atol=1e-9)


def test_a_row_without_a_time(tmp_path):
    """Its neighbours say what was there."""
    frame = pd.DataFrame({"t": T, "u": U, "q": Q})
    frame.loc[100, "t"] = np.nan
    (log,) = rig().read(frame)
    np.testing.assert_allclose(log.time, T, atol=1e-9)
    others = np.arange(T.size) != 100
    np.testing.assert_allclose(log["in_u"][others], U[others], atol=1e-9)
    assert "1 row without a time" in log.warnings[0]


@pytest.mark.parametrize(
    "kind",
    [
        *("datetime64", "with a zone", "timedelta64", "index", "parquet", "json"),
        *("unnamed index", "unnamed index, csv", "unnamed index, parquet"),
    ],
)
def test_dates_of_tables(tmp_path, kind):
    frame = pd.DataFrame({"t": stamps(T).tz_localize(None), "u": U, "q": Q})
    source = frame
    if kind == "with a zone":
        frame["t"] = stamps(T)
    elif kind == "timedelta64":
        frame["t"] = pd.to_timedelta(T, unit="s")
    elif kind == "index":
        source = frame.set_index("t")
    elif kind == "unnamed index":
        source = frame.set_index("t").rename_axis(None)
    elif kind == "unnamed index, csv":
        source = tmp_path / "run.csv"
        frame.set_index("t").rename_axis(None).to_csv(source)
    elif kind == "unnamed index, parquet":
        pytest.importorskip("pyarrow")
        source = tmp_path / "run.parquet"
        frame.set_index("t").rename_axis(None).to_parquet(source)
    elif kind == "parquet":
        pytest.importorskip("pyarrow")
        source = tmp_path / "run.parquet"
        frame.to_parquet(source)
    elif kind == "json":
        source = tmp_path / "run.json"
        frame.to_json(source, orient="records", date_format="iso", date_unit="ms")
    (log,) = rig().read(source)
    np.testing.assert_allclose(log.time, T, atol=1e-9)


NUMBERS = {  # column, unit
    "ms": (1e3 * T, "ms"),
    "us": (1e6 * T, "us"),
    "ns": ((1e9 * T).round().astype(np.int64), "ns"),
    "Unix ns": (1_760_000_000_000_000_000 + (1e9 * T).round().astype(np.int64), "ns"),
    "Unix s": (1_760_000_000 + T, "s"),
    "ticks": ((1e7 * T).round().astype(np.int64), "ticks"),
    "file time": (133_000_000_000_000_000 + (1e7 * T).round().astype(np.int64), "100 ns"),
    "32 bits of us": (((1e6 * T).astype(np.int64) + 2**32 - 500_000) % 2**32, "us"),
    "32 bits of ms": (((1e3 * T).round().astype(np.int64) + 2**32 - 500) % 2**32, "ms"),
    "32 bits with a sign": (
        ((1e6 * T).round().astype(np.int64) + 2**31 - 500_000 + 2**31) % 2**32 - 2**31, "us",
    ),
    "24 bits of us": (((1e6 * T).round().astype(np.int64) + 2**24 - 500_000) % 2**24, "us"),
    "16 bits of ms": (((1e3 * T).round().astype(np.int64) + 2**16 - 500) % 2**16, "ms"),
    "32 bits of us in ms": (
        np.round(1e-3 * (((1e6 * T).round().astype(np.int64) + 2**32 - 500_000) % 2**32), 3), "ms",
    ),
    "seconds of the day": (np.round((86399.0 + T) % 86400.0, 3), "s"),
}  # fmt: skip


@pytest.mark.parametrize("kind", NUMBERS)
@pytest.mark.parametrize("by_file", [True, False])
def test_numbers(tmp_path, kind, by_file):
    values, unit = NUMBERS[kind]
    source = pd.DataFrame({"t": values, "u": U, "q": Q})
    if by_file:
        source.to_csv(tmp_path / "run.csv", index=False)
        source = tmp_path / "run.csv"
    (log,) = rig(unit).read(source)
    assert log.sample_time == pytest.approx(STEP, rel=1e-4)
    np.testing.assert_allclose(log["out_q"], Q, atol=1e-9)
    if "bits" in kind or "day" in kind:
        assert any(" s once while the drive goes on" in w for w in log.warnings), log.warnings


@pytest.mark.parametrize(
    "kind",
    ["Unix ms", "Unix us", "Unix ns", "file time", ".NET", "Excel", "MATLAB", "Julian", "modified"],
)
def test_what_no_seconds_since_any_epoch_are(kind):
    per_second, since = {
        "Unix ms": (1e3, 1_760_000_000_000), "Unix us": (1e6, 1_760_000_000_000_000),
        "Unix ns": (1e9, 1_760_000_000_000_000_000), "file time": (1e7, 133_000_000_000_000_000),
        ".NET": (1e7, 638_000_000_000_000_000), "Excel": (1 / 86400, 45_000.4),
        "MATLAB": (1 / 86400, 738_000.4), "Julian": (1 / 86400, 2_460_988.9),
        "modified": (1 / 86400, 60_988.4),
    }[kind]  # fmt: skip
    time = since + (per_second * T if per_second < 1 else (per_second * T).round().astype(np.int64))
    (log,) = rig("s").read(pd.DataFrame({"t": time, "u": U, "q": Q}))
    assert log.sample_time == pytest.approx(STEP, rel=1e-5)
    assert "since" in log.warnings[0]


@pytest.mark.parametrize("start", [0.0, 0.394, 1 - 1 / 86400])
@pytest.mark.parametrize("step", [0.001, 0.01, 0.1])
def test_fractions_of_a_day(start, step):
    """A time of day as a number, also over midnight."""
    days = (start + step * INDEX / 86400) % 1
    (log,) = rig().read(pd.DataFrame({"t": days, "u": U, "q": Q}))
    assert log.sample_time == pytest.approx(step, rel=1e-6)
    assert len(log) == ROWS
    assert "no seconds of a drive: taken as days of 86400 s" in log.warnings[0]


@pytest.mark.parametrize("start", [0.0, 13.25])
@pytest.mark.parametrize("step", [0.0005, 0.001, 0.005])
def test_hours(start, step):
    """No drive is sampled at 20.83 Hz, as days would have it."""
    (log,) = rig().read(pd.DataFrame({"t": start + step * INDEX / 3600, "u": U, "q": Q}))
    assert log.sample_time == pytest.approx(step, rel=1e-6)
    assert "no seconds of a drive: taken as hours of 3600 s" in log.warnings[0]


@pytest.mark.parametrize("step", [1e-6, 4e-7, 8e-7])
def test_an_oscilloscope_counts_seconds(step):
    (log,) = rig().read(pd.DataFrame({"t": step * INDEX, "u": U, "q": Q}))
    assert log.sample_time == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize("size", [1.0, 0.256, 60.0])
def test_a_clock_that_runs_over_while_the_drive_goes_on(size):
    """Milliseconds within a second or a minute; one fall to the first time is a new run."""
    time = 0.004 * np.arange(1500) + (57.0 if size == 60 else 0.0)
    frame = pd.DataFrame({"t": np.round(time % size, 3), "u": np.sin(time), "q": np.cos(time)})
    (log,) = rig().read(frame)
    assert len(log) == 1500
    assert log.sample_time == pytest.approx(0.004, rel=1e-9)
    assert f"falls by {size:g} s" in log.warnings[0]


def coarse(tick, step):
    return np.round(np.floor(step * INDEX / tick + 1e-9) * tick, 3)


@pytest.mark.parametrize(
    ("tick", "step"),
    [(0.015625, 0.01), (0.016, 0.002), (0.015625, 0.02), (0.001, 0.0015), (1.0, 0.01)],
)
def test_coarse_clock(tick, step):
    """The stamps of a clock that ticks in steps of its own."""
    frame = pd.DataFrame({"t": coarse(tick, step), "u": U, "q": Q})
    (log,) = rig().read(frame)
    assert len(log) == ROWS
    # a tick tells the row after it: twice within the log, to two rows in three hundred
    assert log.sample_time == pytest.approx(step, rel=1e-3)
    np.testing.assert_allclose(log["out_q"], Q, atol=1e-12)
    assert any("clock is coarse" in w and "sample_rate" in w for w in log.warnings)


GROUPS = np.random.default_rng(4).integers(5, 40, 120)  # rows that a program read at once
ENDS = np.cumsum(GROUPS)


@pytest.mark.parametrize("end", ["first", "last"])
@pytest.mark.parametrize("late", [0.0, 0.003])
def test_rows_that_were_read_in_groups(end, late):
    """Each group has one stamp, of its first or last row, and a host is late by chance."""
    of = (ENDS - GROUPS if end == "first" else ENDS - 1) * STEP / 10
    of = of + np.random.default_rng(5).uniform(0.0, late, of.size) + 1.76e9  # since 1970
    time = np.repeat(of, GROUPS)
    true = np.arange(time.size) * STEP / 10
    (log,) = rig().read(pd.DataFrame({"t": time, "u": np.sin(3 * true), "q": np.cos(2 * true)}))
    assert log.sample_time == pytest.approx(STEP / 10, rel=1e-7 if late == 0.0 else 1e-4)
    assert len(log) == true.size
    assert "clock is coarse" in log.warnings[0]


def test_a_group_that_was_lost_is_no_even_clock():
    time, rows = np.repeat(0.1 * np.arange(40), 25), np.ones(1000, bool)
    rows[500:525] = False
    true = 0.004 * np.arange(1000)
    frame = pd.DataFrame({"t": time, "u": np.sin(3 * true), "q": np.cos(2 * true)})[rows]
    with pytest.raises(LogError, match="two values at time 0 s; .* sample_rate"):
        rig().read(frame)


def test_days_of_six_decimals():
    """Excel's days: 86 ms a tick, in which eight rows share a stamp."""
    frame = pd.DataFrame({"t": np.round(45_970.4 + T / 86400, 6), "u": U, "q": Q})
    (log,) = rig().read(frame)
    assert log.sample_time == pytest.approx(STEP, rel=0.02)


def test_a_clock_that_was_set_back_goes_on():
    frame = pd.DataFrame({"t": np.where(INDEX > 150, T - 0.07, T), "u": U, "q": Q})
    (log,) = rig().read(frame)
    np.testing.assert_allclose(log.time, T, atol=1e-9)
    assert log.warnings[0].startswith("the clock falls by 0.07 s once")


def test_rows_out_of_order_are_no_clock_that_was_set_back():
    frame = pd.DataFrame({"t": T, "u": U, "q": Q}).iloc[[*range(100), 101, 100, *range(102, 300)]]
    (log,) = rig().read(frame)
    np.testing.assert_allclose(log["in_u"], U, atol=1e-12)
    assert log.warnings[0] == "sorted by time"


def test_rows_within_a_tick_of_an_irregular_clock():
    true = np.sort(np.random.default_rng(6).uniform(0, 3, 900))
    time = true.round(4)
    assert (np.diff(time) == 0).sum() > 5
    (log,) = rig().read(pd.DataFrame({"t": time, "u": np.sin(3 * true), "q": np.cos(2 * true)}))
    assert np.abs(log["in_u"] - np.sin(3 * log.time)).max() < (3 * np.diff(time).max()) ** 2 / 8
    assert "within a tick of the clock averaged" in log.warnings[0]


@pytest.mark.parametrize("start", [0.0, 0.314])
def test_rate_of_whole_seconds(start):
    """Where stamps change, the clock has just ticked: that tells the rate of samples."""
    time = 0.004 * np.arange(2500) + start
    frame = pd.DataFrame({"t": np.floor(time + 1e-9), "u": np.sin(time), "q": np.cos(time)})
    (log,) = rig().read(frame)
    assert log.sample_time == pytest.approx(0.004, rel=1e-12)


def test_clock_that_is_neither_number_nor_time(tmp_path):
    lines = (f"after {i} steps,{u},{u}\n" for i, u in enumerate(U))
    (tmp_path / "run.csv").write_text("t,u,q\n" + "".join(lines))
    with pytest.raises(LogError, match="nor times as 'after 0 steps' all through; .* sample_rate"):
        rig().read(tmp_path / "run.csv")


def test_coarse_clock_of_a_known_rate():
    frame = pd.DataFrame({"t": coarse(0.5, STEP), "u": U, "q": Q})
    (log,) = rig(more='sample_rate = "100 Hz"').read(frame)
    assert log.sample_time == STEP


def test_jitter_and_lost_rows_are_mended():
    time = T + np.random.default_rng(1).uniform(-0.003, 0.003, ROWS)
    keep = np.delete(INDEX, [50, 51, 52, 200])
    (log,) = rig().read(
        pd.DataFrame({"t": time, "u": np.sin(3 * time), "q": Q})[["t", "u", "q"]].iloc[keep]
    )
    error = np.abs(log["in_u"] - np.sin(3 * log.time)).max()
    assert error < (3 * 0.046) ** 2 / 8  # of a straight line over three lost rows and jitter
    assert any("resampled to even steps" in w for w in log.warnings)


def test_rows_that_occur_twice_are_no_coarse_clock():
    frame = pd.DataFrame({"t": T, "u": U, "q": Q}).loc[lambda f: f.index.repeat(2)]
    (log,) = rig().read(frame)
    assert len(log) == ROWS
    assert any("repeated rows dropped: 300" in w for w in log.warnings)


def test_logger_started_again():
    time = np.concatenate([T[:100], T[:200]])
    (log,) = rig().read(pd.DataFrame({"t": time, "u": U, "q": Q}))
    np.testing.assert_allclose(log["in_u"], U[100:], atol=1e-12)
    assert log.warnings == ("time starts anew: rows 101 to 300 of 300 are used",)


@pytest.mark.parametrize(
    ("time", "unit", "message"),
    [
        (np.where(INDEX > 150, T + 3.0, T), "s", "start, stop"),
        (1e9 * T, "s", 'unit = "ns"'),
        (T, "ns", "time must be in seconds"),
    ],
)
def test_what_cannot_be_mended_names_a_key(time, unit, message):
    with pytest.raises(LogError, match=message):
        rig(unit).read(pd.DataFrame({"t": time, "u": U, "q": Q}))
