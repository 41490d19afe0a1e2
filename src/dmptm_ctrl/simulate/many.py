"""Many plants at once: sixteen per vector loop, such groups over the cores."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.lanes import LANES, aligned, lane_engine, rows_of
from dmptm_ctrl.simulate.observer import UNLED, Observer
from dmptm_ctrl.simulate.plant import Flags, Floats, Plant, Structure, numbers, structure_of
from dmptm_ctrl.simulate.run import NOBODY, Controller

_NO_ROWS = np.zeros((0, 0))
_NO_TABLES = np.zeros((0, 0, 0))


class Common(NamedTuple):
    """What is the same for all plants of a batch.

    Attributes
    ----------
    u : (batch or 1, inputs, n) array
        Signals of the inputs, held between samples; none of them under controllers.
    columns : (c,) array of int
        Kept of what is seen: readings, torques and twists of links, signals of inputs.
    measured : (batch or 1, m, n) array
        What observers follow, or none.
    """

    dt: float
    substeps: int
    samples: int
    u: Floats
    target: Floats  # (batch or 1, n)
    noise: Floats  # (batch or 1, n), or none
    columns: NDArray[np.int64]
    every: int = 1
    statistics: bool = True
    begin: float = 0.0
    measured: Floats = _NO_TABLES

    def of(self, some: Sequence[int]) -> "Common":
        """What some of the plants need of it."""
        tables = {name: getattr(self, name) for name in ("u", "target", "noise", "measured")}
        return self._replace(**{k: t[list(some)] for k, t in tables.items() if len(t) > 1})


def same_shape(
    plants: Sequence[Plant], *, switched: bool = False
) -> list[tuple[list[int], Flags, Structure]]:
    """Group plants that one structure can stand for: with all effects that act in any of them.

    An effect changes nothing where its numbers are those of its absence. With `switched` all
    that there are, behind flags, if one acts: compiled once, not for each choice of them.
    """
    groups: dict[tuple, list[int]] = {}
    for k, plant in enumerate(plants):
        bare = structure_of(plant._replace(on=np.zeros_like(plant.on)), switched=False)
        groups.setdefault((id(bare), id(plant.places)), []).append(k)
    found = []
    for members in groups.values():
        on = np.bitwise_or.reduce([plants[k].on for k in members])
        structure = structure_of(
            plants[members[0]]._replace(on=on), switched=switched and bool(on.any())
        )
        found.append((members, on, structure))
    return found


def run_many(
    plants: Sequence[Plant],
    starts: Sequence[tuple[Floats, Floats]],
    common: Common,
    controllers: Sequence[Controller] | None = None,
    *,
    observers: Sequence[Observer] | None = None,
    n_jobs: int = 1,
    width: int = LANES,
) -> tuple[list[Floats], list[Floats]]:
    """Run plants open loop or each under its controller.

    Parameters
    ----------
    starts : sequence of (coordinates, speeds)
    controllers : sequence of Controller, optional
        Of one function.
    observers : sequence of Observer, optional
        Of the same sensors and leaks; they follow what is measured.
    n_jobs : int
        Threads, −1 for one per core.
    width : int
        Of the lanes, 16 or 8.

    Returns
    -------
    outputs : list of (columns, kept samples) arrays
    statistics : list of (4, seen) arrays
        Least, greatest, sum and sum of squares of all that is seen.
    """
    tasks = []
    for members, on, structure in same_shape(plants):
        for first in range(0, len(members), width):
            some = members[first : first + width]
            given = (
                on,
                [plants[k] for k in some],
                [starts[k] for k in some],
                common.of(some),
                None if controllers is None else [controllers[k] for k in some],
                None if observers is None else [observers[k] for k in some],
                width,
            )
            tasks.append((some, structure, *given))
    outputs: list[Floats] = [np.empty(0)] * len(plants)
    statistics: list[Floats] = [np.empty(0)] * len(plants)
    for structure in {id(task[1]): task[1] for task in tasks}.values():
        lane_engine(structure, width)
    # threads: the loop does not hold the interpreter's lock
    done = (
        [run_lanes(*t) for t in tasks]
        if len(tasks) == 1
        else each(run_lanes, tasks, n_jobs, prefer="threads")
    )
    for some, out, stats in done:
        for lane, k in enumerate(some):
            outputs[k], statistics[k] = out[lane], stats[:, :, lane]
    return outputs, statistics


def run_lanes(
    some: list[int],
    structure: Structure,
    on: Flags,
    plants: list[Plant],
    starts: list[tuple[Floats, Floats]],
    common: Common,
    controllers: list[Controller] | None,
    observers: list[Observer] | None,
    width: int = LANES,
) -> tuple[list[int], Floats, Floats]:
    """Run plants of one structure beside each other, as many as there are lanes at most."""
    engine, rows = lane_engine(structure, width), rows_of(structure, width)
    h, lanes = common.dt / common.substeps, len(plants)
    w = aligned(len(rows.all) * width)
    table = w.reshape(-1, width)
    begun = len(engine.names.state)
    where = rows.index[rows.numbers[0]]
    for lane in range(width):  # those that are left over run along, and nobody looks
        plant, (q, v) = plants[min(lane, lanes - 1)], starts[min(lane, lanes - 1)]
        table[:begun, lane] = engine.names.start
        table[: 3 * structure.coordinates, lane] = np.concatenate([q, v, v])
        table[where : where + len(rows.numbers), lane] = numbers(plant, rows.numbers, h)
    first = rows.index[rows.statistics[0]]
    count = len(rows.seen)
    table[first : first + count], table[first + count : first + 2 * count] = np.inf, -np.inf
    padded = [plants[min(lane, lanes - 1)] for lane in range(width)]
    dead = np.array([p.input_values[:, 1] / common.dt for p in padded]).T
    delays = np.array([p.sensor_delay[p.sensor_delay > 0.0] for p in padded]).T
    ring = np.zeros((len(delays), int(delays.max(initial=0.0) / h) + 2, width))
    for n, i in enumerate(k for k, sensor in enumerate(structure.sensors) if sensor[2]):
        b, speed, _ = structure.sensors[i]
        name = f"{'v' if speed else 'q'}{structure.bodies[b][0]}"
        ring[n] = table[rows.index[name]] * [p.body_ratio[b] for p in padded]
    room = int(np.ceil(dead.max(initial=0.0))) + 2
    inputs = len(structure.inputs)
    kept = np.zeros((width, inputs, room))
    law = NOBODY if controllers is None else controllers[0]
    rules = np.array([c.rule for c in controllers] if controllers else [law.rule] * width)
    led = (observers or [UNLED] * lanes) + [observers[-1] if observers else UNLED] * (width - lanes)
    gains = np.stack([o.gains for o in led], axis=-1)
    shown = np.stack([o.shown(p) for o, p in zip(led, padded, strict=True)], axis=-1)
    kept_samples = -(-common.samples // common.every) if common.columns.size else 0
    out = np.empty((lanes, common.columns.size, kept_samples))
    engine.module.march_lanes(
        w, lanes, on, common.u, kept, np.zeros(inputs), dead, _NO_ROWS, ring,
        np.ascontiguousarray(delays), common.begin, common.dt, common.substeps, law.function,
        rules, np.zeros((width, law.memory)), common.target, common.noise,
        controllers is not None, np.zeros(max(len(structure.sensors), 1)), np.zeros(inputs),
        led[0].sensors, common.measured, gains, shown, led[0].leak,
        np.zeros((led[0].leak.size, width)), np.zeros((2 * structure.coordinates, width)),
        common.columns, common.every, out, common.statistics,
        common.samples,
    )  # fmt: skip
    return some, out, table[first : first + 4 * count].reshape(4, count, width)
