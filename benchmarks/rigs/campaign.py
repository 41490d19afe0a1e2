"""Many rigs in the layout of the blind logs: a plan from one seed, made rig by rig.

    cd benchmarks && python -m rigs.campaign --seed S --count N --out DIR [--hidden K] [--jobs J]

DIR/<id>/*.csv.gz are the logs that may be looked at, DIR/hidden/<id>/*.csv.gz are for
scoring predictions, DIR/labels.json says what is wrong with each rig. A rig that is
there is not made again: run the same line once more to go on.

Every ten rigs hold three nulls, five with one effect, one with a pair and one with an
effect on no list. Names come round in a drawn order before one comes again.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor, as_completed
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from rigs.catalogue import KNOWN
from rigs.rig import make_rig, plain, write_folder
from rigs.unknowns import UNKNOWN

STRENGTHS = (0.5, 1.0, 3.0)
PAIR_STRENGTHS = (1.0, 3.0)
BLOCK = ("null",) * 3 + ("single",) * 5 + ("pair", "unknown")
# Effects that no log tells apart, or that undo each other: never paired.
_ALIKE = (
    {"current_lag", "drive_delay"},
    {"pinion_runout", "ring_gear_eccentricity", "encoder_eccentricity", "backlash_variation"},
    {"position_dependent_friction", "local_spot", "thermal_drift", "load_dependent_friction"},
    {"unbalance", "cable_spring", "drive_offset"},
    {"back_emf", "quadratic_drag"},
)
# Without motor encoders these hardly leave a trace.
_ONLY_IN_MOTOR_ANGLES = {
    "pinion_runout",
    "ring_gear_eccentricity",
    "mesh_error",
    "soft_flank",
    "slipping_hub",
}


class Order(NamedTuple):
    """What to make: one rig of a campaign."""

    id: str
    seed: int
    kind: str
    effects: tuple
    sensors: str


def plan(seed, count):
    """The first `count` rigs of the campaign `seed`; a longer plan starts the same.

    Returns
    -------
    list of Order
    """
    return list(islice(orders(seed), count))


def orders(seed):
    rng = np.random.default_rng([seed, 5])
    singles, unknowns = rounds(rng, list(KNOWN)), rounds(rng, list(UNKNOWN))
    strengths = rounds(rng, list(STRENGTHS))
    i = 0
    while True:
        for kind in rng.permutation(BLOCK):
            i += 1
            if kind == "null":
                effects = ()
            elif kind == "single":
                effects = ((next(singles), next(strengths)),)
            elif kind == "pair":
                effects = tuple((n, float(rng.choice(PAIR_STRENGTHS))) for n in pair(rng))
            else:
                effects = ((next(unknowns), float(rng.choice(PAIR_STRENGTHS))),)
            sensors = str(rng.choice(["all", "load"]))
            if any(name in _ONLY_IN_MOTOR_ANGLES for name, _ in effects):
                sensors = "all"
            yield Order(f"r{i:04d}", 100_000 * seed + i, str(kind), effects, sensors)


def rounds(rng, names):
    """Names for ever, each once in a drawn order before the next round."""
    while True:
        for i in rng.permutation(len(names)):
            yield names[i]


def pair(rng):
    while True:
        names = {str(n) for n in rng.choice(list(KNOWN), 2, replace=False)}
        if not any(names <= alike for alike in _ALIKE):
            return sorted(names)


def make(order, folder, hidden):
    """Make one rig's files; returns its label."""
    rig = make_rig(order.seed, order.effects, sensors=order.sensors, hidden_logs=hidden)
    if hidden:
        write_folder(rig.hidden, folder / "hidden" / order.id)
    write_folder(rig.logs, folder / order.id)
    return rig.label | {"kind": order.kind}


def run(seed, count, folder, hidden=0, jobs=1, report=print):
    """Make what is missing of a campaign; `labels.json` grows with every rig."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "labels.json"
    labels = json.loads(path.read_text()) if path.exists() else {}
    wanted = plan(seed, count)
    for order in wanted:
        if order.id in labels and labels[order.id]["seed"] != order.seed:
            raise ValueError(f"{folder} holds another campaign: {order.id} has another seed")
    todo = [order for order in wanted if order.id not in labels]
    for order, label in made(todo, folder, hidden, jobs):
        labels[order.id] = label
        fresh = path.with_suffix(".part")
        fresh.write_text(json.dumps(plain(dict(sorted(labels.items()))), indent=1) + "\n")
        fresh.replace(path)
        what = " + ".join(f"{name} x{strength:g}" for name, strength in order.effects)
        report(f"{order.id}  {order.kind:8s}{order.sensors:6s}{what}")
    return labels


def made(todo, folder, hidden, jobs):
    """(order, label) of each rig as it gets ready."""
    if jobs == 1:
        for order in todo:
            yield order, make(order, folder, hidden)
        return
    with ProcessPoolExecutor(jobs) as pool:
        running = {pool.submit(make, order, folder, hidden): order for order in todo}
        for done in as_completed(running):
            yield running[done], done.result()


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--hidden", type=int, default=3, help="logs per rig kept for scoring")
    parser.add_argument("--jobs", type=int, default=1)
    asked = parser.parse_args()
    run(asked.seed, asked.count, asked.out, asked.hidden, asked.jobs)


if __name__ == "__main__":
    main()
