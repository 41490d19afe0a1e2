"""How the rows of a text file are written."""

import csv
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from dmptm_ctrl.signals.units import parse_unit, unit_of

COMMENT = ("#", "%", "//", "!")
MISSING = frozenset(
    (
        *("", "nan", "-nan", "na", "n/a", "#n/a", "#na", "<na>", "null", "none", "-", "--", "---"),
        *("n. def.", "#nv", "#value!", "#div/0!", "-1.#ind", "1.#ind", "1.#qnan", "-1.#qnan"),
    )
)
WORDS = frozenset(("true", "false"))
ODD = str.maketrans(
    {"\xa0": "", "\u202f": "", "\u2009": "", "’": "'", "−": "-", "\ufeff": "", "∞": "inf"}
)
_FORTRAN = re.compile(r"[-+]?[\d.]+[dD][-+]?\d+")
_PAIR = re.compile(r"(?<![\w.-])([A-Za-z_][\w.\[\]()/-]*)\s*[=:]\s*(?=[-+.\d])")
_STAMP = re.compile(r"^\s*([\d:.]+)\s*->\s*")  # serial monitors put the time of day before a row
_ENCLOSED = re.compile(r"^\s*[\[(]([^\[\]()]*)[\])][;,]?\s*$")  # printed tuples and arrays
_OF_NUMPY = re.compile(r"np\.\w+\(([^()]*)\)")  # printed scalars
_ESCAPE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")  # colours and places on a terminal
_WITH_UNIT = re.compile(r"([-+]?[\d.,]*\d(?:[eE][-+]?\d+)?)\s*([^\d\s.,:;+-][^\s:;,]*)")
_GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}(,\d{3})+")
_REMARK = re.compile(r"\s+#.*")
_RULE = re.compile(r"[\s|+:=-]*[-=]{3,}[\s|+:=-]*$")  # below the names of a table, around a grid


@dataclass(frozen=True)
class TextFormat:
    """What a user says about a text file, where it cannot be guessed."""

    header: int | None = None  # line of the names, the first is 1; 0: there is none
    separator: str | None = None
    decimal: str | None = None
    skip: int = 0  # lines to leave out at the beginning


def apart(line: str, separator: str) -> str:
    """Line with a separator between each name and its value."""
    return _PAIR.sub(rf"\1{separator}", line)


class Dialect(NamedTuple):
    """How the fields of a row are written."""

    separator: str
    decimal: str = "."
    thousands: str = ""
    pairs: bool = False  # name and value side by side
    units: tuple[str, ...] = ()  # of each field, behind its number

    def split(self, line: str) -> list[str]:
        """Fields of a line, without their quotes and the blanks around them."""
        if self.pairs:
            line = apart(line, self.separator)
        if "\x1b" in line:
            line = _ESCAPE.sub("", line)
        line = line.rstrip("\r\n")
        if not line.isascii():
            line = line.translate(ODD)
        if "np." in line:
            line = _OF_NUMPY.sub(r"\1", line)
        if "->" in line:
            line = _STAMP.sub(rf"\1{self.separator}", line)
        if line[-2:].rstrip(";, ")[-1:] in (")", "]"):
            line = _ENCLOSED.sub(r"\1", line)
        if self.separator == "|" and line.strip()[:1] == line.strip()[-1:] == "|":
            line = line.strip()[1:-1]
        if self.separator == " ":
            line = " ".join(line.split())
        if '"' not in line:
            fields = line.split(self.separator)
        else:
            try:
                fields = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))
            except (csv.Error, StopIteration):
                fields = line.split(self.separator)
        cells = [_unquoted(field) for field in fields]
        return [*map(self._bare, cells, self.units)] if len(self.units) == len(cells) else cells

    def _bare(self, cell: str, unit: str) -> str:
        """Number of a cell that holds its unit; in another unit of the column's quantity too."""
        text = cell.removesuffix(unit).rstrip()
        if text[-1:].isdigit():
            return text
        if (found := _WITH_UNIT.fullmatch(cell)) is None:
            return cell
        own, number = unit_of(found[2]), self.number(found[1])
        if own is None or number is None or own.symbol != (of := parse_unit(unit)).symbol:
            return cell
        return f"{number * own.factor / of.factor:.12g}".replace(".", self.decimal)

    def kind(self, cell: str) -> str:
        """Kind of a field: "number", "time", "" (no value) or "text"."""
        value = self.number(cell)
        if (value is not None and value == value) or cell.lower() in WORDS:
            return "number"
        if cell.lower() in MISSING:
            return ""
        return "time" if TIME.fullmatch(cell) else "text"

    def number(self, cell: str) -> float | None:
        """Value of a field, None if it is no number."""
        if self.thousands and self.thousands in cell:
            whole, _, part = cell.partition(self.decimal)
            if not re.fullmatch(rf"[-+]?\d{{1,3}}({re.escape(self.thousands)}\d{{3}})+", whole):
                return None
            cell = whole.replace(self.thousands, "") + self.decimal * bool(part) + part
        if self.decimal != ".":
            if "." in cell:
                return None
            cell = cell.replace(self.decimal, ".")
        if "_" in cell:
            return None
        try:
            return float(cell)
        except ValueError:
            return float(cell.upper().replace("D", "E")) if _FORTRAN.fullmatch(cell) else None


# MATLAB's "0.01 sec"; a date, a time of day, or both; pandas' "0 days 00:00:01".
_IEC_TIME = r"L?T(?:IME)?#\S+"  # of a PLC: T#1s20ms
DURATION = r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)? (?:s|sec|ms|us|µs|ns|min|h|hr)"
_CLOCK_TEXT = r"\d{1,2}:\d{2}(:\d{2})?([.,:]\d{1,9})?\s*([AaPp][Mm])?(Z|[-+]\d{2}:?\d{2})?"
_ZONE = r"(\[[\w/+-]+\]|\s?[A-Z]{3,4})?"  # besides an offset
_DATE_TEXT = r"(\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.](\d{1,2}|[A-Za-z]{3})[-/.]\d{2,4})"
TIME = re.compile(
    rf"{DURATION}|{_IEC_TIME}|(-?\d+ days?\s+)?{_CLOCK_TEXT}"
    rf"|{_DATE_TEXT}[T ,_-]+{_CLOCK_TEXT}{_ZONE}|\d{{8}}[T_-]\d{{6}}\S*"
)


@dataclass(frozen=True)
class Layout:
    """How a text file is to be read."""

    names: list[str]  # of each column, "" where nothing says
    units: list[str]  # as the file states them, else ""
    dialect: Dialect
    first: int  # lines above the first row of numbers
    kinds: list[str]  # of each column: "number", "time" or "text"
    fields: int  # in each row; those after the last column are empty
    period: float | None = None  # time between samples that the preamble states [s]
    # start and increment of a clock that counts samples [s]
    steps: tuple[float, float] | None = None
    long: tuple[int, int] | None = None  # columns of names and of values: one signal per row
    wordy: int = 0  # lines right above the first row that are such but for a word, as ERR


class Block(NamedTuple):
    """Rows of one shape under one dialect."""

    score: tuple[float, bool, int]
    dialect: Dialect
    first: int
    fields: int
    kinds: list[str]
    constant: list[str]  # text of the columns that say the same in each row
    rows: list[list[str]]

    @property
    def width(self) -> int:
        return len(self.kinds)


def with_units(dialect: Dialect, lines: Sequence[str]) -> Dialect | None:
    """Dialect of cells as "12.5 V", None where no row looks like that."""
    for line in lines:
        found = [_WITH_UNIT.fullmatch(cell) for cell in dialect.split(line)]
        units = tuple(m[2] if m and unit_of(m[2]) else "" for m in found)
        if any(units):
            return dialect._replace(units=units)
    return None


def _unquoted(field: str) -> str:
    """Field without the blanks and quotes around it, also written ="0.1" or '0.1."""
    plain = field.strip().removeprefix("=")
    if len(plain) > 1 and plain[0] == plain[-1] and plain[0] in "'\"":
        return plain[1:-1].strip()
    return plain.removeprefix("'")  # of spreadsheets, before what is a text


def with_points(cells: Iterable[Any]) -> list[Any]:
    """Cells with points for decimal commas; ValueError without any, or where they part thousands.

    Of texts among the values of a table, such as of JSON.
    """
    texts = [cell for cell in cells if isinstance(cell, str)]
    parted = [text for text in texts if "," in text]
    if all(map(_GROUPED.fullmatch, parted)) or any("." in text for text in texts):
        raise ValueError(f"no decimal commas in {parted[:1]}")
    return [cell.replace(",", ".") if isinstance(cell, str) else cell for cell in cells]


def says_nothing(line: str) -> bool:
    """Whether a line is a comment or a rule between the rows of a table."""
    return line.lstrip().startswith(COMMENT) or bool(_RULE.match(line))


def without_remark(line: str) -> str:
    """Line without a remark behind the row."""
    return _REMARK.sub("", line) if "#" in line else line


def trimmed(fields: list[str]) -> list[str]:
    """Fields without the empty ones at the end."""
    while len(fields) > 1 and not fields[-1]:
        fields = fields[:-1]
    return fields


def bare(line: str) -> str:
    """Line without the sign of a comment."""
    plain = line.strip("\ufeff\r\n").lstrip()
    return plain.lstrip("#%!/ ") if plain.startswith(COMMENT) else line
