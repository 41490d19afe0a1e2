"""Logs by the column mapping of a rig file: every format, clocks that are not perfect."""

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError

RIG = """
name = "bench"
[body.rotor]
inertia = "unknown"
[input.drive]
column = "cmd"
unit = "mV"
[sensor.tacho]
column = "speed"
unit = "rpm"
sign = -1
[data]
time = { column = "t", unit = "ms" }
"""
RNG = np.random.default_rng(3)
T = np.arange(200.0)  # ms
CMD = 1000 * np.sin(2 * np.pi * T / 100)
SPEED = 60 * np.cos(2 * np.pi * T / 100)
FRAME = pd.DataFrame({"t": T, "cmd": CMD, "speed": SPEED, "note": 1.0})


def csv(path):
    FRAME.to_csv(path / "run.csv", index=False)


def german_csv(path):
    FRAME.to_csv(path / "run.csv", index=False, sep=";", decimal=",")


def zipped(path):
    FRAME.to_csv(path / "run.csv.gz", index=False)


def blanks(path):
    FRAME.to_csv(path / "run.txt", index=False, sep=" ")


def matlab(path):
    savemat(path / "run.mat", {"rec": {k: FRAME[k].to_numpy() for k in FRAME}})


def dspace(path):
    signals = [
        {"Name": f'"Model Root"/"{k}"', "Data": FRAME[k].to_numpy()} for k in ("cmd", "speed")
    ]
    x = {"Name": "t", "Data": T / 1000, "Unit": "s"}
    savemat(path / "run.mat", {"measurement": {"X": x, "Y": np.array(signals, dtype=object)}})


def matlab73(path):
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("pymatreader")
    with h5py.File(path / "run.mat", "w", userblock_size=512) as file:
        for k in FRAME:
            data = file.create_dataset(k, data=FRAME[k].to_numpy()[None])
            data.attrs["MATLAB_class"] = np.bytes_("double")
    with (path / "run.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


def parquet(path):
    pytest.importorskip("pyarrow")
    FRAME.to_parquet(path / "run.parquet")


@pytest.mark.parametrize(
    "write", [csv, german_csv, zipped, blanks, matlab, dspace, matlab73, parquet]
)
def test_formats(tmp_path, write):
    write(tmp_path)
    text = RIG
    if write is dspace:  # the recording brings its own clock
        text = RIG.replace('{ column = "t", unit = "ms" }', '{ column = "time_s", unit = "s" }')
    (log,) = parse_rig(text).read(tmp_path)
    assert log.name == "run"
    assert log.sample_time == pytest.approx(1e-3)
    np.testing.assert_allclose(log["in_drive"], CMD / 1000, atol=1e-12)
    np.testing.assert_allclose(log["out_tacho"], -SPEED * 2 * np.pi / 60, atol=1e-12)


def test_frame():
    (log,) = parse_rig(RIG).read(FRAME)
    np.testing.assert_allclose(log["in_drive"], CMD / 1000, atol=1e-12)


def test_shuffled_rows_are_sorted():
    (log,) = parse_rig(RIG).read(FRAME.sample(frac=1.0, random_state=1))
    np.testing.assert_allclose(log["in_drive"], CMD / 1000, atol=1e-12)
    assert log.warnings


def test_a_few_missing_samples_are_bridged():
    (log,) = parse_rig(RIG).read(FRAME.drop(index=[50, 51, 120]))
    assert len(log) == 200
    np.testing.assert_allclose(log["in_drive"], CMD / 1000, atol=0.01)
    assert log.warnings


def test_a_long_gap_is_refused():
    with pytest.raises(LogError, match="gap|uneven"):
        parse_rig(RIG).read(FRAME.drop(index=range(50, 90)))


def test_no_clock():
    text = RIG.replace('time = { column = "t", unit = "ms" }', 'sample_rate = "2 kHz"')
    (log,) = parse_rig(text).read(FRAME.drop(columns="t"))
    assert log.sample_time == pytest.approx(5e-4)


def test_no_clock_and_no_word_of_it():
    with pytest.raises(LogError, match="'t'"):
        parse_rig(RIG).read(FRAME.drop(columns="t"))


def test_missing_column_is_named_with_those_there():
    with pytest.raises(LogError, match="'speed'.*rpm_meas"):
        parse_rig(RIG).read(FRAME.rename(columns={"speed": "rpm_meas"}))


@pytest.mark.parametrize(
    ("unit", "shown"), [("mV", "cmd [mV] "), ("1", "cmd "), ("pwm", "cmd [pwm] ")]
)
def test_log_info_by_a_rig(tmp_path, capsys, unit, shown):
    csv(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG.replace('"mV"', f'"{unit}"'))
    file = str(tmp_path / "run.csv")
    assert main(["log", "info", file, "--rig", str(tmp_path / "rig.toml")]) == 0
    said = capsys.readouterr().out
    assert f"\n {shown} " in said  # the column and the unit as the rig file names them
    assert "coulomb_friction" in said


def test_logs_are_named_as_their_files_with_or_without_the_extension(tmp_path):
    for name in "abcd":
        FRAME.to_csv(tmp_path / f"run_{name}.csv", index=False)
    more = """
fit = ["run_a.csv", "run_b"]
held_out = ["*_c.csv", "run_x"]
ignore = ["run_d", "*.bak"]
start = { "run_a.csv" = "100 ms", run_y = 1 }
"""
    rig, reported = parse_rig(RIG + more), []
    logs = rig.read(tmp_path, notes=reported)
    assert [log.name for log in logs] == ["run_a", "run_b", "run_c"]
    assert [len(log) for log in logs] == [100, 200, 200]
    assert rig.roles(["run_a", "run_b", "run_c"]) == {
        "run_a": "fit",
        "run_b": "fit",
        "run_c": "held-out",
    }
    there = "which fits no log; there are 'run_a', 'run_b', 'run_c'"
    assert reported == [
        f"[data] ignore names '*.bak', {there}",
        f"[data] held_out names 'run_x', {there}",
        f"[data] start names 'run_y', {there}",
    ]
