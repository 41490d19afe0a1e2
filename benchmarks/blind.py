"""Diagnose rigs whose lack is known, and score names, probabilities and predictions.

    python benchmarks/blind.py --out DIR --count 20 --only null
    python benchmarks/blind.py --out DIR --seeds 1 2 3 --effects unbalance cogging --strengths 1 3
    python benchmarks/blind.py --out DIR --logs FOLDER

The rigs come from `rigs.campaign`, from one effect after another, or from a folder of
rigs with its labels.json. DIR/results.jsonl gets a line per rig; the same command goes on
where it stopped. DIR/summary.json and the figures are made from all lines that are there.
"""

import argparse
import json
import os
import time
import zlib
from itertools import islice, product
from pathlib import Path
from typing import NamedTuple

import cluster
import numpy as np
from scoring import figures, report, summarise

HIDDEN = 3  # logs per rig that the diagnosis does not see
# The same rig with meshes of so little other stiffness and damping: nobody knows these better.
TWINS, TWIN_SPREAD = 8, 1e-3
ONE_LOG = ("open_sine_0v60",)  # of a rig whose hidden logs only are wanted; it needs one
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class Case(NamedTuple):
    """A rig to diagnose: made from its seed, or read from a folder."""

    id: str
    kind: str
    seed: int | None
    effects: tuple
    sensors: str | None
    folder: Path | None = None
    label: dict | None = None
    laws: tuple = ()  # ("friction", ...), ("contact", ...): where they are not drawn


def planned(seeds, count, only):
    """The first `count` rigs of each campaign, of one kind if `only` says so."""
    from rigs.campaign import orders

    cases = []
    for seed in seeds:
        wanted = (o for o in orders(seed) if only in (None, o.kind))
        for o in islice(wanted, count):
            cases.append(Case(f"s{seed}-{o.id}", o.kind, o.seed, o.effects, o.sensors))
    return cases


def one_by_one(seeds, names, strengths):
    """Rigs with one effect each, in turn with and without motor encoders."""
    cases = []
    for seed, strength, name in product(seeds, strengths, names):
        case = f"{name}-x{strength:g}-s{seed}"
        sensors = ("all", "load")[seed % 2]
        effects = ((name, strength),)
        cases.append(Case(case, "single", zlib.crc32(case.encode()), effects, sensors))
    return cases


def on_disk(folder):
    """Rigs of a folder with labels.json, and those of their hidden logs that are there."""
    cases = []
    for name, label in json.loads((folder / "labels.json").read_text()).items():
        effects = label["effects"]
        kind = "null" if not effects else "single" if len(effects) == 1 else "pair"
        if any(effect.startswith("unknown") for effect in effects):
            kind = "unknown"
        strengths = label.get("strengths", {})
        pairs = tuple((effect, strengths.get(effect)) for effect in effects)
        sensors = label.get("sensors")
        seed = label.get("seed")
        cases.append(Case(name, kind, seed, pairs, sensors, folder / name, label))
    return cases


def given(case):
    """Logs to diagnose, logs kept back with the error no model gets below, and the label."""
    from dmptm_ctrl.signals import load_log, load_logs

    if case.folder is not None:
        kept = case.folder.parent / "hidden" / case.folder.name
        hidden = list(load_logs(kept)) if kept.is_dir() else []
        return list(load_logs(case.folder)), hidden, {}, case.label
    from rigs import make_rig

    options = {"sensors": case.sensors, "hidden_logs": HIDDEN, **dict(case.laws)}
    rig = make_rig(case.seed, case.effects, **options)

    def hidden_of(**other):
        again = make_rig(case.seed, case.effects, logs=ONE_LOG, **options, **other)
        return [load_log(table, name=name) for name, table in again.hidden.items()]

    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    hidden = [load_log(table, name=name) for name, table in rig.hidden.items()]
    factors = 1.0 + TWIN_SPREAD * np.random.default_rng(0).standard_normal((TWINS, 2))
    twins = [
        hidden_of(noise_seed=case.seed + 2 + i, meshes=tuple(pair))
        for i, pair in enumerate(factors if case.effects else ())
    ]
    lowest = {
        "floor": floor(hidden, hidden_of(noise_seed=case.seed + 1)),
        "chance": chance(hidden, twins) if twins else None,  # no effect, no error of one
    }
    return logs, hidden, lowest, rig.label


def floor(logs, repeats):
    """Speed error below 30 Hz that the rig makes against itself, measured twice [deg/s].

    Only for logs with the same voltages both times, that is not in closed loop.
    """
    from dmptm_ctrl.diagnosis.predict import low_pass

    squares = []
    for log, repeat in zip(logs, repeats, strict=True):
        if np.array_equal(log["u_left"], repeat["u_left"]):
            apart = low_pass(log["omega_L"] - repeat["omega_L"], log.sample_time)
            squares.append(np.mean(apart**2) / 2)  # both times have the error
    return float(np.rad2deg(np.sqrt(np.mean(squares)))) if squares else None


def chance(logs, twins):
    """Speed error below 30 Hz of the mean of a rig's twins, run by the rig's own program [deg/s].

    What it exceeds the floor by is chance: where a pinion lands after many bounces.
    """
    from dmptm_ctrl.diagnosis.predict import low_pass

    squares = []
    for log, *same in zip(logs, *twins, strict=True):
        if all(np.array_equal(log["u_left"], twin["u_left"]) for twin in same):
            mean = np.mean([twin["omega_L"] for twin in same], axis=0)
            squares.append(np.mean(low_pass(log["omega_L"] - mean, log.sample_time) ** 2))
    return float(np.rad2deg(np.sqrt(np.mean(squares)))) if squares else None


def examine(case, threads=1):
    """Diagnose a rig on some threads; the line of results.jsonl."""
    line = {"id": case.id, "kind": case.kind, "strengths": dict(case.effects)}
    line |= {"truth": list(line["strengths"]), "sensors": case.sensors, "seconds": 0.0}
    try:
        logs, hidden, lowest, label = given(case)
    except ValueError as error:  # logs that the tool refuses to read
        return line | failed(error)
    line |= {
        "truth": list(label["effects"]),
        "strengths": label.get("strengths", {}),
        "truly_depends_on": label.get("depends_on", []),
        "true_parameters": label.get("effect_parameters", {}),
        "sensors": label.get("sensors"),
        "laws": label.get("laws", {}),
        "seed": label.get("seed"),
    }
    start = time.perf_counter()
    try:
        line |= diagnosed(logs, hidden, threads)
    except Exception as error:  # one bad rig must not end a campaign of hours; it counts as missed
        line |= failed(error)
    line["seconds"] = round(time.perf_counter() - start, 1)
    if line.get("hidden"):
        line["hidden"] |= lowest
    return line


def failed(error):
    """What is known of a rig that ended with an error."""
    why = f"{type(error).__name__}: {error}"
    return {"verdict": "failed", "effects": [], "failure": why}


def diagnosed(logs, hidden, threads):
    """What the diagnosis says, what it rests on, and how well its models predict."""
    from dmptm_ctrl import diagnose
    from dmptm_ctrl.diagnosis.predict import speed_error

    result = diagnose(logs, jobs=threads)
    said = {
        "verdict": result.verdict,
        "effects": [effect.to_dict() for effect in result.effects],
        "depends_on": list(result.depends_on),
        "before": result.error["before"]["rmse"],
        "after": result.error["after"]["rmse"],
        "trials": [
            {
                "name": name,
                "gain": trial.gain,
                "held_gain": trial.held_gain,
            }
            for name, trial in result.decision.trials.items()
        ],
        "rest": [[t.name, t.gain, t.held_gain] for t in result.decision.rest[:3]],
        "at_bounds": list(result.fitted.at_bounds),
        "left_per_window": [per_window(r) for r in (result.decision.before, result.decision.after)],
        "keeps_step": [fit.horizon for fit in result.fits],
    }
    if hidden:
        bare = result.declared.without(list(result.declared.effects))
        said["hidden"] = {
            "before": speed_error(bare, hidden)["rmse"],
            "after": speed_error(result.augmented, hidden)["rmse"],
        }
    return said


def per_window(left):
    """Loss of the balances per window, on fitted and on held-out logs."""
    losses = (left.base.loss, left.base.parts), (left.held_base, left.held.missing(left.base.model))
    return [loss / max(1, sum(map(len, parts))) for loss, parts in losses]


def run(cases, folder, jobs, scheduler=None, show=print, threads=1):
    """Examine what has no line yet; returns all lines, in the order of `cases`."""
    from dmptm_ctrl.parallel import each

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "results.jsonl"
    lines = read(path)
    todo = [case for case in cases if case.id not in lines]
    os.environ.update(dict.fromkeys(THREADS, "1"))  # for the processes to come
    with cluster.where(scheduler), path.open("a", encoding="utf-8") as out:
        for line in each(examine, ((case, threads) for case in todo), jobs, in_order=False):
            out.write(json.dumps(line, allow_nan=False) + "\n")
            out.flush()
            lines[line["id"]] = line
            show(told(line))
    return [lines[case.id] for case in cases]


def read(path):
    """Lines by rig; what a stop cut off in the middle is made again."""
    if not path.exists():
        return {}
    text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        path.write_text(whole, encoding="utf-8")
    return {line["id"]: line for line in map(json.loads, whole.splitlines())}


def told(line):
    """One line for the terminal."""
    named = ", ".join(f"{e['name']} {e['probability']:.2f}" for e in line["effects"])
    best = max(line.get("trials", []), key=lambda t: t["gain"] + t["held_gain"], default=None)
    rests = f"{best['name']} {best['gain']:.0f} + {best['held_gain']:.0f}" if best else ""
    return (
        f"{line['id']:36s}{line['verdict']:10s}{named or '-':32s}best {rests:36s}"
        f"{line.get('before', 0):.3f} -> {line.get('after', 0):.3f} deg/s {line['seconds']:6.0f} s"
        f"{'  ' + line['failure'] if 'failure' in line else ''}"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1])
    parser.add_argument("--count", type=int, default=20, help="rigs per seed")
    parser.add_argument("--only", choices=("null", "single", "pair", "unknown"))
    parser.add_argument("--effects", nargs="+", help="these, one per rig, instead of a campaign")
    parser.add_argument("--strengths", type=float, nargs="+", default=[1.0, 3.0])
    parser.add_argument("--friction", choices=("karnopp", "lugre", "tanh"), help="of all rigs")
    parser.add_argument(
        "--contact",
        choices=("eq21", "two_state", "kelvin_voigt", "hunt_crossley"),
        help="of all rigs",
    )
    parser.add_argument("--logs", type=Path, help="a folder of rigs with labels.json")
    parser.add_argument("--threads", type=int, default=1, help="of each process")
    cluster.add_arguments(parser, jobs=2)
    asked = parser.parse_args()
    if asked.logs:
        cases = on_disk(asked.logs)
    elif asked.effects:
        cases = one_by_one(asked.seeds, asked.effects, asked.strengths)
    else:
        cases = planned(asked.seeds, asked.count, asked.only)
    laws = {"friction": asked.friction, "contact": asked.contact}
    laws = {name: law for name, law in laws.items() if law}
    cases = [c._replace(id="-".join((c.id, *laws.values())), laws=(*laws.items(),)) for c in cases]
    run(cases, asked.out, asked.jobs, asked.scheduler, threads=asked.threads)
    lines = list(read(asked.out / "results.jsonl").values())
    summary = summarise(lines)
    text = json.dumps(summary, indent=1, allow_nan=False) + "\n"
    (asked.out / "summary.json").write_text(text, encoding="utf-8")
    figures(lines, summary, asked.out)
    print("\n" + report(summary))


if __name__ == "__main__":
    main()
