"""Logs of a drive of another shape that something went wrong with: refused, or told."""

import numpy as np
import pandas as pd
import pytest
from tests.chain.truth import Bench, Machine

from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis.ladder_screen import other_scale, screen_chain
from dmptm_ctrl.diagnosis.screen import MAX_ROWS
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.signals import Log, LogError

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
    kept, warnings = screen_chain(rig, logs)
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
    "no voltage": (times(u=0.0), "nothing to diagnose: .* has no excitation: u never changes"),
    "no motion": (times(q=0.0, w=0.0), "nothing to diagnose: .* has no motion: w and q never"),
}


@pytest.mark.parametrize("mistake", REFUSED)
def test_refused(mistake):
    bad, message = REFUSED[mistake]
    with pytest.raises(LogError, match=message):
        looked_at(frames(bad, all_of_them=True))


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


def test_long_logs_are_cut_and_long_files_not_read_whole(tmp_path):
    time = 1e-4 * np.arange(MAX_ROWS + 50.0)
    u, w = np.sin(2 * np.pi * time), -np.cos(2 * np.pi * time)
    rig = parse_rig(BENCH.with_(sensors=("speed",)).rig())
    log = Log("long", time, {"in_drive": u, "out_speed": w})
    (short,), warnings = screen_chain(rig, [log])
    assert len(short) == MAX_ROWS
    assert warnings[0].startswith("long: the first 29.9999 s of 30.0049 s are used")
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
