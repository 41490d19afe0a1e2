"""Runs of many drives on many records at once, led where they are, beside what was measured."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import RING_COUNT, Record, block_mean
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.batch import march_many
from dmptm_ctrl.simulate.compiled import BODIES, FINE_SUBSTEPS, observer_gains
from dmptm_ctrl.simulate.compose import layout
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats

# Of a run in the first tenth of a second, where names are told by a few landings: the next ones
# grow what a coarser scheme misses there.
EARLY_SECONDS, EARLY_SUBSTEPS = 0.1, 32
AT_ONCE = 64  # runs of one call, in groups of lanes
LEAD_HZ = 6.0  # of the observer that leads a run to where it is let go
# One unit of a residual: twice what a gyro of 0.05 deg/s leaves in a block of two samples, and
# one and a half times the rounding of the ring encoder, seen at the pinion.
SPEED_UNIT = np.deg2rad(0.08)  # rad/s
TWIST_UNIT = 1.4 * RING_COUNT / np.sqrt(12.0)  # rad at the ring gear


def led_runs(
    records: Sequence[Record], arrays: Sequence[Arrays], jobs: int, substeps: int | None = None
) -> list[Floats]:
    """Run many drives on each record, led where it is: (len(arrays), n, BODIES) of each.

    In steps as fine as its length asks for, unless `substeps` says how many per sample.
    """
    timed = any(rec.led for rec in records) and depends_on_time(arrays)
    alike: dict[tuple[float, ...], list[int]] = {}  # what runs side by side
    for i, rec in enumerate(records):
        begin = float(rec.time[0]) if timed else 0.0
        alike.setdefault((rec.u.shape[1], rec.dt, rec.led, begin), []).append(i)
    tasks = []
    for rows in alike.values():
        pairs = [*product(rows, range(len(arrays)))]
        tasks += [pairs[first : first + AT_ONCE] for first in range(0, len(pairs), AT_ONCE)]

    def run(task: Sequence[tuple[int, int]]) -> Floats:
        recs = [records[i] for i, _ in task]
        first = recs[0]
        early = first.u.shape[1] * first.dt <= EARLY_SECONDS
        fine = EARLY_SUBSTEPS if early else FINE_SUBSTEPS
        how: dict[str, Any] = {"substeps": substeps or fine}
        if first.led:
            how["observer"] = observer_gains(LEAD_HZ, first.dt)
            how["measured"] = np.array([rec.theta[: rec.led] for rec in recs])
            how["begin"] = float(first.time[0])  # of all of them, where it matters
        u, x0 = np.array([rec.u for rec in recs]), np.array([rec.x0 for rec in recs])
        own = [arrays[k] for _, k in task]
        return march_many(own, u, x0, first.dt, columns=range(BODIES), **how)

    runs: dict[int, list[Floats]] = {i: [] for i in range(len(records))}
    for task, done in zip(tasks, in_threads(run, tasks, jobs), strict=True):
        for (i, _), out in zip(task, done, strict=True):
            runs[i].append(out)
    return [np.array(runs[i]) for i in range(len(records))]


def depends_on_time(arrays: Sequence[Arrays]) -> bool:
    """Whether any of some drives has an effect that depends on the time."""
    used = np.any([on for _, on, _ in arrays], axis=0)
    return any(used[layout()[n][0]] for n, e in CATALOGUE.items() if "time" in e.depends_on)


def compared(
    records: Sequence[Record], arrays: Sequence[Arrays], jobs: int, substeps: int | None = None
) -> Floats:
    """Measured minus simulated of many drives, in units, (len(arrays), m); as :func:`led_runs`."""
    ratios = [BASE.index(key) for key in ("N_1", "N_2")]
    n1, n2 = np.array([base[ratios] for base, _, _ in arrays]).T

    def one(rec: Record, runs: Floats) -> Floats:
        theta, omega, *motors = np.moveaxis(runs, 2, 0)
        rows = [(rec.omega - omega) / SPEED_UNIT]
        if rec.twist is not None:
            for seen, motor in zip(rec.twist.T, motors, strict=True):
                twist = motor / n1[:, None] - n2[:, None] * theta
                rows.append((seen - twist) / (n2[:, None] * TWIST_UNIT))
        parts = np.stack(rows, 1)[..., rec.led :]
        return block_mean(parts, rec.block).reshape(len(arrays), -1)

    runs = led_runs(records, arrays, jobs, substeps)
    return np.hstack([one(rec, run) for rec, run in zip(records, runs, strict=True)])
