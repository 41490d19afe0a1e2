"""Logs of a drive of another shape that something went wrong with: refused, or told."""

import numpy as np
import pandas as pd
import pytest
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis.rig_screen import (
    other_scale,
    refuse_no_gain,
    refuse_reversed,
    screen_rig,
)
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.signals import LogError

BENCH = Bench(Machine(fc=0.03), seconds=3.0, sensors=("speed", "position"))
RIG = parse_rig(BENCH.rig())
FRAMES = {name: pd.DataFrame(columns) for name, columns in BENCH.logs().items()}
FIRST = next(iter(FRAMES))
DEG = np.pi / 180


def frames(bad=lambda table: table, *, all_of_them=False):
    """The bench's tables, the first or all of them mistaken."""
    return {
        name: bad(table) if all_of_them or name == FIRST else table
        for name, table in FRAMES.items()
    }


def looked_at(tables, rig=RIG):
    """What the diagnosis does with them before it begins."""
    logs = [rig.load(table, name=name) for name, table in tables.items()]
    kept, warnings = screen_rig(rig, logs)
    strange = other_scale(rig, balance_of(rig, kept))
    if strange:
        raise LogError(strange)
    return kept, warnings


def times(**factors):
    return lambda table: table.assign(**{c: f * table[c] for c, f in factors.items()})


REFUSED = {
    "angle alone in degrees": (times(q=1 / DEG), r"q \(rad\) changes 57.3 times what w \(rad/s\)"),
    "speed with the wrong sign": (times(w=-1), "one of the two has the wrong sign"),
    "all motion in degrees": (
        times(q=1 / DEG, w=1 / DEG),
        "0.017.* times what the rig file declares: perhaps radians and degrees are mixed up",
    ),
    "all motion in turns": (
        times(q=1 / (2 * np.pi * 57.3), w=1 / (2 * np.pi * 57.3)),
        "36. times what the rig file declares: perhaps turns and degrees are mixed up",
    ),
    "volts in millivolts": (times(u=1e3), "1.0.*e.03 times .* thousandths, are mixed up"),
    "percent as shares": (times(u=0.01), "0.010.* times .* perhaps percent and shares"),
    "no voltage": (times(u=0.0), "nothing to diagnose: .* has no excitation: u never changes"),
    "no motion": (times(q=0.0, w=0.0), "nothing to diagnose: .* has no motion: w and q never"),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_refused(mistake):
    bad, message = REFUSED[mistake]
    with pytest.raises(LogError, match=message):
        looked_at(frames(bad, all_of_them=True))


def test_what_slides_has_a_mass():
    time = 1e-3 * np.arange(4000)
    shaken = np.sin(9 * time) + 0.5 * np.sin(23 * time)
    pushed = -2.0 * (81 * np.sin(9 * time) + 264.5 * np.sin(23 * time))  # 2 kg
    rig = parse_rig(
        '[body.table]\nmass = "0.02 kg"\n[input.f]\ncolumn = "f_N"\n[sensor.x]\ncolumn = "x_m"\n'
    )
    with pytest.raises(LogError, match=r"show a mass of 2(\.0\d*)? kg at table.* or the mass$"):
        looked_at({"run": pd.DataFrame({"time_s": time, "f_N": pushed, "x_m": shaken})}, rig)


WARNED = {
    "no voltage": (times(u=0.0), f"left out: {FIRST} has no excitation"),
    "no motion": (times(q=0.0, w=0.0), f"left out: {FIRST} has no motion"),
    "a stuck sensor": (times(w=0.0), f"left out: {FIRST} has a stuck sensor: w stays"),
    "all motion with the wrong sign": (times(q=-1, w=-1), f"{FIRST}: w goes against u"),
}


@pytest.mark.parametrize("mistake", WARNED)
def test_warned(mistake):
    bad, message = WARNED[mistake]
    kept, warnings = looked_at(frames(bad))
    assert [text for text in warnings if text.startswith(message)], warnings
    assert len(kept) == len(FRAMES) - message.startswith("left out")


def test_a_log_twice():
    kept, warnings = looked_at({**FRAMES, "again": FRAMES[FIRST]})
    assert "holds the same samples as" in warnings[0]
    assert len(kept) == len(FRAMES)


def test_nothing_is_said_of_good_logs():
    kept, warnings = looked_at(FRAMES)
    assert warnings == ()
    assert [log.name for log in kept] == list(FRAMES)


def test_a_heavy_load_behind_a_soft_shaft_is_no_mistake():
    """A drive declared rigid, excited above its antiresonance, seems to be its motor alone."""
    machine = Machine(fc=0.01, j1=2e-5, j2=8e-5, k=0.3, c=1e-4)
    bench = Bench(machine, kinds=(("chirp", 4.0),), seconds=3.0, extra={"one_body": True})
    rig = parse_rig(bench.rig())
    kept, _ = looked_at({n: pd.DataFrame(c) for n, c in bench.logs().items()}, rig)
    assert len(kept) == 1


def test_long_files_are_not_read_whole(tmp_path):
    FRAMES[FIRST].to_csv(tmp_path / "run.csv", index=False)
    (part,) = RIG.read(tmp_path, max_rows=1000)
    assert len(part) == 1000
    assert "the first 1000 rows are read; there are more" in part.warnings


def test_at_the_command_line(tmp_path, capsys):
    logs, rig = tmp_path / "logs", tmp_path / "rig.toml"
    logs.mkdir()
    rig.write_text(BENCH.rig())
    for name, table in frames(times(q=1 / DEG), all_of_them=True).items():
        table.to_csv(logs / f"{name}.csv", index=False)
    before = sorted(tmp_path.rglob("*"))
    assert main(["diagnose", str(logs), "--rig", str(rig), "--out", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "changes 57.3 times what w" in said
    assert sorted(tmp_path.rglob("*")) == before


# -- signs, ratios, scales of a whole rig -------------------------------------------------------

T = 0.002 * np.arange(4000)


def geared(ratio=10.0, noise=0.0, soft=False, **factors):
    """Motor and load on a gear, by hand: J a = u - b v - Fc sign(v), seen by both encoders."""
    rng = np.random.default_rng(5)
    tables = {}
    for k, (f1, f2) in enumerate([(0.7, 1.9), (0.5, 2.7)]):
        q = 2.0 * np.sin(2 * np.pi * f1 * T) + 0.3 * np.sin(2 * np.pi * f2 * T + k)
        v, a = np.gradient(q, T), np.gradient(np.gradient(q, T), T)
        u = 0.004 * a + 0.002 * v + 0.01 * np.sign(v)
        twist = 0.002 * u if soft else 0.0
        columns = {"t": T, "u": u, "m": q, "l": q / ratio - twist}
        for name, factor in factors.items():
            columns[name] = factor * columns[name]
        for name in ("m", "l"):
            columns[name] = columns[name] + noise * rng.normal(size=T.size)
        tables[f"run{k}"] = pd.DataFrame(columns)
    return tables


SENSOR = '[sensor.{s}]\ncolumn = "{s}"\nunit = "rad"\nbody = "{body}"\n'


def geared_rig(
    ratio, *, unit="N m", gain="gain = 1", inertia="0.002 kg m^2", shaft="rigid", sensors="ml",
    sign=1,
):  # fmt: skip
    body = {"m": "motor", "l": "load"}
    return parse_rig(
        f"""
[body.motor]
inertia = "{inertia}"
[body.load]
inertia = "{"0.2 kg m^2" if inertia != "unknown" else "unknown"}"
[shaft.gear]
between = ["motor", "load"]
ratio = {ratio}
stiffness = "{shaft}"
[input.u]
column = "u"
unit = "{unit}"
body = "motor"
sign = {sign}
{gain}
[data]
time = "t_s"
"""
        + "".join(SENSOR.format(s=s, body=body[s]) for s in sensors)
    )


def judged(tables, rig):
    """Everything that the diagnosis asks before it begins."""
    tables = {n: t.rename(columns={"t": "t_s"}) for n, t in tables.items()}
    kept, warnings = screen_rig(rig, [rig.load(t, name=n) for n, t in tables.items()])
    balance = balance_of(rig, kept)
    refuse_no_gain(rig, balance)
    found = [refuse_reversed(rig, balance), other_scale(rig, balance)]
    return [*warnings, *filter(None, found)]


def test_nothing_is_said_of_a_geared_rig_that_is_right():
    for soft in (False, True):
        for shaft in ("rigid", "unknown"):
            rig = geared_rig(10, shaft=shaft)
            assert judged(geared(soft=soft, noise=1e-5), rig) == []
    assert judged(geared(), geared_rig(10, inertia="unknown", gain="")) == []


@pytest.mark.parametrize("shaft", ["rigid", "unknown"])
def test_ratio_the_wrong_way_round(shaft):
    said = (
        r"m moves (9.98|10) times what l does, where \[shaft.gear\] says 0.1: .*the wrong way round"
    )
    with pytest.raises(LogError, match=said):
        judged(geared(soft=shaft != "rigid"), geared_rig(0.1, shaft=shaft))


@pytest.mark.parametrize(("right", "said"), [(1.3, "1.3"), (0.2, "0.2"), (3.0, "3")])
def test_a_small_ratio_the_wrong_way_round(right, said):
    with pytest.raises(LogError, match=f"m moves {said} times .* the wrong way round"):
        judged(geared(ratio=right), geared_rig(1 / right))


def test_ratio_that_is_wrong_otherwise():
    with pytest.raises(
        LogError, match="wrong way round.*; and one of the two counts the other way"
    ):
        judged(geared(l=-1), geared_rig(0.1))
    with pytest.raises(LogError, match="m moves 10 times what l does, where .* says 25"):
        judged(geared(), geared_rig(25))
    with pytest.raises(LogError, match="m moves -10 times .* counts the other way"):
        judged(geared(l=-1), geared_rig(10))
    with pytest.raises(LogError, match="radians and degrees are mixed up"):
        judged(geared(m=1 / DEG), geared_rig(10))
    # 8 degrees in radians are nearly an eighth
    with pytest.raises(LogError, match="degrees and radians are mixed up"):
        judged(geared(ratio=8, l=1 / DEG), geared_rig(8))


def test_ratio_the_wrong_way_round_by_the_inertia_alone():
    """One encoder: the load's inertia is 10 000 times that which the logs show."""
    rig = geared_rig(0.1, sensors="m")
    with pytest.raises(LogError, match="perhaps the ratio of gear is the wrong way round"):
        strange = judged(geared(), rig)
        raise LogError(strange[0])


@pytest.mark.parametrize("sensors", ["m", "ml", "l"])
@pytest.mark.parametrize("inertia", ["0.002 kg m^2", "unknown"])
@pytest.mark.parametrize("shaft", ["rigid", "unknown"])
def test_torque_that_counts_the_other_way(sensors, inertia, shaft):
    if sensors == "l" and shaft == "unknown":
        return  # the far side of a spring may go against the torque
    rig = geared_rig(10, sensors=sensors, inertia=inertia, shaft=shaft)
    value = "-0.4" if sensors == "l" else "-0.004"
    with pytest.raises(LogError, match=rf"inertia of {value}.* u or . counts the other way \(sign"):
        judged(geared(u=-1, noise=1e-6), rig)
    mended = geared_rig(10, sensors=sensors, inertia=inertia, shaft=shaft, sign=-1)
    assert judged(geared(u=-1, noise=1e-6), mended) == []


def test_an_input_without_gain_has_no_direction_that_could_be_wrong():
    rig = geared_rig(10, sensors="m", inertia="unknown", gain="", unit="1")
    with pytest.raises(
        LogError, match=r"input.u\] has no gain .* with sign = -1 there the .* 0.004"
    ):
        judged(geared(u=-1, noise=1e-6), rig)
    mended = geared_rig(10, sensors="m", inertia="unknown", gain="", unit="1", sign=-1)
    assert judged(geared(u=-1, noise=1e-6), mended) == []


def test_nothing_is_said_of_a_negative_gain_that_is_right():
    assert judged(geared(u=-1), geared_rig(10, gain="gain = -1")) == []


def test_all_logs_that_count_the_other_way_beside_a_weight():
    """Where a log alone is not sure, it is no witness against the others."""
    tables = geared(u=-1)
    tables["run1"]["u"] = 0.3 * np.random.default_rng(3).normal(size=T.size)
    with pytest.raises(LogError, match=r"^the logs show an inertia of -0.00"):
        judged(tables, geared_rig(10, sensors="m"))


def test_one_log_that_counts_the_other_way_is_named():
    tables = geared()
    tables["run1"]["u"] *= -1
    with pytest.raises(LogError, match=r"^run1: u or m counts the other way .* inertia of -0.004"):
        judged(tables, geared_rig(10, sensors="m"))


def test_a_factor_between_two_sensors_is_told():
    (said,) = judged(geared(l=1.2), geared_rig(10))  # of both logs once
    assert "m moves 8.333 times what l does, where 10 is declared" in said
    assert said.startswith("run0")


def test_a_wrong_ratio_of_a_soft_shaft_is_told():
    (said,) = judged(geared(soft=True, noise=1e-5), geared_rig(12, shaft="unknown"))
    assert "where 12 is declared: one of the two has another scale, or the ratio is wrong" in said


@pytest.mark.parametrize(
    ("unit", "counts"), [("1", 500.0), ("counts", 500.0), ("percent", 40.0), ("V", 24.0)]
)
def test_inertia_beside_an_input_without_gain(unit, counts):
    """A torque of 0.002 N·m per count makes 500 of an inertia of 1."""
    rig = geared_rig(10, unit=unit, gain="", sensors="m")
    shown = f"{0.004 * counts:.2g}"
    said = rf"has no gain.*inertia of {shown}\d* at motor.*with this inertia {str(1 / counts)[:5]}"
    with pytest.raises(LogError, match=said):
        judged(geared(u=counts), rig)
    assert judged(geared(u=counts), geared_rig(10, unit=unit, gain=f"gain = {1 / counts}")) == []
    assert judged(geared(u=counts), geared_rig(10, unit=unit, gain="", inertia="unknown")) == []


def test_inertia_of_an_arm_with_a_weight():
    """The torque of a motion by hand; gravity goes with the sine and is no inertia."""
    t = 2e-3 * np.arange(4000)
    waves = [(1.2, 2.0, 0.0), (0.6, 3.1, 1.0), (0.1, 9.7, 2.0)]  # rad, rad/s, rad
    q = sum(a * np.sin(w * t + p) for a, w, p in waves)
    v = sum(a * w * np.cos(w * t + p) for a, w, p in waves)
    a = sum(-(w**2) * x * np.sin(w * t + p) for x, w, p in waves)
    torque = 0.02 * a + 0.05 * v + 0.1 * np.sign(v) + np.sin(q)
    rig = parse_rig(
        '[body.arm]\ninertia = "0.002 kg m^2"\n[input.u]\ncolumn = "u"\nunit = "1"\n'
        '[sensor.q]\ncolumn = "q"\nunit = "rad"\n[data]\ntime = { column = "t", unit = "s" }\n'
    )
    log = rig.load(pd.DataFrame({"t": t, "u": 500.0 * torque, "q": q}), name="run")
    with pytest.raises(LogError, match=r"an inertia of (10(\.\d)?|9\.9\d?) at arm.* 0.0002 N·m"):
        refuse_no_gain(rig, balance_of(rig, [log]))
