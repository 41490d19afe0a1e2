"""What a compensation from a diagnosis gains on rigs of another program, predicted and measured.

    cd benchmarks && python compensation.py --out DIR [--rigs 10] [--seed 8]

Each rig has the imperfections of every machine (friction of a drawn law, cogging, eccentricity,
runout, lags, quantised commands, errors of sensors and motors) and three drawn main effects. Its
logs are diagnosed. On the diagnosed model one controller is tuned with the compensation and one
without; a third is tuned with the compensation that the declared model offers. All run on the
rig itself, on a duty that none was tuned for. DIR keeps logs, diagnoses and results; the same
command goes on where it stopped.
"""

import argparse
import json
import time
from pathlib import Path

import numpy as np
from rigs.layout import SPEED, STATES
from rigs.nominal import DEG
from rigs.plant import HISTORY, SAMPLE, at_rest, hold, read
from rigs.rig import FINE_STEP, GYRO_NOISE, MOTOR_ENCODER, RING_ENCODER, quantise

from rigs import KNOWN, make_rig, orders

RING = 2
SUBSTEPS = round(SAMPLE / FINE_STEP)
STRENGTHS = (0.7, 0.8, 0.9)  # of main effects, where a rig has three
STARTS = (-35 * DEG, 50 * DEG)  # angles from which the duty is run
STOPPED = 1e3  # rad/s; a run beyond is broken off


def run_on_rig(record, controller, reference, start, rng):
    """Close the loop around a rig; returns its true speed [rad/s] and the voltages."""
    p, n = record[0], reference.size
    y, m, mode = at_rest(start)
    work, history, seen = np.zeros((3, STATES)), np.zeros(HISTORY), np.zeros(4)
    u, speed, filtered = np.zeros((2, n)), np.empty(n), 0.0
    step = controller.law().stepper(SAMPLE)
    noise = GYRO_NOISE * rng.standard_normal(n)
    for k in range(n):
        speed[k] = y[SPEED + RING]
        read(p, y, filtered, seen)
        ring, motors = quantise(seen[0], RING_ENCODER), quantise(seen[2:], MOTOR_ENCODER)
        u[:, k] = step(reference[k], ring, seen[1] + noise[k], motors[0], motors[1])
        filtered = hold(p, y, m, mode, u, k, n, SUBSTEPS, history, filtered, work)
        if not abs(y[SPEED + RING]) < STOPPED:
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
    """RMS tracking error on the rig [deg/s], over all starts."""
    from dmptm_ctrl.design.duty import SETTLING

    reference, square = judged_duty(), 0.0
    for i, start in enumerate(STARTS):
        rng = np.random.default_rng([seed, i])
        speed, _ = run_on_rig(record, controller, reference, start, rng)
        miss = (speed - reference)[round(SETTLING / SAMPLE) :] / DEG
        square += float(np.mean(miss**2)) / len(STARTS)
    return float(np.sqrt(square))


def drawn_rig(seed):
    """A rig of everyday imperfections and three main effects that can stand together."""
    rng = np.random.default_rng(seed)
    names = orders.together(rng, list(KNOWN), 3)
    options = {"friction": "karnopp"} if "presliding" in names else {}
    effects = [(name, float(rng.choice(STRENGTHS))) for name in names]
    return make_rig(seed, effects, sensors="all", ordinary=True, **options)


def diagnosed(rig, folder):
    """Model that the diagnosis of the rig's logs gives, and the declared one; kept in a folder."""
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


def one_rig(seed, folder, plants, declared):
    from dmptm_ctrl.design.draws import FITTED
    from dmptm_ctrl.design.tune import tune_controller

    rig = drawn_rig(seed)
    model, named = diagnosed(rig, folder)
    start = time.process_time()
    tuned = tune_controller(model, uncertainty=FITTED, plants=plants, jobs=1)
    row = {"rig": folder.name, "effects": rig.label["effects"], "named": named}
    row |= {**rig.label["laws"], "tune_seconds": time.process_time() - start}
    row["predicted"], row["sure"] = (float(np.quantile(tuned.gains, q)) for q in (0.5, 0.1))
    row["parts"] = tuned.parts["median"].to_dict()
    for key, controller in (
        ("without", tuned.without),
        ("declared", declared.controller),
        ("with", tuned.controller),
    ):
        row[key] = rmse(rig.record, controller, seed)
        numbers = ("kp", "ki", "preload", "lead", "late", "friction", "distance")
        row[f"{key} gains"] = [float(getattr(controller, name)) for name in numbers]
    row["measured"] = 1.0 - row["with"] / row["without"]
    row["over_declared"] = 1.0 - row["with"] / row["declared"]
    return row


def results_of(out, rigs, seed, plants):
    """Results of each rig, kept in a folder; what is there already is not done again."""
    from dmptm_ctrl.design.tune import tune_controller
    from dmptm_ctrl.simulate.model import Model

    out.mkdir(parents=True, exist_ok=True)
    results = out / "results.jsonl"
    lines = results.read_text().splitlines() if results.exists() else []
    rows = [json.loads(line) for line in lines]
    declared = tune_controller(Model(), plants=plants, jobs=1)
    for number in range(1000 * seed, 1000 * seed + rigs):
        folder = out / str(number)
        if folder.name in [row["rig"] for row in rows]:
            continue
        row = one_rig(number, folder, plants, declared)
        with results.open("a") as file:
            file.write(json.dumps(row) + "\n")
        rows.append(row)
    return rows


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--rigs", type=int, default=10)
    parser.add_argument("--seed", type=int, default=8)
    parser.add_argument("--plants", type=int, default=64, help="drawn to predict each gain")
    asked = parser.parse_args()
    rows = results_of(asked.out, asked.rigs, asked.seed, asked.plants)
    print("rms tracking error [deg/s] and share of it that the compensation takes off [%]")
    for row in rows:
        shares = [round(100 * row[key]) for key in ("predicted", "sure", "measured")]
        print(
            f"{row['rig']:8s} without {row['without']:.4f}  declared {row['declared']:.4f}  "
            f"with {row['with']:.4f}  predicted {shares[0]} (sure {shares[1]}) measured {shares[2]}"
            f"  {', '.join(row['effects'])}; named {', '.join(row['named']) or 'nothing'}"
        )
    for what in ("predicted", "measured", "over_declared"):
        shares = 100.0 * np.array([row[what] for row in rows])
        print(f"{what}: median {np.median(shares):.0f} %, worst {shares.min():.0f} %")


if __name__ == "__main__":
    main()
