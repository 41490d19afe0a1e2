"""Limit cycles: how often simulation confirms what harmonic balance predicts.

    cd benchmarks && python limit_cycles.py [--count 40] [--seed 0]

Draws gap, dry friction and gains, predicts, simulates, and prints one line per cycle and the
counts. Loops without gap-driven oscillation count where both say rest.
"""

import argparse
import time

import numpy as np

from dmptm_ctrl.design.limit_cycle import limit_cycles
from dmptm_ctrl.simulate.model import Model

GAP = (1e-3, 5e-3)  # rad, half-gaps
KP, KI = (4.0, 20.0), (300.0, 6000.0)  # V/(rad/s), V/rad
FRICTIONLESS = 0.25  # of the draws


def drawn(rng: np.random.Generator) -> tuple[Model, float, float, float, float]:
    """Return a drive, its half-gap, its share of Table 2's dry friction, and gains."""
    gap, kp, ki = (float(np.exp(rng.uniform(*np.log(r)))) for r in (GAP, KP, KI))
    dry = 0.0 if rng.random() < FRICTIONLESS else float(rng.uniform(0.0, 1.0))
    names = [n for n in Model().drive if n[:2] in ("T3", "TL")]
    values = {n: dry * Model().drive[n] for n in names}
    return Model().with_values(gap_l=gap, gap_r=gap, **values), gap, dry, kp, ki


def main() -> None:
    """Draw, predict, simulate, count."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    rng = np.random.default_rng(asked.seed)
    counts = dict.fromkeys(("rest", "own", "seeded", "irregular", "left"), 0)
    misses: list[float] = []
    begun = time.perf_counter()
    print(f"{'mrad':>5s}{'dry':>6s}{'kp':>6s}{'ki':>6s}  predicted Hz, deg/s | simulated Hz, deg/s")
    for _ in range(asked.count):
        model, gap, dry, kp, ki = drawn(rng)
        found = limit_cycles(model, kp, ki)
        where = f"{1e3 * gap:5.1f}{dry:6.2f}{kp:6.1f}{ki:6.0f}"
        if not any(np.isfinite(c.simulated.hz) for c in found if c.simulated):
            counts["rest"] += 1
            print(f"{where}  rest", flush=True)
        for c in found:
            assert c.simulated is not None
            if c.confirmed:
                kind = "seeded" if c.seeded else "own"
                misses.append(c.miss)
            else:
                kind = "irregular" if np.isnan(c.hz) else "left"
            counts[kind] += 1
            numbers = (c.hz, np.rad2deg(c.amplitude), c.simulated.hz)
            print(
                f"{where} {numbers[0]:8.2f}{numbers[1]:8.2f} |{numbers[2]:8.2f}"
                f"{np.rad2deg(c.simulated.amplitude):8.2f}  {kind}",
                flush=True,
            )
    lasting = counts["own"] + counts["seeded"] + counts["irregular"]
    print(
        f"\n{asked.count} loops, {counts['rest']} of them rest in the simulator. "
        f"{lasting} lasting oscillations: {counts['own']} predicted from the balance's own "
        f"starts, {counts['seeded']} from a simulated wave, {counts['irregular']} not balanced."
    )
    if misses:
        print(
            f"Confirmed within 5 %: {len(misses)} of {lasting}; miss {np.median(misses):.3f} in "
            f"the median, {max(misses):.3f} at most."
        )
    print(
        f"{counts['left']} predictions that the simulator leaves (they repel). "
        f"{time.perf_counter() - begun:.0f} s."
    )


if __name__ == "__main__":
    main()
