"""Measure how much rows of short predictions should count in the last fit.

    python benchmarks/campaign.py --kind realistic --seeds S --count N --make --out DIR
    python benchmarks/short_weight.py DIR/rigs

Each rig is diagnosed once. Its model is then fitted to all logs with several weights of the rows of
short predictions, and its free runs are judged on logs that were never handed out. A line per rig:
error of the declared model, and of each weight [deg/s]. The last line has the geometric means over
the rigs, each over that of weight 1. `INDEPENDENT["observer"]` of `identify.balance` is the weight
with the least.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from dmptm_ctrl import diagnose, load_logs
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.residual import closed, predicting_fit
from dmptm_ctrl.identify import balance
from dmptm_ctrl.parallel import small_matrices, thread_pool
from dmptm_ctrl.simulate.model import Model

WEIGHTS = (1.0, 0.3, 0.1, 0.03)


@small_matrices
def errors(folder, jobs):
    """Error of the declared model and of each weight, (1 + weights,) [deg/s]."""
    with thread_pool(jobs):
        found = diagnose(folder, jobs=jobs)
        measured, base = found.source.measured, found.selection.final.left.base
        records = (*measured.fit, *(r for r in measured.held if r not in measured.fit))
        rows, start = closed(records, base.model, Model(measured.drive), base.unknowns, jobs)
        models, usual = [found.declared], balance.INDEPENDENT["observer"]
        for weight in WEIGHTS:
            balance.INDEPENDENT["observer"] = weight
            models.append(predicting_fit(replace(rows, observer_driven=True), start).model)
        balance.INDEPENDENT["observer"] = usual
        hidden = load_logs(folder.with_name(f"{folder.name}.held"))
        return np.array([speed_error(model, hidden, jobs)["rmse"] for model in models])


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    rows = []
    for held in sorted(args.folder.glob("*.held")):
        rig = held.with_name(held.stem)
        rows.append(errors(rig, args.jobs))
        print(rig.name, *(f"{x:.4f}" for x in rows[-1]), flush=True)
    mean = np.exp(np.mean(np.log(np.array(rows)), axis=0))
    pairs = zip(WEIGHTS, mean[1:] / mean[1], strict=True)
    print("over weight 1:", *(f"{weight:g}: {ratio:.3f}" for weight, ratio in pairs))


if __name__ == "__main__":
    main()
