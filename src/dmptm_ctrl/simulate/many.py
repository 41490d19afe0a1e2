"""Many drives at once: sixteen per vector loop, such groups over the cores."""

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.elementary import address_of
from dmptm_ctrl.simulate.lanes import LANES, aligned, calls_of, lane_engine, rows_of
from dmptm_ctrl.simulate.loading import loops as loops_of
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.observer import NO_OBSERVER, Observer
from dmptm_ctrl.simulate.plant import Flags, Floats, Plant, Structure, numbers, structure_of
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.run import NOBODY, Controller


class Closed(Protocol):
    """What closes a loop."""

    def controller(self) -> Controller:
        """Return it as the compiled loop calls it."""


class Common(NamedTuple):
    """What is the same for all drives of a batch.

    Names of what is seen are ``reading0``, ``torque0`` and ``twist0`` of a link, ``signal0`` of an
    input.
    """

    dt: float
    substeps: int
    samples: int
    u: Floats  # (batch or 1, inputs, n), held between samples; n = 0 under controllers
    target: Floats  # (batch or 1, n)
    noise: Floats  # (batch or 1, n), or none
    columns: tuple[str, ...]  # kept of what is seen
    every: int = 1
    summed: tuple[str, ...] = ()  # of what statistics are
    begin: float = 0.0
    measured: Floats = np.zeros((0, 0, 0))  # (batch or 1, m, n), what observers follow, or none
    before: Floats | None = None  # (inputs,), signals before the first sample; 0

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
    models: Sequence[Model | RigModel],
    starts: Sequence[tuple[Floats, Floats]],
    common: Common,
    loops: Sequence[Closed] | None = None,
    *,
    observers: Sequence[Observer] | None = None,
    jobs: int = 1,
    width: int = LANES,
    switched: bool = False,
) -> tuple[Floats | list[Floats], Floats | list[Floats]]:
    """Run drives open loop or each under its loop, from `starts`: coordinates and speeds.

    Controllers of `loops` are of one function; `observers` of the same sensors and leaks, they
    follow what is measured. `jobs` are threads, −1 for one per core; else joblib's, on whatever
    backend is chosen. `width` is that of the lanes, 16 or 8; `switched` as of :func:`same_shape`.
    Returns arrays (columns, kept samples), and (4, summed) of the least, greatest, sum and sum of
    squares of what has statistics.
    """
    tasks: list[Any] = []
    for members, on, structure in same_shape([m.plant() for m in models], switched=switched):
        lane_engine(structure, width)
        for first in range(0, len(members), width):
            some = members[first : first + width]
            lists = (
                None if one is None else [one[k] for k in some]
                for one in (models, starts, loops, observers)
            )
            tasks.append((some, on, structure.switched, common.of(some), width, *lists))
    # threads: the loop does not hold the interpreter's lock
    alone = jobs == 1 or len(tasks) == 1
    done = (_lanes(*t) for t in tasks) if alone else each(_lanes, tasks, jobs, prefer="threads")
    if len(tasks) == 1:  # nothing to copy
        ((_, kept, found),) = done
        return kept, found
    outputs: list[Floats] = [np.empty(0)] * len(models)
    statistics = list(outputs)
    for some, kept, found in done:
        for k, out, sums in zip(some, kept, found, strict=True):
            outputs[k], statistics[k] = out, sums
    return outputs, statistics


def _lanes(
    some: list[int],
    on: Flags,
    switched: bool,
    common: Common,
    width: int,
    models: list[Model | RigModel],
    starts: list[tuple[Floats, Floats]],
    closers: list[Closed] | None,
    observers: list[Observer] | None,
) -> tuple[list[int], Floats, Floats]:
    """Run drives of one shape beside each other, as many as there are lanes at most."""
    plants = [model.plant() for model in models]
    structure = structure_of(plants[0]._replace(on=on), switched=switched)
    engine, rows = lane_engine(structure, width), rows_of(structure, width)
    laws, closed = [NOBODY] * width, closers is not None
    acting = np.bitwise_or.reduce([plant.on for plant in plants])
    if closers is not None:
        known = {id(one): one.controller() for one in closers}
        laws = [known[id(one)] for one in closers]
    h, lanes = common.dt / common.substeps, len(plants)
    table = aligned(len(rows.all) * width).reshape(-1, width)
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
    dead = np.stack([p.input_values[:, 1] / common.dt for p in padded], axis=-1)
    delays = np.stack([p.sensor_delay[p.sensor_delay > 0.0] for p in padded], axis=-1)
    ring = np.zeros((len(delays), int(delays.max(initial=0.0) / h) + 2, width))
    late_of, late_ratio = np.zeros(len(delays), np.int64), np.ones(delays.shape)
    for n, (b, speed, _) in enumerate(sensor for sensor in structure.sensors if sensor[2]):
        seen_row = rows.index[f"{'v' if speed else 'q'}{structure.bodies[b][0]}"]
        late_of[n], late_ratio[n] = seen_row, [p.body_ratio[b] for p in padded]
        ring[n] = table[seen_row] * late_ratio[n]
    room = int(np.ceil(dead.max(initial=0.0))) + 2
    inputs = len(structure.inputs)
    kept = np.zeros((width, inputs, room))
    last = observers[-1] if observers else NO_OBSERVER
    each = [*(observers or [NO_OBSERVER] * lanes), *[last] * (width - lanes)]
    gains = np.stack([o.gains for o in each], axis=-1)
    shown = np.stack([o.shown(p) for o, p in zip(each, padded, strict=True)], axis=-1)
    kept_samples = -(-common.samples // common.every) if common.columns else 0
    out = np.empty((lanes, len(common.columns), kept_samples))
    columns, summed = (
        np.array([rows.seen.index(name) for name in names], np.int64)
        for names in (common.columns, common.summed)
    )
    sensors = len(structure.sensors)
    torques = (columns >= sensors) & (columns < count - inputs)
    loops_of(width).march_lanes(
        table, lanes, *calls_of(structure, width, acting, bool(torques.any() or summed.size)),
        structure.coordinates, inputs, rows.index["u0"], rows.anew or bool(dead.any()),
        rows.index[rows.seen[0]], count,
        common.u, kept, np.zeros(inputs) if common.before is None else common.before, dead,
        bool(dead.any()), ring,
        delays, late_of, late_ratio, common.begin, common.dt,
        common.substeps, address_of(laws[0].function), np.array([law.rule for law in laws]),
        np.zeros((width, laws[0].memory)), common.target, common.noise, closed,
        np.zeros(sensors), np.zeros(inputs),
        each[0].sensors, common.measured, gains, shown, each[0].leak,
        np.zeros((each[0].leak.size, width)), np.zeros((2 * structure.coordinates, width)),
        columns, common.every, out, summed.size > 0, common.samples,
    )  # fmt: skip
    found = table[first : first + 4 * count].reshape(4, count, width)[:, summed, :lanes]
    return some, out, found.transpose(2, 0, 1)
