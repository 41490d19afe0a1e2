"""The loop over lanes of a structure: sixteen drives a step, as vector code."""

import numpy as np

from dmptm_ctrl.simulate.generate import (
    Engine,
    Names,
    compiled,
    engine_by,
    head_text,
    observe_text,
    sensed,
    step_text,
)
from dmptm_ctrl.simulate.plant import Floats, Structure

LANES = 16
LINE = 8  # doubles in a cache line


class Rows:
    """Rows of the work array, each as wide as the lanes: where each name of a step is."""

    def __init__(self, s: Structure, width: int = LANES) -> None:
        names = Names(s)
        self.width = width
        self.late = [f"late{i}" for i, sensor in enumerate(s.sensors) if sensor[2]]
        links, sensors, inputs = (range(len(part)) for part in (s.links, s.sensors, s.inputs))
        # readings, torques and twists of links, signals of inputs
        self.seen = [f"reading{i}" for i in sensors] + [f"torque{k}" for k in links]
        self.seen += [f"twist{k}" for k in links] + [f"signal{j}" for j in inputs]
        self.statistics = [
            f"{x}_{name}" for x in ("low", "top", "sum", "square") for name in self.seen
        ]
        self.all = [*names.state, *names.signals, *names.numbers, *self.late, "nothing", *self.seen]
        self.all += self.statistics
        self.index = {name: i for i, name in enumerate(self.all)}
        self.state, self.numbers = names.state, names.numbers

    def at(self, name: str) -> str:
        """Text of a name in the loop over lanes."""
        return f"w[{self.index[name] * self.width} + lane]"


def lanes_text(s: Structure, width: int) -> str:
    """Text of the loop."""
    names, rows = Names(s), Rows(s, width)
    late = [i for i, sensor in enumerate(s.sensors) if sensor[2]]
    links, sensors, inputs = len(s.links), len(s.sensors), len(s.inputs)
    given = [n if n in ("t", "h") else rows.at(n) for n in names.arguments]
    given[names.arguments.index("t")] = "middle"
    plain = [*names.state, "t", *names.numbers]
    observed = [*names.state, *rows.late, *plain[len(names.state) :]]
    sensed_ = [f"reading{i}" for i in range(sensors)] or ["nothing"]
    torques = [f"{x}{k}" for x in ("torque", "twist") for k in range(links)] or ["nothing"]

    def row(found: list[str]) -> str:
        return ", ".join(n if n == "t" else rows.at(n) for n in found)

    read_late = "".join(
        f"        for lane in range(LANES):\n            {rows.at(f'late{i}')} = "
        f"read_lane(ring, {n}, done, delays[{n}, lane] / h, lane)\n"
        for n, i in enumerate(late)
    )
    keep_late = ""
    for n, i in enumerate(late):
        ratio, signal = sensed(s, i)
        value = (f"{rows.at(ratio)} * " if ratio else "") + rows.at(signal)
        keep_late += "            for lane in range(LANES):\n"
        keep_late += f"                ring[{n}, done % ring.shape[1], lane] = {value}\n"
    statistics = ""
    for name in rows.seen:
        x = rows.at(name)
        low, top, total, square = (rows.at(f"{a}_{name}") for a in ("low", "top", "sum", "square"))
        statistics += (
            f"                {low} = min({low}, {x})\n                {top} = max({top}, {x})\n"
            f"                {total} += {x}\n                {square} += {x} * {x}\n"
        )
    base = {part: rows.index[part] * width for part in ("reading0", "signal0", "u0")}
    push = "".join(
        f"            {rows.at(f'push{g}')} = push[i, {g}] if pushed else 0.0\n"
        for g in range(s.coordinates)
    )
    return f"""\
@njit
def read_lane(ring, row, step, lag, lane):
    back = int(lag)
    newer = ring[row, (step - back) % ring.shape[1], lane]
    older = ring[row, (step - back - 1) % ring.shape[1], lane]
    return newer + (lag - back) * (older - newer)


@njit
def march_lanes(
    w, lanes, u, kept, before, dead, push, ring, delays, begin, dt, substeps,
    control, rules, memory, target, noise, closed, y, command, columns, every, out, statistics,
    samples,
):
    wide()
    w, kept, rules, memory = borrowed(w), borrowed(kept), borrowed(rules), borrowed(memory)
    y, command = borrowed(y), borrowed(command)
    h = dt / substeps
    pushed = push.shape[0] > 0
    late = False
    for lane in range(LANES):
        for j in range({inputs}):
            late = late or dead[j, lane] > 0.0
    room = kept.shape[2]
    done = 0
    for i in range(samples):
        t = begin + i * dt
{read_late}        for lane in range(LANES):
            {row(sensed_)}, = readings({row(observed)})
        if statistics or columns.size > 0:
            for lane in range(LANES):
                {row(torques)}, = torques({row(plain)})
        for lane in range(lanes):
            if closed:
                for k in range({sensors}):
                    y[k] = w[{base["reading0"]} + k * LANES + lane]
                own = lane if target.shape[0] > 1 else 0
                other = lane if noise.shape[0] > 1 else 0
                added = noise[other, i] if noise.size > 0 else 0.0
                control(i, t, dt, target[own, i], added, y, rules[lane], memory[lane], command)
            else:
                own = lane if u.shape[0] > 1 else 0
                for j in range({inputs}):
                    command[j] = u[own, j, i]
            for j in range({inputs}):
                if late:
                    kept[lane, j, i % room] = command[j]
                w[{base["signal0"]} + j * LANES + lane] = command[j]
                w[{base["u0"]} + j * LANES + lane] = command[j]
        if statistics:
            for lane in range(LANES):
{statistics}
        if i % every == 0:
            for c in range(columns.size):
                for lane in range(lanes):
                    out[lane, c, i // every] = w[{base["reading0"]} + columns[c] * LANES + lane]
        for lane in range(LANES):
{push}        for k in range(substeps):
            middle = t + (k + 0.5) * h
            if late:
                for lane in range(lanes):
                    for j in range({inputs}):
                        begins = i + k / substeps - dead[j, lane]
                        w[{base["u0"]} + j * LANES + lane] = held_average(
                            kept[lane], j, begins, begins + 1.0 / substeps, before
                        )
            for lane in range(LANES):
                {row(names.state)}, = step({", ".join(given)})
            done += 1
{keep_late}    return done
"""


def source(s: Structure, width: int) -> str:
    """Return the text of the engine over lanes of a structure."""
    parts = [head_text(s), f"LANES = {width}\n", observe_text(s), step_text(s)]
    return compiled("\n\n".join([*parts, lanes_text(s, width)]), "march_lanes")


def lane_engine(s: Structure, width: int = LANES) -> Engine:
    """Return the compiled loop over lanes of a structure, which `structure_of` gave."""
    return engine_by(s, f"lanes{width}", lambda s: source(s, width))


def aligned(size: int) -> Floats:
    """Room that begins where a cache line does: no vector register's row lies in two of them."""
    room = np.zeros(size + LINE - 1)
    first = -(room.__array_interface__["data"][0] // room.itemsize) % LINE
    return room[first : first + size]


__all__ = ["LANES", "Rows", "aligned", "lane_engine"]
