"""Does a verdict hang on the last bit? The same rigs diagnosed under two arithmetics.

    python benchmarks/arithmetic.py --out DIR [--kind shapes] [--seed 1] [--count 20]
    python benchmarks/arithmetic.py --out DIR --handed FOLDER

One process for each arithmetic, both at once: as this machine computes, and as an older one
does, without fused and wide instructions. Names must be the same, probabilities alike. The exit
code is 1 where they are not. Compiled kernels of each are kept in DIR; the same command goes on
where it stopped.
"""

import argparse
import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from campaign import LIMIT, THREADS, handed, made, planned

OLDER = {"NUMBA_CPU_NAME": "generic", "OPENBLAS_CORETYPE": "Nehalem"}
ARITHMETICS = {"own": {}, "older": OLDER}
ALIKE = 0.05  # between probabilities


def diagnosed(case, out, arithmetic):
    """Content of diagnosis.json, or the message of a refusal."""
    folder = out / arithmetic / case.id
    failure = folder.with_suffix(".txt")
    found = folder / "diagnosis.json"
    if not found.exists() and not failure.exists():
        rig = case.folder / "rig.toml"
        command = [sys.executable, "-m", "dmptm_ctrl", "diagnose", case.folder, "--out", folder]
        command += ["--jobs", "1", *(("--rig", rig) if rig.exists() else ())]
        own = {"NUMBA_CACHE_DIR": str(out / f"numba-{arithmetic}"), **dict.fromkeys(THREADS, "1")}
        environment = {**os.environ, **own, **ARITHMETICS[arithmetic]}
        done = subprocess.run(
            [*map(str, command)], capture_output=True, text=True, timeout=LIMIT, check=False,
            env=environment,
        )  # fmt: skip
        if done.returncode != 0:
            failure.parent.mkdir(parents=True, exist_ok=True)
            failure.write_text(done.stderr.strip()[-300:] + "\n", encoding="utf-8")
    if failure.exists():
        return {
            "verdict": failure.read_text(encoding="utf-8").strip(),
            "effects": [],
            "error": None,
        }
    return json.loads(found.read_text(encoding="utf-8"))


def names_of(said):
    return {f"{e['name']} @ {e['location']}": e["probability"] for e in said["effects"]}


def differences(one, other):
    """What differs between two verdicts, in words; and the greatest difference of probability."""
    mine, theirs = names_of(one), names_of(other)
    found = [f"{n} in one only" for n in sorted(mine.keys() ^ theirs.keys())]
    apart = {n: abs(mine[n] - theirs[n]) for n in mine.keys() & theirs.keys()}
    found += [f"{n}: {mine[n]:.2f} and {theirs[n]:.2f}" for n in sorted(apart) if apart[n] > ALIKE]
    if one["verdict"] != other["verdict"]:
        found.append(f"verdict {one['verdict']} and {other['verdict']}")
    return found, max(apart.values(), default=0.0)


def error_of(said):
    """Error that is left, in the unit of the balance."""
    return said["error"]["after"]["rmse"] if said["error"] else 0.0


def compare(cases, out, show=print):
    """Diagnose each rig under both; the rigs that differ."""
    apart, bits = [], 0.0
    show(f"{'rig':16s}{'error differs by':>18s}{'probability by':>16s}  names")
    with ThreadPoolExecutor(len(ARITHMETICS)) as pool:
        for case in cases:
            own, older = pool.map(lambda a, c=case: diagnosed(c, out, a), ARITHMETICS)
            found, probability = differences(own, older)
            left = abs(error_of(own) - error_of(older)) / (error_of(own) or 1.0)
            bits = max(bits, left)
            apart += [case.id] if found else []
            names = ", ".join(names_of(own)) or own["verdict"]
            show(f"{case.id:16s}{left:18.1e}{probability:16.1e}  {names}"
                 f"{'  DIFFER: ' * bool(found)}{'; '.join(found)}")  # fmt: skip
    show(f"{len(cases) - len(apart)} of {len(cases)} rigs have the same verdict")
    if bits == 0.0:
        show("no number differs: both processes computed alike, so nothing is shown")
    return apart


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--kind", choices=("dual", "realistic", "shapes"), default="shapes")
    parser.add_argument("--handed", type=Path, help="a folder of rigs with labels.json")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=20)
    asked = parser.parse_args()
    cases = (
        handed(asked.handed)[: asked.count]
        if asked.handed
        else planned(asked.kind, [asked.seed], asked.count, None, [1.0], asked.out)
    )
    for case in cases:
        if case.order is not None:
            made(case)
    return 1 if compare(cases, asked.out.resolve()) else 0


if __name__ == "__main__":
    sys.exit(main())
