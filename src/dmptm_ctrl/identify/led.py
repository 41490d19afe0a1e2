"""Runs of many drives on many records at once, led where they are, beside what was measured."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import RING_COUNT, Record, block_mean
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.batch import march_many
from dmptm_ctrl.simulate.compiled import BODIES, FINE_SUBSTEPS, observer_gains
from dmptm_ctrl.simulate.compose import layout
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats, Stacked, stacked

# Of a run in the first tenth of a second, where names are told by a few landings: the next ones
# grow what a coarser scheme misses there.
EARLY_SECONDS, EARLY_SUBSTEPS = 0.1, 32
AT_ONCE = 64  # runs of one call, in groups of lanes
LEAD_HZ = 6.0  # of the observer that leads a run to where it is let go
LEAD_SUBSTEPS = 4  # of a run that it leads, and that forgets what such steps miss
OF_ONE_STEP = ("presliding", "sensor_delay")  # sites whose numbers are of one length of steps
# One unit of a residual: twice what a gyro of 0.05 deg/s leaves in a block of two samples, and
# one and a half times the rounding of the ring encoder, seen at the pinion.
SPEED_UNIT = np.deg2rad(0.08)  # rad/s
TWIST_UNIT = 1.4 * RING_COUNT / np.sqrt(12.0)  # rad at the ring gear


def side_by_side(
    records: Sequence[Record], drives: Stacked, jobs: int, substeps: int | None
) -> list[tuple[list[int], Floats]]:
    """Run many drives on each record, led where it is.

    In steps as fine as its length asks for, unless `substeps` says how many per sample. Returns
    which records are alike, and their runs (len, drives, n, BODIES).
    """
    timed = any(rec.led for rec in records) and acts(drives, lambda e: "time" in e.depends_on)
    alike: dict[tuple[float, ...], list[int]] = {}  # what runs side by side
    for i, rec in enumerate(records):
        begin = float(rec.time[0]) if timed else 0.0
        key = (rec.u.shape[1], rec.dt, rec.led, begin, rec.block, rec.twist is None)
        alike.setdefault(key, []).append(i)
    groups = [_Group([records[i] for i in rows], drives, substeps) for rows in alike.values()]
    tasks = [(group, first) for group in groups for first in range(0, group.count, AT_ONCE)]
    done = iter(in_threads(lambda task: task[0].run(task[1]), tasks, jobs))
    shape = len(drives), -1, BODIES
    return [
        (
            rows,
            np.concatenate([next(done) for _ in range(0, group.count, AT_ONCE)]).reshape(
                len(rows), *shape
            ),
        )
        for rows, group in zip(alike.values(), groups, strict=True)
    ]


class _Group:
    """Runs of many drives on records that are alike, one record after another."""

    def __init__(self, alike: Sequence[Record], drives: Stacked, substeps: int | None) -> None:
        first = alike[0]
        self.drives, self.dt, self.count = drives, first.dt, len(alike) * len(drives)
        self.u = np.array([rec.u for rec in alike])
        self.x0 = np.array([rec.x0 for rec in alike])
        early = self.u.shape[2] * self.dt <= EARLY_SECONDS
        self.how: dict[str, Any] = {
            "substeps": substeps or (EARLY_SUBSTEPS if early else FINE_SUBSTEPS),
            "columns": range(BODIES),
        }
        self.theta = np.array([rec.theta[: first.led] for rec in alike])
        if first.led:
            self.how["observer"] = observer_gains(LEAD_HZ, self.dt)
            if not acts(drives, lambda effect: effect.site in OF_ONE_STEP):
                self.how["lead_substeps"] = min(LEAD_SUBSTEPS, self.how["substeps"])
            self.how["begin"] = float(first.time[0])  # of all of them, where it matters

    def run(self, first: int) -> Floats:
        """Run from one on as many as go at once."""
        record, drive = np.divmod(
            np.arange(first, min(first + AT_ONCE, self.count)), len(self.drives)
        )
        measured = self.theta[record] if self.theta.size else None
        own = self.drives[drive]
        return march_many(
            own, self.u[record], self.x0[record], self.dt, measured=measured, **self.how
        )


def acts(drives: Stacked, wanted: Callable[[Effect], bool]) -> bool:
    """Whether any of some drives has an effect of a kind."""
    used = np.any(drives.on, axis=0)
    return any(used[layout()[name][0]] for name, e in CATALOGUE.items() if wanted(e))


def compared(
    records: Sequence[Record], arrays: Sequence[Arrays], jobs: int, substeps: int | None = None
) -> Floats:
    """Measured minus simulated of many drives, in units, (len(arrays), m), by `side_by_side`."""
    drives = stacked(arrays)
    n1, n2 = (drives.base[:, BASE.index(key), None] for key in ("N_1", "N_2"))
    parts: dict[int, Floats] = {}
    for which, runs in side_by_side(records, drives, jobs, substeps):
        some = [records[i] for i in which]
        theta, omega, *motors = np.moveaxis(runs, 3, 0)  # (records, drives, n) each
        rows = [(np.array([rec.omega for rec in some])[:, None] - omega) / SPEED_UNIT]
        if some[0].twist is not None:
            measured = np.array([rec.twist for rec in some])[:, None]
            for side, motor in enumerate(motors):
                twist = motor / n1 - n2 * theta
                rows.append((measured[..., side] - twist) / (n2 * TWIST_UNIT))
        missed = np.stack(rows, 2)[..., some[0].led :]
        missed = block_mean(missed, some[0].block).reshape(len(some), len(drives), -1)
        parts |= zip(which, missed, strict=True)
    return np.concatenate([parts[i] for i in range(len(records))], axis=1)
