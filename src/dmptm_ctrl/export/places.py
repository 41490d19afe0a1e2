"""What a traced calculation reads from and writes to, beside plain variables."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from dmptm_ctrl.export.program import FOREVER, Array


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

    array: Array


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
        return FOREVER, self.columns


class Signals(NamedTuple):
    """Two-dimensional array of rings, one per signal, each with `size` samples."""

    rings: tuple["Ring | Latest | Array", ...]
    size: int = FOREVER

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
