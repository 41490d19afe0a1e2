"""The files and exit codes of `dmptm diagnose` and `dmptm predict` that others rely on."""

import io
import json
import math
import re
import shutil
from contextlib import redirect_stdout

import numpy as np
import pandas as pd
import pytest

import dmptm_ctrl
from dmptm_ctrl import data, load_log
from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis import predict
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE, TABLES
from dmptm_ctrl.simulate.model_file import read_model

DEMO = data.path("demo_rig")  # without motor encoders
OTHER = data.path("null_rig")  # with
SHORT = ("open_sine_0v60", "open_sine_0v75", "closed_sine_10", "closed_sine_15")
PREDICTED = ["time_s", "theta_L_deg", "omega_L_deg_s", "theta_ml_deg", "theta_mr_deg"]
KEYS = {
    *("schema", "verdict", "effects", "budget", "ranking", "depends_on", "error", "declared"),
    "provenance",
}
ROW = {"name", "location", "speed_rms", "torque_rms", "share", "depends_on"}
STATUS = {"supported", "rejected", "not testable with these logs"}
VARIABLES = {
    "theta_L", "theta_m", "omega_L", "omega_m", "u", "du_dt", "mesh_torque", "time",
    "time_at_rest",
}  # fmt: skip


def table(rig=DEMO, name="open_sine_0v60"):
    return pd.read_csv(rig / f"{name}.csv.gz")


def campaign(folder, **tables):
    """A folder of logs: a good one and those given."""
    folder.mkdir()
    shutil.copy(DEMO / "closed_sine_10.csv.gz", folder)
    for name, frame in tables.items():
        frame.to_csv(folder / f"{name}.csv", index=False, na_rep="nan")
    return folder


def without_speed(tmp_path):
    return campaign(tmp_path / "logs", a=table().drop(columns="omega_L_deg_s"))


def without_voltage(tmp_path):
    folder = tmp_path / "logs"
    folder.mkdir()
    table().drop(columns="u_left_V").to_csv(folder / "a.csv", index=False)
    return folder


def with_nan(tmp_path):
    """A few are bridged with a warning; so many may hide anything."""
    frame = table()
    frame.loc[1000:1100, "theta_L_deg"] = math.nan
    return campaign(tmp_path / "logs", a=frame)


def unknown_unit(tmp_path):
    """Among other logs it would be left out with a warning; alone nothing is left."""
    folder = campaign(tmp_path / "logs", a=table().rename(columns={"theta_L_deg": "theta_L_grade"}))
    (folder / "closed_sine_10.csv.gz").unlink()
    return folder


def unit_of_another_quantity(tmp_path):
    return campaign(tmp_path / "logs", a=table().rename(columns={"theta_L_deg": "theta_L_V"}))


def speed_called_radians(tmp_path):
    """The name says rad/s, the figures are deg/s: speed and angle disagree."""
    frame = table().rename(columns={"omega_L_deg_s": "omega_L_rad_s"})
    return campaign(tmp_path / "logs", a=frame)


def logs_of_two_rigs(tmp_path):
    return campaign(tmp_path / "logs", a=table(OTHER))


def empty_folder(tmp_path):
    (tmp_path / "logs").mkdir()
    return tmp_path / "logs"


def no_folder(tmp_path):
    return tmp_path / "logs"


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        (without_speed, "omega_L"),
        (without_voltage, "u_left"),
        (with_nan, "NaN.*theta_L_deg|theta_L_deg.*NaN"),
        (unknown_unit, "theta_L_grade"),
        (unit_of_another_quantity, "theta_L_V"),
        (speed_called_radians, "omega_L"),
        (logs_of_two_rigs, "different rigs"),
        (empty_folder, "no log"),
        (no_folder, "no such"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_bad_input_writes_nothing(tmp_path, capsys, bad, message):
    logs = bad(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert main(["diagnose", str(logs), "--out", str(tmp_path / "out")]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("dmptm: ")
    assert err.count("\n") == 1
    assert err.endswith("\n")
    assert re.search(message, err)
    assert sorted(tmp_path.rglob("*")) == before


def test_predict_without_a_model_writes_nothing(tmp_path, capsys):
    log, out = str(DEMO / "open_sine_0v60.csv.gz"), tmp_path / "pred.csv"
    assert main(["predict", log, "--model", str(tmp_path / "no.toml"), "--out", str(out)]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """What `dmptm diagnose` writes for four logs of the demo rig, which is out of balance."""
    folder = tmp_path_factory.mktemp("diagnosis")
    (folder / "logs").mkdir()
    for name in SHORT:
        shutil.copy(DEMO / f"{name}.csv.gz", folder / "logs")
    arguments = ["diagnose", str(folder / "logs"), "--out", str(folder / "out"), "--seed", "5"]
    arguments += ["--jobs", "2"]
    with redirect_stdout(io.StringIO()) as printed:
        assert main(arguments) == 0
    (folder / "printed.txt").write_text(printed.getvalue(), encoding="utf-8")
    return folder


def no_constant(text):
    raise AssertionError(f"{text} in diagnosis.json")


@pytest.fixture(scope="module")
def found(written):
    text = (written / "out" / "diagnosis.json").read_text(encoding="utf-8")
    return json.loads(text, parse_constant=no_constant)


def test_files_and_keys(written, found):
    names = {path.name for path in (written / "out").iterdir()}
    assert {"diagnosis.json", "model.toml", "report.html"} <= names
    assert set(found) >= KEYS
    assert found["schema"] == 2
    assert found["verdict"] in {"none", "explained", "unknown"}
    assert found["verdict"] == "explained"
    assert set(found["depends_on"]) <= VARIABLES


@pytest.mark.long
def test_threads_change_nothing(found):
    """One set of logs has one verdict, to the bit, on any number of threads."""
    logs = dmptm_ctrl.load_logs([DEMO / f"{name}.csv.gz" for name in sorted(SHORT)])
    alone = json.loads(json.dumps(dmptm_ctrl.diagnose(logs, jobs=1).to_dict()))
    assert alone["effects"]
    assert {k: v for k, v in alone.items() if k != "provenance"} == {
        k: v for k, v in found.items() if k != "provenance"
    }


def test_effects(found):
    assert [effect["name"] for effect in found["effects"]] == ["unbalance"]
    for effect in found["effects"]:
        assert effect["location"] == CATALOGUE[effect["name"]].location
        assert 0.0 <= effect["probability"] <= 1.0
        assert effect["material"] is True
        assert set(effect["confusable_with"]) <= set(CATALOGUE) - {effect["name"]}
        assert effect["evidence"].endswith(".")
        declared = {p.name: p.unit for p in CATALOGUE[effect["name"]].parameters}
        found_units = {n: p["unit"] for n, p in effect["parameters"].items()}
        assert found_units == {**declared, "amplitude": declared["cosine"]}
        for p in effect["parameters"].values():
            assert set(p) == {"value", "se", "unit"}
            assert p["se"] > 0.0


def test_budget(found):
    budget = found["budget"]
    assert [row["name"] for row in budget[-2:]] == ["not explained", "floor"]
    named = [row["name"] for row in budget[:-2] if row["name"] != "shared"]
    assert named == [effect["name"] for effect in found["effects"]]
    assert sum(row["share"] for row in budget) == pytest.approx(1.0, abs=1e-9)
    shares = [row["share"] for row in budget[:-2]]
    assert shares == sorted(shares, reverse=True)
    for row in budget:
        assert set(row) == ROW
        assert set(row["depends_on"]) <= VARIABLES
        assert all(row[key] is None or row[key] >= 0.0 for key in ("speed_rms", "torque_rms"))
    assert budget[0]["depends_on"] == ["theta_L"]
    assert budget[0]["speed_rms"] > budget[-1]["speed_rms"] > 0.0


def test_ranking(found):
    names = [row["name"] for row in found["ranking"]]
    assert sorted(names) == sorted(set(CATALOGUE) - set(TABLES))
    added = {effect["name"] for effect in found["effects"]}
    rivals = {name for effect in found["effects"] for name in effect["confusable_with"]}
    least = min(row["score"] for row in found["ranking"] if row["name"] in added)
    for row in found["ranking"]:
        assert row["status"] in STATUS
        assert row["location"] == CATALOGUE[row["name"]].location
        assert row["reveals"].strip()
        assert isinstance(row["score"], float)
        assert (row["status"] == "supported") == (row["name"] in added)
        if row["status"] == "rejected":
            assert row["reason"].strip()
        if row["status"].startswith("not testable"):
            assert row["name"] not in rivals
            assert row["score"] < least


def test_error(found):
    error = found["error"]
    assert (error["unit"], error["bandwidth_hz"], error["on"]) == ("deg/s", 30, "held-out logs")
    for side in ("before", "after", "floor"):
        reported = error[side]
        assert reported["rmse"] == reported["speed"]["rmse"] > 0.0
        assert reported["unit"] == reported["speed"]["unit"] == "deg/s"
        assert reported["speed"]["bandwidth_hz"] == 30
        assert reported["torque"]["unit"] == "N·m"
        assert reported["torque"]["rmse"] > 0.0
        assert 0.0 < reported["torque"]["percent"] < 100.0
        assert reported["horizon"]["unit"] == "deg/s"
        assert reported["horizon"]["rmse"] > 0.0
        assert reported["horizon"]["seconds"] > 0.0
    for side in ("before", "after"):
        speed = error[side]["speed"]
        assert speed["fit_percent"] <= 100.0
        assert -1.0 <= speed["pearson_r"] <= 1.0
    for kind in ("speed", "torque", "horizon"):
        before, after, floor = (error[s][kind]["rmse"] for s in ("before", "after", "floor"))
        assert floor <= min(before, after)
    assert error["after"]["rmse"] < 0.5 * error["before"]["rmse"]
    assert error["after"]["torque"]["rmse"] < 0.5 * error["before"]["torque"]["rmse"]


def test_declared(found):
    drive = paper_drive()
    assert set(found["declared"]) == set(drive.free)
    for name, reported in found["declared"].items():
        quantity = drive.quantities[name]
        assert reported["declared"] == quantity.value
        assert reported["range"] == list(quantity.range)
        assert reported["unit"] == quantity.unit
        low, high = reported["range"]
        edge = 1e-5 * (high - low)
        assert low - edge <= reported["fitted"] <= high + edge
        assert reported["se"] > 0.0
        inside = low + edge < reported["fitted"] < high - edge
        assert reported["outside"] is not inside


def test_provenance(found):
    origin = found["provenance"]
    assert origin["version"] == dmptm_ctrl.__version__
    assert origin["seed"] == 5
    assert origin["seconds"] > 0
    logs = {log["name"]: log for log in origin["logs"]}
    assert set(logs) == set(SHORT)
    assert {log["role"] for log in logs.values()} == {"fit", "held-out"}
    for name, log in logs.items():
        assert log["sha256"] == load_log(DEMO / f"{name}.csv.gz").sha256


def test_what_is_printed_says_no_more_than_the_budget(written):
    reported = (written / "printed.txt").read_text(encoding="utf-8")
    assert "nothing is missing" not in reported
    assert "unbalance" in reported.splitlines()[0]
    for line in ("not explained", "floor", "speed error on held-out logs"):
        assert line in reported
    assert "nan" not in reported


def run_predict(log, written, out):
    model = written / "out" / "model.toml"
    assert main(["predict", str(log), "--model", str(model), "--out", str(out)]) == 0
    return pd.read_csv(out)


def test_predict_is_a_free_run(written, tmp_path):
    """Only the voltages and the first angle of the log count."""
    frame = table(name="open_square_0v60")
    whole = run_predict(DEMO / "open_square_0v60.csv.gz", written, tmp_path / "whole.csv")
    assert list(whole.columns) == PREDICTED
    np.testing.assert_allclose(whole["time_s"], frame["time_s"], atol=1e-9)
    bare = frame[["time_s", "u_left_V", "u_right_V", "theta_L_deg"]].copy()
    bare["theta_L_deg"] = bare["theta_L_deg"].iloc[0]
    bare.to_csv(tmp_path / "bare.csv", index=False)
    alone = run_predict(tmp_path / "bare.csv", written, tmp_path / "alone.csv")
    pd.testing.assert_frame_equal(alone, whole)
    assert whole["theta_L_deg"].iloc[0] == pytest.approx(frame["theta_L_deg"].iloc[0], abs=1e-4)


def test_predict_from_python_is_the_same(written, tmp_path):
    log = DEMO / "open_square_0v60.csv.gz"
    model = read_model(written / "out" / "model.toml")
    here = predict(model, load_log(log))
    there = run_predict(log, written, tmp_path / "pred.csv")
    np.testing.assert_allclose(here, there, rtol=1e-6, atol=1e-9)  # seven digits in the file


def test_predict_is_better_on_a_log_never_seen(written, tmp_path):
    """The effect is in the model: without it the speed of another experiment is further off."""
    frame = table(name="open_square_0v60")
    log = load_log(DEMO / "open_square_0v60.csv.gz")
    model = read_model(written / "out" / "model.toml")
    seen = frame["omega_L_deg_s"].to_numpy()
    far = predict(model.without(["unbalance"]), log)["omega_L_deg_s"].to_numpy() - seen
    near = predict(model, log)["omega_L_deg_s"].to_numpy() - seen
    assert np.sqrt(np.mean(near**2)) < 0.7 * np.sqrt(np.mean(far**2))
