"""Many drives at once: 16 per vector loop, such groups over the cores."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.parallel import each
from dmptm_ctrl.simulate.compiled import (
    BODIES,
    OUTPUTS,
    SUBSTEPS,
    Loop,
    controller_of,
    march,
    rest,
)
from dmptm_ctrl.simulate.compose import engine
from dmptm_ctrl.simulate.dual import columns_seen, dual_plant, start
from dmptm_ctrl.simulate.lanes import LANES
from dmptm_ctrl.simulate.law import NO_LAWS, Law
from dmptm_ctrl.simulate.many import Common, run_many, same_shape
from dmptm_ctrl.simulate.model import Arrays, Floats, Model, stacked
from dmptm_ctrl.simulate.plant import Flags

BATCH_OUTPUTS = (*OUTPUTS, "u_left", "u_right")
_OPEN = 5  # numbers of a loop, all zero of a run that is open
# Drives left over by full groups, which one after another take the plain loop less than lanes of
# which most are empty: these take as long as four or five, however many are in them.
ALONE = 4
LINE = 8  # doubles in a cache line
_NO_ROWS = np.zeros((0, 0))
_NO_DRIVE = np.zeros((0, 2, 0))


class Batch(NamedTuple):
    """Runs of a batch.

    Attributes
    ----------
    time : (m,) array [s]
        Of the kept samples.
    outputs : (batch, len(labels), m) array
        SI, like :data:`BATCH_OUTPUTS`.
    labels : tuple of str
        Names of the kept outputs.
    least, greatest, mean, rms : (batch, 10) arrays
        Over all samples, of all :data:`BATCH_OUTPUTS`.
    """

    time: Floats
    outputs: Floats
    labels: tuple[str, ...]
    least: Floats
    greatest: Floats
    mean: Floats
    rms: Floats


class Task(NamedTuple):
    """What is the same for all lanes of a run."""

    dt: float  # s
    substeps: int
    samples: int
    inputs: Floats  # (k, 2, n) [V], or (0, 2, n) under the loop
    target: Floats  # (k, n) [rad/s]
    measured: Floats  # (k, n): angle for the observer, or noise of the loop's speed
    observer: Floats  # (3,) gains per sample, and steps while it leads
    extra: Floats  # (n, 3) or (0, 3) [N·m]
    columns: NDArray[np.int64]
    every: int
    statistics: bool
    design: Arrays | None = None  # of the controllers' model
    begin: float = 0.0  # s, time of the first sample

    def rows(self, group: slice) -> "Task":
        """What a group of the drives needs of it."""
        tables = {name: getattr(self, name) for name in ("inputs", "target", "measured")}
        return self._replace(**{n: t[group] for n, t in tables.items() if t.shape[0] > 1})


def _aligned(size: int) -> Floats:
    """Room that begins where a cache line does: no vector register's row lies in two of them."""
    room = np.empty(size + LINE - 1)
    first = -(room.__array_interface__["data"][0] // room.itemsize) % LINE
    return room[first : first + size]


def _lanes(
    task: Task,
    arrays: Sequence[Arrays],
    x0: Floats,
    loops: Floats,
) -> tuple[Floats, Floats]:
    """Run any number of drives, as many at once as there are lanes."""
    loop = engine()
    count = len(arrays)
    rows = stacked(arrays)
    room = _aligned(loop.VALUES + rows.values.shape[1] * loop.LANES)
    laws = NO_LAWS if task.design is None else loops
    kept = -(-task.samples // task.every) if task.columns.size else 0
    out = np.empty((count, task.columns.size, kept))
    stats = np.empty((4, loop.COLUMNS, count) if task.statistics else (0, 0, 0))
    loop.march_groups(
        *(task.inputs, task.target, task.measured, laws, task.design or arrays[0]),
        *(task.observer, task.extra, task.begin, task.dt, task.substeps),
        *(rows.base, rows.on, rows.values, x0, loops, room, task.columns, task.every, out, stats),
    )
    return out, stats


def _all(
    task: Task, arrays: Sequence[Arrays], x0: Floats, loops: Floats, n_jobs: int
) -> tuple[Floats, Floats]:
    """Run any number of drives in groups of lanes, on threads or joblib's backend."""
    size = engine().LANES
    if n_jobs == 1 or len(arrays) <= size:
        return _lanes(task, arrays, x0, loops)
    groups = [slice(k, k + size) for k in range(0, len(arrays), size)]
    parts = ((task.rows(g), arrays[g], x0[g], loops[g]) for g in groups)
    # threads: the loop does not hold the interpreter's lock
    done = list(each(_lanes, parts, n_jobs, prefer="threads"))
    outs, stats = zip(*done, strict=True)
    return np.concatenate(outs), np.concatenate(stats, axis=2)


def march_many(
    arrays: Sequence[Arrays],
    u: Floats,
    x0: Floats,
    dt: float,
    *,
    substeps: int = SUBSTEPS,
    observer: tuple[float, float] | None = None,
    measured: Floats | None = None,
    lead_substeps: int | None = None,
    extra: Floats | None = None,
    begin: float = 0.0,
    columns: Sequence[int] = range(len(OUTPUTS)),
    jobs: int = 1,
) -> Floats:
    """Run many drives open loop: :func:`~.compiled.march` for each of `arrays`, but faster.

    Parameters
    ----------
    arrays : sequence of what :meth:`Model.arrays` gives
    u : (2, n) or (batch, 2, n) array [V]
    x0 : (6,) or (batch, 6) array
    dt, substeps, observer, lead_substeps, extra, begin
        As for :func:`~.compiled.march`, the same for all.
    measured : (m,) or (batch, m) array [rad]
    columns : sequence of int
        Which of :data:`BATCH_OUTPUTS` to keep.
    jobs : int
        Threads.

    Returns
    -------
    (batch, n, len(columns)) array
        SI. The same scheme as `march`; rounding differs.
    """
    inputs = np.ascontiguousarray(u if u.ndim == 3 else u[None])
    task = Task(
        dt=dt,
        substeps=substeps,
        samples=inputs.shape[2],
        inputs=inputs,
        target=_NO_ROWS,
        measured=_NO_ROWS if measured is None else np.ascontiguousarray(np.atleast_2d(measured)),
        observer=np.array([*(observer or (0.0, 0.0)), lead_substeps or substeps]),
        extra=np.zeros((0, 3)) if extra is None else extra,
        columns=np.array(columns, np.int64),
        every=1,
        statistics=False,
        begin=begin,
    )
    count = len(arrays)
    starts = np.ascontiguousarray(np.broadcast_to(x0, (count, 6)), float)
    kept, _ = _all(task, arrays, starts, np.zeros((count, _OPEN)), jobs)
    return kept.transpose(0, 2, 1)


def march_any(
    arrays: Sequence[Arrays],
    u: Floats,
    x0: Floats,
    dt: float,
    *,
    measured: Floats | None = None,
    columns: Sequence[int] = range(len(OUTPUTS)),
    **options: Any,
) -> Floats:
    """Run any number of drives: :func:`march_many`, and one by one those that fill no lanes.

    Parameters
    ----------
    arrays, u, x0, dt, measured
        As for :func:`march_many`.
    columns : sequence of int
        Which of :data:`~.compiled.OUTPUTS` to keep.
    **options
        What both take: substeps, observer, lead_substeps, extra, begin.

    Returns
    -------
    (batch, n, len(columns)) array
        SI.
    """
    count = len(arrays)
    alone = count % engine().LANES
    if not 0 < alone <= ALONE:
        alone = 0
    inputs = u if u.ndim == 3 else u[None]
    angles = None if measured is None else np.atleast_2d(measured)
    starts = np.broadcast_to(x0, (count, 6))

    def of(rows: Floats, some: slice) -> Floats:
        return rows[some] if len(rows) > 1 else rows  # one for all

    def given(some: slice) -> tuple[Floats, Floats | None]:
        return of(inputs, some), None if angles is None else of(angles, some)

    together = count - alone
    out = np.empty((count, len(columns), inputs.shape[2]))
    if together:
        some = slice(together)
        volts, led = given(some)
        runs = march_many(
            arrays[some], volts, starts[some], dt, measured=led, columns=columns, **options
        )
        if not alone:
            return runs
        out[some] = runs.transpose(0, 2, 1)
    meshes = max(columns) >= BODIES
    for k in range(together, count):
        (volts,), led = given(slice(k, k + 1))
        lead = None if led is None else led[0]
        run = march(arrays[k], volts, starts[k], dt, measured=lead, meshes=meshes, **options)
        out[k] = run.T[[*columns]]
    return out.transpose(0, 2, 1)


def simulate_batch(
    models: Sequence[Model],
    timepts: ArrayLike,
    inputs: ArrayLike,
    initial_state: ArrayLike | None = None,
    *,
    loop: Loop | Law | Sequence[Loop] | Sequence[Law] | None = None,
    noise: ArrayLike | None = None,
    outputs: Sequence[str] = (),
    every: int = 1,
    substeps: int = SUBSTEPS,
    n_jobs: int = -1,
) -> Batch:
    """Run many drives, open loop or each under its speed loop.

    Parameters
    ----------
    models : sequence of Model
    timepts : (n,) array [s]
        Evenly spaced.
    inputs : (2, n) or (batch, 2, n) array [V]
        Left and right motor voltage; with `loop` the reference, (n,) or (batch, n) [rad/s].
    initial_state : (6,) or (batch, 6) array, optional
        As for :func:`~dmptm_ctrl.simulate.simulate`.
    loop : Loop, Law or sequence of either, optional
        One for all, or one for each.
    noise : (n,) or (batch, n) array [rad/s], optional
        Added to the speed that the loop sees.
    outputs : sequence of str
        Which of :data:`BATCH_OUTPUTS` to keep as signals. Without any the memory does not
        grow with time: only the statistics are kept.
    every : int
        Keep every so many samples.
    substeps : int
        Steps per sample.
    n_jobs : int
        Threads, −1 for one per core, 1 for none; else joblib's, so ``parallel_config`` can send
        the groups to another backend.

    Returns
    -------
    Batch

    Raises
    ------
    ValueError
        Nothing to run, shapes that do not fit, an output that does not exist.
    """
    from dmptm_ctrl.simulate import _timepts

    time = _timepts(timepts)
    n, count = time.size, len(models)
    if count == 0:
        raise ValueError("models is empty; needs at least one model")
    for name, number in (("every", every), ("substeps", substeps)):
        if int(number) != number or number < 1:
            raise ValueError(f"{name} is {number!r}; needs a whole number of at least 1")
    for name in outputs:
        if name not in BATCH_OUTPUTS:
            raise ValueError(f"no output {name!r}; there are {', '.join(BATCH_OUTPUTS)}")
    drive, target = np.zeros((1, 2, 0)), np.zeros((1, 1))
    measured = _NO_ROWS
    loops: list[Loop | Law] | None = None
    if loop is None:
        drive = _rows("inputs", inputs, count, (2, n))
    else:
        target = _rows("inputs", inputs, count, (n,))
        if noise is not None:
            measured = _rows("noise", noise, count, (n,))
        loops = _loops(loop, count)
    if initial_state is None:
        states = np.array([rest(model, 0.0) for model in models])
    else:
        rows = _rows("initial_state", initial_state, count, (6,))
        states = np.broadcast_to(rows, (count, 6))
    arrays = [model.arrays() for model in models]
    plants = [dual_plant(own) for own in arrays]
    kept: list[Floats] = [np.empty(0)] * count
    found: list[Floats] = [np.empty(0)] * count
    tasks: list[tuple[Any, ...]] = []
    wanted = [BATCH_OUTPUTS.index(name) for name in outputs]
    dt = (time[-1] - time[0]) / (n - 1)
    whole = Common(dt, substeps, n, drive, target, measured, np.array(wanted, np.int64), every)
    for members, acting, _ in same_shape(plants):
        for first in range(0, len(members), LANES):
            some = members[first : first + LANES]
            own = None if loops is None else [loops[k] for k in some]
            tasks.append(
                (some, [arrays[k] for k in some], states[some], whole.of(some), own, acting)
            )
    # threads: the loop does not hold the interpreter's lock
    alone = n_jobs == 1 or len(tasks) == 1
    done = (
        (_group(*task) for task in tasks)
        if alone
        else each(_group, tasks, n_jobs, prefer="threads")
    )
    for some, runs, statistics in done:
        for k, out, stats in zip(some, runs, statistics, strict=True):
            kept[k], found[k] = out, stats
    least, greatest, total, squares = np.array(found).transpose(1, 0, 2)
    return Batch(
        time[::every] if outputs else time[:0],
        np.array(kept),
        tuple(outputs),
        least,
        greatest,
        total / n,
        np.sqrt(squares / n),
    )


def _group(
    some: list[int],
    arrays: list[Arrays],
    states: Floats,
    common: Common,
    loops: list[Loop | Law] | None,
    acting: Flags,
) -> tuple[list[int], list[Floats], list[Floats]]:
    """Run drives of one shape, on whatever thread or machine."""
    plants = [dual_plant(own) for own in arrays]
    # where compliant reducers are links too, the outputs are elsewhere among what is seen
    seen = np.array(columns_seen(plants[0]))
    common = common._replace(columns=seen[common.columns])
    starts = [start(plant, x0) for plant, x0 in zip(plants, states, strict=True)]
    controllers = None
    if loops is not None:
        known = {id(one): controller_of(one) for one in loops}
        controllers = [known[id(one)] for one in loops]
    runs, stats = run_many(plants, starts, common, controllers, acting=acting)
    return some, runs, [table[:, seen] for table in stats]


def _loops(loop: Loop | Law | Sequence[Loop] | Sequence[Law], count: int) -> list[Loop | Law]:
    each: list[Loop | Law] = [loop] * count if isinstance(loop, Loop | Law) else list(loop)
    if len(each) != count:
        raise ValueError(f"loop has {len(each)} entries for {count} models")
    if len({isinstance(one, Law) for one in each}) > 1:
        raise ValueError("loop mixes Loop and Law; give one kind")
    return each


def _rows(name: str, values: ArrayLike, count: int, shape: tuple[int, ...]) -> Floats:
    """Return (1 or batch, *shape), finite."""
    array = np.array(values, float)
    if array.shape == shape:
        array = array[None]
    if array.shape[1:] != shape or array.shape[0] not in (1, count):
        raise ValueError(
            f"{name} has shape {np.shape(values)}; needs {shape}, or {(count, *shape)} for "
            f"{count} models"
        )
    if not np.all(np.isfinite(array)):
        raise ValueError(f"{name} holds a value that is not finite")
    return array
