"""Simulated machines, unchanged and changed; `benchmarks/check.py` has many of them."""

import json

import numpy as np
import pytest

import check as bench
from dmptm_ctrl.check.run import check, date_of
from dmptm_ctrl.cli import main
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.simulate.model_file import to_toml
from dmptm_ctrl.testing import assert_explained


@pytest.fixture(scope="module")
def known():
    """A machine, the model of a fit on its logs, and the generator."""
    rng = np.random.default_rng([7, 1])
    truth = bench.machine(rng)
    return truth, *bench.fitted(truth, bench.campaign(truth, rng)), rng


def write(folder, logs, prefix=""):
    folder.mkdir(exist_ok=True)
    names = {"u_left": "V", "u_right": "V"} | dict.fromkeys(
        ("theta_L", "theta_ml", "theta_mr"), "deg"
    )
    for log in logs:
        columns = {"time_s": log.time}
        for channel in (*names, "omega_L"):
            unit = names.get(channel, "deg_s")
            factor = 1.0 if unit == "V" else 180 / np.pi
            columns[f"{channel}_{unit}"] = factor * log[channel]
        rows = np.column_stack(list(columns.values()))
        file = folder / f"{prefix}{log.name}.csv"
        np.savetxt(file, rows, "%.10g", ",", header=",".join(columns), comments="")


def recorded(errors):
    """What of a diagnosis.json is read."""
    declared = {k: {"se": v} for k, v in errors.items() if "." not in k}
    effects = {}
    for key, se in errors.items():
        if "." in key:
            name, _, parameter = key.partition(".")
            effects.setdefault(name, {})[parameter] = {"se": se}
    listed = [{"name": k, "location": "", "parameters": v} for k, v in effects.items()]
    return {
        "declared": declared,
        "effects": listed,
        "error": {"after": {"torque": {"rmse": 0.4, "unit": "N·m"}}},
    }


@pytest.fixture(scope="module")
def folder(known, tmp_path_factory):
    truth, model, errors, rng = known
    path = tmp_path_factory.mktemp("machine")
    (path / "model.toml").write_text(to_toml(model), encoding="utf-8")
    (path / "diagnosis.json").write_text(json.dumps(recorded(errors)), encoding="utf-8")
    write(path / "same", bench.campaign(truth, rng))
    (path / "same" / "notes.txt").write_text("Oil changed on Monday.\n")
    worn = bench.changed(truth, "friction of the ring gear")
    write(path / "worn", bench.campaign(worn, rng))
    write(path / "dated", bench.campaign(truth, rng)[::3], "2026-03-01_")
    write(path / "dated", bench.campaign(worn, rng)[::3], "2026-04-01_")
    return path


def test_unchanged_machines_raise_no_alarm(known):
    truth, model, errors, rng = known
    for _ in range(3):
        assert bench.checked(model, errors, bench.campaign(truth, rng))[0] == []


@pytest.mark.parametrize("what", bench.CHANGES)
def test_a_change_is_found_with_its_size(known, what):
    truth, model, errors, rng = known
    moved, _ = bench.checked(model, errors, bench.campaign(bench.changed(truth, what), rng))
    assert moved[0].entry.name == what
    assert moved[0].change == pytest.approx(bench.CHANGES[what] - 1.0, rel=0.25)


def test_command_says_yes(folder, capsys):
    arguments = ["check", str(folder / "same"), "--model", str(folder / "model.toml")]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    assert "still the same machine" in text
    assert "recorded for the model: 0.4" in text
    assert "warning: left out: notes.txt: no rows of numbers" in text


def test_command_says_no_and_what_moved(folder, tmp_path, capsys):
    out = tmp_path / "out"
    model = ["--model", str(folder / "model.toml"), "--out", str(out)]
    assert main(["check", str(folder / "worn"), *model]) == 1
    assert "friction of the ring gear: +" in capsys.readouterr().out
    found = json.loads((out / "check.json").read_text("utf-8"))
    assert found["same"] is False
    row = found["moved"][0]
    assert row["name"] == "friction of the ring gear"
    assert row["change"] == pytest.approx(0.2, abs=0.05)
    assert row["standard_errors"] == pytest.approx(row["change"] / row["se"])
    assert not (out / "trend.png").exists()


def test_dated_logs_give_a_trend_and_the_newest_decides(folder, tmp_path):
    out = tmp_path / "out"
    model = ["--model", str(folder / "model.toml"), "--out", str(out), "--quiet"]
    assert main(["check", str(folder / "dated"), *model]) == 1
    found = json.loads((out / "check.json").read_text("utf-8"))
    assert all(name.startswith("2026-04-01") for name in found["logs"])
    dates = [row["date"] for row in found["trend"]]
    assert dates == ["2026-03-01T00:00:00", "2026-04-01T00:00:00"]
    drift = [
        next(e["change"] for e in row["entries"] if e["name"] == "friction of the ring gear")
        for row in found["trend"]
    ]
    assert drift == pytest.approx([0.0, 0.2], abs=0.05)
    assert (out / "trend.png").read_bytes().startswith(b"\x89PNG")


def test_friction_gap_and_eccentricity_are_drawn_over_the_dates():
    """All three grow from date to date; the picture has their sizes, and says which is which."""
    rng = np.random.default_rng([7, 3])
    truth = bench.machine(rng).with_effect("ring_gear_eccentricity", cosine=4e-4, sine=3e-4)
    model, errors = bench.fitted(truth, bench.campaign(truth, rng))
    growth, logs = (1.0, 1.2, 1.4), []
    friction = ("TLs_plus", "TLc_plus", "TLs_minus", "TLc_minus")
    for month, grown in enumerate(growth, start=1):
        worn = truth.with_values(**{n: grown * truth.drive[n] for n in (*friction, "gap_l")})
        worn = worn.with_effect("ring_gear_eccentricity", cosine=grown * 4e-4, sine=grown * 3e-4)
        for log in bench.campaign(worn, rng):
            logs.append(Log(f"2026-{month:02d}-01_{log.name}", log.time, dict(log.channels)))
    panel = check(model, logs, errors=errors).plot()
    handles, labels = panel.get_legend_handles_labels()
    for name in ("friction of the ring gear", "gap of the left mesh", "ring_gear_eccentricity"):
        line = handles[labels.index(name)].lines[0]
        np.testing.assert_allclose(line.get_ydata(), 100 * (np.array(growth) - 1), atol=6.0)


def test_bad_input_is_one_line(folder, tmp_path, capsys):
    out = tmp_path / "out"
    model = ["--model", str(folder / "none.toml"), "--out", str(out)]
    assert main(["check", str(folder / "same"), *model]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not out.exists()


def test_short_logs_are_refused(known):
    truth, model, _, rng = known
    log = bench.campaign(truth, rng)[0].segment(0.0, 0.1)
    with pytest.raises(LogError, match="a check needs at least 200"):
        check(model, [log])


def test_logs_of_different_rates_are_refused(known):
    truth, model, _, rng = known
    one, other, *_ = bench.campaign(truth, rng)
    rarer = Log("rarer", other.time[::2], {c: other[c][::2] for c in other}, units=other.units)
    with pytest.raises(LogError, match="different sample time"):
        check(model, [one, rarer])


def test_more_residual_than_recorded_that_no_entry_explains_is_a_change(known):
    truth, model, errors, rng = known
    found = check(model, bench.campaign(truth, rng), errors=errors, floor=0.01)
    assert found.moved == []
    assert not found.same
    assert "no entry of the model says how" in str(found)


def test_assert_explained(folder):
    assert assert_explained(folder / "model.toml", folder / "same").same
    with pytest.raises(AssertionError, match="friction of the ring gear"):
        assert_explained(folder / "model.toml", folder / "worn")


@pytest.mark.parametrize(
    ("name", "date"),
    [
        ("2026-03-01_run", "2026-03-01T00:00:00"),
        ("run_20260301T143000", "2026-03-01T14:30:00"),
        ("run_20261301", None),
        ("closed_sine_10", None),
    ],
)
def test_dates_of_names(name, date):
    found = date_of(name)
    assert (found and found.isoformat()) == date
