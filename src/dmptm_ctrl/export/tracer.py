"""Names and cells of a calculation that is being traced, and the statements that are left."""

from collections.abc import Mapping
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.export import program as ir
from dmptm_ctrl.export.reserved import RESERVED


class NotScalar(ValueError):
    """Source that is more than scalar arithmetic, branches and loops."""


class Cells:
    """Numbers kept apart, each read and written at a known place."""

    def __init__(self, values: Any, names: Mapping[int, str] | None = None) -> None:
        self.start = list(values)
        self.size = len(self.start)
        self.names = names or {}


class Ring(NamedTuple):
    """The last `array.size` samples of a signal, by the number of the sample."""

    array: ir.Array


class Latest(NamedTuple):
    """A signal of which only the present sample is read."""

    value: Any


class Row(NamedTuple):
    """Two-dimensional array of which one row, the present sample's, is written."""

    cells: Cells
    columns: int

    @property
    def shape(self) -> tuple[int, int]:
        """Rows are as many as samples."""
        return ir.FOREVER, self.columns


class Signals(NamedTuple):
    """Two-dimensional array of rings, one per signal, each with `size` samples."""

    rings: tuple["Ring | Latest | ir.Array", ...]
    size: int = ir.FOREVER

    @property
    def shape(self) -> tuple[int, int]:
        """Signals and samples."""
        return len(self.rings), self.size


class Returned(NamedTuple):
    """What a function gives back."""

    value: Any


class Range(NamedTuple):
    """Numbers from `start` to before `stop`."""

    start: Any
    stop: Any


class Tracer:
    """Follows source and collects statements in `block`."""

    def __init__(self) -> None:
        self.block: list[Any] = []
        self.heap: dict[tuple[int, int], Any] = {}
        self._alive: list[Cells] = []  # so that no identity is given twice
        self.wide: set[tuple[int, int]] = set()  # cells that are doubles in every program
        self.taken: dict[str, int] = {}
        self.tables: dict[tuple[float, ...], ir.Array] = {}
        self.arrays: list[tuple[ir.Array, float]] = []

    # names and cells

    def fresh(self, base: str, kind: str = ir.REAL) -> ir.Name:
        """Return a name that is not in use, whatever the case of its letters."""
        base = base.strip("_").lower() or "x"
        name = base
        while name in RESERVED or name in self.taken:
            self.taken[base] = count = self.taken.get(base, 0) + 1
            name = f"{base}_{count + 1}"
        self.taken.setdefault(name, 0)
        return ir.Name(name, kind)

    def cells(self, values: Any, names: Mapping[int, str] | None = None) -> Cells:
        """Return new cells with these values, called so in what is printed."""
        made = Cells(values, names)
        self._alive.append(made)
        for k, value in enumerate(made.start):
            self.heap[id(made), k] = value
        return made

    def title(self, place: tuple[int, int]) -> str:
        """Name of a cell in what is printed."""
        owner = next(c for c in self._alive if id(c) == place[0])
        return owner.names.get(place[1], f"value_{place[1]}")

    def array(self, base: str, size: int) -> ir.Array:
        """Return an array that is kept from step to step, of zeros at first."""
        made = ir.Array(self.fresh(base).id, size)
        self.arrays.append((made, 0.0))
        return made

    def table(self, values: tuple[float, ...]) -> ir.Array:
        """Return the constant table of these values."""
        if values not in self.tables:
            self.tables[values] = ir.Array(self.fresh("table").id, len(values), values)
        return self.tables[values]

    # functions and statements

    @contextmanager
    def collected(self, into: list[Any]) -> Any:
        """Collect statements there."""
        before, self.block = self.block, into
        try:
            yield
        finally:
            self.block = before

    def kept(self, name: str, value: Any) -> Any:
        """Give an expression a name, so that it is computed once."""
        if isinstance(value, tuple):
            named = zip(part_names(name, value), value, strict=True)
            parts = [self.kept(part, v) for part, v in named]
            return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
        if not isinstance(value, ir.Op | ir.Item):
            return value
        made = self.fresh(name, ir.kind_of(value))
        self.block.append(ir.Assign(made, value))
        return made


class Merge:
    """Gives what two branches leave different one name, set in each of them."""

    def __init__(self, tracer: Tracer, body: list[Any], orelse: list[Any]) -> None:
        self.tracer, self.ways = tracer, (body, orelse)
        self.declared: list[Any] = []

    def of(self, base: str, a: Any, b: Any) -> Any:
        """Value behind both branches."""
        if same(a, b):
            return a
        if isinstance(a, tuple) and isinstance(b, tuple) and len(a) == len(b):
            names = part_names(base, a)
            parts = [self.of(n, x, y) for n, x, y in zip(names, a, b, strict=True)]
            return type(a)(*parts) if hasattr(a, "_fields") else tuple(parts)
        scalar = all(ir.known(v) or isinstance(v, ir.Name | ir.Op | ir.Item) for v in (a, b))
        if not scalar:
            return None  # of no use behind the branches
        kinds = {ir.kind_of(a), ir.kind_of(b)}
        kind = next(iter(kinds)) if len(kinds) == 1 else ir.WIDE if ir.WIDE in kinds else ir.REAL
        name = self.tracer.fresh(base, kind)
        self.declared.append(ir.Assign(name, None))
        for way, value in zip(self.ways, (a, b), strict=True):
            value = ir.make(kind, value) if kind in (ir.REAL, ir.WIDE) else value
            way.append(ir.Assign(name, value, declare=False))
        return name


def part_names(name: str, value: tuple[Any, ...]) -> list[str]:
    fields = None if isinstance(value, Returned) else getattr(value, "_fields", None)
    return [f"{name}_{f}" for f in fields] if fields else [name] * len(value)


def same(a: Any, b: Any) -> bool:
    if isinstance(a, np.ndarray) or isinstance(b, np.ndarray):
        return a is b
    return bool(a is b or (type(a) is type(b) and a == b))
