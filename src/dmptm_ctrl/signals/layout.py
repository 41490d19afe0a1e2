"""Where the rows of numbers are in a text file, and what their columns are called."""

import csv
import itertools
import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from dmptm_ctrl.signals.columns import CLOCK
from dmptm_ctrl.signals.errors import LogError, NotALogError
from dmptm_ctrl.signals.units import Unit, named_unit, parse_unit

COMMENT = ("#", "%", "//", "!")
SEPARATORS = (";", "\t", ",", "|", " ")
# decimal sign, sign between thousands; the plainest that reads everything is taken
NUMBERS = ((".", ""), (",", ""), (".", ","), (",", "."), (".", "'"), (".", " "), (",", " "))
FILE_TIME = 1e16  # a clock without a name that reads more counts ticks since 1601
STEADY = 10  # rows of one kind in a row that are the table and no part of the preamble
MISSING = frozenset(
    [
        "",
        "nan",
        "-nan",
        "na",
        "n/a",
        "#n/a",
        "#na",
        "<na>",
        "null",
        "none",
        "-",
        "--",
        "---",
        "#nv",
        "#value!",
        "#div/0!",
        "-1.#ind",
        "1.#ind",
        "1.#qnan",
        "-1.#qnan",
    ]
)
_FORTRAN = re.compile(r"[-+]?[\d.]+[dD][-+]?\d+")
WORDS = frozenset(("true", "false"))
_PAIR = re.compile(r"(?<![\w.-])([A-Za-z_][\w.\[\]()/-]*)\s*[=:]\s*(?=[-+.\d])")
ODD = str.maketrans({"\xa0": "", "\u202f": "", "\u2009": "", "’": "'", "−": "-", "\ufeff": ""})
_SEP_LINE = re.compile(r'(?i)\ufeff?"?sep=(.)"?\s*$')
_TYPE = re.compile(r"(?i)(l?real|[us]?[dls]?int|float|double|bool|lword|dword|word)\d*$")
_TIME_NAME = re.compile(r"(?i)(time|zeit|uhrzeit|timestamp|x_value|t)(\W|_|\d|$)")
_PERIOD = re.compile(r"(?i)sampl\w*[ _-]?(time|period|interval|rate|frequency)|delta_x|abtastzeit")
_AMOUNT = re.compile(r"[\s:=\"]*(?:is\s+)?([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([a-zA-Zµ]*)")


@dataclass(frozen=True)
class TextFormat:
    """What a user says about a text file, where it cannot be guessed.

    Attributes
    ----------
    header : int or None
        Line of the names, the first is 1; 0: there is none.
    separator, decimal : str or None
    skip : int
        Lines to leave out at the beginning.
    """

    header: int | None = None
    separator: str | None = None
    decimal: str | None = None
    skip: int = 0


class Dialect(NamedTuple):
    """How the fields of a row are written."""

    separator: str
    decimal: str = "."
    thousands: str = ""
    pairs: bool = False  # name and value side by side

    def split(self, line: str) -> list[str]:
        """Fields of a line, without their quotes and the blanks around them."""
        if self.pairs:
            line = _PAIR.sub(rf"\1{self.separator}", line)
        line = line.rstrip("\r\n").translate(ODD)
        if self.separator == " ":
            line = " ".join(line.split())
        if '"' not in line:
            fields = line.split(self.separator)
        else:
            try:
                fields = next(csv.reader([line], delimiter=self.separator, skipinitialspace=True))
            except (csv.Error, StopIteration):
                fields = line.split(self.separator)
        return [field.strip().strip('"').strip() for field in fields]

    def kind(self, cell: str) -> str:
        """Kind of a field: "number", "time", "" (no value) or "text"."""
        if cell.lower() in MISSING:
            return ""
        if self.number(cell) is not None or cell.lower() in WORDS:
            return "number"
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
        if _FORTRAN.fullmatch(cell):
            cell = cell.upper().replace("D", "E")
        try:
            return float(cell)
        except ValueError:
            return None


# MATLAB's "0.01 sec"; a date, a time of day, or both; pandas' "0 days 00:00:01".
DURATION = r"[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)? (?:sec|ms|min|hr)"
_CLOCK_TEXT = r"\d{1,2}:\d{2}(:\d{2})?([.,:]\d{1,9})?\s*([AaPp][Mm])?(Z|[-+]\d{2}:?\d{2})?"
_DATE_TEXT = r"(\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.](\d{1,2}|[A-Za-z]{3})[-/.]\d{2,4})"
TIME = re.compile(
    rf"{DURATION}|(-?\d+ days?\s+)?{_CLOCK_TEXT}|{_DATE_TEXT}([T ,]+{_CLOCK_TEXT})?"
    r"|\d{8}T\d{6}\S*"
)


@dataclass(frozen=True)
class Layout:
    """How a text file is to be read.

    Attributes
    ----------
    names : list of str
        Of each column, "" where nothing says.
    units : list of str
        As the file states them, "" where it does not.
    dialect : Dialect
    first : int
        Lines above the first row of numbers.
    kinds : list of str
        Of each column: "number", "time" or "text".
    fields : int
        In each row; those after the last column are empty.
    period : float or None
        Time between samples that the preamble states [s].
    steps : (start, increment) or None
        Of the clock, where the first column counts the samples [s].
    long : bool
        Each row is a name and its value.
    """

    names: list[str]
    units: list[str]
    dialect: Dialect
    first: int
    kinds: list[str]
    fields: int
    period: float | None = None
    steps: tuple[float, float] | None = None
    long: bool = False


class _Block(NamedTuple):
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


def find_layout(
    lines: Sequence[str], source: str, how: TextFormat, wanted: Collection[str] = ()
) -> Layout:
    """Find the table in the first lines of a file.

    Parameters
    ----------
    lines : sequence of str
    source : str
        Name of the file, for messages.
    how : TextFormat
    wanted : collection of str
        Columns that tell which of several lines of names is meant.

    Raises
    ------
    NotALogError
        No row of numbers.
    LogError
        Names that do not fit the rows.
    """
    best = None
    for dialects in _dialects(lines, how):
        blocks = [b for d in dialects if (b := _block(lines, d, how)) is not None]
        # of equals, the first
        best = max([*([best] if best else []), *blocks], key=lambda b: b.score, default=None)
        if best is not None and best.score[0] > 0.99:
            break
    if best is None:
        what = "no rows of numbers" if any(s.strip() for s in lines) else "the file is empty"
        raise NotALogError(f"{source}: {what}")
    return _named(lines, best, source, how, wanted)


def _dialects(lines: Sequence[str], how: TextFormat) -> Iterator[list[Dialect]]:
    """Ways to write numbers, the usual ones first."""
    declared = next((m[1] for s in lines[:3] if (m := _SEP_LINE.match(s))), None)
    chosen = how.separator or declared
    separators = (chosen,) if chosen else SEPARATORS
    usual = [n for n in NUMBERS if how.decimal in (None, n[0])]
    plain = [Dialect(s, *n) for s in separators for n in usual if not n[1] and n[0] != s]
    yield plain
    quoted = [Dialect(s, s) for s in separators if s == "," and how.decimal in (None, s)]
    yield quoted + [
        Dialect(s, *n) for s in separators for n in usual if n[1] and n[1] != s.strip(",")
    ]
    yield [d._replace(pairs=True) for d in plain]


def _block(lines: Sequence[str], dialect: Dialect, how: TextFormat) -> _Block | None:
    """Rows of the commonest shape; None where no column holds numbers."""
    start = max(how.skip, how.header or 0)
    rows = [
        (i, dialect.split(s))
        for i, s in enumerate(lines)
        if i >= start and not s.lstrip().startswith(COMMENT)
    ]
    kinds = [[dialect.kind(cell) for cell in row] for _, row in rows]
    fields = Counter(len(k) for k in kinds if "number" in k).most_common(1)
    if not fields:
        return None
    width = fields[0][0]
    alike = [k for k in kinds if len(k) == width and "number" in k]
    column = [_kind_of([k[c] for k in alike if k[c]]) for c in range(width)]
    while column and column[-1] == "":
        column.pop()
    if "number" not in column:
        return None
    column = [kind or "number" for kind in column]

    def regular(kind: list[str]) -> bool:
        return (
            len(kind) == width
            and any(x in ("number", "time") for x in kind)
            and not any(x == "text" != of for x, of in zip(kind, column, strict=False))
        )

    good = [regular(k) for k in kinds]
    runs = _runs(good)
    if not runs:
        return None
    enough = min(STEADY, max(stop - begin for begin, stop in runs))
    steady = next(b for b, stop in runs if stop - b >= enough)
    begin = steady
    for i in range(steady - 1, -1, -1):  # blank lines between alike rows part nothing
        if good[i] and kinds[i] == kinds[steady]:
            begin = i
        elif any(kinds[i]):
            break
    first = rows[begin][0]
    body = [row for (_, row), ok in zip(rows[begin:], good[begin:], strict=True) if ok]
    constant = ["" if of != "text" else _same([r[c] for r in body]) for c, of in enumerate(column)]
    cells = Counter(
        kind
        for row, ok in zip(kinds[begin:], good[begin:], strict=True)
        for c, kind in enumerate(row[: len(column)])
        if ok and kind and not constant[c]
    )
    others = sum(any(row) for _, row in rows[begin:]) - len(body)
    share = 1 - (cells["text"] + others) / max(sum(cells.values()), 1)
    above = {len(_trimmed(dialect.split(bare(s)))) for s in lines[start:first]}
    told = len(column) in above or how.header is not None
    return _Block(
        (round(share, 2), told, len(column)), dialect, first, width, column, constant, body
    )


def _kind_of(cells: list[str]) -> str:
    """Kind of most cells of a column; "" where all are empty."""
    counted = Counter(cells)
    if not counted:
        return ""
    if counted["text"] > 0.1 * len(cells):
        return "text"
    return "time" if counted["time"] > counted["number"] else "number"


def _same(texts: list[str]) -> str:
    return texts[0] if len(set(texts)) == 1 else ""


def _runs(good: list[bool]) -> list[tuple[int, int]]:
    """Begin and end of each run of rows of numbers."""
    edges = [i for i in range(len(good) + 1) if (i and good[i - 1]) != (i < len(good) and good[i])]
    return list(zip(edges[::2], edges[1::2], strict=True))


def _trimmed(fields: list[str]) -> list[str]:
    """Fields without the empty ones at the end."""
    while len(fields) > 1 and not fields[-1]:
        fields = fields[:-1]
    return fields


def bare(line: str) -> str:
    """Line without the sign of a comment."""
    plain = line.strip("\ufeff\r\n").lstrip()
    return plain.lstrip("#%!/ ") if plain.startswith(COMMENT) else line


# -- names -----------------------------------------------------------------------------------


def _named(
    lines: Sequence[str], block: _Block, source: str, how: TextFormat, wanted: Collection[str]
) -> Layout:
    """Names and units from the lines above the first row of numbers."""
    nothing = [""] * block.width
    layout = Layout(
        nothing, nothing, block.dialect, block.first, block.kinds, block.fields,
        _period(lines[: block.first], block.dialect),
    )  # fmt: skip
    long = block.kinds == ["text", "number"] and not block.constant[0]
    if long and len({r[0] for r in block.rows}) <= len(block.rows) / 4:
        return replace(layout, names=["name", "value"], long=True)
    values = [c for c, kind in enumerate(block.kinds) if kind != "text"]
    if all(c and block.constant[c - 1] for c in values):
        return replace(layout, names=["", *(n.rstrip(":=") for n in block.constant[:-1])])
    if how.header is not None:
        rows = [_trimmed(block.dialect.split(bare(s))) for s in lines[: how.header][-1:]]
    else:
        rows = _candidates(lines, block)
        last = next((s for s in lines[: block.first][::-1] if s.strip() and bare(s) is s), "")
        if not rows and last and not _SEP_LINE.match(last):
            raise LogError(
                f"{source}: the header names {len(block.dialect.split(last))} columns, the first "
                f"row has {block.width} values; if another line holds the names, write its number "
                "in [data] of the rig file, as in header = 3, or header = 0 for none"
            )
    found = _from_rows([_fitted(r, block.width) for r in rows], layout, wanted)
    ticks = [block.dialect.number(cell) or 0.0 for cell in block.rows[0][: block.width]]
    units = [
        "ticks" if name == CLOCK and value > FILE_TIME else unit
        for name, unit, value in zip(found.names, found.units, ticks, strict=True)
    ]
    return replace(found, units=units)


def _candidates(lines: Sequence[str], block: _Block) -> list[list[str]]:
    """Rows of text above the table that have as many fields, the nearest first."""
    used = max(c for c, kind in enumerate(block.kinds) if kind != "text") + 1
    found: dict[tuple[bool, bool], list[list[str]]] = {}
    for line in reversed(lines[: block.first]):
        if not line.strip() or _SEP_LINE.match(line):
            continue
        fields = _trimmed(block.dialect.split(bare(line)))
        comment, short = bare(line) is not line, len(fields) < used
        fits = len(fields) == block.width if comment else not short
        fits = fits or (len(fields) == block.width - 1 and _counts_rows(block))
        if fits and any(block.dialect.kind(f) == "text" for f in fields):
            found.setdefault((comment, short), []).append(fields)
    # names without the sign of a comment, as many as columns, come first
    return found[min(found)] if found else []


def _counts_rows(block: _Block) -> bool:
    """Whether the first column numbers or names the rows, as R writes it without a name."""
    if block.kinds[0] == "text":
        return True
    first = [block.dialect.number(r[0]) for r in block.rows]
    return len(first) > 2 and all(
        a is not None and b is not None and b - a == 1 for a, b in itertools.pairwise(first)
    )


def _fitted(row: list[str], width: int) -> list[str]:
    """As many names as columns; one less: the first column counts the rows."""
    if len(row) == width - 1 and width > 1:
        return ["", *row]
    return (row + [""] * width)[:width]


def _from_rows(rows: list[list[str]], plain: Layout, wanted: Collection[str]) -> Layout:
    if not rows:
        return plain
    alike = {w.strip() for w in wanted}

    def worth(row: list[str]) -> tuple[int, int, bool]:
        """Known names, little that is no name, the label of such rows."""
        names = [named_unit(n)[0] for n in row]
        known = len(alike & ({*row} | {*names}))
        given = [n for n in row if n]
        others = sum(_is_unit(n) or bool(_TYPE.match(n)) for n in given)
        others += sum(plain.dialect.kind(n) != "text" for n in given)
        return known, len({*given}) - len(given) - others, row[0].lower() == "name"

    best = max(rows, key=worth)
    others = [r for r in rows if r is not best]
    units = [named_unit(n)[1] for n in best]
    for row in others:
        texts = [n for n in row if n and plain.dialect.number(n) is None]
        if texts and sum(_is_unit(n) for n in texts) > len(texts) / 2:
            units = [
                u or (n.strip("[]()") if _is_unit(n) else "")
                for u, n in zip(units, row, strict=True)
            ]
    twice = {n for n in best if n and best.count(n) > 1}
    names = list(best)
    # Labels of rows stand where clocks have no name: "Name", "Data-Type", "SampleTime[ms]".
    for name in twice:
        places = [c for c, n in enumerate(best) if n == name]
        said = [{r[c] for c in places} for r in others]
        if places[0] == 0 and said and all(len(s) == 1 for s in said):
            period = next((m for s in said if (m := re.search(r"\[(\w+)\]", next(iter(s))))), None)
            for c in places:
                names[c], units[c] = CLOCK, period[1] if period else "s"
    return replace(plain, names=names, units=units, steps=_steps(names, others, plain.dialect))


def _steps(
    names: list[str], others: list[list[str]], dialect: Dialect
) -> tuple[float, float] | None:
    """Start and increment that oscilloscopes write beside the names of their channels."""
    place = {name.lower(): c for c, name in enumerate(names)}
    for row in others:
        start, step = (
            dialect.number(row[place[key]]) if key in place else None
            for key in ("start", "increment")
        )
        if start is not None and step is not None and step > 0:
            return start, step
    return None


def _is_unit(text: str) -> bool:
    """Whether a field is a unit, also in brackets."""
    inside = text.strip()
    bracket = inside[:1] + inside[-1:] in ("[]", "()")
    inside = inside.strip("[]()").strip()
    if not inside:
        return bracket
    if len(inside) > 12 or (len(inside) == 1 and inside.isupper() and inside not in "NAVWK"):
        return False
    try:
        parse_unit(inside)
    except LogError:
        return bracket and len(inside) <= 8
    return True


def is_clock_name(name: str) -> bool:
    """Whether a column is called as clocks are: t, time_s, Time CH2, Zeit."""
    return bool(_TIME_NAME.match(name.strip())) or name == CLOCK


def _period(preamble: Sequence[str], dialect: Dialect) -> float | None:
    """Time between samples that the lines above the table state [s]."""
    for line in preamble:
        name = _PERIOD.search(line)
        if name is None:
            continue
        cells = dialect.split(line)
        if len(cells) > 1 and _PERIOD.match(cells[0]) and dialect.number(cells[1]) is not None:
            value, unit = dialect.number(cells[1]), named_unit(cells[0])[1]
            unit = unit or (cells[2] if len(cells) > 2 and _is_unit(cells[2]) else "")
        elif amount := _AMOUNT.match(line[name.end() :]):
            value, unit = Dialect(" ").number(amount[1]), amount[2]
        else:
            continue
        rate = "rate" in name[0].lower() or "freq" in name[0].lower()
        try:
            known = parse_unit(unit) if unit else Unit("Hz" if rate else "s", 1.0)
        except LogError:
            continue
        if value is not None and value > 0 and known.symbol in ("Hz", "s", ""):
            amount_si = value * known.factor
            return 1 / amount_si if rate or known.symbol == "Hz" else amount_si
    return None
