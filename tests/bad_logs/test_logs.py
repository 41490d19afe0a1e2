"""Logs that something went wrong with: refused in one line, or diagnosed with a warning."""

import json

import numpy as np
import pandas as pd
import pytest

from dmptm_ctrl import LogError, data, load_logs
from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis.screen import READ_ROWS, screen, shortened
from dmptm_ctrl.drive import paper_drive

DEG = np.pi / 180
SECONDS = 3.0
ANGLES = ("theta_L_deg", "omega_L_deg_s", "theta_ml_deg", "theta_mr_deg")


def frame(name="open_sine_0v60", rig="null_rig", seconds=SECONDS):
    return pd.read_csv(data.path(rig) / f"{name}.csv.gz", nrows=round(1000 * seconds))


def two_logs():
    return {"slow": frame("open_sine_0v60"), "fast": frame("open_sine_0v75")}


def write(folder, logs):
    folder.mkdir()
    for name, table in logs.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    return folder


def scaled(factors):
    """Both logs with columns multiplied."""
    return {
        name: table.assign(**{c: f * table[c] for c, f in factors.items()})
        for name, table in two_logs().items()
    }


def with_fast(**changes):
    logs = two_logs()
    return {**logs, "fast": logs["fast"].assign(**changes)}


REFUSED = {
    "all zero": (
        scaled(dict.fromkeys(("u_left_V", "u_right_V", *ANGLES), 0.0)),
        "nothing to diagnose: .* has no voltage",
    ),
    "constant sensors": (
        scaled(dict.fromkeys(ANGLES, 0.0)),
        "nothing to diagnose: .* has no motion",
    ),
    "one sample": ({k: t.iloc[:1] for k, t in two_logs().items()}, "1 sample, at least 100"),
    "half a second": (
        {k: t.iloc[:500] for k, t in two_logs().items()},
        "nothing to diagnose: .* is too short",
    ),
    "signals reversed in time": (
        {k: t.iloc[::-1].assign(time_s=t["time_s"].to_numpy()) for k, t in two_logs().items()},
        "one of the two has the wrong sign",
    ),
    "angle alone in radians": (
        scaled({"theta_L_deg": DEG}),
        "degrees and radians are mixed up",
    ),
    "everything in radians": (
        scaled(dict.fromkeys(ANGLES, DEG)),
        "times those of the declared model .* degrees and radians are mixed up",
    ),
    "everything in degrees twice over": (
        scaled(dict.fromkeys(ANGLES, 1 / DEG)),
        "times those of the declared model .* radians and degrees are mixed up",
    ),
    "both motor encoders in radians": (
        scaled({"theta_ml_deg": DEG, "theta_mr_deg": DEG}),
        "theta_ml changes 0.017.* times what 206.25 times theta_L does",
    ),
    "volts in millivolts": (
        scaled({"u_left_V": 1e3, "u_right_V": 1e3}),
        "times those of the declared model under the same voltages",
    ),
    "volts for millivolts": (
        scaled({"u_left_V": 1e-3, "u_right_V": 1e-3}),
        "those of the declared model under the same voltages",
    ),
    "speed with the wrong sign": (scaled({"omega_L_deg_s": -1}), "wrong sign"),
    "one voltage with the wrong sign": (
        scaled({"u_right_V": -1}),
        "u_right works against the motion .* wrong sign",
    ),
    "both voltages with the wrong sign": (
        scaled({"u_left_V": -1, "u_right_V": -1}),
        "the voltages or the speed have the wrong sign",
    ),
    "all motion with the wrong sign": (scaled(dict.fromkeys(ANGLES, -1)), "wrong sign"),
    "motor encoders with the wrong sign": (
        scaled({"theta_ml_deg": -1, "theta_mr_deg": -1}),
        "theta_ml changes against what 206.25 times theta_L does",
    ),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_refused(tmp_path, capsys, mistake):
    logs, message = REFUSED[mistake]
    folder = write(tmp_path / "logs", logs)
    with pytest.raises(LogError, match=message):
        screen(load_logs(folder), paper_drive())
    before = sorted(tmp_path.rglob("*"))
    assert main(["diagnose", str(folder), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(tmp_path.rglob("*")) == before


def clipped(name, level):
    logs = two_logs()
    values = logs["fast"][name]
    limit = level * values.abs().max()
    return with_fast(**{name: values.clip(-limit, limit)})


def swapped():
    """Under preload the stronger motor leads; with its encoder's lead exchanged it lags."""
    logs = {"slow": frame("open_multisine_preload"), "fast": two_logs()["fast"]}
    one = logs["slow"]
    one = one.assign(theta_ml_deg=one["theta_mr_deg"], theta_mr_deg=one["theta_ml_deg"])
    return {**logs, "slow": one}


def noise():
    return np.random.default_rng(1).normal(size=len(two_logs()["fast"]))


WARNED = {
    "one log all zero": (
        with_fast(**dict.fromkeys(("u_left_V", "u_right_V", *ANGLES), 0.0)),
        "left out: fast has no voltage",
    ),
    "one log without motion": (
        with_fast(**dict.fromkeys(ANGLES, 0.0)),
        "left out: fast has no motion",
    ),
    "a stuck speed sensor": (with_fast(omega_L_deg_s=1.0), "left out: fast has a stuck sensor"),
    "a foreign motor encoder": (
        with_fast(theta_ml_deg=noise()),
        "left out: fast has a foreign or failing motor encoder: theta_ml",
    ),
    "saturated voltage": (clipped("u_left_V", 0.7), "fast: u_left is clipped or saturated"),
    "clipped speed": (clipped("omega_L_deg_s", 0.7), "fast: omega_L is clipped or saturated"),
    "left and right swapped": (swapped(), "slow: left and right may be swapped"),
    "a log twice": (
        {**two_logs(), "again": two_logs()["fast"]},
        "fast holds the same samples as again and is left out",
    ),
    "a log of few samples": (
        {n: t.iloc[::12] for n, t in two_logs().items()}
        | {"few": two_logs()["fast"].iloc[:2160:12]},
        "left out: few is too short: 180 samples",
    ),
    "a log too short": (
        {**two_logs(), "short": two_logs()["fast"].iloc[:900]},
        "left out: short is too short",
    ),
}


@pytest.mark.parametrize("mistake", WARNED)
def test_warned(tmp_path, mistake):
    logs, message = WARNED[mistake]
    kept, warnings = screen(load_logs(write(tmp_path / "logs", logs)), paper_drive())
    said = [*warnings, *(f"{log.name}: {text}" for log in kept for text in log.warnings)]
    assert [text for text in said if text.startswith(message)], said


@pytest.fixture(scope="module")
def warned(tmp_path_factory):
    """A diagnosis of logs with three mistakes."""
    folder = tmp_path_factory.mktemp("bad day")
    logs = {
        **clipped("u_left_V", 0.7),
        "again": two_logs()["slow"],
        "zero": 0.0 * two_logs()["slow"] + two_logs()["slow"][["time_s"]].reindex(
            columns=two_logs()["slow"].columns, fill_value=0.0
        ),
    }  # fmt: skip
    write(folder / "logs", logs)
    return folder


def test_warnings_are_on_stderr_and_in_the_files(warned, capsys):
    code = main(["diagnose", str(warned / "logs"), "--out", str(warned / "out"), "--quiet"])
    out, err = capsys.readouterr()
    assert (code, out) == (0, "")
    page = (warned / "out" / "report.html").read_text(encoding="utf-8")
    listed = json.loads((warned / "out" / "diagnosis.json").read_text(encoding="utf-8"))["warnings"]
    for text in (
        "fast: u_left is clipped or saturated",
        "slow holds the same samples as again",
        "left out: zero has no voltage",
    ):
        assert f"warning: {text}" in err
        assert text in page
        assert any(line.startswith(text) for line in listed)


def test_nothing_is_said_of_good_logs():
    for rig in ("demo_rig", "null_rig"):
        kept, warnings = screen(load_logs(data.path(rig)), paper_drive())
        assert warnings == ()
        assert len(kept) == 10


def test_fast_log_is_thinned_and_long_one_cut():
    """Voltages are held: their mean over the steps left out; readings are taken as they are."""
    (log,) = load_logs(data.path("null_rig") / "open_sine_0v60.csv.gz")
    every = np.repeat(np.arange(len(log)), 4)
    fast = type(log)(
        "fast",
        0.25e-3 * np.arange(every.size),
        {c: values[every] for c, values in log.channels.items()},
    )
    slow, notes = shortened(fast)
    assert "thinned to 1000 Hz" in notes[0]
    for channel in log:
        np.testing.assert_allclose(slow[channel], log[channel], rtol=1e-12)
    assert slow.sample_time == pytest.approx(1e-3)


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.parquet", "run.mat"])
def test_only_so_many_rows_are_read(tmp_path, name):
    from scipy.io import savemat

    from dmptm_ctrl import load_log

    table = frame()
    path = tmp_path / name
    if name.endswith("parquet"):
        table.to_parquet(path, row_group_size=300)
    elif name.endswith("mat"):
        savemat(path, {c: table[c].to_numpy() for c in table})
    else:
        table.to_csv(path, index=False)
    whole, part = load_log(path), load_log(path, max_rows=1000)
    assert whole.warnings == ()
    assert part.warnings == ("the first 1000 rows are read; there are more",)
    assert load_log(path, max_rows=len(table)).warnings == ()
    assert part.sha256 == whole.sha256
    for channel in whole:
        np.testing.assert_array_equal(part[channel], whole[channel][:1000])
    assert READ_ROWS > 1000
