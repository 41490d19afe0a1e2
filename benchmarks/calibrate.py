"""Measure the largest evidence that any absent effect reaches on drives that lack nothing.

    python benchmarks/calibrate.py --seeds 1000 --count 20 [--ordinary] --out FILE.jsonl

Each rig has friction and contact laws drawn from all that `rigs` knows; with --ordinary also the
imperfections of an ordinary machine, whose names do not count as absent. A line per rig: its laws,
the evidence of every absent name that was selected with the share by which what is left rises
without it, and the largest evidence that was not selected. LEVEL of `diagnosis.select` and
NEGLIGIBLE of `diagnosis.budget` lie above what one drive in a hundred reaches in both.
"""

import argparse
import json
import time
from pathlib import Path

from rigs.rig import make_rig

from dmptm_ctrl.diagnosis.candidate import name_of
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState
from dmptm_ctrl.diagnosis.dual_budget import rise
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.select import select_effects
from dmptm_ctrl.diagnosis.sensors import cross_check, with_sensors
from dmptm_ctrl.diagnosis.short_predictions import with_short_predictions
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.parallel import small_matrices, thread_pool
from dmptm_ctrl.signals import load_log
from dmptm_ctrl.simulate.model import Model

# What every ordinary machine has a little of; a lag and a dead time are one name here.
ORDINARY = {
    "mesh_error",
    "pinion_runout",
    "ring_gear_eccentricity",
    "cogging",
    "current_lag",
    "drive_delay",
    "sensor_delay",
    "torque_constant_mismatch",
    "thermal_drift",
}


@small_matrices
def absent(seed, ordinary, jobs):
    """Laws of a rig that lacks nothing, and the evidence of absent names."""
    rig = make_rig(seed, (), ordinary=ordinary)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    declared = paper_drive()
    with thread_pool(jobs):
        measured = measure(logs, declared)
        sensors = cross_check((*measured.fit, *measured.held))
        model = with_sensors(Model(declared), sensors)
        if model.effects:
            measured = measured.started(model)
        base = DualState(residual(measured, model, jobs=jobs))
        evidence = DualEvidence(measured, tuple(sensors.values), jobs)
        found = select_effects(evidence, base)
        named = reported(found)
        # what short predictions add, those that are negligible left out
        named |= reported(with_short_predictions(evidence, found))
    own = ORDINARY if ordinary else set()
    rest = [c.evidence for c in found.rest if c.keys[0].partition("@")[0] not in own]
    return {
        "seed": seed,
        "laws": rig.label["laws"],
        "sensors": rig.label["sensors"],
        "absent": {k: v for k, v in named.items() if k not in own},
        "present": {k: v for k, v in named.items() if k in own},
        "rest": round(max(rest, default=0.0), 1),
    }


def reported(found):
    """Evidence of each name, and the share by which what is left rises without it."""
    return {
        name_of(e.key): (round(e.evidence, 1), round(rise(e.without, found.final), 4))
        for e in found.entries
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, required=True, help="the first one")
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--ordinary", action="store_true")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    with args.out.open("a", encoding="utf-8") as lines:
        for seed in range(args.seeds, args.seeds + args.count):
            start = time.perf_counter()
            row = absent(seed, args.ordinary, args.jobs)
            row["seconds"] = round(time.perf_counter() - start, 1)
            lines.write(json.dumps(row) + "\n")
            lines.flush()
            print(row, flush=True)


if __name__ == "__main__":
    main()
