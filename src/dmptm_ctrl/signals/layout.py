"""Where the rows of numbers are in a text file."""

import re
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace

from dmptm_ctrl.signals.clock import MAX_BRIDGED
from dmptm_ctrl.signals.dialect import (
    Block,
    Dialect,
    Layout,
    TextFormat,
    bare,
    says_nothing,
    trimmed,
    with_units,
)
from dmptm_ctrl.signals.errors import NotALogError
from dmptm_ctrl.signals.header import SEP_LINE, SEPARATORS, layout_of

# decimal sign, sign between thousands; the plainest that reads everything is taken
NUMBERS = ((".", ""), (",", ""), (".", ","), (",", "."), (".", "'"), (".", " "), (",", " "))
_PLACE = re.compile(r"column\d+")
_FRAME = re.compile(  # candump, Vector's .asc
    r"\b\w*can\d+\s+[\dA-F]{3,8}(#|\s+\[\d+\])|^\s*[\d.]+\s+\d+\s+[\dA-Fa-f]{3,8}x?\s+[RT]x\s"
)
STEADY = 10  # rows of one kind in a row that are the table and no part of the preamble


def find_layout(
    lines: Sequence[str], source: str, how: TextFormat, wanted: Collection[str] = ()
) -> Layout:
    """Find the table in the first lines of a file.

    `wanted` columns say which of several lines of names is meant. NotALogError without numbers,
    LogError for names that do not fit the rows.
    """
    if sum(bool(_FRAME.search(line)) for line in lines[:50]) > 0.5 * len(lines[:50]):
        raise NotALogError(
            f"{source}: frames of a CAN bus; decode them by their .dbc file, as cantools and "
            "asammdf do, and save the signals as CSV or MF4"
        )
    if wanted and all(_PLACE.fullmatch(name) for name in wanted):
        how = replace(how, header=0)  # who counts columns knows of no names
    best = None
    for dialects in _dialects(lines, how):
        blocks = [b for d in dialects if (b := _block(lines, d, how)) is not None]
        # of equals, the first
        best = max([*([best] if best else []), *blocks], key=lambda b: b.score, default=None)
        if best is not None and best.score[0] > 0.99:
            break
    if best is None or (best.score[0] < 0.5 and len(best.rows) < STEADY):  # prose
        given = ", ".join(f"{k} = {v!r}" for k, v in vars(how).items() if v not in (None, 0))
        what = "no rows of numbers" if any(s.strip() for s in lines) else "the file is empty"
        what += f", read with {given} of [data] in the rig file" * bool(given)
        raise NotALogError(f"{source}: {what}")
    if how.decimal is None and _groups(best):
        sign = best.dialect.decimal
        dialect = best.dialect._replace(decimal="." if sign == "," else ",", thousands=sign)
        grouped = _block(lines, dialect, how)
        best = grouped if grouped is not None and grouped.score >= best.score else best
    return layout_of(lines, best, source, how, wanted)


def _groups(block: Block) -> bool:
    """Whether a decimal sign can only be one between thousands: 998, 999, 1.000."""
    thousands = re.compile(rf"[-+]?[1-9]\d{{0,2}}(\{block.dialect.decimal}\d{{3}})")
    for c, kind in enumerate(block.kinds):
        cells = [row[c] for row in block.rows if row[c]]
        parted = [cell for cell in cells if block.dialect.decimal in cell]
        zero = any(cell.endswith("0") for cell in parted)
        # fixed decimals are written everywhere, and others without a 0 at their end
        if kind == "number" and len(parted) < len(cells) and zero:
            return not block.dialect.thousands and all(map(thousands.fullmatch, parted))
    return False


def _dialects(lines: Sequence[str], how: TextFormat) -> Iterator[list[Dialect]]:
    """Ways to write numbers, the usual ones first."""
    declared = next((m[1] for s in lines[:3] if (m := SEP_LINE.match(s))), None)
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
    start = max(how.skip, how.header or 0)
    yield [u for d in plain if (u := with_units(d, lines[start:])) is not None]


def _block(lines: Sequence[str], dialect: Dialect, how: TextFormat) -> Block | None:
    """Rows of the commonest shape; None where no column holds numbers."""
    start = max(how.skip, how.header or 0)
    numbered = enumerate(lines[start:], start)
    rows = [(i, dialect.split(s)) for i, s in numbered if not says_nothing(s)]
    kinds = [[dialect.kind(cell) for cell in row] for _, row in rows]
    fields = Counter(len(k) for k in kinds if "number" in k).most_common(1)
    if not fields:
        return None
    width = _whole(rows, kinds, fields[0][0])
    alike = [k for k in kinds if len(k) == width and "number" in k]
    column = [_kind_of([k[c] for k in alike if k[c]]) for c in range(width)]
    while column and column[-1] == "":
        column.pop()
    if "number" not in column:
        return None
    column = [kind or "number" for kind in column]

    def regular(kind: list[str]) -> bool:
        return (
            not {*kind[width:]} - {"text", ""}  # a remark behind the row
            and len(kind) >= width
            and any(x in ("number", "time") for x in kind)
            and not any(x == "text" != of for x, of in zip(kind, column, strict=False))
        )

    good = [regular(k) for k in kinds]
    runs = _runs(good)
    if not runs:
        return None
    enough = min(STEADY, max(stop - begin for begin, stop in runs))
    steady = next(b for b, stop in runs if stop - b >= enough)
    full = (len(trimmed(row)) == len(column) for _, row in rows)
    named = [{*kind} == {"text"} and whole for kind, whole in zip(kinds, full, strict=True)]
    begin, parted = steady, False
    for i in range(steady - 1, -1, -1):  # blank lines between alike rows part nothing
        if good[i] and kinds[i][:width] == kinds[steady][:width]:
            if parted and not _goes_on(dialect, [rows[k][1][0] for k in (i, begin, begin + 1)]):
                break
            begin, parted = i, False
        elif any(kinds[i]):
            if named[i] and not any(named[:i]):
                break
            parted = True  # by a remark, or names that were written again
    first = rows[begin][0]
    body = [row for (_, row), ok in zip(rows[begin:], good[begin:], strict=True) if ok]
    said = [{r[c] for r in body} if of == "text" else set() for c, of in enumerate(column)]
    constant = [texts.pop() if len(texts) == 1 else "" for texts in said]
    cells = Counter(
        kind
        for row, ok in zip(kinds[begin:], good[begin:], strict=True)
        for c, kind in enumerate(row[: len(column)])
        if ok and kind and not constant[c]
    )
    others = sum(any(row) for _, row in rows[begin:]) - len(body)
    share = 1 - (cells["text"] + others) / max(sum(cells.values()), 1)
    above = {len(trimmed(dialect.split(bare(s)))) for s in lines[start:first]}
    has_names = len(column) in above or how.header is not None
    values = sum(kind != "text" for kind in column)
    # columns without a value that have a name
    column += ["text"] * max([w - len(column) for w in above if w <= width], default=0)
    constant += [""] * (len(column) - len(constant))
    tabs = dialect.separator == " " and any("\t" in lines[i] for i, _ in rows[begin : begin + 9])
    score = (round(share, 2), has_names, values * (not tabs))
    return Block(score, dialect, first, width, column, constant, body)


def _goes_on(dialect: Dialect, clock: list[str]) -> bool:
    """Whether a row comes just before another and the one after it, by their first cells."""
    before, here, after = (dialect.number(cell) for cell in clock)
    if before is None or here is None or after is None:
        return clock[0] < clock[1] and {dialect.kind(cell) for cell in clock} == {"time"}
    return 0 < here - before <= (MAX_BRIDGED + 1) * (after - here)


def _whole(rows: list[tuple[int, list[str]]], kinds: list[list[str]], width: int) -> int:
    """Fields of whole rows; fill up those after which a column of a slower clock has ended."""

    def numbers(i: int) -> bool:
        return "number" in kinds[i] and "text" not in kinds[i]

    top = next(i for i, kind in enumerate(kinds) if len(kind) == width and "number" in kind)
    while top and numbers(top - 1) and len(kinds[top - 1]) >= len(kinds[top]):
        top -= 1
    whole = len(kinds[top])
    if whole > width:
        for i in filter(numbers, range(top, len(kinds))):
            lacking = [""] * (whole - len(kinds[i]))
            kinds[i] += lacking
            rows[i] = rows[i][0], rows[i][1] + lacking
    return whole


def _kind_of(cells: list[str]) -> str:
    """Kind of most cells of a column; "" where all are empty."""
    counted = Counter(cells)
    if not counted:
        return ""
    if counted["text"] > 0.3 * len(cells):
        return "text"
    return "time" if counted["time"] > counted["number"] else "number"


def _runs(good: list[bool]) -> list[tuple[int, int]]:
    """Begin and end of each run of rows of numbers."""
    edges = [i for i in range(len(good) + 1) if (i and good[i - 1]) != (i < len(good) and good[i])]
    return list(zip(edges[::2], edges[1::2], strict=True))
