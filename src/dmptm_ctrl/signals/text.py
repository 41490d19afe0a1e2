"""Columns of numbers in text files, plain or gzip, as programs write them."""

import gzip
import io
import itertools
import sys
import zlib
from collections import Counter, deque
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

import numpy as np

from dmptm_ctrl.signals.clock import equal, increases, same_clock, ticks, times_of
from dmptm_ctrl.signals.columns import TIMES, Choose, Table, listed
from dmptm_ctrl.signals.dialect import (
    MISSING,
    ODD,
    Layout,
    TextFormat,
    apart,
    says_nothing,
    without_remark,
)
from dmptm_ctrl.signals.encodings import encoding_of
from dmptm_ctrl.signals.errors import LogError, NotALogError
from dmptm_ctrl.signals.header import clock_word, is_clock_name
from dmptm_ctrl.signals.layout import find_layout

CHUNK_ROWS = 200_000  # text of one chunk is in memory at once, about 20 MB
HEAD = 1 << 16  # bytes that show the encoding
FIELD_LINES = 8  # a quoted field goes over no more than this; else it is a mark of inches
MAX_LINE = 1 << 20  # bytes; a line longer than this is no row of numbers
MAX_BYTES = 20 << 30  # unpacked; guards against archives that unpack without end
SAMPLES = (1000, 20_000)  # lines looked at before the first row of numbers is found

_GZIP_MAGIC = b"\x1f\x8b"
_FIELD = "\x1f"  # between the fields that pandas gets
_NOTHING = "\0\x1a \t\r\n"  # of lines that say nothing
_PLAIN = frozenset("0123456789+-. \t;,|")  # what rows of numbers begin with


def read_text(
    path: Path,
    choose: Choose,
    max_rows: int | None = None,
    how: TextFormat | None = None,
    wanted: Collection[str] = (),
) -> Table:
    """Read columns of numbers from a text file, plain or gzip by content, a chunk at a time.

    `choose` gets names and units and returns the columns to read; those without a name are called
    column1, column2, … `wanted` columns say which of several lines of names is meant. Columns are
    float64, read-only; times timedelta64. A LogError gives line and column.
    """
    how = how or TextFormat()
    try:
        with _open(path) as stream:
            encoding = encoding_of(stream.peek(HEAD)[:HEAD], path.name, wanted)
        sample, layout = _sample(path, encoding, how, wanted)
        try:
            return _table(path, encoding, layout, choose, max_rows, words=False)
        except _CellError as error:  # the first rows may say too little of how numbers are written
            again = find_layout([*sample, *error.lines], path.name, how, wanted)
            return _table(path, encoding, again, choose, max_rows, words=True)
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise NotALogError(f"{path.name}: the gzip archive is damaged or cut short") from error
    except OSError as error:
        raise LogError(f"{path.name}: {error.strerror or error}") from error


class _CellError(LogError):
    """A field that is no number; carries its line."""

    lines: tuple[str, ...] = ()


class _Guarded(io.RawIOBase):
    """Stream that refuses endless lines and archives, so that memory stays bounded."""

    def __init__(self, raw: IO[bytes] | gzip.GzipFile, name: str) -> None:
        self._raw, self._name = raw, name
        self._line = self._total = 0

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        data = self._raw.read(len(buffer))
        self._total += len(data)
        newline = max(data.rfind(b"\n"), data.rfind(b"\r"))
        self._line = self._line + len(data) if newline < 0 else len(data) - newline - 1
        if self._line > MAX_LINE or self._total > MAX_BYTES:
            raise NotALogError(
                f"{self._name}: no rows of numbers, a line runs over {MAX_LINE} bytes"
            )
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._raw.close()
        super().close()


def _open(path: Path) -> io.BufferedReader:
    raw = path.open("rb")
    packed = raw.read(2) == _GZIP_MAGIC
    raw.seek(0)
    return io.BufferedReader(_Guarded(gzip.open(raw) if packed else raw, path.name), HEAD)


@contextmanager
def _lines(path: Path, encoding: str) -> Iterator[Iterator[str]]:
    """Lines of a file; a quoted field that goes over several makes one, and blank ones follow."""
    with io.TextIOWrapper(_open(path), encoding=encoding, errors="replace") as stream:
        yield _whole_lines(stream)


def _whole_lines(stream: Iterator[str]) -> Iterator[str]:
    held: deque[str] = deque()
    while (line := held.popleft() if held else next(stream, None)) is not None:
        if line.count('"') % 2:
            held.extend(itertools.islice(stream, FIELD_LINES - len(held)))
            quotes = itertools.accumulate(s.count('"') for s in held)
            end = next((k for k, n in enumerate(quotes, 1) if n % 2), 0)
            for _ in range(end):
                line = f"{line.rstrip()} {held.popleft()}"
            held.extendleft(["\n"] * end)
        yield line


def _sample(
    path: Path, encoding: str, how: TextFormat, wanted: Collection[str]
) -> tuple[list[str], Layout]:
    """As many of the first lines as show rows of numbers, and their layout."""
    lines: list[str] = []
    with _lines(path, encoding) as stream:
        for count in SAMPLES:
            lines += itertools.islice(stream, count + how.skip)
            try:
                layout = find_layout(lines, path.name, how, wanted)
            except LogError:
                if count == SAMPLES[-1]:
                    raise
                continue
            if len(lines) > 2 * layout.first:
                break
    return lines, layout


def _table(
    path: Path, encoding: str, layout: Layout, choose: Choose, max_rows: int | None, words: bool
) -> Table:
    names = [name or f"column{c + 1}" for c, name in enumerate(layout.names)]
    stated = [TIMES if k == "time" else u for k, u in zip(layout.kinds, layout.units, strict=True)]
    units = {n: u for n, u in zip(names, stated, strict=True) if u}
    if layout.long:
        return _long_table(_Rows(path, encoding, layout, words), layout, names, units, choose)
    chosen = choose(list(dict.fromkeys(names)), units)
    clocks = [c for c, n in enumerate(names) if is_clock_name(n) and layout.kinds[c] != "text"]
    signals = {n for n in chosen if names.count(n) == 1}
    clocks = [c for c in clocks if c == clocks[0] or names[c] not in signals]
    clocks += [c for c, n in enumerate(names) if n in chosen and names.count(n) > 1]
    used = [c for c, n in enumerate(names) if n in chosen]
    read = sorted({*used, *(max((k for k in clocks if k < c), default=c) for c in used)})
    rows = _Rows(path, encoding, layout, words)
    data = rows.read({c: names[c] for c in read}, sys.maxsize if max_rows is None else max_rows)
    if layout.steps is not None and 0 in data:
        data[0] = layout.steps[0] + layout.steps[1] * data[0]
    columns, own = _one_each(path.name, names, chosen, data, sorted({*clocks} & {*read}))
    return Table(columns, units, {}, tuple(rows.notes()), own, layout.period, rows.words())


def _one_each(
    source: str, names: list[str], chosen: list[str], data: dict[int, Any], clocks: list[int]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Columns by name, and the clocks of those that have another than the first."""
    columns: dict[str, Any] = {}
    own: dict[str, Any] = {}
    for c, values in sorted(data.items()):
        name = names[c]
        if name not in chosen:
            continue
        if name not in columns:
            columns[name] = values
        elif not increases(values) and not equal(values, columns[name]):
            raise LogError(
                f"{source}: column {name!r} occurs {names.count(name)} times with different "
                "values; rename one, or call all columns by place: column1, column2, …"
            )
    main = next((c for c in clocks if names[c] in chosen and increases(data[c])), None)
    if main is None:
        return columns, own
    for c, name in enumerate(names):
        clock = max((k for k in clocks if k <= c), default=main)
        if name not in columns or c not in data or c in clocks:
            continue
        other, alike = data[clock], clock_word(names[clock]) == clock_word(names[main])
        if alike and increases(other) and ticks(other) and not same_clock(data[main], other):
            own[name] = other
    return columns, own


def _long_table(
    rows: "_Rows", layout: Layout, names: list[str], units: dict[str, str], choose: Choose
) -> Table:
    """Rows of one name and one value each: a column, and a clock if there is one, per name."""
    import pandas as pd

    of, value = layout.long or (0, 1)
    own: dict[str, Any] = {}
    clocks = [c for c, k in enumerate(layout.kinds) if k == "time" or is_clock_name(names[c])]
    data = rows.read({c: names[c] for c in {of, value, *clocks}}, sys.maxsize)
    labels = pd.Series(data.pop(of)).str.strip().str.rstrip(":=")
    places = {str(n): p for n, p in labels.groupby(labels, sort=False).indices.items()}
    values = data.pop(value)
    if names[value] == "VarValue":  # WinCC counts days in millionths
        data = {c: 86.4 * (v - v[0]) if names[c] == "Time_ms" else v for c, v in data.items()}
    if not data:  # a name that comes as often as the others is one of a row
        longest = max(map(len, places.values()))
        places = {n: p for n, p in places.items() if len(p) >= longest - 1}
        places = {n: p[: min(map(len, places.values()))] for n, p in places.items()}
    finest = sorted(data, key=lambda c: -np.unique(data[c]).size)
    chosen = choose([*(names[c] for c in finest), *places], units)
    columns = {n: values[places[n]] for n in chosen if n in places}
    clock = next((c for c in finest if names[c] in chosen), None)
    if clock is not None:
        times = {n: data[clock][places[n]] for n in columns}
        main = data[clock][max(places.values(), key=len)]
        own = {n: t for n, t in times.items() if not equal(t, main)}
        columns = {names[clock]: main, **columns}
    period = layout.period if clock is None else None
    return Table(columns, units, {}, tuple(rows.notes()), own, period, rows.words())


class _Rows:
    """Rows of numbers of a file; remembers what else stands between them, or refuses words."""

    def __init__(self, path: Path, encoding: str, layout: Layout, words: bool) -> None:
        self._path, self._encoding, self._layout, self._words = path, encoding, layout, words
        self._no_numbers: dict[str, list[tuple[str, int]]] = {}
        self._left_out: dict[str, list[int]] = {}
        wordy = range(layout.first - layout.wordy + 1, layout.first + 1)
        self._leave_out("incomplete rows", [*wordy])

    def __iter__(self) -> Iterator[tuple[int, str]]:
        """Line number and fields, between which stands ``_FIELD`` (or a blank)."""
        held: tuple[int, str] | None = None  # the last row may be cut
        lately: deque[str] = deque(maxlen=50)
        for number, line, row in self._all():
            if held is not None:
                yield held
            held = (number, row)
            lately.append(line)
        if held is not None and self._is_cut(lately):
            self._leave_out("incomplete rows", [held[0]])
        elif held is not None:
            yield held

    def _all(self) -> Iterator[tuple[int, str, str]]:
        layout = self._layout
        separator, fields = layout.dialect.separator, layout.fields
        blanks, pairs = separator == " ", layout.dialect.pairs
        units = Counter(filter(None, layout.dialect.units))
        named = layout.long is not None  # rows begin with words, and end with numbers
        odd: list[tuple[int, str, str]] = []  # no rows, unless a row follows
        with _lines(self._path, self._encoding) as stream:
            for _ in range(layout.first):
                next(stream, None)
            for number, line in enumerate(stream, start=layout.first + 1):
                if '"' in line and line.count(separator) == fields - 1:
                    line = line.replace('"', "")  # nothing in the quotes separates
                if pairs:
                    line = apart(line, separator)
                alone = _without(units, line) if units else line
                line = alone or line
                whole = alone and (line[0] in _PLAIN or (named and line[-2:-1].isdigit()))
                plain = whole and '"' not in line and "#" not in line
                if plain and not blanks and line.count(separator) == fields - 1:
                    row, what = line.replace(separator, _FIELD), ""
                elif plain and blanks and len(line.split()) == fields:
                    row, what = line, ""
                elif not line.strip(_NOTHING):
                    continue
                else:
                    row, what = self._judged(line)
                if what == "odd":
                    odd.append((number, line, row))
                    continue
                if what:  # a text after it: the program was stopped there
                    yield from self._ended(odd)
                    self._leave_out(what, [number])
                else:
                    yield from map(self._row_of, odd)
                    yield number, line, row
                odd.clear()
        yield from self._ended(odd)

    def _ended(self, odd: list[tuple[int, str, str]]) -> Iterator[tuple[int, str, str]]:
        """Rows after the last whole one: columns of a slower clock end before the others."""
        dialect, fields = self._layout.dialect, self._layout.fields
        rows = [dialect.split(line) for _, line, _ in odd]
        lengths = [fields + 1, *map(len, rows)]
        numbers = all({*map(dialect.kind, row)} <= {"", "number", "time"} for row in rows)
        if len(rows) < 2 or not numbers or any(a < b for a, b in itertools.pairwise(lengths)):
            self._leave_out("incomplete rows", [n for n, _, _ in odd])
            return
        for (number, line, _), row in zip(odd, rows, strict=True):
            yield number, line, self._joined(row + [""] * (fields - len(row)))

    def _joined(self, cells: list[str]) -> str:
        """Fields as pandas gets them."""
        if self._layout.dialect.separator == " ":
            return " ".join(cell.replace(" ", "_") or "nan" for cell in cells) + "\n"
        return _FIELD.join(cells) + "\n"

    def _row_of(self, odd: tuple[int, str, str]) -> tuple[int, str, str]:
        """Row of an odd line between others: one of another width is a mistake."""
        if odd[2]:
            return odd
        count = len(self._layout.dialect.split(odd[1]))
        raise LogError(
            f"{self._path.name}: line {odd[0]} has {count} values, the header names "
            f"{len(self._layout.kinds)} columns"
        )

    def _judged(self, line: str) -> tuple[str, str]:
        """Row as pandas gets it, and what it is if no row of numbers; odd: it lacks some."""
        layout = self._layout
        if says_nothing(line):
            return "", "comments"
        cells = layout.dialect.split(without_remark(line))
        # what a program wrote behind some rows only: nothing, or a remark
        while len(cells) > layout.fields and layout.dialect.kind(cells[-1]) in ("", "text"):
            cells.pop()
        found = [
            (layout.dialect.kind(cell), of)
            for cell, of in zip(cells, layout.kinds, strict=False)
            if of != "text"
        ]  # a number is no time
        kinds = ["text" if both == ("number", "time") else both[0] for both in found]
        if not any(kind in ("number", "time") for kind in kinds) and any(kinds):
            return "", "text"
        if len(cells) != layout.fields:
            return "", "odd"
        return self._joined(cells), "odd" if "text" in kinds else ""

    def _leave_out(self, what: str, numbers: list[int]) -> None:
        if numbers:
            self._left_out.setdefault(what, []).extend(numbers)

    def notes(self) -> list[str]:
        """What was left out, and where."""
        return [
            f"left out {what} in line{'s' * (len(where) > 1)} {listed(where, 4)}"
            for what, where in self._left_out.items()
        ] + [f"{name} is {words}: taken as no value" for name, words in self.words().items()]

    def words(self) -> dict[str, str]:
        """First word among the numbers of each column that has some, and the lines of all."""
        return {
            name: f"{cells[0][0]!r} in line{'s' * (len(cells) > 1)} "
            f"{listed([line for _, line in cells], 4)}"
            for name, cells in self._no_numbers.items()
        }

    def read(self, places: dict[int, str], most: int) -> dict[int, Any]:
        """Values of some columns, by position."""
        parts: dict[int, list[Any]] = {c: [] for c in places}
        rows = itertools.islice(self, most)
        while chunk := list(itertools.islice(rows, CHUNK_ROWS)):
            frame = self._parsed(chunk, list(places))
            for c, name in places.items():
                parts[c].append(self._column(frame[c], name, c, chunk))
        columns = {}
        for c, name in places.items():
            values = np.concatenate(parts.pop(c)) if parts[c] else np.empty(0)
            if self._layout.kinds[c] == "time":
                values = times_of(values, self._path.name, name)
            values.flags.writeable = False
            columns[c] = values
        return columns

    def _parsed(self, chunk: list[tuple[int, str]], places: list[int]) -> Any:
        import pandas as pd

        dialect, layout = self._layout.dialect, self._layout
        older = tuple(map(int, pd.__version__.split(".")[:2])) < (3, 1)  # rounds a little otherwise
        exact = {"float_precision": "round_trip"} if older else {}
        text = "".join([row for _, row in chunk])
        if not text.isascii():
            text = text.translate(ODD)
        return pd.read_csv(
            io.StringIO(text),
            sep=r"\s+" if dialect.separator == " " else _FIELD,
            header=None,
            names=range(layout.fields),
            usecols=places,
            dtype={c: str for c in places if layout.kinds[c] != "number"},
            decimal=dialect.decimal,
            thousands=dialect.thousands or None,
            na_values=[*MISSING, *(m.upper() for m in MISSING)],
            skipinitialspace=True,
            quoting=3,  # csv.QUOTE_NONE
            low_memory=False,
            **exact,
        )

    def _column(self, column: Any, name: str, place: int, chunk: list[tuple[int, str]]) -> Any:
        """One column of a chunk as numbers; times and texts stay text."""
        if self._layout.kinds[place] != "number":
            return column.to_numpy(dtype=object)
        if column.dtype.kind in "fiub":
            return column.to_numpy(dtype=np.int64 if column.dtype.kind in "iu" else np.float64)
        texts = column.to_numpy(dtype=object)
        dialect = self._layout.dialect
        values = np.full(texts.size, np.nan)
        for row, cell in enumerate(texts):
            if isinstance(cell, bool | int | float):
                values[row] = cell
                continue
            kind = dialect.kind(cell.strip())
            if kind == "number":
                number = dialect.number(cell.strip())
                values[row] = cell.strip().lower() == "true" if number is None else number
            elif kind and self._words:
                self._no_numbers.setdefault(name, []).append((cell[:20], chunk[row][0]))
            elif kind:
                error = _CellError(
                    f"{self._path.name}: line {chunk[row][0]}: {name} is {cell[:40]!r}, "
                    "not a number"
                )
                near = chunk[max(0, row - 200) : row + 200]
                error.lines = tuple(line.replace(_FIELD, dialect.separator) for _, line in near)
                raise error
        return values

    def _is_cut(self, lately: Sequence[str]) -> bool:
        """Whether the last row of a file lacks a part of its last number."""
        dialect, kinds = self._layout.dialect, self._layout.kinds
        rows = [dialect.split(line) for line in lately]
        if kinds[-1] != "number" or min(map(len, rows)) < len(kinds):
            return False
        ends = [row[len(kinds) - 1] for row in rows]
        if dialect.kind(ends[-1]) == "text":
            return True
        if lately[-1].endswith(("\n", "\r")) or len(ends) < 10:
            return False
        decimals = [len(end.partition(dialect.decimal)[2]) for end in ends]
        return len(set(decimals[:-1])) == 1 and decimals[-1] < decimals[0]


def _without(units: Counter[str], line: str) -> str:
    """Row without the units of its columns; empty where it has others, or words."""
    for unit, count in units.items():
        if line.count(unit) != count:
            return ""
        line = line.replace(unit, "")
    return line if _PLAIN.issuperset(line.strip().replace(":", "")) else ""
