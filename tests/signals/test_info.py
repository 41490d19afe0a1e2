"""What a log can tell, on runs made to tell it."""

import json

import numpy as np
import pytest

from dmptm_ctrl import Log
from dmptm_ctrl.signals.info import NEEDS, describe, describe_file

TIME = np.arange(5000) * 1e-3


def tellable(info):
    return {row.effect for row in info.testable if row.testable}


def test_figures_of_a_known_motion():
    frequency = 0.4  # Hz, two periods
    rate = 2 * np.pi * frequency
    log = Log(
        "sine",
        TIME,
        {
            "u_left": 0.6 * np.cos(rate * TIME) + 0.1,
            "u_right": 0.6 * np.cos(rate * TIME) - 0.1,
            "theta_L": 0.3 * np.sin(rate * TIME),
            "omega_L": 0.3 * rate * np.cos(rate * TIME),
        },
    )
    info = describe(log)
    e = info.excitation
    assert e.travel == pytest.approx(0.6, rel=1e-6)
    assert e.top_speed == pytest.approx(0.3 * rate, rel=1e-3)
    assert e.reversals == 4
    assert e.both_ways
    assert e.preload == pytest.approx(0.2)
    assert e.bandwidth < 2 * frequency
    assert e.angle_and_speed
    assert not e.both_sides
    assert info.channels[2].column == "theta_L_deg"
    assert info.channels[2].high == pytest.approx(np.degrees(0.3), rel=1e-6)
    assert info.channels[0].rms == pytest.approx(np.sqrt(0.6**2 / 2 + 0.1**2), rel=1e-6)
    assert {"coulomb_friction", "load_dependent_friction", "unbalance"} <= tellable(info)
    assert not {"current_lag", "ring_gear_eccentricity", "thermal_drift"} & tellable(info)


def test_resolution_is_the_encoders():
    step = 2 * np.pi / 2**12
    angle = step * np.round(np.sin(TIME) / step)
    log = Log("run", TIME, {"u": np.cos(TIME), "x": angle}, units={"u": "V", "x": "rad"})
    assert describe(log).channels[1].resolution == pytest.approx(360 / 2**12, rel=1e-9)


@pytest.mark.parametrize("counts", [3.4, 34.1])
def test_resolution_of_a_ramp_that_never_moves_by_one_count(counts):
    step = 2 * np.pi / 8192
    angle = step * np.round(counts * np.arange(5000))
    log = Log("run", TIME, {"x": angle}, units={"x": "rad"})
    assert describe(log).channels[0].resolution == pytest.approx(360 / 8192, rel=1e-6)


def test_resolution_of_counts_rounded_as_decimals():
    step = 360 / 8192
    angle = np.radians(np.round(step * np.round(30 * np.sin(6 * TIME) / step), 4))
    log = Log("run", TIME, {"x": angle}, units={"x": "rad"})
    assert describe(log).channels[0].resolution == pytest.approx(step, rel=1e-3)


def test_resolution_of_values_without_a_grid_is_their_smallest_difference():
    values = np.sort(np.random.default_rng(0).normal(size=5000))
    log = Log("run", TIME, {"x": values}, units={"x": "V"})
    assert describe(log).channels[0].resolution == np.diff(values).min()


@pytest.mark.parametrize(("unit", "channel"), [("m", "q"), ("rad", "shaft"), ("m/s", "v")])
def test_any_drive(unit, channel):
    motion = np.sin(TIME)
    log = Log("run", TIME, {"i": np.cos(TIME), channel: motion}, units={"i": "A", channel: unit})
    assert describe(log).excitation.both_ways


def test_multisine_excites_the_fast_effects():
    line = np.arange(1, 60)[:, None]
    phases = np.pi * line**2 / 59.0
    u = 0.1 * np.cos(2.0 * np.pi * line * TIME + phases).sum(axis=0)
    log = Log("run", TIME, {"u": u, "x": np.cumsum(u)}, units={"u": "V", "x": "rad"})
    assert {"current_lag", "drive_delay", "shaft_compliance"} <= tellable(describe(log))


def test_no_input_no_advice():
    log = Log("run", TIME, {"theta_L": np.sin(TIME)})
    assert describe(log).excitation is None
    assert describe(log).testable == ()


def test_a_drive_at_rest_tells_nothing_about_friction():
    log = Log("run", TIME, {"u_left": np.zeros(5000), "theta_L": np.zeros(5000)})
    assert tellable(describe(log)) <= {"thermal_drift"}


def test_goes_to_json():
    log = Log("run", TIME, {"u_left": np.sin(TIME), "theta_L": np.sin(TIME)})
    again = json.loads(json.dumps(describe(log).to_dict()))
    assert again["samples"] == 5000
    assert len(again["testable"]) == len(NEEDS)


def file_of(folder, header, *columns):
    """Path of a table of texts or numbers."""
    rows = "".join(",".join(map(str, row)) + "\n" for row in zip(*columns, strict=True))
    (folder / "run.csv").write_text(f"{header}\n{rows}")
    return folder / "run.csv"


def test_columns_of_text_are_named(tmp_path):
    states = np.where(np.sin(TIME) > 0, "RUN", "IDLE")
    path = file_of(tmp_path, "time_s,x_deg,state,empty", TIME, np.sin(TIME), states, [""] * 5000)
    info = describe_file(path)
    assert [c.column for c in info.channels] == ["time_s", "x_deg"]
    assert info.warnings == ("left out 'state': no column of numbers",)


@pytest.mark.parametrize(
    ("clock", "start", "per_second"),
    [("t [ticks]", 0, 1e7), ("t [100ns]", 133_800_000_000_000_000, 1e7), ("t", 1.7e18, 1e9)],
)
def test_a_clock_in_ticks_is_shown_in_seconds(tmp_path, clock, start, per_second):
    counts = [int(start) + round(per_second * t) for t in TIME]
    channel = describe_file(file_of(tmp_path, f"{clock},x_deg", counts, np.sin(TIME))).channels[0]
    assert (channel.column, channel.low) == ("t [s]", 0.0)
    assert channel.high == pytest.approx(TIME[-1], rel=1e-6)
    assert channel.resolution == pytest.approx(1e-3, rel=1e-2)


@pytest.mark.parametrize("name", ["enc [counts]", "enc_counts"])
def test_a_counter_that_runs_over_is_told(tmp_path, name):
    counts = np.floor(4000 * np.sin(TIME) + 5000 * TIME).astype(int) % 4096
    info = describe_file(file_of(tmp_path, f"time_s,{name}", TIME, counts))
    wrap = f"{name} is a 12 bit counter that ran over, 5 times; as a position it is unwrapped"
    assert wrap in info.warnings
