"""What a step costs on drives of any shape, beside the paper's drive. One run answers.

    python benchmarks/engine.py [--repeats N]

Prints nanoseconds per body and step of trains of one to nine bodies, with and without gaps,
relative to the paper's dual-motor drive, and the time of ten minutes of a one-body axis.
Processor time, the least of several turns.
"""

import argparse
import json
import time

import numpy as np

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.compiled import march as march_dual
from dmptm_ctrl.simulate.compiled import rest
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT, SUBSTEPS = 1e-3, 8
TIME = DT * np.arange(20_000)
WAVE = np.sin(2 * np.pi * 1.5 * TIME)
LONG = 600_000  # samples: ten minutes at 1 kHz


def train(count, gaps):
    """Bodies in a row with friction, a mesh or shaft between neighbours."""
    text = ['name = "train"']
    for i in range(count):
        text += [
            f"[body.b{i}]", "inertia = 0.01", "viscous = 0.02", "coulomb = 0.02", "static = 0.03",
            "stribeck_speed = 0.1",
        ]  # fmt: skip
    for i in range(count - 1):
        kind = "mesh" if gaps else "shaft"
        text += [f"[{kind}.s{i}]", f'between = ["b{i}", "b{i + 1}"]', "ratio = 1"]
        text += ["stiffness = 400", "damping = 0.05"]
        text += ["half_gap = 0.01", "gap_damping = 0.001"] if gaps else []
    text += ["[input.m]", 'column = "u_V"', 'body = "b0"', 'gain = "0.5 N m/V"']
    text += ["[sensor.last]", 'column = "q_rad"', f'body = "b{count - 1}"']
    return parse_rig("\n".join(text) + "\n")


def least(functions, repeats):
    """Least processor time of each function [s], in turns."""
    best = dict.fromkeys(functions, np.inf)
    for _ in range(repeats):
        for name, function in functions.items():
            start = time.process_time()
            function()
            best[name] = min(best[name], time.process_time() - start)
    return best


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=7)
    repeats = parser.parse_args().repeats
    dual = Model()
    u = np.array([0.9 * WAVE + 0.2, 0.9 * WAVE - 0.2])
    tasks, bodies = {"dual": lambda: march_dual(dual, u, rest(dual, 0.0), DT)}, {"dual": 3}
    for count in (1, 2, 3, 5, 9):
        for gaps in (False, True)[: 2 if count > 1 else 1]:
            name = f"{count} bodies{' with gaps' if gaps else ''}"
            model = RigModel(train(count, gaps))
            tasks[name] = lambda m=model: march(m, WAVE[None], DT, substeps=SUBSTEPS)
            bodies[name] = count
    drag = RigModel(train(3, True), (Placed("quadratic_drag", "b1", {"coefficient": 0.01}),))
    tasks["3 bodies with gaps and an effect"] = lambda: march(drag, WAVE[None], DT, substeps=8)
    bodies["3 bodies with gaps and an effect"] = 3
    for name, task in tasks.items():
        start = time.process_time()
        task()
        print(f"{name:36s} ready after {time.process_time() - start:5.1f} s")
    times = least(tasks, repeats)
    steps = TIME.size * SUBSTEPS
    cost = {name: 1e9 * t / steps / bodies[name] for name, t in times.items()}
    ratios = {name: x / cost["dual"] for name, x in cost.items()}
    for name, x in cost.items():
        print(f"{name:36s} {x:6.1f} ns per body and step, {ratios[name]:5.2f} of the dual drive's")
    axis = RigModel(train(1, False))
    long = np.sin(0.01 * np.arange(LONG))[None]
    minutes = least({"axis": lambda: march(axis, long, DT)}, 3)["axis"]
    print(f"ten minutes of one body: {minutes:.3f} s")
    print(json.dumps({"ratios": ratios, "ten_minutes_s": minutes}))


if __name__ == "__main__":
    main()
