"""Run a plant: the scalar loop, its state, and what closes the loop."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, types

from dmptm_ctrl.simulate.elementary import address_of, compiled_callback, table_of
from dmptm_ctrl.simulate.loading import loops
from dmptm_ctrl.simulate.observer import NO_OBSERVER, Observer
from dmptm_ctrl.simulate.plant import NO_ROWS, Floats, Ints, Plant, Structure, numbers, structure_of
from dmptm_ctrl.simulate.scalar import advance_of, scalar_engine
from dmptm_ctrl.simulate.sites import acting

_ROW = types.CPointer(float64)
SIGNATURE = types.void(int64, *[float64] * 4, *[_ROW] * 4)
_NOTHING, _NONE = np.zeros(1), np.zeros(0)


class Controller(NamedTuple):
    """A sampled controller as the compiled loop calls it.

    Its `function`, compiled for SIGNATURE, ``f(i, t, dt, target, noise, y, rule, memory, u)``,
    writes the signals of the inputs into `u`; `y` are the readings of the sensors.
    """

    function: Any
    rule: Floats  # (m,), its numbers
    memory: int  # room that it keeps from sample to sample


def compiled_controller(function: Callable[..., None], *, cache: bool = False) -> Any:
    """Compile a controller so that any loop can call it; `cache` it where there is a place."""
    return compiled_callback(SIGNATURE, function, cache=cache)


@partial(compiled_controller, cache=True)
def _open(i, t, dt, target, noise, y, rule, memory, u):
    """Leave the inputs as they are."""


NOBODY = Controller(_open, _NOTHING, 1)


@dataclass(frozen=True)
class State:
    """State from which a run continues."""

    names: tuple[str, ...]
    # by `names`: coordinates q, their speeds v, those one step before p, and what meshes, lags,
    # bristles and contacts remember
    values: Floats
    time: float = 0.0  # s
    memory: Floats = field(default_factory=lambda: np.zeros(0))  # of the controller
    # (inputs, j), the latest, as many as dead times need; and (delayed sensors, j) of late readings
    signals: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    late: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    steps: int = 0
    # how far an observer has it ahead of what readings show
    lead: Floats = field(default_factory=lambda: np.zeros(0))

    def __getitem__(self, name: str) -> float:
        return float(self.values[self.names.index(name)])


class Motion(NamedTuple):
    """Samples of a run."""

    u: Floats  # (inputs, n), as a controller gave them
    # (n, columns): readings of sensors, torques of links at their first bodies, twists of links,
    # coordinates, their speeds; or the first of these columns
    rows: Floats
    size: tuple[int, int, int, int, int]  # of the plant
    state: State  # at the end of the last sample's interval, to continue from

    def _part(self, first: int, count: int) -> Floats:
        return self.rows[:, first : first + count]

    @property
    def readings(self) -> Floats:
        """(n, sensors) array."""
        return self._part(0, self.size[4])

    @property
    def links(self) -> Floats:
        """Torques, (n, links) array."""
        return self._part(self.size[4], self.size[2])

    @property
    def q(self) -> Floats:
        """Coordinates, (n, coordinates) array."""
        return self._part(self.size[4] + 2 * self.size[2], self.size[0])

    @property
    def v(self) -> Floats:
        """Their speeds, (n, coordinates) array."""
        return self._part(self.size[4] + 2 * self.size[2] + self.size[0], self.size[0])


def start_state(structure: Structure, q: Floats, v: Floats) -> State:
    """Return the state at given coordinates and speeds."""
    names = scalar_engine(structure).names
    values = np.array(names.start)
    count = structure.coordinates
    values[:count], values[count : 2 * count], values[2 * count : 3 * count] = q, v, v
    return State(tuple(names.state), values)


def structure_for(plant: Plant) -> Structure:
    """Structure that a scalar run of a plant takes: bare, or what has all that effects may ask."""
    asked = plant.on, plant.bristles[:, 0], plant.sensor_delay, plant.input_values[:, 2]
    any_ = any(np.any(part) for part in asked) or bool(plant.given)
    return structure_of(plant, switched=any_, either=any_)


def advance(
    plant: Plant,
    state: State,
    u: Floats,
    dt: float,
    substeps: int,
    *,
    structure: Structure | None = None,
    before: Floats | None = None,
    push: Floats | None = None,
    given: tuple[Floats, Floats] = (NO_ROWS, NO_ROWS),
    controller: Controller | None = None,
    target: Floats | None = None,
    noise: Floats | None = None,
    observer: Observer | None = None,
    measured: Floats | None = None,
    columns: int | None = None,
) -> Motion:
    """Run a plant from a state, as `start_state` or an earlier run gave it.

    `u` (inputs, n) is held from each sample of `dt` seconds to the next, of so many `substeps`;
    under a `controller`, with its `target` and `noise` (n,), its values do not matter. What the
    noise is added to is the controller's choice. `before` (inputs,) is what the inputs were
    before the run, for dead times; 0. `push` (n, coordinates) are torques added. `given` are
    positions and speeds (given coordinates, n) where motion is prescribed. An `observer` leads the
    run by what its sensors `measured` (m, n); a run from the state at the end is free. `columns`
    is how many of `Motion.rows` are wanted; all.
    """
    structure = structure or structure_for(plant)
    h, n = dt / substeps, u.shape[1]
    dead = plant.input_values[:, 1] / dt
    kept = state.signals.shape[1]
    signals = np.hstack([state.signals, u]) if kept else np.asarray(u, float)
    if controller is not None or not signals.flags.c_contiguous or not signals.flags.writeable:
        signals = np.array(signals, order="C")
    delays = plant.sensor_delay[[late for *_, late in structure.sensors]]
    ring = np.array(state.late)
    x = np.array(state.values)
    late_of, late_ratio = late_parts(plant, structure)
    if ring.size == 0 and delays.size:  # before the run: as at its start
        length = int(delays.max() / h) + 2
        ring = np.repeat((late_ratio * x[late_of])[:, None], length, axis=1)
    law = NOBODY if controller is None else controller
    memory = np.array(state.memory) if state.memory.size else np.zeros(law.memory)
    count, _, links, inputs, sensors = plant.size
    whole = sensors + 2 * links + 2 * count
    observer = NO_OBSERVER if observer is None else observer
    size = observer.leak.size
    lead = np.array(state.lead) if state.lead.size == size else np.zeros(size)
    out = np.empty((n, whole if columns is None else columns))
    engine = scalar_engine(structure)
    acts, posts, sites = acting(structure, plant)
    own = numbers(plant, engine.names.numbers, h)
    effects = plant.on, plant.values, acts, sites, posts, np.zeros(4)
    width, lates = len(engine.names.signals), delays.size
    rows, now, latest = (np.zeros(size) for size in (substeps * width, lates, substeps * lates))
    y, late = np.zeros(sensors + 2 * links), bool(delays.any())
    loops().march(
        advance_of(structure), table_of(x, own, *effects, rows, now, latest, y), x, count,
        rows, width if dead.any() or plant.given else 0, now, latest, lates if late else 0,
        sensors, y, y[:, None], late or bool(plant.given), signals, kept,
        np.zeros(inputs) if before is None else np.array(before, float), dead,
        NO_ROWS if push is None else np.ascontiguousarray(push, float),
        np.array(plant.given, np.int64), *(np.ascontiguousarray(g, float) for g in given),
        ring, delays, late_of, late_ratio, state.steps, state.time,
        dt, substeps, address_of(law.function), law.rule, memory,
        _NONE if target is None else np.array(target, float),
        _NONE if noise is None else np.array(noise, float),
        controller is not None, np.zeros(inputs), observer.sensors,
        np.zeros((0, 0, 0)) if measured is None else own_rows(measured)[None],
        np.ascontiguousarray(observer.gains)[..., None], observer.shown(plant)[..., None],
        observer.leak, lead[:, None], np.zeros((2 * count, 1)), out,
    )  # fmt: skip
    used = int(np.ceil(dead.max(initial=0.0))) + 1 if dead.any() else 0
    after = replace(
        state, values=x, time=state.time + n * dt, memory=memory, late=ring,
        steps=state.steps + n * substeps, signals=signals[:, max(signals.shape[1] - used, 0) :],
        lead=lead,
    )  # fmt: skip
    if not used:
        after = replace(after, signals=np.zeros((inputs, 0)))
    return Motion(signals[:, kept:], out, plant.size, after)


def own_rows(values: Floats) -> Floats:
    """Rows in one piece that may be written to: of another kind the engine compiles anew."""
    return np.require(np.atleast_2d(values), np.float64, ["C", "W"])


def advance_by(
    plant: Plant,
    state: State,
    law: Callable[[float, float, Floats], Any],
    target: Floats,
    dt: float,
    substeps: int,
    *,
    push: Floats | None = None,
) -> Motion:
    """Run a plant under a law in Python, ``law(t, target, y)``, one sample after the other.

    See :func:`advance`; `y` are the readings of the sensors.
    """
    structure = structure_for(plant)
    n, (count, _, links, inputs, sensors) = len(target), plant.size
    nothing = np.zeros((inputs, 1))
    u = np.empty((inputs, n))
    out = np.empty((n, sensors + 2 * links + 2 * count))
    for i in range(n):
        pushed = None if push is None else push[i : i + 1]
        # readings are those before the sample's own signals act
        ahead = partial(advance, plant, structure=structure, push=pushed)
        seen = ahead(state, nothing, dt, 1, columns=sensors)
        u[:, i] = law(state.time, float(target[i]), seen.rows[0])
        done = ahead(state, u[:, i : i + 1], dt, substeps)
        out[i], state = done.rows[0], done.state
    return Motion(u, out, plant.size, state)


def late_parts(plant: Plant, structure: Structure) -> tuple[Ints, Floats]:
    """Return the numbers of the state that late sensors see, and their ratios to those."""
    own = [i for i, (_, _, late) in enumerate(structure.sensors) if late]
    bodies = plant.sensor_body[own]
    fast = structure.coordinates * (plant.sensor_speed[own] > 0)
    return plant.body_coordinate[bodies] + fast, plant.body_ratio[bodies]
