"""A linear axis to try the diagnosis on: writes the logs of `data/axis`.

A carriage on a ball screw behind a DC motor, position loop over speed loop, simulated with
nothing of dmptm_ctrl: LuGre friction, explicit steps of 20 µs, held voltages, a rounded encoder.
Run `python -m benchmarks.axis_rig FOLDER`.
"""

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from numba import njit

MASS = 90.0  # kg, with motor and screw
GAIN = 35.0  # N/V
VISCOUS = 180.0  # N·s/m, mean of both ways
COULOMB = 21.0  # N, mean of both ways
ASYMMETRY = -0.17  # friction more (+) or less (−) in the positive direction
OFFSET = -0.10  # V
KP, KV = 150.0, 240.0  # 1/s, V·s/m
COUNT = 1e-6  # m
DT, FINE = 2e-3, 100  # s, steps per sample
SECONDS = 20.0
BRISTLE = 2e-6  # m


@njit
def drive(reference, added, noise):
    """Return voltage and encoder reading per sample."""
    n, h = reference.size, DT / FINE
    u, reading = np.empty(n), np.empty(n)
    q, v, z = 0.0, 0.0, 0.0
    last, older = 0.0, 0.0
    for i in range(n):
        here = np.round(q / COUNT) * COUNT
        speed = (here - older) / (2 * DT)
        older, last = last, here
        u[i] = KV * (KP * (reference[i] - here) - speed) + added[i]
        reading[i] = here
        for _ in range(FINE):
            way = 1.0 + ASYMMETRY if v > 0.0 else 1.0 - ASYMMETRY
            level = way * COULOMB
            rate = v - abs(v) / BRISTLE * z
            z = min(BRISTLE, max(-BRISTLE, z + h * rate))
            force = GAIN * (u[i] + OFFSET) + noise[i]
            v += h * (force - level / BRISTLE * z - way * VISCOUS * v) / MASS
            q += h * v
    return u, reading


def path(rng):
    """Smooth moves between random places, with rests: positions over time [m]."""
    t = DT * np.arange(round(SECONDS / DT))
    q, here, start = np.zeros(t.size), 0.0, 0.0
    while start < SECONDS:
        there = rng.uniform(-0.12, 0.12)
        length = abs(there - here) / rng.uniform(0.03, 0.15) + 0.3
        x = np.clip((t - start) / length, 0.0, 1.0)
        move = here + (there - here) * (10 * x**3 - 15 * x**4 + 6 * x**5)
        q = np.where(t >= start, move, q)
        here, start = there, start + length + 0.2
    return t, q


def main(folder):
    folder.mkdir(parents=True, exist_ok=True)
    for seed, (name, height) in enumerate((("moves", 0.0), ("pulses", 1.5))):
        rng = np.random.default_rng(50 + seed)
        t, reference = path(rng)
        pulses = height * ((t % 1.0) < 0.4) * (t > 1.0)
        noise = rng.normal(0.0, 1.5, t.size)  # N, what no model knows
        u, q = drive(reference, pulses, noise)
        columns = {"t": t, "u": np.round(u, 5), "q": np.round(q, 7), "ref": np.round(reference, 7)}
        frame = pd.DataFrame(columns)
        frame["pulses"] = pulses
        file = folder / f"{name}.csv.gz"
        frame.to_csv(
            file, index=False, float_format="%.7g", compression={"method": "gzip", "mtime": 0}
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
