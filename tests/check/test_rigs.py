"""Rig files: machines of an independent program, unchanged and changed."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from tests.identify.test_reading_noise import geared
from tests.rig_files.truth import Bench, Machine

import check as bench_of
from dmptm_ctrl.check.evidence import evidence_of, only_own
from dmptm_ctrl.check.moved import entries_of, find_moved, information_of
from dmptm_ctrl.check.run import check
from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis.rig_diagnose import split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.rig_fit import fit_rig
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.model_file import model_text
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.testing import assert_explained

MACHINE = Machine(fc=0.02, fs=0.02, cog=0.01, order=7.0, b1=4e-4)
BENCH = Bench(MACHINE, sensors=("speed", "position"), zero=True, seconds=6.0)
CHANGES = {
    "coulomb_friction@motor": ({"fc": 0.024, "fs": 0.024}, 0.2),
    "cogging@motor": ({"cog": 0.02}, 1.0),
    # its back-EMF adds 2e-3 to the viscous friction of 4e-4
    "viscous of motor": ({"b1": 8e-4}, 4.0 / 24.0),
}


def logs_of(bench, seed):
    rig = parse_rig(bench.rig(), "rig.toml")
    tables = bench.with_(seed=seed).logs()
    logs = rig.read([pd.DataFrame(columns) for columns in tables.values()])
    return rig, logs


@pytest.fixture(scope="module")
def model():
    """A model fitted on logs of the unchanged machine."""
    rig, logs = logs_of(BENCH, 1)
    start = RigModel(
        rig,
        (
            Placed("coulomb_friction", "motor", {"level": 0.01}),
            Placed("cogging", "motor", {"cosine": 0.005, "sine": 0.0, "order": 7.0}),
        ),
        {"body.motor.viscous": 5e-4},
    )
    return fit_rig(State(start), balance_of(rig, logs), iterations=20).model


def checked(model, bench, seed):
    _, logs = logs_of(bench, seed)
    evidence = only_own(evidence_of(model, logs))
    return find_moved(information_of(evidence, {}), entries_of(evidence.parameters))


@pytest.mark.parametrize("seed", range(2, 8))
def test_unchanged_machines_raise_no_alarm(model, seed):
    moved, alone = checked(model, BENCH, seed)
    assert [c.text() for c in moved] == []
    assert {c.entry.name for c in alone} >= set(CHANGES)


@pytest.mark.parametrize("name", CHANGES)
def test_a_change_is_found_with_its_size(model, name):
    values, size = CHANGES[name]
    bench = BENCH.with_(machine=replace(MACHINE, **values))
    moved, _ = checked(model, bench, 9)
    assert moved[0].entry.name == name
    assert moved[0].change == pytest.approx(size, rel=0.25)


@pytest.fixture(scope="module")
def folder(model, tmp_path_factory):
    """What a user has: a model, the same machine's logs, and those of a worn one, with dates."""
    path = tmp_path_factory.mktemp("rig")
    (path / "model.toml").write_text(model_text(model), encoding="utf-8")
    worn = replace(MACHINE, **CHANGES["coulomb_friction@motor"][0])
    for name, machines in {"same": [MACHINE], "worn": [worn], "dated": [MACHINE, worn]}.items():
        (path / name).mkdir()
        for month, machine in enumerate(machines, start=1):
            few = BENCH.with_(machine=machine, seed=8, kinds=BENCH.kinds[:2])
            for log, columns in few.logs().items():
                file = path / name / f"2026-0{month}-01_{log}.csv"
                pd.DataFrame(columns).to_csv(file, index=False)
    return path


def test_assert_explained_of_a_rig_file_s_drive(folder):
    assert assert_explained(folder / "model.toml", folder / "same").same
    with pytest.raises(AssertionError, match=r"changed:\n  coulomb_friction@motor: \+"):
        assert_explained(folder / "model.toml", folder / "worn")


def test_dated_logs_of_a_rig_file_s_drive_give_a_trend(folder, tmp_path):
    model = ["--model", str(folder / "model.toml"), "--quiet", "--out", str(tmp_path / "dated")]
    assert main(["check", str(folder / "dated"), *model]) == 1
    assert (tmp_path / "dated" / "trend.png").read_bytes().startswith(b"\x89PNG")
    rows = json.loads((tmp_path / "dated" / "check.json").read_text("utf-8"))["trend"]
    assert [row["date"][:10] for row in rows] == ["2026-01-01", "2026-02-01"]
    entries = [{e["name"]: e["change"] for e in row["entries"]} for row in rows]
    drift = [one["coulomb_friction@motor"] for one in entries]
    assert drift == pytest.approx([0.0, 0.2], abs=0.03)


@pytest.mark.parametrize("name", CHANGES)
def test_logs_that_disagree_are_told(model, name):
    """One before a change, one after it; logs of one machine agree."""
    values, size = CHANGES[name]
    old, new = (
        replace(logs_of(BENCH.with_(machine=replace(MACHINE, **v)), 9)[1][0], name=n)
        for n, v in (("old", {}), ("new", values))
    )
    found = check(model, [old, new])
    (said,) = [text for text in found.warnings if "disagree" in text]
    assert said.startswith(f"the logs disagree about {name}: ")
    assert said.endswith(" in old; check them one by one")
    assert float(said.split(": ")[1].split(" %")[0]) == pytest.approx(100 * size, rel=0.25)
    again = replace(logs_of(BENCH, 8)[1][0], name="again")
    assert check(model, [old, again]).warnings == ()


@pytest.mark.parametrize(
    ("effect", "column", "wrong"),
    [
        (Placed("sensor_gain", "speed", {"error": 0.06}), "w", lambda y: 1.06 * y),
        (
            Placed("encoder_eccentricity", "position", {"cosine": 0.03, "sine": 0.02}),
            "q",
            lambda y: y + 0.03 * np.cos(y) + 0.02 * np.sin(y),
        ),
    ],
)
def test_what_the_model_says_of_a_sensor_is_no_change(model, effect, column, wrong):
    bench = BENCH.with_(sensors=(effect.on,), seed=8)
    rig, right = logs_of(bench, 8)
    tables = [{**t, column: wrong(t[column])} for t in bench.logs().values()]
    logs = rig.read([pd.DataFrame(columns) for columns in tables])
    own = replace(model, rig=rig)
    floor = evidence_of(own, right).torque_rms
    assert not check(own, logs, floor=floor).same  # the premise
    assert check(own.with_effect(effect), logs, floor=floor).same


def test_runs_that_show_more_of_the_noise_are_no_change(model):
    """Fast motion allows a wider band; the residual is that of the band of the diagnosis."""
    seen, kinds = BENCH.with_(sensors=("position",)), (("prbs", 6.0),)
    rig, slow = logs_of(seen.with_(kinds=(("sine", 5.0),)), 3)
    own, fast = replace(model, rig=rig), logs_of(seen.with_(kinds=kinds), 3)[1]
    floor, band = evidence_of(own, slow).torque_rms, balance_of(rig, slow).bandwidth
    assert not check(own, fast, floor=floor).same  # the premise
    assert check(own, fast, floor=floor, bandwidth=band).same


def test_a_bandwidth_goes_before_the_recorded_one(model, tmp_path):
    rig, logs = logs_of(BENCH.with_(sensors=("position",)), 3)
    path = tmp_path / "model.toml"
    path.write_text(model_text(replace(model, rig=rig)), encoding="utf-8")
    torque = {"rmse": 0.1, "bandwidth_hz": 5.0}
    recorded = json.dumps({"error": {"after": {"torque": torque}}})
    path.with_name("diagnosis.json").write_text(recorded, encoding="utf-8")
    found = [check(path, logs, bandwidth=band).torque_rms for band in (None, 5.0, 10.0)]
    assert found[0] == found[1] != found[2]


def test_a_number_that_the_balance_gives_otherwise_is_no_change(model, tmp_path):
    """Runs gave the model more friction than its balance of torques has, as a check's has."""
    key = "body.motor.viscous"
    size, path = model.value(key), tmp_path / "model.toml"
    path.write_text(model_text(model.with_values({key: 1.5 * size})), encoding="utf-8")
    recorded, logs = {"declared": {key: {"se": 1e-3 * size}}}, logs_of(BENCH, 3)[1]
    for more, moved in (({}, ["viscous of motor"]), ({key: 0.5 * size}, [])):
        content = json.dumps(recorded | {"apart_from_balance": more})
        path.with_name("diagnosis.json").write_text(content, encoding="utf-8")
        assert [c.entry.name for c in check(path, logs).moved] == moved


@pytest.fixture(scope="module")
def loose():
    """A machine with a gap between two encoders, and the model of a fit."""
    rng = np.random.default_rng([581, 0])
    truth = bench_of.rig_machine(rng)
    return truth, bench_of.rig_fitted(truth, bench_of.rig_campaign(truth, rng))[0]


@pytest.mark.parametrize("what", [None, *bench_of.RIG_CHANGES])
def test_rattle_in_a_gap_is_no_change_and_a_wider_gap_is(loose, what):
    truth, model = loose
    machine = bench_of.rig_changed(truth, what) if what else truth
    _, logs = bench_of.rig_campaign(machine, np.random.default_rng(5))
    moved, _ = bench_of.checked(model, {}, logs)
    assert [c.entry.name for c in moved[:1]] == ([what] if what else [])


def test_noise_of_readings_is_no_change():
    """Of the very logs of the fit; least squares would have the gear's damping lower by 70 %."""
    rig, logs = geared(("q", "q2"))
    fitted, held, _, _ = split(rig, balance_of(rig, logs))
    fit = RigEvidence(fitted, held, 1).base(State(rough_start(RigModel(rig), fitted))).fit
    evidence = only_own(evidence_of(fit.model, logs))
    entries, names = entries_of(evidence.parameters), []
    for own in (evidence, replace(evidence, noise=None)):
        moved, _ = find_moved(information_of(own, fit.errors), entries)
        names.append([c.entry.name for c in moved])
    assert names == [[], ["link.gear.damping"]]


def test_a_drive_at_rest_tells_nothing(model):
    _, logs = logs_of(BENCH, 1)
    still = [log.with_channels(**{c: np.zeros(len(log)) for c in log.channels}) for log in logs]
    with pytest.raises(LogError, match="the drive does not move"):
        evidence_of(model, still)
