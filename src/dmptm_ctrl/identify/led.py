"""Runs of many drives on many records at once, led where they are, beside what was measured."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import RING_COUNT, Record, block_mean
from dmptm_ctrl.parallel import free, in_threads
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.compiled import BODIES, FINE_SUBSTEPS, OUTPUTS, observer_gains
from dmptm_ctrl.simulate.compose import engine, layout
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats, Stacked, stacked

# Of a run in the first tenth of a second, where names are told by a few landings: the next ones
# grow what a coarser scheme misses there.
EARLY_SECONDS, EARLY_SUBSTEPS = 0.1, 32
AT_ONCE = 256  # runs of one call, in groups of lanes
THREADED = 60_000  # steps of all runs, about 1 ms, of which threads take longer than they save
SPEED = (OUTPUTS.index("omega_L"),)
LEAD_HZ = 6.0  # of the observer that leads a run to where it is let go
LEAD_SUBSTEPS = 4  # of a run that it leads, and that forgets what such steps miss
OF_ONE_STEP = ("presliding", "sensor_delay")  # sites whose numbers are of one length of steps
# One unit of a residual: twice what a gyro of 0.05 deg/s leaves in a block of two samples, and
# one and a half times the rounding of the ring encoder, seen at the pinion.
SPEED_UNIT = np.deg2rad(0.08)  # rad/s
TWIST_UNIT = 1.4 * RING_COUNT / np.sqrt(12.0)  # rad at the ring gear


class Bench:
    """Records on which many drives run, led where they are; what all runs share is made once.

    Parameters
    ----------
    records : sequence of Record
    """

    def __init__(self, records: Sequence[Record]) -> None:
        self.records = records
        self.led = any(rec.led for rec in records)
        self._groups: dict[bool, list[_Alike]] = {}

    def groups(self, timed: bool) -> "list[_Alike]":
        """Records that run side by side; those of other times only where time does not matter."""
        if timed not in self._groups:
            alike: dict[tuple[float, ...], list[int]] = {}
            for i, rec in enumerate(self.records):
                begin = float(rec.time[0]) if timed else 0.0
                key = (rec.u.shape[1], rec.dt, rec.led, begin, rec.block, rec.twist is None)
                alike.setdefault(key, []).append(i)
            self._groups[timed] = [_Alike(rows, self.records) for rows in alike.values()]
        return self._groups[timed]

    def run(
        self, drives: Stacked, jobs: int, substeps: int | None, *, compares: bool = False
    ) -> "list[tuple[_Alike, Floats]]":
        """Run drives on each record, in steps as fine as its length asks for unless said.

        Returns records that are alike, and their runs (len, drives, bodies, n); of what they are
        compared by only where that is all that is wanted.
        """
        timed = self.led and acts(drives, lambda e: "time" in e.depends_on)
        groups = [_Runs(alike, drives, substeps, compares) for alike in self.groups(timed)]
        steps = sum(one.count * one.alike.u.shape[2] * one.how["substeps"] for one in groups)
        jobs = free(jobs) if steps > THREADED else 1
        tasks = [(one, some) for one in groups for some in one.shares(jobs)]
        done = iter(in_threads(lambda task: task[0].run(task[1]), tasks, jobs))
        runs = []
        for one in groups:
            parts = [next(done) for _ in one.shares(jobs)]
            several = parts[0] if len(parts) == 1 else np.concatenate(parts)
            runs.append(
                (one.alike, several.reshape(one.alike.count, len(drives), *several.shape[1:]))
            )
        return runs

    def compared(self, drives: Stacked, jobs: int, substeps: int | None = None) -> Floats:
        """Measured minus simulated of many drives, in units, (len(drives), m)."""
        parts: dict[int, Floats] = {}
        n1, n2 = (drives.base[:, BASE.index(key), None] for key in ("N_1", "N_2"))
        for alike, runs in self.run(drives, jobs, substeps, compares=True):
            runs = runs[..., alike.led :]
            if alike.twist is None:
                missed = block_mean((alike.omega - runs[:, :, 0]) / SPEED_UNIT, alike.block)
            else:
                theta, omega, *motors = np.moveaxis(runs, 2, 0)
                rows = [(alike.omega - omega) / SPEED_UNIT]
                for measured, motor in zip(alike.twist, motors, strict=True):
                    rows.append((measured - (motor / n1 - n2 * theta)) / (n2 * TWIST_UNIT))
                several = [block_mean(row, alike.block) for row in rows]
                missed = np.concatenate(several, axis=2)
            parts |= zip(alike.rows, missed, strict=True)
        return np.concatenate([parts[i] for i in range(len(self.records))], axis=1)


class _Alike:
    """Records of one length and kind: what a run needs of them, and what it is compared with."""

    def __init__(self, rows: Sequence[int], records: Sequence[Record]) -> None:
        some = [records[i] for i in rows]
        first = some[0]
        self.rows, self.count = rows, len(rows)
        self.dt, self.led, self.block = first.dt, first.led, first.block
        self.begin = float(first.time[0])  # of all of them, where it matters
        self.u = np.array([rec.u for rec in some])
        self.x0 = np.array([rec.x0 for rec in some])
        self.theta = np.array([rec.theta[: first.led] for rec in some])
        self.early = self.u.shape[2] * self.dt <= EARLY_SECONDS
        self.omega = np.array([rec.omega[first.led :] for rec in some])[:, None]
        self.twist: list[Floats] | None = None
        if first.twist is not None:
            twists = np.array([rec.twist for rec in some])[:, None, first.led :]
            self.twist = [twists[..., side] for side in range(2)]


class _Runs:
    """Runs of many drives on records that are alike, one record after another."""

    def __init__(
        self, alike: _Alike, drives: Stacked, substeps: int | None, compares: bool
    ) -> None:
        self.alike, self.drives = alike, drives
        self.count = alike.count * len(drives)
        self.how: dict[str, Any] = {
            "substeps": substeps or (EARLY_SUBSTEPS if alike.early else FINE_SUBSTEPS),
            "columns": SPEED if compares and alike.twist is None else range(BODIES),
        }
        if alike.led:
            self.how["observer"] = observer_gains(LEAD_HZ, alike.dt)
            if not acts(drives, lambda effect: effect.site in OF_ONE_STEP):
                self.how["lead_substeps"] = min(LEAD_SUBSTEPS, self.how["substeps"])
            self.how["begin"] = alike.begin

    def shares(self, jobs: int) -> list[range]:
        """Share the runs out to threads, in groups of lanes that are full."""
        lanes = engine().LANES
        size = min(AT_ONCE, lanes * -(-self.count // (lanes * jobs)))
        return [range(k, min(k + size, self.count)) for k in range(0, self.count, size)]

    def run(self, some: range) -> Floats:
        """Run some of them."""
        record, drive = np.divmod(np.array(some), len(self.drives))
        alike, own = self.alike, self.drives[drive]
        measured = alike.theta[record] if alike.theta.size else None
        u, x0 = alike.u[record], alike.x0[record]
        runs = march_any(own, u, x0, alike.dt, measured=measured, **self.how)
        return runs.transpose(0, 2, 1)


def acts(drives: Stacked, wanted: Callable[[Effect], bool]) -> bool:
    """Whether any of some drives has an effect of a kind."""
    used = np.any(drives.on, axis=0)
    return any(used[layout()[name][0]] for name, e in CATALOGUE.items() if wanted(e))


def side_by_side(
    records: Sequence[Record], drives: Stacked, jobs: int, substeps: int | None
) -> list[tuple[Sequence[int], Floats]]:
    """Run many drives on each record: which are alike, and their runs (len, drives, n, BODIES)."""
    runs = Bench(records).run(drives, jobs, substeps)
    return [(alike.rows, several.transpose(0, 1, 3, 2)) for alike, several in runs]


def compared(
    records: Sequence[Record], arrays: Sequence[Arrays], jobs: int, substeps: int | None = None
) -> Floats:
    """Measured minus simulated of many drives, in units, (len(arrays), m), by `Bench`."""
    return Bench(records).compared(stacked(arrays), jobs, substeps)
