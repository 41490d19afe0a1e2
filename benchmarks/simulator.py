"""How fast is the simulator, at what accuracy, beside others? One run answers.

    python benchmarks/simulator.py [--out DIR] [--repeats N]

Drive and loop of the paper: three bodies, two meshes with backlash, Stribeck friction, PI at
1 kHz, 10 s of 10 sin(πt) deg/s. Two cases: preloaded, and without preload, where the flanks
are hit at each reversal. Without preload the motion after some seconds of impacts depends on
the last digit of everything, so errors are taken over the first second, against the
event-located reference whose own error is shown. Contenders take turns; the least
processor time counts.
Costs of growth, of derivatives and of a first result are measured too. Prints a table and, as
the last line, one JSON object with the ratios; draws DIR/simulator.png.
"""

import argparse
import json
import os
import tempfile
import time
from datetime import date
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from contenders import (
    CasADi,
    ScalarC,
    located,
    naive_numba,
    python_control,
    sampled_blocks,
)
from numba import njit
from scaling import SECONDS as LENGTHS
from scaling import SIZES, exponent, peak
from scaling import batch as small_batch
from scaling import run as open_loop
from starts import starts

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import Loop, close_loop, rest
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.sensitivity import simulate_with_sensitivities

DT, SECONDS = 1e-3, 10.0  # s
TIME = DT * np.arange(round(SECONDS / DT) + 1)
TARGET = np.deg2rad(10.0) * np.sin(np.pi * TIME)  # rad/s
PER_DEGREE = 180.0 / np.pi
JUDGED = 1001  # samples, over which errors are taken
SHORT = 1001  # samples of the slow contenders; their times are scaled to 10 s
RK4_STEPS = (4, 10, 20, 50)  # per sample; 10 is the 100 µs of the comparison
OWN_STEPS = (2, 3, 4, 8, 16, 32, 64)
TOLERANCES = (1e-3, 1e-6)  # of RK45; the first is SciPy's and python-control's own
OWN, PYTHON_CONTROL, BLOCKS = "dmptm_ctrl", "python-control RK45", "its blocks, sampled"
BATCH = 1000
SPINS, SPIN = 64, 5_000_000  # tasks of about 10 ms that touch nothing but registers
PARAMETERS = ("c", "k_m", "J_L", "T3c_plus", "TLc_plus", "gap_l", "B3_plus", "BL_plus")
PARAMETERS += ("T3s_plus", "TLs_plus", "gap_r", "J_2", "T3c_minus", "TLc_minus")
# Of effects in use while derivatives are taken, what is not a clearly visible size of all
# amplitudes. A dead time of whole steps has a kink, where no derivative exists.
EXAMPLES = {
    "cogging": {"left_cosine": 0.01, "right_sine": 0.01, "order": 24.0},
    "mesh_error": {"left_cosine": 4e-5, "right_sine": 4e-5},
    "drive_offset": {"left": 0.05, "right": -0.05},
    "drive_delay": {"delay": 2.3e-3},
    "sensor_delay": {"delay": 2.3e-3},
}

CASES = {
    "preloaded": Loop(0.08 * PER_DEGREE, 1.5 * PER_DEGREE, 10.0, 0.5, -0.5),
    "no preload": Loop(0.05 * PER_DEGREE, 0.5 * PER_DEGREE, 10.0),
}


class Point(NamedTuple):
    """One contender at one setting."""

    name: str
    setting: str
    run: object  # () -> speed at the samples
    samples: int


def contenders(model, loop, folder):
    """All points of a case that are run over 10 s."""
    points = []
    c = ScalarC(folder) if ScalarC.available() else None
    for steps in RK4_STEPS:
        setting = f"{1e6 * DT / steps:.4g} µs"
        runs = {"numba RK4": lambda s=steps: naive_numba(model, loop, TARGET, DT, s)}
        if c is not None:
            runs["C -O3 RK4"] = lambda s=steps: c(model, loop, TARGET, DT, s)
        points += [Point(name, setting, run, TIME.size) for name, run in runs.items()]
    if CasADi.available():
        for steps in RK4_STEPS[1:2]:
            machine = CasADi(model, loop, DT, TIME.size, steps)
            setting = f"{1e6 * DT / steps:.4g} µs"
            points.append(Point("CasADi RK4", setting, lambda m=machine: m(TARGET), TIME.size))
    points += [
        Point(
            OWN,
            f"{1e6 * DT / steps:.4g} µs",
            # the others give no torques of the meshes at the samples either
            lambda s=steps: close_loop(model, loop, TARGET, DT, substeps=s, meshes=False)[1][:, 1],
            TIME.size,
        )
        for steps in OWN_STEPS
    ]
    return points


def slow(model, loop):
    """Points that are run once, over a shorter time."""
    whole = Point(
        PYTHON_CONTROL,
        "rtol 1e-3",
        lambda: python_control(model, loop, TARGET[:SHORT], DT),
        SHORT,
    )
    return [whole] + [
        Point(
            BLOCKS,
            f"rtol {tolerance:.0e}",
            lambda r=tolerance: sampled_blocks(model, loop, TARGET[:SHORT], DT, r),
            SHORT,
        )
        for tolerance in TOLERANCES
    ]


def least(functions, repeats, clock=time.process_time):
    """Least time of each of several functions that take turns.

    Of the processor, so that what else runs meanwhile counts little; several threads' add up.
    """
    for function in functions:
        function()
    times = []
    for _ in range(repeats):
        row = []
        for function in functions:
            start = clock()
            function()
            row.append(clock() - start)
        times.append(row)
    return np.min(times, axis=0)


def error(speed, exact):
    """RMS over the judged samples, as a share of the reference's."""
    return float(np.sqrt(np.mean((speed[:JUDGED] - exact) ** 2) / np.mean(exact**2)))


def measure(case, loop, model, repeats, folder):
    """Rows (case, name, setting, seconds for 10 s, error), and the reference's own error."""
    exact, coarser = (located(model, loop, TARGET[:JUDGED], DT, r) for r in (1e-11, 1e-9))
    fast, few = contenders(model, loop, folder), slow(model, loop)
    times = least([p.run for p in fast], repeats)
    rows = []
    for point, spent in zip(fast, times, strict=True):
        rows.append((case, point.name, point.setting, float(spent), error(point.run(), exact)))
    for point in few:
        start = time.process_time()  # once only: what else runs meanwhile must not count
        speed = point.run()
        spent = (time.process_time() - start) * TIME.size / point.samples
        rows.append((case, point.name, point.setting, spent, error(speed, exact)))
    return rows, error(coarser, exact)


def picked(rows, case, name, setting=None):
    return [r for r in rows if r[0] == case and r[1] == name and setting in (None, r[2])]


@njit(nogil=True)
def spin(count):
    """Multiply and add in registers: what the second core adds to this is the most it can."""
    x = float(count)  # not 1, which stays as it is: nothing would be left to do
    for _ in range(count):
        x = x * 0.999999 + 1e-6
    return x


def spinning(jobs):
    return lambda: list(each(spin, [(SPIN,)] * SPINS, jobs, prefer="threads"))


def batch_ratios(model, loop, substeps, c, repeats):
    """Throughput of a batch against C's, per core and over the cores."""
    rng = np.random.default_rng(1)
    models = [
        model.with_values(
            **{key: model.drive[key] * rng.uniform(0.9, 1.1) for key in ("c", "k_m", "J_L")}
        )
        for _ in range(BATCH)
    ]

    def batch(jobs):
        options = {"loop": loop, "substeps": substeps, "jobs": jobs}
        return lambda: simulate_batch(models, TIME, TARGET, **options)

    functions = [batch(1), batch(2)]
    if c is not None:
        functions.append(lambda: [c(m, loop, TARGET, DT, 10) for m in models[:20]])
    busy = least(functions, repeats)
    walled = [*functions[:2], spinning(1), spinning(2)]
    wall = least(walled, repeats, time.perf_counter)
    return {
        "batch_processor_seconds": round(busy[0], 3),
        "batch_seconds": [round(t, 3) for t in wall[:2]],
        "two_cores_over_one": round(wall[0] / wall[1], 2),
        "two_cores_over_one_of_the_machine": round(wall[2] / wall[3], 2),
        "processor_two_cores_over_one": round(busy[1] / busy[0], 2),
        "batch_over_c_per_core": round(busy[2] / 20 * BATCH / busy[0], 1) if c else None,
    }


def sensitivity_costs(model, loop, repeats, *, existing=False, names=PARAMETERS, most=14):
    """Cost of p sensitivities, in runs, both as a user calls them.

    Over 10 s, or as long as all derivatives exist.
    """
    u, _ = close_loop(model, loop, TARGET, DT)
    x0, times = rest(model, 0.0), TIME
    if existing:
        exists = simulate_with_sensitivities(model, times, u, names, x0).exists.all(axis=0)
        n = times.size if exists.all() else int(np.argmin(exists))
        u, times = np.ascontiguousarray(u[:, :n]), times[:n]
    counts = [p for p in (1, 2, 3, 4, 6, 7, 8, 10, 14) if p <= most]

    def run(p):
        return lambda: simulate_with_sensitivities(model, times, u, names[:p], x0)

    spent = least([lambda: simulate(model, times, u, x0), *(run(p) for p in counts)], repeats)
    costs = {p: round(float(t / spent[0]), 2) for p, t in zip(counts, spent[1:], strict=True)}
    return {"seconds": round(float(times[-1]), 2), **costs}


def costs_with_effects(model, loop, repeats, **how):
    """The same of drives with an effect in use, the first parameter one of the effect's."""
    found = {}
    for effect, own in CATALOGUE.items():
        values = EXAMPLES.get(effect, {p.name: p.step for p in own.parameters if not p.bank})
        names = (f"{effect}.{next(iter(values))}", *PARAMETERS)
        changed = model.with_effect(effect, **values)
        found[f"sensitivities_in_runs_with_{effect}"] = sensitivity_costs(
            changed, loop, repeats, names=names, most=6, **how
        )
    return found


def growth(model, repeats):
    """Exponents of cost over time and batch, 1 if linear; memory [MB] of statistics only."""
    lengths = least([open_loop(model, seconds) for seconds in LENGTHS], repeats)
    sizes = least([small_batch(count) for count in SIZES], repeats)
    # the voltages come from the caller, and are copied once
    memory = {s: peak(small_batch(64, s)) - 2 * 8 * (s / DT + 1) / 1e6 for s in (1.0, 10.0)}
    return {
        "time_exponent": exponent(LENGTHS, lengths),
        "batch_exponent": exponent(SIZES, sizes),
        "mb_of_statistics_1_s": round(memory[1.0], 3),
        "mb_of_statistics_10_s": round(memory[10.0], 3),
    }


def figure(rows, floors, path):
    """Work–precision diagram: time against error, all contenders."""
    styles = {
        OWN: ("o", "-", "0.0"),
        "C -O3 RK4": ("s", "--", "0.35"),
        "numba RK4": ("^", ":", "0.35"),
        "CasADi RK4": ("D", "", "0.35"),
        PYTHON_CONTROL: ("v", "", "0.6"),
        BLOCKS: ("<", "-.", "0.6"),
    }
    fig, axes = plt.subplots(1, len(CASES), figsize=(8.0, 4.4), sharey=True, layout="constrained")
    for ax, case in zip(axes, CASES, strict=True):
        for name, (marker, line, colour) in styles.items():
            points = np.array([r[3:5] for r in picked(rows, case, name)])
            if points.size:
                ax.loglog(
                    points[:, 1],
                    points[:, 0],
                    marker=marker,
                    linestyle=line or "none",
                    color=colour,
                    label=name,
                    markersize=5,
                )
        ax.set_title(f"{case} (reference: {floors[case]:.0e})", fontsize="medium")
        ax.set_xlabel("RMS error of ring-gear speed over 1 s,\nshare of its RMS")
        ax.grid(which="major", linewidth=0.3)
    axes[0].set_ylabel("time for 10 s of motion [s]")
    fig.legend(
        *axes[0].get_legend_handles_labels(), fontsize="small", loc="outside lower center", ncols=3
    )
    fig.savefig(path, dpi=150)
    plt.close(fig)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("."))
    parser.add_argument("--repeats", type=int, default=7)
    asked = parser.parse_args()
    asked.out.mkdir(parents=True, exist_ok=True)
    model = Model()
    rows, floors = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for case, loop in CASES.items():
            found, floors[case] = measure(case, loop, model, asked.repeats, folder)
            rows += found
        c = ScalarC(folder) if ScalarC.available() else None
        ratios = {"date": date.today().isoformat(), "cores": os.cpu_count()}
        ratios |= summary(rows, floors)
        loop = CASES["preloaded"]
        batch = batch_ratios(model, loop, ratios["steps"], c, max(2, asked.repeats // 3))
        costs = {
            "sensitivities_in_runs": sensitivity_costs(model, loop, asked.repeats),
            "sensitivities_in_runs_no_preload": sensitivity_costs(
                model, CASES["no preload"], asked.repeats, existing=True
            ),
            **costs_with_effects(model, loop, asked.repeats),
        }
        later = costs_with_effects(model, CASES["no preload"], asked.repeats, existing=True)
        costs |= {f"{name}_no_preload": found for name, found in later.items()}
        ratios |= growth(model, asked.repeats)
        first = starts(str(Path(folder) / "start"))
    print(f"{'case':12s}{'contender':22s}{'step':12s}{'10 s take':>12s}{'error':>12s}")
    for case, name, setting, spent, wrong in rows:
        print(f"{case:12s}{name:22s}{setting:12s}{1e3 * spent:9.2f} ms{wrong:12.1e}")
    one, two = batch["batch_seconds"]
    print(
        f"batch of {BATCH}: {one:.3f} s on one core, {two:.3f} s on two, "
        f"{batch['two_cores_over_one']:.2f} times as fast; the machine's own two cores are "
        f"{batch['two_cores_over_one_of_the_machine']:.2f} times as fast as one at spinning"
    )
    print_costs(costs)
    for name, spent in first.items():
        print(f"{name.replace('_', ' '):28s}{spent['seconds']:8.2f} s")
    ratios |= batch | costs | {"first_result": first}
    figure(rows, floors, asked.out / "simulator.png")
    print(json.dumps(ratios, allow_nan=False))


def print_costs(costs):
    """Costs of derivatives beside the goal, 1 + 0.5 p runs; a star where it is missed."""
    counts = sorted({p for found in costs.values() for p in found if p != "seconds"})
    print(f"{'cost of p sensitivities, in runs':44s}" + "".join(f"{p:>7d}" for p in counts))
    print(f"{'  goal':44s}" + "".join(f"{1 + 0.5 * p:7.1f}" for p in counts))
    for name, found in costs.items():
        shown = name.removeprefix("sensitivities_in_runs").strip("_").replace("_", " ")
        line = f"  {shown or 'without effects'}, {found['seconds']:.3g} s"
        cells = [
            f"{found[p]:6.2f}{'*' if found[p] > 1 + 0.5 * p else ' '}" if p in found else " " * 7
            for p in counts
        ]
        print(f"{line:44s}" + "".join(cells))
    for ending in ("", "_no_preload"):
        names = [name for name in costs if "_with_" in name]
        rows = [costs[n] for n in names if n.endswith("_no_preload") == bool(ending)]
        middle = [float(np.median([found[p] for found in rows])) for p in counts if p in rows[0]]
        shown = f"  median of {len(rows)} effects{ending.replace('_', ' ')}"
        print(f"{shown:44s}" + "".join(f"{cost:6.2f} " for cost in middle))


def as_good(rows, rivals):
    """Own rows per case at the coarsest step that is as accurate as the rival in every case."""
    for steps in OWN_STEPS:
        own = {case: picked(rows, case, OWN, f"{1e6 * DT / steps:.4g} µs")[0] for case in CASES}
        if all(own[case][4] <= rivals[case][4] for case in CASES):
            break
    return own


def summary(rows, floors):
    """Ratios of single runs, each at the coarsest own step that is as good as the rival.

    Without cc the naive numba RK4 stands for C.
    """
    rival = "C -O3 RK4" if ScalarC.available() else "numba RK4"
    settings = {rival: "100 µs", PYTHON_CONTROL: None, BLOCKS: None}
    found = {"error_reference": floors, "rival": rival}
    for name, setting in settings.items():
        rows_of = {case: picked(rows, case, name, setting)[0] for case in CASES}
        own = as_good(rows, rows_of)
        key = {rival: "rival", PYTHON_CONTROL: "python_control", BLOCKS: "its_blocks"}[name]
        found[f"over_{key}"] = {c: round(rows_of[c][3] / own[c][3], 2) for c in CASES}
        found[f"step_{key}"] = own["preloaded"][2]
        found[f"error_{key}"] = {c: [own[c][4], rows_of[c][4]] for c in CASES}
        if key == "rival":
            found["ms"] = {c: round(1e3 * own[c][3], 3) for c in CASES}
            found["steps"] = round(DT / (1e-6 * float(own["preloaded"][2].split()[0])))
    return found


if __name__ == "__main__":
    main()
