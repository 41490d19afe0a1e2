"""Columns of numbers in text files: CSV, tab or blank separated, plain or gzip."""

import gzip
import io
import sys
import warnings
import zlib
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from dmptm_ctrl.signals.columns import Choose, Table
from dmptm_ctrl.signals.errors import LogError

CHUNK_ROWS = 200_000  # text of one chunk is in memory at once, about 20 MB
MAX_LINE = 1 << 20  # bytes; a line longer than this is no row of numbers
MAX_BYTES = 20 << 30  # unpacked; guards against archives that unpack without end

_GZIP_MAGIC = b"\x1f\x8b"
_COMMENT = ("#", "%")


class _Layout(NamedTuple):
    names: list[str]
    separator: str
    decimal: str
    skip: int  # lines before the first row of numbers


def read_text(path: Path, choose: Choose, max_rows: int | None = None) -> Table:
    """Read columns of numbers from a text file, a chunk at a time.

    Parameters
    ----------
    path : Path
        Plain or gzip, by content rather than by extension. The first line that is no comment
        names the columns; without one they are called column1, column2, …
    choose : callable
        Gets the names, returns those to read; what the other columns hold does not matter.
    max_rows : int, optional
        Rows after this many are not read.

    Returns
    -------
    Table
        Columns as float64, read-only.

    Raises
    ------
    LogError
        Not readable, no header and no mapping, rows of different width, text or nothing where a
        number should be; the message gives row (first row of numbers = 1) and column.
    """
    try:
        with _open(path) as stream:
            layout = _layout(stream, path.name)
        chosen = choose(layout.names, {})
        with _open(path) as stream:
            return Table(_columns(stream, layout, chosen, path.name, max_rows), {}, {})
    except (EOFError, zlib.error, gzip.BadGzipFile) as error:
        raise LogError(f"{path.name}: the gzip archive is damaged or cut short") from error
    except OSError as error:
        raise LogError(f"{path.name}: {error.strerror or error}") from error


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
            raise LogError(f"{self._name}: no rows of numbers, a line runs over {MAX_LINE} bytes")
        buffer[: len(data)] = data
        return len(data)

    def close(self) -> None:
        self._raw.close()
        super().close()


def _open(path: Path) -> io.BufferedReader:
    raw = path.open("rb")
    packed = raw.read(2) == _GZIP_MAGIC
    raw.seek(0)
    return io.BufferedReader(_Guarded(gzip.open(raw) if packed else raw, path.name), 1 << 16)


def _layout(stream: io.BufferedReader, source: str) -> _Layout:
    """Names, separator and decimal sign from the first lines."""
    header, comment, skip = "", "", 0
    rows: list[str] = []
    while len(rows) < 1:
        raw = stream.readline(MAX_LINE)
        if not raw:
            break
        line = _decode(raw, source).strip()
        if line.startswith(_COMMENT):
            comment, skip = line.lstrip("#% \t"), skip + 1
        elif not line and not header:
            skip += 1
        elif line and not header and not _numeric(line):
            header, skip = line, skip + 1
        elif line:
            rows.append(line)
        elif not rows:
            skip += 1
    if not rows:
        raise LogError(f"{source}: {'no rows below the header' if header else 'the file is empty'}")
    separator = _separator(header or rows[0])
    width = len(_split(rows[0], separator))
    if not header and len(_split(comment, _separator(comment))) == width and comment:
        names = _split(comment, _separator(comment))
    elif header:
        names = _split(header, separator)
    else:
        names = [f"column{i + 1}" for i in range(width)]
    if len(names) != width:
        raise LogError(
            f"{source}: the header names {len(names)} columns, the first row has {width} values"
        )
    comma = separator != "," and "," in rows[0] and "." not in rows[0]
    return _Layout(names, separator, "," if comma else ".", skip)


def _decode(raw: bytes, source: str) -> str:
    if raw.startswith((b"\xff\xfe", b"\xfe\xff")) or b"\0" in raw:
        raise LogError(f"{source}: not a text file in UTF-8; save it as CSV in UTF-8")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")  # names with ° or µ from older programs


def _separator(line: str) -> str:
    return next((sign for sign in ";\t," if sign in line), r"\s+")


def _split(line: str, separator: str) -> list[str]:
    fields = line.split() if separator == r"\s+" else line.split(separator)
    return [field.strip().strip('"').strip() for field in fields]


def _numeric(line: str) -> bool:
    """Whether every field is a number or empty: such a line is a row, not a header."""
    fields = _split(line, _separator(line))
    numbers = [field for field in fields if _number(field.replace(",", "."))]
    return bool(numbers) and all(_number(f.replace(",", ".")) or not f for f in fields)


def _number(field: str) -> bool:
    try:
        float(field)
    except ValueError:
        return False
    return True


def _columns(
    stream: io.BufferedReader,
    layout: _Layout,
    chosen: list[str],
    source: str,
    max_rows: int | None,
) -> dict[str, Any]:
    lines = _Lines(stream, layout)
    # One letter for what nobody wants: its text is cut, its place is counted.
    kinds = [(f"f{i}", "f8" if n in chosen else "S1") for i, n in enumerate(layout.names)]
    place = {name: f"f{layout.names.index(name)}" for name in chosen}
    parts: dict[str, list[Any]] = {name: [] for name in chosen}
    left = sys.maxsize if max_rows is None else max_rows
    while left > 0:
        wanted = min(CHUNK_ROWS, left)
        chunk = _chunk(lines, kinds, layout, source, wanted)
        for name in chosen:
            parts[name].append(chunk[place[name]].copy())
        left -= chunk.size if chunk.size == wanted else left
    columns = {}
    for name in chosen:
        columns[name] = np.concatenate(parts.pop(name))
        columns[name].flags.writeable = False
    return columns


class _Lines:
    """Lines below the header; the last one given is the one a parser stumbled on."""

    def __init__(self, stream: io.BufferedReader, layout: _Layout) -> None:
        for _ in range(layout.skip):
            stream.readline()
        self._text = io.TextIOWrapper(stream, encoding="latin-1")
        self._comma = layout.decimal == ","
        self.number, self.line = layout.skip, ""

    def __iter__(self) -> "_Lines":
        return self

    def __next__(self) -> str:
        self.line = next(self._text)
        self.number += 1
        return self.line.replace(",", ".") if self._comma else self.line


def _chunk(
    lines: _Lines, kinds: list[tuple[str, str]], layout: _Layout, source: str, rows: int
) -> Any:
    separator = None if layout.separator == r"\s+" else layout.separator
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # "input contained no data" at the end
        try:
            return np.loadtxt(
                lines,
                dtype=kinds,
                delimiter=separator,
                comments=None,
                quotechar='"',
                ndmin=1,
                max_rows=rows,
            )
        except (ValueError, OverflowError) as error:
            raise LogError(f"{source}: {_trouble(lines, kinds, layout)}") from error


def _trouble(lines: _Lines, kinds: list[tuple[str, str]], layout: _Layout) -> str:
    """What is wrong with the line that the parser stumbled on."""
    where = f"line {lines.number}"
    fields = _split(lines.line.rstrip("\r\n"), layout.separator)
    if len(fields) != len(layout.names):
        return f"{where} has {len(fields)} values, the header names {len(layout.names)} columns"
    for field, name, (_, kind) in zip(fields, layout.names, kinds, strict=True):
        if kind == "f8" and not field:
            return f"{where} has no value for {name}"
        if kind == "f8" and not _number(field.replace(layout.decimal, ".")):
            second = "; a second line of headers is to be deleted" if lines.number == 2 else ""
            return f"{where}: {name} is {field[:40]!r}, not a number{second}"
    return f"{where} is no row of numbers"
