"""The result of a rig file: errors against another computation, units, pictures, the page."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from matplotlib.figure import Figure
from scipy.signal import butter, sosfiltfilt
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl import data, load_rig, predict
from dmptm_ctrl.diagnosis.budget import Errors, Squares
from dmptm_ctrl.diagnosis.html import render
from dmptm_ctrl.diagnosis.quality import fold
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig
from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import Sensor
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.compared_signals import low_pass
from dmptm_ctrl.signals import Log

BENCH = Bench(
    Machine(fc=0.03, offset=0.6), seconds=4.0, dt=2e-3,
    kinds=(("steps", 6.0), ("sine", 5.0), ("chirp", 4.0)),
)  # fmt: skip
PARTS = ("speed", "torque")


@cache
def recorded():
    return [
        Log(name, columns["t"], {"in_drive": columns["u"], "out_speed": columns["w"]})
        for name, columns in BENCH.logs().items()
    ]


@cache
def diagnosed():
    """The diagnosis that tests of this folder look at."""
    return diagnose_rig(recorded(), parse_rig(BENCH.rig(), "rig.toml"), jobs=1)


@pytest.fixture(scope="module")
def logs():
    return recorded()


@pytest.fixture(scope="module")
def found():
    return diagnosed()


def test_every_key_of_the_contract_is_there(found):
    content = found.to_dict()
    error = content["error"]
    for side in ("before", "after", "floor"):
        assert set(error[side]) >= {"speed", "torque", "rmse", "unit"}
        assert error[side]["rmse"] == error[side]["speed"]["rmse"]
        assert error[side]["unit"] == error[side]["speed"]["unit"] == found.units[0]
        assert error[side]["torque"]["unit"] == found.units[1]
        assert error[side]["torque"]["percent"] > 0.0
    for side in ("before", "after"):
        speed = error[side]["speed"]
        known = {"rmse", "unit", "fit_percent", "pearson_r", "bandwidth_hz", "sensor"}
        assert set(speed) == known
    for part in PARTS:
        before, after, floor = (error[s][part]["rmse"] for s in ("before", "after", "floor"))
        assert floor <= after < 0.5 * before
    named = content["budget"][:-2]
    assert [r["name"] for r in named if r["name"] != "shared"] == [e.name for e in found.effects]
    assert found.budget[0].speed_rms > found.budget[-1].speed_rms
    depends_on = {row.name: row.depends_on for row in found.budget[:2]}
    assert depends_on == {"coulomb_friction": ("omega:motor",), "drive_offset": ("u",)}
    for effect in content["effects"]:
        assert set(effect) == {
            *("name", "location", "probability", "material", "parameters"),
            *("confusable_with", "evidence"),
        }
    for declared in content["declared"].values():
        assert set(declared) >= {"declared", "range", "fitted", "se", "outside"}
    fit = found.selection.final.fit
    assert content["apart_from_balance"] == fit.off_balance
    assert "coulomb_friction@motor.level" in fit.off_balance
    for row in content["ranking"]:
        assert set(row) >= {"name", "location", "score", "status", "reveals"}
    assert content["provenance"]["versions"]["numpy"]


def test_speed_error_is_that_of_predictions_below_the_band(found, logs):
    """From `predict`, filtered here, on the tenths of each log that nothing was fitted to."""
    reported = found.error["after"]["speed"]
    seen, run = [], []
    for log in logs:
        sos = butter(4, reported["bandwidth_hz"], fs=1 / log.sample_time, output="sos")
        held = np.isin(np.arange(len(log)) * 10 // len(log), (2, 5, 8))
        pad = int(
            np.ceil(3.0 / (reported["bandwidth_hz"] * log.sample_time))
        )  # periods beyond the ends
        seen.append(sosfiltfilt(sos, log["out_speed"], padlen=pad)[held])
        run.append(sosfiltfilt(sos, predict(found.augmented, log)["w"], padlen=pad)[held])
    seen, run = np.concatenate(seen), np.concatenate(run)
    rmse = np.sqrt(np.mean((seen - run) ** 2))
    assert reported["rmse"] == pytest.approx(rmse, rel=1e-6)
    assert reported["fit_percent"] == pytest.approx(100 * (1 - rmse / np.std(seen)), rel=1e-6)
    assert reported["pearson_r"] == pytest.approx(np.corrcoef(seen, run)[0, 1], rel=1e-6)


def test_where_only_a_position_is_measured_its_rate_counts():
    """A sine of 2 deg at 3 Hz: its rate has 2 · 2π · 3 deg/s; a run of half of it misses half."""
    time = 1e-3 * np.arange(10_000)
    angle = np.deg2rad(2.0) * np.sin(2 * np.pi * 3.0 * time)
    log = Log("a", time, {"out_q": angle, "in_u": 0.0 * time})
    sensor = Sensor("q", "q", "deg", "body", "position")
    bare = Runs(0.0, sensor, 30.0, (log,), (np.ones(time.size, bool),), None, None, 0.0, 1)
    (rate,) = bare.measured
    inner = slice(500, -500)
    wanted = 2.0 * 2 * np.pi * 3.0 * np.cos(2 * np.pi * 3.0 * time)
    np.testing.assert_allclose(rate[inner], wanted[inner], atol=1e-3 * wanted[0])
    half = Runs(0.0, sensor, 30.0, (log,), bare.held, [0.0 * rate], [0.5 * rate], 0.0, 1)
    error = half.error()
    assert error["after"]["unit"] == "deg/s"
    assert error["after"]["rmse"] == pytest.approx(0.5 * error["before"]["rmse"], rel=1e-9)
    assert error["after"]["rmse"] == pytest.approx(0.5 * wanted[0] / np.sqrt(2), rel=0.01)


def test_a_filter_leaves_the_ends_of_a_motion_as_they_are():
    """The rate of a falling weight, whose position has a parabola for ever."""
    time = 1e-3 * np.arange(2000)
    rate = np.gradient(low_pass(1.0 + 3.0 * time - 4.9 * time**2, 1e-3), 1e-3, edge_order=2)
    np.testing.assert_allclose(rate, 3.0 - 9.8 * time, atol=0.3)


def test_bursts_hardly_count_in_what_runs_miss_as_a_rule():
    """Noise of 0.1 with a burst of 5 in one sample of fifty: of all, its scale is near 0.1."""
    rng = np.random.default_rng(1)
    miss = 0.1 * rng.standard_normal(10_000)
    miss[::50] += 5.0
    time = 1e-3 * np.arange(miss.size)
    log = Log("a", time, {"out_q": 0.0 * time, "in_u": 0.0 * time})
    sensor = Sensor("q", "q", "rad/s", "body", "speed")
    held = (np.ones(time.size, bool),)
    runs = Runs(5.0, sensor, 30.0, (log,), held, [miss], [0.5 * miss], 1e-3, 1)
    before, after, floor = runs.usual
    assert np.sqrt(before) == pytest.approx(0.1, rel=0.2)
    assert after == pytest.approx(before / 4.0)
    assert floor == pytest.approx(1e-6)
    assert np.sqrt(runs.squares.before) > 0.5


@pytest.mark.parametrize("speed", [0.01, 0.1, 1.0, 10.0])  # a step takes 0.1 s to 0.1 ms
@pytest.mark.parametrize("measures", ["position", "speed"])
def test_rounding_is_part_of_the_floor_however_slow_the_motion(speed, measures):
    """The floor of a model that is right: what a grid makes of a motion nearby."""
    time, step = 1e-3 * np.arange(20_000), 1e-3
    true = speed * (time + 0.3 * np.sin(2.0 * time))
    read = np.round(true / step) * step
    log = Log("a", time, {"out_q": read, "in_u": 0.0 * time})
    unit = "rad" if measures == "position" else "rad/s"
    sensor = Sensor("q", "q", unit, "body", measures, resolution=Quantity(step, unit, 0.0, ""))
    runs = Runs(0.0, sensor, 30.0, (log,), (np.ones(time.size, bool),), None, None, 0.0, 1)
    missed = np.std(runs.seen(read, 1e-3) - runs.seen(true, 1e-3))
    assert runs._noise(log, lambda: true + 0.3 * step) == pytest.approx(missed, rel=0.3)


@pytest.mark.parametrize(
    ("runs", "said"),
    [
        (Squares(1.21, 1.21, 1.0), "as good as these logs can show"),
        (Squares(4.0, 4.0, 1.0), "The balance shows no lack"),
        (None, "as good as these logs can show"),
    ],
)
def test_runs_far_above_their_floor_are_said(found, runs, said):
    """A balance at its floor does not say that nothing is missing."""
    errors = Errors(1.0, 1.0, 1.0, runs)
    none = replace(found, verdict="none", effects=(), errors=errors)
    assert said in none.sentence()
    assert ("2.0 times their floor" in none.sentence()) == ("no lack" in said)
    far = {"body.motor.inertia": {"outside": True}}
    listed = replace(none, declared_values=far).sentence()
    # behind all that is said of the runs
    same = none.sentence()[:-1]
    assert listed == same + ("; fitted values leave their declared ranges: body.motor.inertia.")


def test_what_only_short_predictions_show_is_said_with_their_size(found):
    short = Squares(9.0, 9.0, 1.0)
    unknown = replace(
        found, verdict="unknown", effects=(), errors=Errors(1.0, 1.0, 1.0, None, short)
    )
    said = unknown.sentence()
    assert "balance shows no lack" in said
    assert "short predictions do: they miss by 3.0 times their floor" in said
    lacking = replace(unknown, errors=Errors(9.0, 9.0, 1.0, None, short))
    assert "lacks something unknown" in lacking.sentence()


def test_short_predictions_miss_less_than_free_runs(found):
    """A part of a log is nearly predicted from its start; its end is not."""
    error = found.error["before"]
    assert error["horizon"]["rmse"] < error["speed"]["rmse"]
    assert error["horizon"]["seconds"] == pytest.approx(1 / (2 * np.pi * 5.0), abs=1e-3)


def test_a_run_without_end_leaves_no_error_and_says_so():
    log = Log("a", np.arange(300) * 1e-3, {"out_w": np.zeros(300), "in_u": np.zeros(300)})
    sensor = Sensor("w", "w", "rad/s", "body", "speed")
    runs = Runs(0.0, sensor, 30.0, (log,), (np.ones(300, bool),), None, None, 0.0, 1)
    assert runs.error() is None
    assert runs.overlays() == []
    assert runs.left() == (None, None)
    assert "leaves all finite numbers" in runs.warnings[0]


def test_means_over_bins_are_those_of_the_samples():
    """y = ±2 by direction, and noise of 0.5: the mean, and its standard error σ/√n."""
    rng = np.random.default_rng(4)
    x, way = rng.uniform(0.0, 10.0, 48_000), np.where(rng.uniform(size=48_000) < 0.5, 1.0, -1.0)
    y = 2.0 * way + rng.normal(0.0, 0.5, x.size)
    made = fold([(x, y, way, 0.25)], [(x, y - 2.0 * way, way, 0.25)], "x [m]", "y [N]", "")
    for direction, level in (("forward", 2.0), ("backward", -2.0)):
        before, after = made.before[direction], made.after[direction]
        np.testing.assert_allclose(before.mean, level, atol=0.1)
        np.testing.assert_allclose(after.mean, 0.0, atol=0.1)
        np.testing.assert_allclose(before.se, 0.5 / np.sqrt(0.25 * 1000), rtol=0.15)


def test_evidence_of_each_effect_is_in_the_rigs_units(found):
    """Without Coulomb friction the drive gives more than the model, in the way of the motion."""
    made = found.evidence("coulomb_friction")
    assert made.variable == "speed of motor [rad/s]"
    assert made.quantity.endswith("[N·m]")
    slow = [  # not at the reversal itself, where filtered motion has no way
        curve.mean[(np.abs(curve.x) > 5.0) & (np.abs(curve.x) < 30.0)].mean()
        for curve in made.before.values()
    ]
    assert slow[0] - slow[1] > 0.03  # forward, backward: 2 · 0.03 N·m, less what others took up
    assert slow[0] > 0.0 > slow[1]
    for curve in made.after.values():
        assert np.median(np.abs(curve.mean)) < 0.004
    offset = found.evidence("drive_offset")
    assert offset.variable == "drive [V]"
    with pytest.raises(KeyError, match="no effect 'cogging' in this diagnosis"):
        found.evidence("cogging")


def test_the_page_is_the_same_for_every_drive(found):
    page = render(found)
    first = page.split("<nav")[0]
    assert found.sentence() in first
    assert 'alt="Error budget: share of the mean square of the balance on held-out' in first
    for part in ("budget", "error", "evidence", "declared", "ranking", "model", "provenance"):
        assert f'id="{part}"' in page
    text = re.sub(r'src="data:[^"]*"|<style>.*?</style>', "", page, flags=re.S)
    assert not re.search(r"\b(nan|inf|None)\b", text)
    assert "free run [rad/s]" in text
    assert "balance [N·m]" in text
    assert page.count('alt="speed on run') == len(found.overlays())
    assert page.count('alt="Binned residual against') == len(found.effects)
    assert "dm.read_model" in text


def test_pictures_of_a_result_use_the_axes_given(found):
    panel = Figure().subplots()
    assert found.plot_budget(ax=panel) is panel
    overlays = found.overlays()
    panels = Figure().subplots(2, len(overlays))
    found.plot(ax=panels)
    assert "speed [rad/s]" in panels[0, 0].get_ylabel()
    shown = panels[1, 0].get_lines()[1].get_ydata()
    np.testing.assert_array_equal(np.isfinite(shown), overlays[0].held)


def test_parameters_outside_their_range_are_on_the_first_screen(found):
    from dataclasses import replace

    values = dict(found.declared_values)
    assert not found.outside
    values["body.motor.inertia"] = {**values["body.motor.inertia"], "outside": True}
    first = render(replace(found, declared_values=values)).split("<nav")[0]
    assert "At or outside the declared range: body.motor.inertia." in first


def test_the_bundled_rig_names_its_units():
    sensor = load_rig(data.path("axis") / "rig.toml").sensors[0]
    log = Log("a", np.arange(300) * 1e-3, {"out_encoder": np.zeros(300), "in_motor": np.zeros(300)})
    runs = Runs(0.0, sensor, 30.0, (log,), (np.ones(300, bool),), None, None, 0.0, 1)
    assert runs.unit == "m/s"
