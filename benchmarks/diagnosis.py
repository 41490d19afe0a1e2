"""What does the diagnosis of one rig cost, in seconds and simulations, and where do they go?

    python benchmarks/diagnosis.py [LOGS] [--jobs N]

LOGS is a folder with a rig's logs; without it the rig that comes with the package. Times are
of a second run, with everything compiled. The last line is one JSON object.
"""

import argparse
import cProfile
import json
import pstats
import time
from pathlib import Path
from unittest.mock import patch

from dmptm_ctrl import diagnose, load_logs
from dmptm_ctrl.data import path as bundled
from dmptm_ctrl.simulate import batch

TOP = 10  # places shown


def profiled(logs, jobs):
    """Seconds, the profile, and how many runs went side by side, of one diagnosis."""
    profile = cProfile.Profile()
    side_by_side, group = [], batch._group

    def counted(some, *rest):
        side_by_side.append(len(some))
        return group(some, *rest)

    start = time.perf_counter()
    with patch.object(batch, "_group", counted):
        profile.runcall(diagnose, logs, jobs=jobs)
    return time.perf_counter() - start, pstats.Stats(profile), sum(side_by_side)


def shares(stats):
    """Seconds of their own by place in the package or library function; runs one by one."""
    places, calls = {}, 0
    for (file, _, name), (_, count, own, _, _) in stats.stats.items():
        path = Path(file)
        if path.name.startswith("engine_"):
            key = "compiled engine"
        elif "dmptm_ctrl" in path.parts:
            key = "/".join(path.parts[path.parts.index("dmptm_ctrl") + 1 :])
            calls += count if (path.name, name) == ("compiled.py", "march") else 0
        else:
            key = f"{path.stem}: {name}" if path.suffix == ".py" else name.strip("<>")
        places[key] = places.get(key, 0.0) + own
    return dict(sorted(places.items(), key=lambda item: -item[1])), calls


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path, nargs="?")
    parser.add_argument("--jobs", type=int, default=1, help="threads of the diagnosis")
    asked = parser.parse_args()
    logs = list(load_logs(asked.logs or bundled("demo_rig")))
    cold, *_ = profiled(logs, asked.jobs)
    start, busy = time.perf_counter(), time.process_time()
    result = diagnose(logs, jobs=asked.jobs)
    warm, busy = time.perf_counter() - start, time.process_time() - busy
    _, stats, side_by_side = profiled(logs, asked.jobs)
    places, alone = shares(stats)
    calls = alone + side_by_side
    recorded = sum(log.time[-1] - log.time[0] for log in logs)
    print(f"{len(logs)} logs, {recorded:.0f} s recorded: {result.verdict}")
    print(
        f"{warm:.1f} s, {busy:.1f} s of the processor ({cold:.1f} s the first time); "
        f"{calls} simulations of a log or its start"
    )
    for name, spent in list(places.items())[:TOP]:
        print(f"{spent:8.2f} s in {name}")
    print(
        json.dumps(
            {
                "logs": len(logs),
                "recorded_s": round(float(recorded), 1),
                "seconds": round(warm, 2),
                "processor_seconds": round(busy, 2),
                "simulations": calls,
                "own_seconds": {k: round(v, 2) for k, v in list(places.items())[:TOP]},
            }
        )
    )


if __name__ == "__main__":
    main()
