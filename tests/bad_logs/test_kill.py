"""A whole diagnosis killed: its outputs are whole or absent, whenever it happens."""

import json
import multiprocessing
import os
import shutil
import signal
import sys
import time

import numpy as np
import pandas as pd
import pytest
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.cli import main
from dmptm_ctrl.signals.atomic import output_folder

BENCH = Bench(Machine(fc=0.03), kinds=(("steps", 6.0), ("sine", 5.0)), seconds=4.0)
FILES = {"diagnosis.json", "model.toml", "report.html"}
WRITES = {"open", "os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate"}
KILLS = 1
watch = []  # called before each event of the interpreter that may change a file


def heard(event, _):
    if watch and event in WRITES:
        watch[0]()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kill")
    (folder / "logs").mkdir()
    for name, columns in BENCH.logs().items():
        pd.DataFrame(columns).to_csv(folder / "logs" / f"{name}.csv", index=False)
    (folder / "rig.toml").write_text(BENCH.rig())
    return folder


def diagnose(folder, out):
    logs, rig = str(folder / "logs"), str(folder / "rig.toml")
    return main(["diagnose", logs, "--rig", rig, "--out", str(out), "--jobs", "1", "--quiet"])


def content(out):
    """What a folder of results says, but for the seconds that it took."""
    assert {entry.name for entry in out.iterdir()} == FILES
    found = json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))
    del found["provenance"]["seconds"]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.rstrip().endswith("</html>")
    return found, (out / "model.toml").read_bytes(), len(page) // 1000


def watched(look, work):
    """Call `look` before each event of some work; return what it says each time."""
    said = []
    watch.append(lambda: said.append(look()))
    try:
        work()
    finally:
        watch.clear()
    return said


@pytest.fixture(scope="module")
def whole(folder):
    """Results of a run, the states of its output folder on the way, and its duration.

    What a kill leaves is the disk as it is at that moment, so each state is looked at.
    """
    assert diagnose(folder, folder / "first") == 0  # compiles, imports
    sys.addaudithook(heard)
    out = folder / "whole"
    start = time.perf_counter()
    states = watched(
        lambda: out.exists() and {entry.name for entry in out.iterdir()},
        lambda: diagnose(folder, out),
    )
    return content(out), states, time.perf_counter() - start


def test_files_appear_together(folder, whole):
    found, states, _ = whole
    assert len(states) > 2 * len(FILES)
    assert all(state in (False, FILES) for state in states)
    assert states[0] is False
    assert content(folder / "first") == found


def test_old_and_new_never_mix(folder, whole):
    """Into a folder with results: a file is old, new or absent, and never are there both kinds."""
    out = folder / "again"
    shutil.copytree(folder / "whole", out)
    old = {name: (out / name).stat().st_ino for name in FILES}

    def look():
        return {old[e.name] == e.stat().st_ino for e in out.iterdir()}

    def write():
        with output_folder(out) as fresh:
            for name in FILES:
                (fresh / name).write_text("new")

    kinds = watched(look, write)
    assert kinds[0] == {True}
    assert all(len(kind) <= 1 for kind in kinds)
    assert {entry.name: entry.read_text() for entry in out.iterdir()} == dict.fromkeys(FILES, "new")


def killed(folder, out, *, event=None, seconds=None):
    """Run in another process; kill it at an event or after a time. Whether it was."""

    def run():
        left = iter(range(event or 0))
        if event is not None:
            watch.append(lambda: next(left, None) is None and os.kill(os.getpid(), signal.SIGKILL))
        diagnose(folder, out)

    process = multiprocessing.get_context("fork").Process(target=run)
    process.start()
    process.join(seconds)
    process.kill()
    process.join()
    return process.exitcode == -signal.SIGKILL


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="no fork of a process with threads")
def test_killed_at_drawn_moments(folder, whole):
    expected, states, seconds = whole
    for event in np.random.default_rng(7).integers(0, len(states), KILLS):
        out = folder / f"killed_{event}"
        assert killed(folder, out, event=int(event))
        assert not out.exists() or content(out) == expected
    out = folder / "killed_while_it_computes"
    killed(folder, out, seconds=0.5 * seconds)
    assert not out.exists() or content(out) == expected
