"""Is a controller designed on the model of the diagnosis better on the rig?

    cd benchmarks && python controllers.py --out DIR [--rigs 10] [--seed 8]

For each of ten rigs of another program (`rigs/`), each with one drawn effect at ordinary
strength and drawn laws of contact and friction: diagnose its logs, design on the declared
model and on the diagnosis' model by the same call, and run both controllers on that rig
itself, on a duty that neither was tuned for. DIR keeps logs, diagnoses and results; the
same command goes on where it stopped.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from numba import njit
from rigs.layout import ANGLE, MEMORY, MOTOR_ANGLE, SLOSH_ANGLE, SPEED, STATES
from rigs.nominal import REDUCER_RATIO, RING_RATIO
from rigs.plant import SAMPLE, advance, amplifier, remember
from rigs.rig import FINE_STEP, GYRO_NOISE, MOTOR_ENCODER, RING_ENCODER, quantise

from rigs import KNOWN, make_rig

RING = 2
DEG = np.pi / 180.0
SUBSTEPS = round(SAMPLE / FINE_STEP)
HISTORY = 4096  # fine steps
UNSTABLE = 10.0  # deg/s rms: more than the duty itself moves at most of the time
STARTS = (-35 * DEG, 50 * DEG)  # angles from which the duty is run


@njit
def _one_sample(p, y, m, mode, work, late, fine, history):
    """Advance a rig by one sample under the voltages `late` (2, n) sent so far."""
    step = SAMPLE / SUBSTEPS
    behind = round(p.delay / step)
    volts = np.zeros(2)
    for _ in range(SUBSTEPS):
        at = fine - behind
        for i in range(2):
            u = late[i, at // SUBSTEPS] if at >= 0 else 0.0
            volts[i] = amplifier(p, m, i, u, fine * step, step)
        advance(fine * step, step, y, p, m, volts, mode, work)
        remember(p, m, y[ANGLE + RING], y[SPEED + RING], step)
        fine += 1
        history[fine % HISTORY] = y[SPEED + RING]
    return fine


def run_on_rig(record, controller, reference, start, rng):
    """Close the loop around a rig; returns its true speed [rad/s] and the voltages."""
    p = record[0]
    n = reference.size
    y, m, mode = np.zeros(STATES), np.zeros(MEMORY), np.zeros(3)
    y[ANGLE + RING] = y[SLOSH_ANGLE] = start
    y[ANGLE : ANGLE + 2] = y[MOTOR_ANGLE : MOTOR_ANGLE + 2] = RING_RATIO * start
    work, history, u = np.zeros((3, STATES)), np.zeros(HISTORY), np.zeros((2, n))
    late_gyro = min(HISTORY - 1, round(float(p["gyro_delay"]) / (SAMPLE / SUBSTEPS)))
    motor = MOTOR_ANGLE if p["reducer_stiffness"] > 0.0 else ANGLE
    step = controller.law().stepper(SAMPLE)
    speed, fine = np.empty(n), 0
    noise = GYRO_NOISE * rng.standard_normal(n)
    for k in range(n):
        speed[k] = y[SPEED + RING]
        gyro = (1.0 + p["gyro_gain_error"]) * history[(fine - late_gyro) % HISTORY] + noise[k]
        ring = y[ANGLE + RING]
        if p["encoder_eccentricity"] != 0.0:
            ring += p["encoder_eccentricity"] * np.cos(ring + p["encoder_phase"])
        motors = quantise(REDUCER_RATIO * y[motor : motor + 2], MOTOR_ENCODER)
        u[:, k] = step(reference[k], quantise(ring, RING_ENCODER), gyro, motors[0], motors[1])
        fine = _one_sample(p, y, m, mode, work, u, fine, history)
        if not np.isfinite(y[SPEED + RING]) or abs(y[SPEED + RING]) > 1e3:
            speed[k:] = np.inf
            break
    return speed, u


def judged_duty():
    """Setpoints that no controller was tuned for, after a rest for the preload: 10 s."""
    from dmptm_ctrl.design.duty import SETTLING, sine, there_and_back

    return np.concatenate(
        [
            np.zeros(round(SETTLING / SAMPLE)),
            sine(12 * DEG, 0.7, 2),
            sine(4 * DEG, 0.4, 1),
            there_and_back(18 * DEG, 60 * DEG, 0.4),
            sine(8 * DEG, 1.4, 2),
        ]
    )


def rmse(record, controller, seed):
    """RMS tracking error on the rig [deg/s], over all starts; and the largest voltage."""
    from dmptm_ctrl.design.duty import SETTLING

    reference, square, volts = judged_duty(), 0.0, 0.0
    for i, start in enumerate(STARTS):
        rng = np.random.default_rng([seed, i])
        speed, u = run_on_rig(record, controller, reference, start, rng)
        miss = (speed - reference)[round(SETTLING / SAMPLE) :] / DEG
        square += float(np.mean(miss**2)) / len(STARTS)
        volts = max(volts, float(np.abs(u).max()))
    return float(np.sqrt(square)), volts


def diagnosed(rig, folder):
    """Model that the diagnosis of the rig's logs gives, kept in the folder."""
    import dmptm_ctrl
    from dmptm_ctrl.identify.build_up import with_build_up
    from dmptm_ctrl.simulate.model_file import read_model, to_toml

    kept = folder / "diagnosis"
    if not (kept / "model.toml").exists():
        if not folder.exists():
            rig.save(folder)
        logs = [dmptm_ctrl.load_log(f) for f in sorted(folder.glob("*.csv.gz"))]
        found = dmptm_ctrl.diagnose(logs, jobs=1)
        kept.mkdir(exist_ok=True)
        (kept / "diagnosis.json").write_text(json.dumps(found.to_dict()))
        (kept / "declared.toml").write_text(to_toml(found.declared))
        (kept / "model.toml").write_text(to_toml(with_build_up(found.augmented, logs)))
    named = [e["name"] for e in json.loads((kept / "diagnosis.json").read_text())["effects"]]
    return read_model(kept / "model.toml"), named


def one_rig(name, seed, folder, plants, nominal):
    from dmptm_ctrl.design.draws import FITTED
    from dmptm_ctrl.design.tune import tune_controller

    rig = make_rig(seed, effects=[(name, 1.0)], sensors="all")
    model, named = diagnosed(rig, folder)
    start = time.process_time()
    fitted = tune_controller(model, uncertainty=FITTED, plants=plants, n_jobs=1)
    seconds = time.process_time() - start
    row = {"rig": folder.name, "named": named, **rig.label["laws"], "tune_seconds": seconds}
    for label, tuned in (("nominal", nominal), ("augmented", fitted)):
        for stage in tuned.stages:
            key = f"{label}: {stage['stage']}"
            if stage["stage"] in ("PI, linear design", "optimised"):
                row[key], row[key + " V"] = rmse(rig.record, stage["controller"], seed)
                tuned_to = stage["controller"]
                row[key + " gains"] = [tuned_to.kp, tuned_to.ki, tuned_to.preload, tuned_to.lead]
    row["gain_percent"] = 100.0 * (1.0 - row["augmented: optimised"] / row["nominal: optimised"])
    return row


def main():
    from dmptm_ctrl.design.tune import tune_controller
    from dmptm_ctrl.simulate.model import Model

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=8)
    parser.add_argument("--plants", type=int, default=1000, help="drawn to judge each design")
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    names = np.random.default_rng(asked.seed).permutation(list(KNOWN))[: asked.rigs]
    results = asked.out / "results.jsonl"
    rows = (
        [json.loads(line) for line in results.read_text().splitlines()] if results.exists() else []
    )
    nominal = tune_controller(Model(), plants=asked.plants, n_jobs=1)
    print(nominal.summary(), flush=True)
    for i, name in enumerate(map(str, names)):
        folder = asked.out / f"{i:02d}-{name}"
        if folder.name in [row["rig"] for row in rows]:
            continue
        row = one_rig(name, 1000 * asked.seed + i, folder, asked.plants, nominal)
        with results.open("a") as file:
            file.write(json.dumps(row) + "\n")
        rows.append(row)
        print(
            f"{row['rig']:32s} {' + '.join(row['named']) or 'none':32s} "
            f"PI {row['nominal: PI, linear design']:.3f}  nominal {row['nominal: optimised']:.4f}  "
            f"augmented {row['augmented: optimised']:.4f} deg/s  {row['gain_percent']:+.0f} %",
            flush=True,
        )
    gains = np.array([row["gain_percent"] for row in rows])
    worst = max(row["augmented: optimised"] for row in rows)
    print(
        f"better on {np.sum(gains > 0)} of {gains.size} rigs, by {np.median(gains):.0f} % in the "
        f"median; largest error {worst:.2f} deg/s, unstable: {int(worst > UNSTABLE)}"
    )


if __name__ == "__main__":
    main()
