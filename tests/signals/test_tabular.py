"""Data frames, Parquet and MDF; the latter two where their libraries are installed."""

import sys

import numpy as np
import pandas as pd
import pytest

from dmptm_ctrl import LogError, load_log
from dmptm_ctrl.signals import mdf


def test_frame(columns):
    log = load_log(pd.DataFrame(columns), name="mine")
    assert log.name == "mine"
    assert log.sha256 is None
    np.testing.assert_allclose(log["theta_L"], np.radians(columns["theta_L_deg"]), rtol=1e-15)


def test_frame_indexed_by_time(columns):
    frame = pd.DataFrame(columns).set_index("time_s")
    assert load_log(frame).sample_time == 1e-3


@pytest.mark.parametrize("kind", ["frame", "Arrow", "Parquet by another name"])
def test_dates_are_the_clock(columns, tmp_path, kind):
    frame = pd.DataFrame({"taken": pd.date_range("2024", periods=2000, freq="ms"), **columns})
    source = frame = frame.drop(columns="time_s")
    if kind != "frame":
        source = pytest.importorskip("pyarrow").Table.from_pandas(frame)
    if kind == "Parquet by another name":
        source = tmp_path / "run.pq"
        frame.to_parquet(source)
    assert load_log(source).sample_time == pytest.approx(1e-3, rel=1e-12)


def test_frame_is_not_changed(columns):
    frame = pd.DataFrame(columns)
    before = frame.copy(deep=True)
    load_log(frame)
    pd.testing.assert_frame_equal(frame, before)


@pytest.mark.parametrize(
    ("frame", "message"),
    [
        ([1, 2, 3], "a log is a path or a DataFrame, not list"),
        (pd.DataFrame([[1.0, 2.0]], columns=["x_m", "x_m"]), "'x_m' .* occurs 2 times"),
        (pd.DataFrame({"time_s": ["a", "b"]}), "'time_s' does not hold numbers"),
        (pd.DataFrame({"time_s": [[1], [2, 3]]}), "'time_s' does not hold numbers"),
        (pd.DataFrame({"time_s": pd.date_range("2020", periods=3)}), "3 samples, at least 100"),
        (
            pd.DataFrame({"time_s": [0, 1, 2], "x_m": pd.date_range("2020", periods=3)}),
            "'x_m' does not hold numbers",
        ),
        (pd.DataFrame({"time_s": [0, 1, 2], "x_m": 1j}), "'x_m' does not hold numbers"),
        (pd.DataFrame(), "no time column"),
    ],
)
def test_bad_frame(frame, message):
    with pytest.raises(LogError, match=message):
        load_log(frame)


def test_parquet(columns, tmp_path):
    pytest.importorskip("pyarrow")
    path = tmp_path / "run.parquet"
    pd.DataFrame({**columns, "note": "text"}).to_parquet(path)
    log = load_log(path)
    np.testing.assert_allclose(log["omega_L"], np.radians(columns["omega_L_deg_s"]), rtol=1e-15)
    assert any("ignored 'note'" in warning for warning in log.warnings)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(LogError, match="not a readable Parquet file, or damaged"):
        load_log(path)


def test_parquet_with_missing_values(columns, tmp_path):
    pytest.importorskip("pyarrow")
    frame = pd.DataFrame(columns)
    frame.loc[7, "theta_L_deg"] = None
    frame.to_parquet(tmp_path / "run.parquet")
    log = load_log(tmp_path / "run.parquet")
    np.testing.assert_allclose(np.degrees(log["theta_L"]), columns["theta_L_deg"], atol=1e-4)
    assert "theta_L_deg lacks 1 value, at most 1 in a row: bridged" in log.warnings


@pytest.fixture
def save_mdf(tmp_path):
    asammdf = pytest.importorskip("asammdf")

    def save(*groups):
        path = tmp_path / "run.mf4"
        with asammdf.MDF(version="4.10") as file:
            for time, signals in groups:
                file.append([asammdf.Signal(v, time, name=n, unit=u) for n, v, u in signals])
            file.save(path, overwrite=True)
        return path

    return save


def test_mdf_takes_units_from_the_file(columns, save_mdf):
    time = columns["time_s"]
    path = save_mdf(
        (time, [("u_left", 1e3 * columns["u_left_V"], "mV")]),
        (time, [("x", time**2, "mm"), ("omega_L_deg_s", columns["omega_L_deg_s"], "")]),
    )
    log = load_log(path)
    np.testing.assert_allclose(log.time, time, rtol=1e-15)
    np.testing.assert_allclose(log["u_left"], columns["u_left_V"], rtol=1e-12)
    np.testing.assert_allclose(log["x"], 1e-3 * time**2, rtol=1e-12)
    np.testing.assert_allclose(log["omega_L"], np.radians(columns["omega_L_deg_s"]), rtol=1e-12)


def test_mdf_on_two_clocks(columns, save_mdf):
    time = columns["time_s"]
    path = save_mdf((time, [("u", time, "V")]), (time[::10], [("x", time[::10], "m")]))
    log = load_log(path)
    np.testing.assert_allclose(log["x"], log.time, atol=1e-12)
    assert "x on another clock" in log.warnings[0]


def test_mdf_channels_of_one_name(save_mdf):
    time = 0.01 * np.arange(200)
    path = save_mdf((time, [("u", time, "V")]), (time, [("u", -time, "V"), ("x", time, "m")]))
    log = load_log(path, {"u (group 2)": ("u", "V"), "x": ("x", "m"), "t": ("time", "s")})
    np.testing.assert_allclose(log["u"], -time)
    with pytest.raises(LogError, match=r"did you mean 'u \(group 1\)', 'u \(group 2\)'"):
        load_log(path, {"u": ("u", "V")})


def test_damaged_mdf(tmp_path):
    pytest.importorskip("asammdf")
    (tmp_path / "run.mf4").write_bytes(b"MDF     4.10    " + b"\xff" * 200)
    with pytest.raises(LogError, match="not a readable .mf4 file, or damaged"):
        load_log(tmp_path / "run.mf4")


def test_missing_pyarrow_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    (tmp_path / "run.parquet").write_bytes(b"anything")
    with pytest.raises(LogError, match=r"pip install 'dmptm-ctrl\[parquet\]'"):
        load_log(tmp_path / "run.parquet")


def test_missing_asammdf_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "asammdf", None)
    with pytest.raises(ImportError, match=r"pip install 'dmptm-ctrl\[mf4\]'"):
        mdf.find_signals(tmp_path / "run.mf4")
