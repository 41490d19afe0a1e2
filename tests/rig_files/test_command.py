"""Files of a diagnosis of a small motor bench, `dmptm predict` on them, and what is refused."""

import json
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tests.rig_files.test_report import BENCH, diagnosed

from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis.predict import errors_text
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    (folder / "logs").mkdir()
    for name, columns in BENCH.logs().items():
        pd.DataFrame(columns).to_csv(folder / "logs" / f"{name}.csv", index=False)
    diagnosed().save(folder / "out")
    return folder


def test_diagnosis_names_the_friction(bench):
    found = json.loads((bench / "out" / "diagnosis.json").read_text())
    assert found["schema"] == 2
    assert found["verdict"] == "explained"
    values = {e["name"]: e["parameters"] for e in found["effects"]}
    assert set(values) == {"coulomb_friction", "drive_offset"}
    assert values["coulomb_friction"]["level"]["value"] == pytest.approx(0.03, rel=0.05)
    assert found["error"]["after"]["rmse"] < 0.5 * found["error"]["before"]["rmse"]
    rows = {row["name"]: row for row in found["budget"]}
    assert rows["not explained"]["share"] + rows["floor"]["share"] < 0.1
    assert min(rows[name]["share"] for name in values) > 0.1
    assert rows["coulomb_friction"]["torque_rms"] < found["error"]["before"]["rmse"]
    assert {row["status"] for row in found["ranking"]} <= {
        "supported", "rejected", "not testable with these logs",
    }  # fmt: skip
    roles = {log["role"] for log in found["provenance"]["logs"]}
    assert roles == {"fit"}
    assert "held-out" in found["error"]["on"]


def test_report_stands_alone(bench):
    page = (bench / "out" / "report.html").read_text()
    assert "coulomb friction" in page
    assert "<script" not in page
    assert "http://" not in page
    assert "https://" not in page


@pytest.mark.parametrize(("friction", "code"), [(1.0, 0), (1.2, 1)])
def test_check_of_other_experiments_than_the_fitted_ones(bench, friction, code, tmp_path, capsys):
    other = BENCH.with_(
        kinds=(("prbs", 5.0), ("multisine", 8.0)), seed=32,
        machine=replace(BENCH.machine, fc=friction * BENCH.machine.fc),
    )  # fmt: skip
    for name, columns in other.logs().items():
        pd.DataFrame(columns).to_csv(tmp_path / f"{name}.csv", index=False)
    model = str(bench / "out" / "model.toml")
    assert main(["check", str(tmp_path), "--model", model]) == code
    assert ("coulomb_friction@motor: +" in capsys.readouterr().out) == bool(code)


def test_prediction_follows_the_log(bench, capsys):
    log = bench / "logs" / "run3_chirp.csv"
    out = bench / "pred.csv"
    model = bench / "out" / "model.toml"
    assert main(["predict", str(log), "--model", str(model), "--out", str(out)]) == 0
    seen, run = pd.read_csv(log), pd.read_csv(out)
    assert list(run.columns[:2]) == ["time_s", "w"]
    assert len(run) == len(seen)
    error = np.sqrt(np.mean((run.w - seen.w) ** 2))
    assert error < 0.05 * np.std(seen.w)  # free run, no correction
    (said,) = re.findall(
        r"^w: rms error (\S+) rad/s against the log$", capsys.readouterr().out, re.M
    )
    assert float(said) == pytest.approx(error, rel=0.01)


def test_errors_of_a_prediction_are_in_the_unit_of_the_sensor():
    """One count of 4096 off; columns that are not in the log have their unit."""
    text = (
        '[body.rotor]\ninertia = 1\n[input.u]\ncolumn = "u_V"\n[sensor.enc]\ncolumn = "n"\n'
        'unit = "counts"\ncounts_per_rev = 4096\n[sensor.tacho]\ncolumn = "w"\nunit = "rpm"\n'
    )
    table = pd.DataFrame({"n": [1.0, 2.0], "w": [3.0, 4.0]})
    text_of_rig = errors_text(RigModel(parse_rig(text)), table, {"n": np.array([0.0, 3.0])})
    assert text_of_rig.splitlines() == [
        f"n: rms error {2 * np.pi / 4096:.3g} rad against the log",
        "w: in rpm, not in the log",
    ]
    time = np.arange(2000) * 1e-3
    fast = np.sqrt(2.0) * np.sin(2.0 * np.pi * 200.0 * time)  # above the report's band
    table = pd.DataFrame({"time_s": time, "omega_L_deg_s": 2.0 + 0.75 * fast})
    text = errors_text(Model(), table, {"omega_L_deg_s": np.ones(2000)})
    (slow,) = re.findall(
        r"omega_L_deg_s: rms error 1.25 deg/s against the log, (\S+) below 30", text
    )
    assert float(slow) == pytest.approx(1.0, abs=0.01)
    assert "theta_ml_deg: in deg, not in the log" in text


def test_a_prediction_that_runs_away_is_refused(bench, tmp_path, capsys):
    """Of a speed that the offset alone makes a million times too large, and finite."""
    text = (bench / "out" / "model.toml").read_text()
    far, changed = re.subn(r"\noffset = \S+", "\noffset = 1e6", text)
    assert changed == 1
    (tmp_path / "model.toml").write_text(far)
    arguments = ["--model", str(tmp_path / "model.toml"), "--out", str(tmp_path / "pred.csv")]
    assert main(["predict", str(bench / "logs" / "run3_chirp.csv"), *arguments]) == 2
    assert "leaves all motion of the log at" in capsys.readouterr().err
    assert not (tmp_path / "pred.csv").exists()


def test_prediction_needs_the_inputs_only(bench, capsys):
    full, log = bench / "logs" / "run3_chirp.csv", bench / "inputs.csv"
    table = pd.read_csv(full).drop(columns="w").to_csv(index=False)
    log.write_text(table + "6.0")  # the program was stopped there
    model, out, reference = bench / "out" / "model.toml", bench / "bare.csv", bench / "full.csv"
    for source, target in ((log, out), (full, reference)):
        assert main(["predict", str(source), "--model", str(model), "--out", str(target)]) == 0
    assert capsys.readouterr().err.count("warning: left out incomplete rows in line") == 1
    whole = pd.read_csv(reference)
    assert np.abs(pd.read_csv(out).w - whole.w).max() < 0.02 * np.abs(whole.w).max()


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (('column = "w"', 'column = "speed"'), ["'speed'"]),
        (('unit = "V"', 'unit = "volts per"'), ["rig.toml, line 7", "unit"]),
        (("[input.drive]", "[inputs.drive]"), ["line 5", "did you mean 'input'"]),
        (('inertia = "0.0001 kg m^2 ± 40 %"', 'inertia = "1e-4 kg m"'), ["line 3", "kg·m²"]),
    ],
)
def test_bad_rig_file_is_one_line_and_exit_2(bench, tmp_path, capsys, edit, words):
    text = BENCH.rig()
    assert edit[0] in text
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace(*edit))
    out = tmp_path / "out"
    assert main(["diagnose", str(bench / "logs"), "--rig", str(rig), "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for word in words:
        assert word in said
    assert not out.exists()


def test_no_rig_file(bench, tmp_path, capsys):
    assert main(["diagnose", str(bench / "logs"), "--rig", str(tmp_path / "rig.toml")]) == 2
    assert "no such rig file" in capsys.readouterr().err
