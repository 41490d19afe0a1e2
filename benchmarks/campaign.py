"""Make rigs whose lacks are known, diagnose each with the command, and score what it says.

    python benchmarks/campaign.py --kind dual|realistic|shapes --seeds S ... --count N --out DIR
    python benchmarks/campaign.py --kind realistic --seeds 1 2 --effects unbalance --out DIR
    python benchmarks/campaign.py --handed FOLDER --out DIR

DIR/results.jsonl gets a line per rig; the same command goes on where it stopped. The summary
and the pictures are made from all lines that are there; --again only makes those.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
import tomllib
from pathlib import Path
from typing import NamedTuple

import cluster
import numpy as np
import pandas as pd
from rigs.rig import plain
from scipy.signal import butter, sosfiltfilt
from scoring import pictures, report, score, summarise

from rigs import orders

BAND = 30.0  # Hz, of the speeds that are compared
HORIZON = 1.0  # s, of the short runs: the start of each free run
LIMIT = 3600  # s, for one command
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
KEPT = ("schema", "verdict", "effects", "budget", "ranking", "depends_on", "error")
# Units of speeds; a column of any other is a position.
SPEEDS = ("deg/s", "rad/s", "rpm", "m/s", "mm/s")


class Case(NamedTuple):
    """A rig to diagnose: to be made, or there already with its label."""

    id: str
    order: orders.Order | None
    folder: Path
    label: dict | None = None


def handed(folder):
    """Rigs of a folder with labels.json, and their held-out logs where they are."""
    labels = json.loads((folder / "labels.json").read_text(encoding="utf-8"))
    return [Case(name, None, folder / name, label) for name, label in labels.items()]


def planned(kind, seeds, count, effects, strengths, folder):
    """Rigs of a kind: `count` of each seed's plan, or one for each effect."""
    if effects:
        wanted = list(orders.one_by_one(kind, seeds, effects, strengths))
    else:
        wanted = [order for seed in seeds for order in orders.plan(kind, seed, count)]
    return [Case(order.id, order, folder / "rigs" / order.id) for order in wanted]


def examine(case, out, threads):
    """Make a rig where it must be made, diagnose it; the line of results.jsonl."""
    label = case.label or made(case)
    found = out / "found" / case.id
    rig = case.folder / "rig.toml"
    command = ["diagnose", case.folder, "--out", found, "--jobs", threads]
    start = time.perf_counter()
    done = dmptm(*command, *(("--rig", rig) if rig.exists() else ()))
    line = {"id": case.id, "label": label, "seconds": round(time.perf_counter() - start, 1)}
    if done.returncode != 0:
        return line | {"exit": done.returncode, "message": done.stderr.strip()[-2000:]}
    said = json.loads((found / "diagnosis.json").read_text(encoding="utf-8"))
    line["diagnosis"] = {key: said[key] for key in KEPT if key in said}
    held = case.folder.with_name(f"{case.id}.held")
    if not held.is_dir():
        held = case.folder.parent / "hidden" / case.id
    if held.is_dir():
        line["held"] = predicted(sorted(held.glob("*.csv*")), found / "model.toml", rig)
    return line


def made(case):
    """Label of a rig, which is made unless it is there."""
    path = case.folder.with_name(f"{case.id}.json")
    if not path.exists():
        case.folder.parent.mkdir(parents=True, exist_ok=True)
        label = orders.make(case.order, case.folder.parent)
        write_json(label, path)
    return json.loads(path.read_text(encoding="utf-8"))


def dmptm(*arguments):
    command = [sys.executable, "-m", "dmptm_ctrl", *map(str, arguments)]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, -1, "", f"longer than {LIMIT} s")


def predicted(logs, model, rig):
    """Errors of the speed on logs never handed out, of free runs whole and at their start.

    In deg/s below BAND for the dual drive; for a rig with a file in % of the speed's rms, mean
    square over its sensors, of which positions are differentiated.
    """
    columns = sensors_of(rig)
    squares, sizes = (np.zeros((2, len(columns))) for _ in range(2))
    with tempfile.TemporaryDirectory() as folder:
        for path in logs:
            to = Path(folder) / "predicted.csv"
            done = dmptm("predict", path, "--model", model, "--out", to)
            if done.returncode != 0:
                return {"free": None, "horizon": None, "message": done.stderr.strip()[-500:]}
            measured, run = pd.read_csv(path), pd.read_csv(to)
            dt = float(np.median(np.diff(measured[measured.columns[0]])))
            n = round(HORIZON / dt)
            for k, (column, position) in enumerate(columns):
                true, ours = (speed(t[column].to_numpy(), dt, position) for t in (measured, run))
                for i, part in enumerate((slice(None), slice(n))):
                    squares[i, k] += np.sum((ours - true)[part] ** 2)
                    sizes[i, k] += np.sum(true[part] ** 2) if rig.exists() else true[part].size
    error = np.sqrt(np.mean(squares / sizes, axis=1)) * (100.0 if rig.exists() else 1.0)
    unit = "%" if rig.exists() else "deg/s"
    return {"free": float(error[0]), "horizon": float(error[1]), "unit": unit}


def sensors_of(rig):
    """(column, whether it is a position) of the sensors whose speeds are compared."""
    if not rig.exists():
        return [("omega_L_deg_s", False)]
    sensors = tomllib.loads(rig.read_text(encoding="utf-8"))["sensor"].values()
    return [(s["column"], s["unit"] not in SPEEDS) for s in sensors]


def speed(signal, dt, position):
    low = butter(4, min(BAND, 0.2 / dt), fs=1 / dt, output="sos")
    return sosfiltfilt(low, np.gradient(signal, dt) if position else signal)


def make(cases, jobs, scheduler=None, show=print):
    """Make the rigs that are not there, and labels.json: a folder for --handed."""
    from dmptm_ctrl.parallel import each

    with cluster.where(scheduler):
        labels = list(each(made, ((case,) for case in cases), jobs))
    labels = {case.id: label for case, label in zip(cases, labels, strict=True)}
    if cases:
        write_json(labels, cases[0].folder.parent / "labels.json")
    for name, label in labels.items():
        show(f"{name:28s}{label['lacks']:10s}{' + '.join(label['things'])[:100]}")


def write_json(content, path):
    text = json.dumps(plain(content), indent=1, allow_nan=False) + "\n"
    path.write_text(text, encoding="utf-8")


def run(cases, out, jobs, threads, scheduler=None, show=print):
    """Examine what has no line yet."""
    from dmptm_ctrl.parallel import each

    path = out / "results.jsonl"
    there = read(path)
    todo = [case for case in cases if case.id not in there]
    if jobs > 1:
        os.environ.update(dict.fromkeys(THREADS, str(threads)))  # for the processes to come
    with cluster.where(scheduler), path.open("a", encoding="utf-8") as file:
        for line in each(examine, ((case, out, threads) for case in todo), jobs, in_order=False):
            file.write(json.dumps(line, allow_nan=False) + "\n")
            file.flush()
            show(reported(line))


def read(path):
    """Lines by rig; what a stop cut off in the middle is made again."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    return {line["id"]: line for line in map(json.loads, whole.splitlines())}


def reported(line):
    """One line for the terminal."""
    judged = score(line)
    said = line.get("diagnosis", {"effects": []})
    named = ", ".join(f"{e['name']} {e['probability']:.2f}" for e in said["effects"])
    free = (line.get("held") or {}).get("free")
    left = "" if free is None else f"held {free:.3g}"
    return (
        f"{line['id']:24s}{judged['outcome']:11s}{judged['verdict']:10s}"
        f"{', '.join(judged['true']) or '-':40s} said {named or '-':40s} {left} "
        f"{line['seconds']:.0f} s {line.get('message', '')[-200:]}"
    )


def summary_of(out):
    """Write summary.json, summary.txt and the pictures; returns the table."""
    scores = [score(line) for line in read(out / "results.jsonl").values()]
    summary = summarise(scores)
    write_json(summary, out / "summary.json")
    (out / "summary.txt").write_text(report(summary) + "\n", encoding="utf-8")
    pictures(scores, summary, out)
    return report(summary)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kind", choices=tuple(orders.BLOCKS))
    parser.add_argument("--handed", type=Path, help="a folder of rigs with labels.json")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--count", type=int, default=10, help="rigs per seed")
    parser.add_argument("--effects", nargs="+", help="one rig for each of these instead")
    parser.add_argument("--strengths", type=float, nargs="+", default=[1.0])
    parser.add_argument("--only", nargs="+", help="only the rigs of these names")
    parser.add_argument("--make", action="store_true", help="only make the rigs")
    parser.add_argument("--again", action="store_true", help="only score what is there again")
    parser.add_argument("--threads", type=int, default=1, help="of each diagnosis")
    cluster.add_arguments(parser, jobs=1)
    asked = parser.parse_args()
    if not asked.again:
        if (asked.kind is None) == (asked.handed is None):
            parser.error("say either --kind or --handed")
        cases = (
            handed(asked.handed)
            if asked.handed
            else planned(
                asked.kind, asked.seeds, asked.count, asked.effects, asked.strengths, asked.out
            )
        )
        cases = [case for case in cases if not asked.only or case.id in asked.only]
        asked.out.mkdir(parents=True, exist_ok=True)
        if asked.kind:
            make(cases, asked.jobs, asked.scheduler, print if asked.make else lambda line: None)
        if asked.make:
            return
        run(cases, asked.out, asked.jobs, asked.threads, asked.scheduler)
    print("\n" + summary_of(asked.out))


if __name__ == "__main__":
    main()
