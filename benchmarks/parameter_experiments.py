"""Do the parameter experiments of section 4.2 recover known values within their errors?

Many simulated rigs, each with every parameter up to 10 % off the declaration, run through
all experiments with sensors' noise and resolution. Per parameter: the share of estimates
within two standard errors of the truth, and the mean square of the misses in standard errors
(1: the errors are what they say; less: padded).

    python -m benchmarks.parameter_experiments [SEEDS]      100 seeds take about a minute
"""

import sys

import numpy as np
from rich.console import Console
from rich.table import Table

from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.identify.experiments import Estimate
from dmptm_ctrl.identify.experiments_breakaway import reducer_breakaway, ring_breakaway
from dmptm_ctrl.identify.experiments_contact import gap_damping
from dmptm_ctrl.identify.experiments_dynamic import shaken_turns
from dmptm_ctrl.identify.experiments_rig import ramp, shaken_turn, staircase, taps
from dmptm_ctrl.identify.experiments_steady import constant_speed, stribeck_fit
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DECLARED = paper_drive()
SPEEDS = np.array([0.06, 0.12, 0.25, 0.5, 1, 2, 4, 8, 16, 30]) * DEG
LINES = np.unique(np.round(np.geomspace(2, 260, 24) * 4) / 4)
# What the other experiments know when the flights are judged, as shares of the value.
KNOWN_SE = (
    {"J_2": 0.003, "B3_plus": 0.007, "B3_minus": 0.007}
    | dict.fromkeys(("T3s_plus", "T3c_plus", "T3s_minus", "T3c_minus"), 0.004)
    | {"W3_plus": 0.15, "W3_minus": 0.15}
)
Rng = np.random.Generator


def rig(rng: Rng) -> Drive:
    """Draw a drive with each parameter up to 10 % off; static friction stays above Coulomb."""
    values = {n: DECLARED[n] * rng.uniform(0.9, 1.1) for n in DECLARED.free if n[0] != "T"}
    for pair in ("T3{}_plus", "T3{}_minus", "TL{}_plus", "TL{}_minus"):
        factor = rng.uniform(0.9, 1.1)
        values |= {pair.format(k): DECLARED[pair.format(k)] * factor for k in "sc"}
    values |= {"c": rng.uniform(1.5, 6.0), "c_f": rng.uniform(0.05, 0.4), "J_m": DECLARED["J_m"]}
    return DECLARED.with_values(**values)


def steady(truth: Drive, rng: Rng) -> dict[str, Estimate]:
    """Constant speeds under preload: gaps, stiffness, both Stribeck curves."""
    logs = [
        staircase(Model(truth), [*SPEEDS, *-SPEEDS[::-1]], b, rng, seconds=2.0)
        for b in (0.6, -0.6, 1.2)
    ]
    found = constant_speed(DECLARED, logs)
    return {**found.estimates, **stribeck_fit(found.reducer), **stribeck_fit(found.ring)}


def breakaway(truth: Drive, rng: Rng) -> dict[str, Estimate]:
    """Ramps: static friction."""

    def ramps(top: float, **options: bool) -> list:
        return [
            ramp(Model(truth), way * rng.uniform(0.01, 0.03), top, rng, **options)
            for way in (1, 1, -1, -1)
        ]

    reducers = reducer_breakaway(DECLARED, ramps(0.4))
    return reducers | ring_breakaway(DECLARED, ramps(0.6, from_flank=True), reducers)


def shaken(truth: Drive, rng: Rng) -> dict[str, Estimate]:
    """Shaken turns: inertias, stiffness, damping."""
    logs = [
        shaken_turn(Model(truth), LINES, volts, rng, differential=kind)
        for kind, volts in ((False, 0.04), (True, 0.005))
    ]
    found = shaken_turns(DECLARED, logs, period=4.0, lines=LINES)
    return {{"B3": "B3_plus", "BL": "BL_plus"}.get(n, n): e for n, e in found.items()}


def flights(truth: Drive, rng: Rng) -> dict[str, Estimate]:
    """Flights through the gaps: gap damping."""
    log = taps(Model(truth), (0.45, 0.6, 0.8, 1.0), rng, repeats=3)
    known = {}
    for name, share in KNOWN_SE.items():
        se = share * truth[name]
        known[name] = Estimate(truth[name] + se * rng.normal(), se, "")
    return gap_damping(DECLARED, log, known)


EXPERIMENTS = (steady, breakaway, shaken, flights)


def misses(seeds: range) -> dict[str, dict[str, list[float]]]:
    """Estimate minus truth in standard errors, by experiment and parameter, one per seed."""
    result: dict[str, dict[str, list[float]]] = {}
    for experiment in EXPERIMENTS:
        family = result.setdefault(experiment.__name__, {})
        for seed in seeds:
            rng = np.random.default_rng(seed)
            truth = rig(rng)
            for name, found in experiment(truth, rng).items():
                family.setdefault(name, []).append((found.value - truth[name]) / found.se)
    return result


def main(arguments: list[str]) -> None:
    seeds = int(arguments[0]) if arguments else 100
    table = Table("experiment", "parameter", "within 2 se [%]", "mean square", "worst [se]")
    every = []
    for experiment, family in misses(range(seeds)).items():
        for name, values in family.items():
            z = np.abs(values)
            every.append(z)
            cells = (100 * np.mean(z < 2), np.mean(z**2), z.max())
            table.add_row(experiment, name, *(f"{c:.4g}" for c in cells))
    console = Console()
    console.print(table)
    z = np.concatenate(every)
    console.print(f"{100 * np.mean(z < 2):.1f} % of {z.size} estimates within two standard errors")


if __name__ == "__main__":
    main(sys.argv[1:])
