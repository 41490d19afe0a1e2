"""The loop over lanes of a structure: sixteen drives a step, as vector code."""

from functools import cached_property
from itertools import compress, groupby
from typing import Any

import numpy as np
from numba import float64, types

from dmptm_ctrl.simulate.elementary import COMPILED, FAST, compiled_callback
from dmptm_ctrl.simulate.generate import (
    Engine,
    Names,
    compiled,
    engine_by,
    head_text,
    reading_lines,
    sensed,
    step_lines,
    torque_lines,
)
from dmptm_ctrl.simulate.loading import LOADING
from dmptm_ctrl.simulate.plant import Flags, Floats, Ints, Structure
from dmptm_ctrl.simulate.segments import Segment, segments

LANES = 16
LINE = 8  # doubles in a cache line


class Rows:
    """Rows of the work array, each as wide as the lanes: where each name of a step is."""

    def __init__(self, s: Structure, width: int = LANES) -> None:
        names = Names(s, rows=True)
        self.width = width
        late = [f"late{i}" for i, sensor in enumerate(s.sensors) if sensor[2]]
        links, sensors, inputs = (range(len(part)) for part in (s.links, s.sensors, s.inputs))
        # readings, torques and twists of links, signals of inputs
        self.readings = [f"reading{i}" for i in sensors]
        torques = [f"{x}{k}" for x in ("torque", "twist") for k in links]
        self.seen = [*self.readings, *torques, *(f"signal{j}" for j in inputs)]
        self.statistics = [
            f"{x}_{name}" for x in ("low", "top", "sum", "square") for name in self.seen
        ]
        given = [*names.state, *names.signals, *names.numbers, *late]
        self.step = segments(step_lines(s, rows=True), given, names.state)
        self.observed, self.links = (
            segments([*lines, *(f"    {a} = {b}" for a, b in zip(kept, found, strict=True))],
                     given, kept)
            for (lines, found), kept in (
                (reading_lines(s, rows=True), self.readings),
                (torque_lines(s, rows=True), torques),
            )
        )  # fmt: skip
        own = [name for part in (self.step, self.observed, self.links) for one in part
               for name in (*one.takes, *one.leaves)]  # fmt: skip
        self.all = list(dict.fromkeys([*given, *self.seen, *self.statistics, *own]))
        self.index = {name: i for i, name in enumerate(self.all)}
        self.state, self.numbers = names.state, names.numbers

    def at(self, name: str) -> str:
        """Text of a name in the loop over lanes."""
        return f"w[{self.index[name] * self.width} + lane]"

    def first(self, name: str) -> int:
        """Where the row of a name begins."""
        return self.index[name] * self.width

    def functions(self) -> str:
        """Text of the loops over lanes, each a function."""
        return "".join(
            part.function(f"{name}_{i}", self.at)
            for name in ("step", "observed", "links")
            for i, part in enumerate(getattr(self, name))
        )

    def calls(self, name: str, indent: int) -> str:
        """Text that calls those of the step, of what is observed, or of the links."""
        parts: list[Segment] = getattr(self, name)
        lines: list[str] = []
        numbers = {one: n for n, one in enumerate(self.apart)}
        for apart, group in groupby(enumerate(parts), lambda one: bool(one[1].flags)):
            own = [(f"{name}_{i}", part) for i, part in group]
            if apart:
                first = numbers[own[0][0]]
                lines += [
                    f"for n in range(ends[{first}], ends[{first + len(own)}]):",
                    "    called_at(calls[n], (w, t, h))",
                ]
            else:
                lines += [part.call(one, self.first) for one, part in own]
        return "".join(f"{' ' * indent}{line}\n" for line in lines)

    @cached_property
    def apart(self) -> dict[str, list[int]]:
        """Loops of effects, and the flags of which one has to be up for each."""
        return {
            f"{name}_{i}": part.flags
            for name in ("step", "observed", "links")
            for i, part in enumerate(getattr(self, name))
            if part.flags
        }


_ROWS: dict[tuple[int, int], Rows] = {}


def rows_of(s: Structure, width: int = LANES) -> Rows:
    """Return the rows of a structure, which `structure_of` gave; found once."""
    key = id(s), width
    if key not in _ROWS:
        _ROWS[key] = Rows(s, width)
    return _ROWS[key]


def lanes_text(s: Structure, width: int) -> str:
    """Text of the loop."""
    rows = rows_of(s, width)
    late = [i for i, sensor in enumerate(s.sensors) if sensor[2]]
    sensors, inputs = len(s.sensors), len(s.inputs)
    read_late = "".join(
        f"        for lane in range(LANES):\n            {rows.at(f'late{i}')} = "
        f"read_lane(ring, {n}, done, delays[{n}, lane] / h, lane)\n"
        for n, i in enumerate(late)
    )
    keep_late, move_late = "", ""
    for n, i in enumerate(late):
        ratio, signal = sensed(s, i)
        lever = f"{rows.at(ratio)} * " if ratio else ""
        keep_late += "            for lane in range(LANES):\n"
        keep_late += f"                ring[{n}, done % ring.shape[1], lane] = "
        keep_late += f"{lever}{rows.at(signal)}\n"
        if not s.sensors[i][1]:
            move_late += "            for lane in range(LANES):\n"
            move_late += "                for back in range(ring.shape[1]):\n"
            move_late += f"                    ring[{n}, back, lane] += "
            move_late += f"{lever}moves[{signal[1:]}, lane]\n"
    kinds = ("low", "top", "sum", "square")
    seen, low, top, total, square = (
        f"w[{rows.first(f'{kind}{rows.seen[0]}')} + lane]"
        for kind in ("", *(f"{k}_" for k in kinds))
    )
    base = {part: rows.first(part) for part in ("reading0", "signal0", "u0", "q0", "v0", "p0")}
    push = "".join(
        f"            {rows.at(f'push{g}')} = push[i, {g}] if pushed else 0.0\n"
        for g in range(s.coordinates)
    )
    return f"""\
@njit
def some(w, first):
    found = 0
    for lane in range(LANES):
        found |= w[first + lane] > 0.0
    return found > 0


{rows.functions()}\
@njit
def read_lane(ring, row, step, lag, lane):
    back = int(lag)
    newer = ring[row, (step - back) % ring.shape[1], lane]
    older = ring[row, (step - back - 1) % ring.shape[1], lane]
    return newer + (lag - back) * (older - newer)


@njit
def march_lanes(
    w, lanes, calls, ends, u, kept, before, dead, push, ring, delays, begin, dt, substeps,
    control, rules, memory, target, noise, closed, y, command,
    watched, measured, gains, shown, leak, lead, moves,
    columns, every, out, statistics, samples,
):
    wide()
    w, calls, ends, kept = borrowed(w), borrowed(calls), borrowed(ends), borrowed(kept)
    rules, memory = borrowed(rules), borrowed(memory)
    y, command, moves = borrowed(y), borrowed(command), borrowed(moves)
    measured, gains = borrowed(measured), borrowed(gains)
    watched, shown, leak, lead = borrowed(watched), borrowed(shown), borrowed(leak), borrowed(lead)
    read = w[{base["reading0"]} : {base["reading0"] + sensors * width}].reshape(({sensors}, LANES))
    h = dt / substeps
    pushed = push.shape[0] > 0
    late = False
    for lane in range(LANES):
        for j in range({inputs}):
            late = late or dead[j, lane] > 0.0
    links = statistics
    for c in columns:
        links = links or {sensors} <= c < {sensors + 2 * len(s.links)}
    room = kept.shape[2]
    done = 0
    for i in range(samples):
        now = begin + i * dt
        t = now
{read_late}{rows.calls("observed", 8)}\
        if links:
{rows.calls("links", 12) or "            pass" + chr(10)}\
        if watched.size > 0:
            observed(i, read, watched, measured, gains, shown, leak, lead, moves)
            for g in range({s.coordinates}):
                for lane in range(LANES):
                    w[{base["q0"]} + g * LANES + lane] += moves[g, lane]
                    moving = w[{base["v0"]} + g * LANES + lane] != 0.0
                    kick = moves[{s.coordinates} + g, lane] if moving else 0.0
                    w[{base["v0"]} + g * LANES + lane] += kick
                    w[{base["p0"]} + g * LANES + lane] += kick
{move_late}\
        for lane in range(lanes):
            if closed:
                for k in range({sensors}):
                    y[k] = w[{base["reading0"]} + k * LANES + lane]
                own = lane if target.shape[0] > 1 else 0
                other = lane if noise.shape[0] > 1 else 0
                added = noise[other, i] if noise.size > 0 else 0.0
                called_at(
                    control,
                    (i, now, dt, target[own, i], added, y, rules[lane], memory[lane], command),
                )
            else:
                own = lane if u.shape[0] > 1 else 0
                for j in range({inputs}):
                    command[j] = u[own, j, i]
            for j in range({inputs}):
                if late:
                    kept[lane, j, i % room] = command[j]
                w[{base["signal0"]} + j * LANES + lane] = command[j]
        if statistics:
            for lane in range({len(rows.seen)} * LANES):
                {low} = min({low}, {seen})
                {top} = max({top}, {seen})
                {total} += {seen}
                {square} += {seen} * {seen}
        if i % every == 0:
            for c in range(columns.size):
                for lane in range(lanes):
                    out[lane, c, i // every] = w[{base["reading0"]} + columns[c] * LANES + lane]
        for lane in range(LANES):
{push}        for k in range(substeps):
            t = now + (k + 0.5) * h
            for lane in range({inputs} * LANES):
                w[{base["u0"]} + lane] = w[{base["signal0"]} + lane]
            if late:
                for lane in range(lanes):
                    for j in range({inputs}):
                        begins = i + k / substeps - dead[j, lane]
                        w[{base["u0"]} + j * LANES + lane] = held_average(
                            kept[lane], j, begins, begins + 1.0 / substeps, before
                        )
{rows.calls("step", 12)}\
            done += 1
{keep_late}    return done
"""


def source(s: Structure, width: int) -> str:
    """Return the text of the engine over lanes of a structure."""
    text = "\n\n".join([head_text(s, rows=True), f"LANES = {width}\n", lanes_text(s, width)])
    return compiled(text, "march_lanes")


def lane_engine(s: Structure, width: int = LANES) -> Engine:
    """Return the compiled loop over lanes of a structure, which `structure_of` gave."""
    return engine_by(s, f"lanes{width}", lambda s: source(s, width))


_PART = types.void(types.CPointer(float64), float64, float64)
_PARTS: dict[tuple[str, str], Any] = {}


def calls_of(s: Structure, width: int, on: Flags) -> tuple[Any, Ints]:
    """Addresses of the loops of effects that act, and how many come before each loop there is.

    They are compiled when they are asked for.
    """
    module, found = lane_engine(s, width).module, []
    acts = [bool(on[flags].any()) for flags in rows_of(s, width).apart.values()]
    for name in compress(rows_of(s, width).apart, acts):
        with LOADING:
            key = module.__name__, name
            if key not in _PARTS:
                _PARTS[key] = compiled_callback(
                    _PART, getattr(module, name), cache=True, error_model="numpy", fastmath=FAST
                )
            found.append(getattr(_PARTS[key], "address", _PARTS[key]))
    return np.array(found, np.int64 if COMPILED else object), np.cumsum([0, *acts])


def aligned(size: int) -> Floats:
    """Room that begins where a cache line does: no vector register's row lies in two of them."""
    room = np.zeros(size + LINE - 1)
    first = -(room.__array_interface__["data"][0] // room.itemsize) % LINE
    return room[first : first + size]


__all__ = ["LANES", "Rows", "aligned", "calls_of", "lane_engine", "rows_of"]
