"""What the columns of a text file are called, and in which units they are."""

import itertools
import re
from collections.abc import Collection, Sequence
from dataclasses import replace

from dmptm_ctrl.signals.columns import CLOCK
from dmptm_ctrl.signals.dialect import (
    Block,
    Dialect,
    Layout,
    TextFormat,
    bare,
    trimmed,
)
from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.units import COUNTS, FOREIGN, Unit, named_unit, unit_of

SEPARATORS = (";", "\t", ",", "|", " ")
FILE_TIME = 1e16  # a clock without a name that reads more counts ticks since 1601
SEP_LINE = re.compile(r'(?i)\ufeff?"?sep=(.)"?\s*$')
_TYPE = re.compile(r"(?i)(l?real|[us]?[dls]?int|float|double|bool|lword|dword|word)\d*$")
_TIME_NAME = re.compile(r"(?i)(time|zeit|uhrzeit|timestamp|x_value|t)(\W|_|\d|$)")
_PERIOD = re.compile(
    r"(?i)sampl\w*[ _-]?(time|period|interval|rate|frequency)|delta_x|\b[tx]inc\b"
    r"|abtast(zeit|rate|frequenz|intervall|periode)"
)
_LABEL = re.compile(r"(?i)_?(var|signal|tag|channel|field|name|item|topic|kanal|sensor|metric|key)")
_VALUE = re.compile(r"(?i)\w*(val|wert|reading)")
_KIND = re.compile(r"(?<=\S) \([A-Z][a-z]+\)$")  # TwinCAT: V (Voltage)
_AMOUNT = re.compile(r"[\s:=,;\"]*(?:is\s+)?([-+]?[\d.]+(?:[eE][-+]?\d+)?)\s*([a-zA-Zµ]*)")


def layout_of(
    lines: Sequence[str], block: Block, source: str, how: TextFormat, wanted: Collection[str]
) -> Layout:
    """Layout with names and units from the lines above the first row of numbers."""
    nothing = [""] * block.width
    layout = Layout(
        nothing, nothing, block.dialect, block.first, block.kinds, block.fields,
        _period(lines[: block.first], block.dialect),
        wordy=_wordy(lines[how.skip : block.first], block),
    )  # fmt: skip
    if block.kinds == ["text", "number"] and (long := _long(["", ""], block, wanted)):
        return replace(layout, long=long)
    values = [c for c, kind in enumerate(block.kinds) if kind != "text"]
    clocks = {c for c, kind in enumerate(block.kinds) if kind == "time"}  # a date is no name
    said = ["", *(n.rstrip(":=") for n in block.constant[:-1])]
    beside = ["" if c in clocks else name for c, name in enumerate(said)]
    if all(said[c] for c in values) or (block.dialect.pairs and sum(map(bool, beside)) > 1):
        # pairs may follow a time and a level
        return _finished(replace(layout, names=beside), block, wanted)
    if how.header is not None:
        rows = [trimmed(block.dialect.split(bare(s))) for s in lines[: how.header][-1:]]
    else:
        rows = _candidates(lines, block)
        last = next((s for s in lines[: block.first][::-1] if s.strip() and bare(s) is s), "")
        given = len(trimmed(block.dialect.split(last)))
        if not rows and given > 1 and not SEP_LINE.match(last):
            raise LogError(
                f"{source}: the header names {given} columns, the first "
                f"row has {block.width} values; if another line holds the names, write its number "
                "in [data] of the rig file, as in header = 3, or header = 0 for none"
                + "; a comma before decimals needs another separator than a comma"
                * (block.dialect.separator == "," and given < block.width)
            )
    found = _from_rows([_fitted(r, block.width) for r in rows], layout, wanted)
    return _finished(replace(found, steps=_steps(rows, block.dialect)), block, wanted)


def _finished(found: Layout, block: Block, wanted: Collection[str]) -> Layout:
    """Layout with a name for its clock, units of its cells, and what makes it a long table."""
    names, units = list(found.names), list(found.units)
    for c, unit in enumerate(block.dialect.units[: block.width]):
        units[c] = unit or units[c]
    for c, name in enumerate(names):
        if name == CLOCK and (block.dialect.number(block.rows[0][c]) or 0.0) > FILE_TIME:
            units[c] = "ticks"
    dates = block.kinds[0] == "time" and block.kinds.count("time") == 1
    seconds = (first := unit_of(units[0])) is not None and first.symbol == "s"
    if found.steps is not None:
        names[0], units[0] = CLOCK, "s"
    elif names[0] == "" and (dates or seconds):
        names[0] = CLOCK
    long = _long(names, block, wanted)
    others = [c for c, kind in enumerate(block.kinds) if kind == "number" and c not in (long or ())]
    if long is not None and len(others) == 1 and not names[others[0]]:
        names[others[0]] = CLOCK
    return replace(found, names=names, units=units, long=long)


def _long(names: Sequence[str], block: Block, wanted: Collection[str]) -> tuple[int, int] | None:
    """Columns of the names and the values, where each row holds one value of one signal."""
    numbers = [c for c, kind in enumerate(block.kinds) if kind == "number"]
    value = next((c for c in numbers if _VALUE.match(names[c])), numbers[-1])
    labelled = len(block.kinds) == 2 or _VALUE.match(names[value])
    for c in (c for c, kind in enumerate(block.kinds) if kind == "text"):
        said = {row[c].rstrip(":=") for row in block.rows}
        few = 1 < len(said) <= len(block.rows) / 4 and (not names[c] or _LABEL.match(names[c]))
        if said & {*wanted} - {*names} or (labelled and few):
            return c, value
    return None


def _candidates(lines: Sequence[str], block: Block) -> list[list[str]]:
    """Rows of text above the table that have as many fields, the nearest first."""
    used = max(c for c, kind in enumerate(block.kinds) if kind != "text") + 1
    found: dict[tuple[bool, ...], list[list[str]]] = {}
    for line in reversed(lines[: block.first]):
        if not line.strip() or SEP_LINE.match(line):
            continue
        comment = bare(line) is not line
        for separator in dict.fromkeys((block.dialect.separator, *SEPARATORS)):
            dialect = block.dialect._replace(separator=separator)
            if separator == " " and dialect != block.dialect and block.dialect.separator in line:
                continue  # a sentence
            fields = dialect.split(bare(line))
            if len(fields) != block.width:
                fields = trimmed(fields)
            short, other = len(fields) < used, dialect != block.dialect
            fits = len(fields) == block.width if comment or other else not short
            fits = fits or (len(fields) == block.width - 1 and _counts_rows(block))
            if fits and any(dialect.kind(f) == "text" for f in fields):
                loose = sum(f[-1:] in SEPARATORS for f in fields if f)
                found.setdefault((comment, short, loose > 0, other), []).append(fields)
    # names without the sign of a comment, as many as columns, come first
    return found[min(found)] if found else []


def _wordy(above: Sequence[str], block: Block) -> int:
    def is_row(line: str) -> bool:
        kinds = [block.dialect.kind(cell) for cell in block.dialect.split(line)]
        alike = len(kinds) == block.fields and block.kinds[0] == kinds[0] != "text"
        return alike and "number" in kinds

    return sum(1 for _ in itertools.takewhile(is_row, reversed(above)))


def _counts_rows(block: Block) -> bool:
    """Whether the first column numbers or names the rows, as R writes it without a name."""
    if block.kinds[0] in ("text", "time"):
        return True
    first = [block.dialect.number(r[0]) for r in block.rows]
    return len(first) > 2 and all(
        a is not None and b is not None and b - a == 1 for a, b in itertools.pairwise(first)
    )


def _fitted(row: list[str], width: int) -> list[str]:
    """As many names as columns; one less: the first column counts the rows."""
    if len(row) == width - 1 and width > 1:
        return ["", *row]
    if len(row) == width + 1 and not _is_unit(row[0]) and all(map(_is_unit, row[1:])):
        return row[1:]  # what the row is, before the units
    if len(row) == 2 * width and len({*row[::2]}) == 1:
        return row[1::2]  # clocks that were not exported still have their labels
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
        # a label before each channel, as Unit, is no unit
        label = row[0] if row.count(row[0]) > 1 and not _is_unit(row[0]) else ""
        given = [n for n in row if n not in ("", label)]
        texts = [n for n in given if plain.dialect.number(n) in (None, 1.0)]  # 1: no unit
        if sum(_is_unit(n) for n in texts) > len(given) / 2:
            units = [
                u or (_KIND.sub("", n).strip("[]()") if _is_unit(n) else "")
                for u, n in zip(units, row, strict=True)
            ]
    twice = {n for n in best if n and best.count(n) > 1}
    if twice and all(map(_is_unit, best)):  # Second,Volt,Volt
        return replace(plain, units=best)
    names = list(best)
    for c, name in enumerate(names):
        if name.startswith("in ") and _is_unit(name[3:]):
            names[c], units[c] = "", name[3:]
    # Labels of rows stand where clocks have no name: "Name", "Data-Type", "SampleTime[ms]".
    for name in twice | {n for n in best[:1] if n.lower() == "name"}:
        places = [c for c, n in enumerate(best) if n == name]
        said = [[r[c] for c in places] for r in others]
        same = sum(len({*s}) == 1 for s in said)  # a comma in a time may shift a row
        if places[0] == 0 and same > len(said) / 2:
            stated = (m[1] for s in said if (m := re.search(r"\[(\w+)\]", s[0])))
            ticks = (u for u in stated if (unit := unit_of(u)) is not None and unit.symbol == "s")
            period = next(ticks, "s")  # others state sizes, in bytes
            for c in places:
                names[c], units[c] = CLOCK, period
    # what has no name in its row may have one in a row beside it
    for c in (c for c, n in enumerate(names) if not n):
        beside = (r[c] for r in others if plain.dialect.kind(r[c]) == "text")
        names[c] = next((t for t in beside if not _is_unit(t)), "")
    return replace(plain, names=names, units=units)


def _steps(rows: list[list[str]], dialect: Dialect) -> tuple[float, float] | None:
    """Start and increment that oscilloscopes write beside the names of their channels."""
    for row, below in itertools.permutations(rows, 2):
        beside = dict(zip(map(str.lower, row), map(dialect.number, below), strict=False))
        start, step = beside.get("start"), beside.get("increment")
        if start is not None and step is not None and step > 0:
            return start, step
    return None


def _is_unit(text: str) -> bool:
    """Whether a field is a unit, also in brackets."""
    inside = _KIND.sub("", text.strip())
    bracket = inside[:1] + inside[-1:] in ("[]", "()")
    inside = inside.strip("[]()").strip()
    if not inside:
        return bracket
    if inside.lower() in FOREIGN or inside.lower().partition("/")[0] in COUNTS:
        return True
    if len(inside) > 12 or (len(inside) == 1 and inside.isupper() and inside not in "NAVWK"):
        return False
    return unit_of(inside) is not None or (bracket and len(inside) <= 8)


def is_clock_name(name: str) -> bool:
    """Whether a column is called as clocks are: t, time_s, Time CH2, Zeit; T_Nm is a torque."""
    if name == CLOCK:
        return True
    if not _TIME_NAME.match(name.strip()):
        return False
    unit = unit_of(named_unit(name)[1] or name.rpartition("_")[2])
    return unit is None or unit.symbol == "s"


def clock_word(name: str) -> str:
    """Word by which a column is called a clock, as it is written: clocks of channels share it."""
    found = _TIME_NAME.match(name.strip())
    return found[1] if found else name


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
        known = unit_of(unit) if unit else Unit("Hz" if rate else "s", 1.0)
        if value is not None and value > 0 and known and known.symbol in ("Hz", "s", ""):
            amount_si = value * known.factor
            return 1 / amount_si if rate or known.symbol == "Hz" else amount_si
    return None
