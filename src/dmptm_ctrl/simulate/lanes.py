"""Loops over lanes of a structure: sixteen drives a step, as vector code."""

from typing import Any

import numpy as np
from numba import float64, types

from dmptm_ctrl.simulate.elementary import COMPILED
from dmptm_ctrl.simulate.generate import (
    Engine,
    Names,
    called_of,
    engine_by,
    head_text,
    reading_lines,
    step_lines,
    torque_lines,
)
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
        # whether a step changes signals, which the next one needs as they were
        self.anew = any(name in names.signals for one in self.step for name in one.leaves)

    def at(self, name: str) -> str:
        """Text of a name in the loop over lanes."""
        return f"w[{self.index[name] * self.width} + lane]"

    @property
    def parts(self) -> list[tuple[str, Segment]]:
        """Loops over lanes by the names of their functions."""
        return [
            (f"{name}_{i}", part)
            for name in ("step", "observed", "links")
            for i, part in enumerate(getattr(self, name))
        ]


_ROWS: dict[tuple[int, int], Rows] = {}


def rows_of(s: Structure, width: int = LANES) -> Rows:
    """Return the rows of a structure, which `structure_of` gave; found once."""
    key = id(s), width
    if key not in _ROWS:
        _ROWS[key] = Rows(s, width)
    return _ROWS[key]


def source(s: Structure, width: int) -> str:
    """Return the text of the loops over lanes of a structure, each a function."""
    rows = rows_of(s, width)
    functions = [part.function(name, rows.at) for name, part in rows.parts]
    return "\n\n".join([head_text(s, rows=True), f"LANES = {width}\n", *functions])


def lane_engine(s: Structure, width: int = LANES) -> Engine:
    """Return the loops over lanes of a structure, which `structure_of` gave."""
    return engine_by(s, f"lanes{width}", lambda s: source(s, width))


_PART = types.void(types.CPointer(float64), float64, float64)


def calls_of(s: Structure, width: int, on: Flags, links: bool) -> tuple[Any, Ints, int]:
    """Return what `loops.march_lanes` calls, when, and how many of it are of a step.

    Loops of effects that do not act are left out, those of links where nobody asks for them. They
    are compiled when they are asked for.
    """
    module, rows = lane_engine(s, width).module, rows_of(s, width)
    parts = [
        (name, part)
        for name, part in rows.parts
        if (not part.flags or on[part.flags].any()) and (links or not name.startswith("links"))
    ]
    found = [called_of(module, name, _PART) for name, _ in parts]
    when = [rows.index[part.row] if part.row else -1 for _, part in parts]
    steps = sum(name.startswith("step") for name, _ in parts)
    return np.array(found, np.int64 if COMPILED else object), np.array(when, np.int64), steps


def aligned(size: int) -> Floats:
    """Room that begins where a cache line does: no vector register's row lies in two of them."""
    room = np.zeros(size + LINE - 1)
    first = -(room.__array_interface__["data"][0] // room.itemsize) % LINE
    return room[first : first + size]
