"""Folders as campaigns leave them, and what `log info` says of files without a rig."""

import gzip
import json
import shutil

import numpy as np
import pandas as pd
import pytest
from scipy.io import savemat

from dmptm_ctrl import diagnose
from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError, load_log, load_logs

T = 0.01 * np.arange(400)
FRAME = pd.DataFrame({"t": T, "u": np.sin(T), "q": np.cos(T)})
RIG = """
[body.a]
inertia = "unknown"
[input.u]
column = "u"
unit = "{unit}"
[sensor.q]
column = "q"
unit = "rad"
[data]
time = {{ column = "t", unit = "s" }}
"""
TEXT = FRAME.to_csv(index=False)
STRAY = {
    "aborted.csv": b"t,u,q\n0.0,0.1,0.2\n0.01,0.2,0.3\n",
    "empty.csv": b"",
    "header.csv": b"t,u,q\n",
    "notes.txt": b"Bench 3, oil changed on Monday.\nRun a: sines; run b: mirrored.\n",
    "numbers.txt": b"1\n2\n3\n",
    "summary.csv": pd.DataFrame({"run": range(200), "rms": 1.0}).to_csv(index=False).encode(),
    "temperature.csv": pd.DataFrame({"t": T, "T_bearing": 30.0}).to_csv(index=False).encode(),
    "picture.dat": bytes(range(256)) * 40,
    "cut.csv.gz": gzip.compress(TEXT.encode())[:200],
    "settings.json": b'{"kp": 3.0, "name": "a"}',
    "broken.mat": b"MATLAB 5.0 MAT-file, cut",
    "README": b"Logs of the bench.\n",
}
SILENT = {
    "._run.csv": b"\0\5\x16\7" * 30,
    ".DS_Store": b"\0\0\0\1Bud1",
    "~lock.csv": b"t,u,q\n",
    "rig.toml": b"",
    "plot.png": b"\x89PNG",
    "evaluate.py": b"1, 2\n",
    "book.xlsx": b"PK",
    "desktop.ini": b"[x]",
}


def folder(tmp_path, files, logs=("run_a", "run_b")):
    for i, name in enumerate(logs):
        FRAME.assign(u=FRAME["u"] + i).to_csv(tmp_path / f"{name}.csv", index=False)
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_stray_files_are_left_out(tmp_path):
    reported = []
    logs = parse_rig(RIG.format(unit="N m")).read(folder(tmp_path, STRAY | SILENT), notes=reported)
    assert [log.name for log in logs] == ["run_a", "run_b"]
    assert all(t.startswith("left out: ") for t in reported)
    assert sorted(t.split()[2].rstrip(":") for t in reported) == sorted(STRAY)


@pytest.mark.parametrize("name", ["run.xls", "run.bak", "run.m", "run"])
def test_a_file_that_is_named_is_judged_by_its_content(tmp_path, name):
    (tmp_path / name).write_text(TEXT)
    (log,) = parse_rig(RIG.format(unit="N m")).read(tmp_path / name)
    np.testing.assert_allclose(log["out_q"], FRAME["q"])


def test_a_folder_inside_is_passed_over(tmp_path):
    folder(tmp_path, {})
    (tmp_path / "old.csv").mkdir()
    assert len(parse_rig(RIG.format(unit="N m")).read(tmp_path)) == 2


@pytest.mark.parametrize("name", STRAY)
def test_a_stray_file_alone_is_refused(tmp_path, name):
    with pytest.raises(LogError) as error:
        parse_rig(RIG.format(unit="N m")).read(folder(tmp_path, {name: STRAY[name]}, ()))
    assert str(error.value).startswith(name)


def test_nothing_but_stray_files_is_one_sentence(tmp_path, capsys):
    logs = tmp_path / "logs"
    logs.mkdir()
    folder(logs, STRAY, ())
    (tmp_path / "rig.toml").write_text(RIG.format(unit="N m"))
    arguments = ["diagnose", str(logs), "--rig", str(tmp_path / "rig.toml")]
    assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "nor can 11 more of the files be used" in said
    assert not (tmp_path / "out").exists()


def test_ignored_files_are_not_even_opened(tmp_path):
    a_rig = parse_rig(RIG.format(unit="N m") + 'ignore = ["notes*", "aborted.csv"]\n')
    reported = []
    a_rig.read(
        folder(tmp_path, {k: STRAY[k] for k in ("notes.txt", "aborted.csv")}), notes=reported
    )
    assert reported == []


@pytest.mark.parametrize("unit", ["1", "percent", "PWM", "counts", "V", "N m"])
def test_log_info_judges_inputs_of_any_unit(tmp_path, capsys, unit):
    FRAME.to_csv(tmp_path / "run.csv", index=False)
    (tmp_path / "rig.toml").write_text(RIG.format(unit=unit))
    arguments = ["log", "info", str(tmp_path / "run.csv"), "--rig", str(tmp_path / "rig.toml")]
    assert main(arguments) == 0
    said = capsys.readouterr().out
    assert "Can identify base_vibration" in said
    assert "nothing to diagnose" not in said


def packed(path):
    FRAME.to_csv(path / "run.csv.gz", index=False)


def matlab(path):
    savemat(path / "run.mat", {k: FRAME[k].to_numpy() for k in FRAME})


def parquet(path):
    pytest.importorskip("pyarrow")
    FRAME.assign(note="text").to_parquet(path / "run.parquet")


def columns_of_json(path):
    (path / "run.json").write_text(json.dumps(FRAME.to_dict("list")))


def units_row(path):
    (path / "run.csv").write_text(TEXT.replace("q\n", "q\ns,A,rad\n", 1))


@pytest.mark.parametrize("write", [packed, matlab, parquet, columns_of_json, units_row])
def test_log_info_lists_columns_without_a_rig(tmp_path, capsys, write):
    write(tmp_path)
    (file,) = tmp_path.iterdir()
    assert main(["log", "info", str(file)]) == 0
    assert "400 samples" in capsys.readouterr().out
    assert main(["log", "info", str(file), "--json"]) == 0
    info = json.loads(capsys.readouterr().out)
    assert info["samples"] == 400
    u = next(c for c in info["channels"] if c["column"].split("_")[0].split()[0] == "u")
    names = {c["column"].split("_")[0].split()[0] for c in info["channels"]}
    assert {"u", "q"} <= names <= {"t", "u", "q"}
    assert u["high"] == pytest.approx(np.sin(T).max())


def test_units_of_the_file_make_a_log(tmp_path):
    """Columns that are not called NAME_UNIT, where the file states their units."""
    units_row(tmp_path)
    log = load_log(tmp_path / "run.csv")
    assert log.units == {"u": "A", "q": "rad"}
    assert log.sample_time == pytest.approx(0.01)


@pytest.mark.parametrize("beside", [{}, {"tout": T}])
def test_object_of_matlab(tmp_path, beside):
    """Version 7.3 stores an object as a reference of six numbers."""
    h5py = pytest.importorskip("h5py")
    pytest.importorskip("pymatreader")
    path = tmp_path / "run.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        reference = np.array([[0xDD000000, 2, 1, 1, 1, 1]], dtype=np.uint32)
        data = file.create_dataset("ans", data=reference)
        data.attrs["MATLAB_class"] = np.bytes_("timeseries")
        data.attrs["MATLAB_object_decode"] = np.int32(3)
        for name, values in beside.items():
            file.create_dataset(name, data=values[None])
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    with pytest.raises(LogError, match="objects such as ans must be saved as structures"):
        parse_rig(RIG.format(unit="N m")).read(path)


def test_a_log_is_not_changed_by_reading(tmp_path):
    folder(tmp_path, STRAY)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    parse_rig(RIG.format(unit="N m")).read(tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before
    shutil.rmtree(tmp_path)


@pytest.mark.parametrize("logs", [None, 3, [1.0, 2.0]])
def test_what_is_no_log_at_all(logs):
    for take in (load_logs, diagnose):
        with pytest.raises((LogError, TypeError), match=r"logs? .*, not (a )?(NoneType|int|float)"):
            take(logs)


def test_a_column_called_time_is_the_clock_without_a_unit(tmp_path):
    FRAME.rename(columns={"t": "time", "u": "u_V"}).to_csv(tmp_path / "run.csv", index=False)
    log = load_log(tmp_path / "run.csv")
    assert log.sample_time == pytest.approx(0.01)
    assert "the clock is column 'time', taken in seconds" in log.warnings
