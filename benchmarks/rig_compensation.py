"""What a compensation gains on machines described by rig files, predicted and measured.

    python benchmarks/rig_compensation.py [--machines 10] [--seed 1]

Each machine is a motor that drives a load through a gap, with cogging and LuGre friction, drawn and
simulated by the program of tests/rig_files. A model is fitted to its logs. On that model one
controller is tuned with compensation and one without; both run on the machine, on a duty that
neither was tuned for. Its encoder counts and its speed reading is noisy, as in the logs. Encoders
keep their zero: else no controller could know where cogging begins.
"""

import argparse

import numpy as np

from check import integrate, rig_campaign, rig_fitted, rig_machine
from dmptm_ctrl.design.draws import FITTED
from dmptm_ctrl.design.duty import sine, there_and_back
from dmptm_ctrl.design.rig_aims import rig_aims
from dmptm_ctrl.design.tune import tune_controller

DT, FINE, LIMIT = 1e-3, 50, 12.0  # s, steps per sample, V
NOISE, COUNT = 0.1, 2 * np.pi / 65536  # rad/s, rad


def judged(speed):
    """Setpoints that no controller was tuned for."""
    parts = sine(0.8, 0.7, 2), sine(0.25, 0.4, 1), there_and_back(1.0, 3.3, 0.4), sine(0.5, 1.4, 2)
    return speed * np.concatenate(parts)


def run(machine, controller, target, seed):
    """RMS of the motor's speed error on the machine [rad/s]."""
    law, state, row = controller.law(), machine.at(), machine.row()
    step, used = law.stepper(DT), law.wired.wiring.sensors
    noise = NOISE * np.random.default_rng(seed).standard_normal((2, target.size))
    miss = np.empty(target.size)
    for k, wanted in enumerate(target):
        q1, v1, q2, v2 = state[:4]
        angles = COUNT * np.round(np.array([q1, q2]) / COUNT)
        miss[k] = v1 - wanted
        # the rig's sensors: speed and position of the motor, then of the load
        readings = [v1 + noise[0, k], angles[0], v2 + noise[1, k], angles[1]]
        (u,) = step(wanted, *(readings[i] for i in used))
        integrate(np.array([u]), DT, FINE, row, state, 1.0)
    return float(np.sqrt(np.mean(miss**2)))


def gains(machines, seed):
    """Predicted and measured share of the error that compensation takes off, (machines, 2)."""
    rows = []
    for k in range(machines):
        rng = np.random.default_rng([seed, k])
        machine = rig_machine(rng)
        model, _ = rig_fitted(machine, rig_campaign(machine, rng, homed=True))
        aims = rig_aims(model, limit=LIMIT)
        tuned = tune_controller(model, aims, uncertainty=FITTED, plants=64, jobs=1)
        target = judged(aims.duty.reference.max())
        without, found = (run(machine, c, target, k) for c in (tuned.without, tuned.controller))
        predicted, measured = float(np.median(tuned.gains)), 1.0 - found / without
        rows.append((predicted, measured))
        print(
            f"machine {k}: without {without:.3f}, with {found:.3f} rad/s; "
            f"predicted {predicted:.0%}, measured {measured:.0%}; "
            f"{', '.join(tuned.parts.index)}",
            flush=True,
        )
    return np.array(rows)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    rows = gains(asked.machines, asked.seed)
    for name, shares in zip(("predicted", "measured"), rows.T, strict=True):
        print(f"{name}: median {np.median(shares):.0%}, worst {shares.min():.0%}")


if __name__ == "__main__":
    main()
