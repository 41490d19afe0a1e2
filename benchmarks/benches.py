"""Does the ladder name what a bench lacks, and nothing else? Benches of many kinds, at random.

Machines are simulated with nothing of dmptm_ctrl: friction by tanh, LuGre or Karnopp's stick
band, explicit steps of 10 to 20 µs, sampled loops on quantised readings, drives with a current
loop. On top of what a case injects, every machine has what real ones have and nobody declares:
torque noise, friction and offset that differ a little from run to run, a current loop of a few
tenths of a millisecond, speed filters.

    python -m benchmarks.benches --cases all --seeds 0 1 --out benches.json

prints a table of names found against names injected, and writes it.
"""

import argparse
import json
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np
from benchmarks import cluster
from benchmarks.bench_machine import logs_of, machine_of, rig_of, style_of

C = {"coulomb": 0.15}
CASES = {
    # name: what is in it (names, what may be named besides), and how strong
    "null_viscous": {"names": []},
    "null_declared": {"names": [], "share": C, "declared": "coulomb"},
    "coulomb": {"names": ["coulomb_friction"], "share": C},
    "offset": {"names": ["coulomb_friction", "drive_offset"], "share": C | {"offset": 0.08}},
    "asymmetry": {"names": ["coulomb_friction", "friction_asymmetry"], "share": C | {"asym": 0.25}},
    "offset_asymmetry": {
        "names": ["coulomb_friction", "friction_asymmetry", "drive_offset"],
        "share": C | {"asym": 0.25, "offset": 0.08},
    },
    "stribeck": {
        "names": ["coulomb_friction", "stribeck_friction"], "share": C | {"stribeck": 0.15},
    },
    "cogging": {
        "names": ["coulomb_friction", "cogging"], "share": C | {"cog": 0.12}, "rotary": True,
    },
    "position_friction": {
        "names": ["coulomb_friction", "position_dependent_friction"], "rotary": True,
        "share": C | {"pos": 0.1},
    },
    "fan": {"names": ["coulomb_friction", "quadratic_drag"], "share": C | {"quad": 0.5}},
    "dead_band": {
        "names": ["drive_dead_band", "coulomb_friction"], "share": C | {"dead": 0.12},
    },
    "saturation": {
        "names": ["coulomb_friction", "drive_saturation"], "open": True,
        "share": C | {"limit": 0.55}, "kinds": ("steps", "sine", "chirp", "triangle"),
    },
    "delay": {"names": ["coulomb_friction", "drive_delay"], "share": C | {"delay": 0.008}},
    "lag": {
        "names": ["coulomb_friction", "current_lag"], "share": C | {"lag": 0.008}, "fast": True,
    },
    "pendulum": {
        "names": ["coulomb_friction", "unbalance"], "share": C | {"unb": 0.5}, "rotary": True,
    },
    "cable": {
        "names": ["coulomb_friction", "cable_spring"], "share": C | {"cable": 0.5},
        "needs_loop": True,
    },
    "warming": {
        "names": ["coulomb_friction", "thermal_drift"], "share": C | {"rise": 0.8}, "runs": 1,
    },
    "drift": {"names": ["coulomb_friction"], "share": C, "drift": 0.2},
    "shaft_hidden": {
        "names": ["coulomb_friction", "shaft_compliance"], "share": C, "two": True, "fast": True,
        "open": True, "kinds": ("chirp", "multisine", "prbs", "steps", "square"),
    },
    "shaft_both": {
        "names": ["coulomb_friction", "shaft_compliance"], "share": C, "two": True, "fast": True,
        "one_body": False, "stiffness": "rigid", "sensors": ("q", "q2"),
    },
    "soft_declared": {
        "names": ["coulomb_friction"], "share": C, "two": True, "fast": True,
        "one_body": False, "sensors": ("q", "q2"),
    },
    "load_rubs": {
        "names": ["coulomb_friction"], "share": C, "two": True, "fast": True, "rubs": "load",
        "one_body": False, "sensors": ("q", "q2"),
    },
    "both_rub": {
        "names": ["coulomb_friction"], "share": C, "two": True, "fast": True, "rubs": "both",
        "one_body": False, "sensors": ("q", "q2"),
    },
    "backlash": {
        "names": ["coulomb_friction", "backlash"], "share": C | {"gap_angle": 0.03}, "two": True,
        "fast": True, "one_body": False, "geared": True, "sensors": ("q", "q2"), "rotary": True,
    },
}  # fmt: skip
MINOR = {"current_lag", "drive_delay", "sensor_delay"}  # every bench has a little of these
ALSO = {  # another name of the same physics, as far as a log can tell
    "lag": {"drive_delay"}, "delay": {"current_lag"}, "drift": {"drive_offset"},
}  # fmt: skip


def bench(case_name, seed):
    """Return frames and rig text of a case."""
    case = CASES[case_name]
    rng = np.random.default_rng([seed, sorted(CASES).index(case_name), 20])
    style = style_of(rng, case)
    drawn = machine_of(rng, style, case)
    frames = logs_of(rng, style, *drawn, case)
    return style, drawn, frames, rig_of(rng, style, drawn[0], drawn[1], case)


def try_one(case_name, seed):
    """Diagnose a bench; return the row of the table."""
    from dmptm_ctrl.diagnosis.ladder_diagnose import diagnose_chain

    warnings.simplefilter("ignore")
    style, drawn, frames, rig = bench(case_name, seed)
    row = {
        "case": case_name, "seed": seed, "names": CASES[case_name]["names"],
        "style": {**style._asdict(), "inertia": drawn[0].j1 + drawn[0].j2, "slow": drawn[3]},
    }  # fmt: skip
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        for name, frame in frames.items():
            frame.to_parquet(Path(folder) / f"{name}.parquet", index=False)
        (Path(folder) / "rig.toml").write_text(rig, encoding="utf-8")
        logs = sorted(Path(folder).glob("*.parquet"))
        try:
            found = diagnose_chain(logs, Path(folder) / "rig.toml", jobs=1)
        except Exception as error:  # a crash is a row of the table too
            return {**row, "error": f"{type(error).__name__}: {error}", "found": [], "seconds": 0.0}
    names = sorted({e.name for e in found.effects})
    truth, also = set(row["names"]), MINOR | ALSO.get(case_name, set())
    return {
        **row,
        "found": names,
        "missed": sorted(truth - set(names) if not _same(truth, names) else set()),
        "false": sorted(set(names) - truth - also),
        "minor": sorted((set(names) - truth) & also),
        "verdict": found.verdict,
        "depends_on": list(found.depends_on),
        "rungs": [
            (r.key, round(r.gain, 3), round(r.held_after.percent, 2)) for r in found.ladder.rungs
        ],
        "before": round(found.error["before"]["relative_percent"], 2),
        "after": round(found.error["after"]["relative_percent"], 2),
        "bandwidth": round(found.error["bandwidth_hz"], 1),
        "seconds": round(time.perf_counter() - started, 1),
    }


def _same(truth, names):
    """Dead time and lag stand for each other."""
    late = {"drive_delay", "current_lag"}
    return truth - late <= set(names) and (not truth & late or bool(late & set(names)))


def table(rows):
    """Text of the confusion table."""
    lines = [f"{'case':18s} {'right':>6s}  missed / false"]
    for case in dict.fromkeys(r["case"] for r in rows):
        own = [r for r in rows if r["case"] == case]
        right = sum(not r.get("missed") and not r.get("false") and "error" not in r for r in own)
        notes = [
            f"{r['seed']}: " + " ".join([*(f"-{m}" for m in r.get("missed", [])),
                                         *(f"+{f}" for f in r.get("false", [])),
                                         *([r["error"]] if "error" in r else [])])
            for r in own if r.get("missed") or r.get("false") or "error" in r
        ]  # fmt: skip
        lines.append(f"{case:18s} {right:2d}/{len(own):<3d}  " + "; ".join(notes))
    missed = sum(len(r.get("missed", [])) for r in rows)
    false = sum(len(r.get("false", [])) for r in rows)
    total = sum(len(r["names"]) for r in rows)
    lines.append(f"names: {total - missed} of {total} found, {false} false; {len(rows)} benches")
    return "\n".join(lines)


def main():
    """Run cases and write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", nargs="+", default=["all"])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0])
    parser.add_argument("--out", type=Path)
    cluster.add_arguments(parser, jobs=1)
    options = parser.parse_args()
    from dmptm_ctrl.parallel import each

    cases = list(CASES) if options.cases == ["all"] else options.cases
    rows = []
    tasks = [(case, seed) for seed in options.seeds for case in cases]
    with cluster.where(options.scheduler):
        for row in each(try_one, tasks, options.jobs):
            rows.append(row)
            print(
                f"{row['case']:18s} {row['seed']:3d} {row['seconds']:5.1f} s "
                f"{row.get('before', 0):7.2f} → {row.get('after', 0):6.2f} %  "
                f"missed {row.get('missed')} false {row.get('false')} minor {row.get('minor')} "
                f"{row.get('depends_on')} {row.get('error', '')}",
                flush=True,
            )
            if options.out:
                options.out.write_text(json.dumps(rows, indent=1, default=str), encoding="utf-8")
    print(table(rows))


if __name__ == "__main__":
    main()
