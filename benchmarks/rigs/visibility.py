"""How much one unit of strength changes the logs: the table of README.md.

    cd benchmarks && python -m rigs.visibility [--seeds N] [NAME ...]

Each figure is the rms change below 30 Hz against the same rig without the effect, less
(in squares) what measuring that rig again changes, in the log where it is largest; of
these the median over seeds. The first row is the same rig measured again, with
other noise, in its median log: rattle after reversals makes even that differ.
"""

import argparse

import numpy as np
from scipy.signal import butter, sosfiltfilt

from rigs.catalogue import KNOWN
from rigs.nominal import REDUCER_RATIO, RING_RATIO
from rigs.rig import make_rig
from rigs.unknowns import UNKNOWN

LOW_PASS = butter(4, 30, fs=1000, output="sos")  # Hz


def channels(log):
    """Speed [deg/s], voltage [V] and transmission error at the ring gear [arcmin]."""
    ratio = REDUCER_RATIO * RING_RATIO
    error = [60 * (log[c] / ratio - log["theta_L_deg"]) for c in ("theta_ml_deg", "theta_mr_deg")]
    return log["omega_L_deg_s"], log["u_left_V"], *error


def changes(rig, other):
    """Mean squares below 30 Hz, (logs, 3): speed, voltage, transmission error."""
    table = []
    for name, log in rig.logs.items():
        pairs = zip(channels(log), channels(other.logs[name]), strict=True)
        square = [np.mean(sosfiltfilt(LOW_PASS, np.asarray(a - b)) ** 2) for a, b in pairs]
        table.append([square[0], square[1], max(square[2:])])
    return np.array(table)


def beyond(found, again):
    """Largest over the logs of the rms that measuring again does not explain."""
    return np.sqrt(np.max(np.maximum(found - again, 0.0), axis=0))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=[*KNOWN, *UNKNOWN])
    parser.add_argument("--seeds", type=int, default=3)
    asked = parser.parse_args()
    seeds = range(asked.seeds)
    plain = [make_rig(seed, sensors="all") for seed in seeds]
    again = [make_rig(seed, sensors="all", noise_seed=seed + 1) for seed in seeds]
    print("| effect | speed, deg/s | voltage, V | transmission error, arcmin |\n|---|---|---|---|")
    repeat = [changes(a, b) for a, b in zip(plain, again, strict=True)]
    row("measured again", [np.sqrt(np.median(r, axis=0)) for r in repeat])
    for name in asked.names:
        found = [make_rig(seed, [(name, 1.0)], sensors="all") for seed in seeds]
        row(name, [beyond(changes(*p), r) for *p, r in zip(plain, found, repeat, strict=True)])


def row(name, found):
    cells = " | ".join(f"{value:.2g}" for value in np.median(found, axis=0))
    print(f"| {name} | {cells} |", flush=True)


if __name__ == "__main__":
    main()
