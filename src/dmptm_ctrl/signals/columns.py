"""From columns as a file names them to channels in SI."""

import difflib
import re
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.signals.errors import ColumnsError, LogError, repeated
from dmptm_ctrl.signals.units import (
    CANONICAL,
    COUNTS,
    SUFFIXES,
    Unit,
    expected_symbol,
    named_unit,
    parse_unit,
    split_column,
    unit_of,
)


class Column(NamedTuple):
    """Where a column of a file goes: value_SI = scale · factor of the unit · value."""

    channel: str
    unit: str  # of the column
    scale: float = 1.0  # such as a sign


class Target(NamedTuple):
    """A column resolved: its channel, the SI symbol and the factor to SI."""

    channel: str
    symbol: str
    factor: float


# A reader calls it with the file's columns and stated units; it returns the columns to read.
Choose = Callable[[list[str], Mapping[str, str]], list[str]]


class Table(NamedTuple):
    """What a file holds."""

    columns: dict[str, Any]  # by their own names
    units: dict[str, str]  # where the file states them
    meta: dict[str, Any]
    notes: tuple[str, ...] = ()  # what was left out
    # times of the columns that have another clock than the table's
    clocks: Mapping[str, Any] = MappingProxyType({})
    period: float | None = None  # time between samples that the file states [s]
    words: Mapping[str, str] = MappingProxyType({})  # among the numbers of columns, and where


CLOCK = "(clock)"  # a clock without a name of its own
TIMES = "(times)"  # instead of the unit of a column of dates or times of day
_BESIDE = " #%"  # blanks and signs of comments around names
CLOCKS = ("t", "time", "tout", "_time", "zeit", "uhrzeit", "timestamp", "datetime", "date", "datum")
_BRACKET = re.compile(r"\s*[\[(][^\[\]()]*[\])]$")  # a unit, known or not
Mapped = Mapping[str, "Column | tuple | str"]


def as_columns(mapping: Mapped | None, source: str) -> dict[str, Column]:
    """Mapping of columns in one form; LogError for a target that is no NAME_UNIT."""
    columns = {}
    for column, target in (mapping or {}).items():
        if isinstance(target, str):
            split = split_column(target)
            if split is None:
                raise LogError(
                    f"{source}: column {column!r} is mapped to {target!r}, not a NAME_UNIT"
                )
            target = split[0], target[len(split[0]) + 1 :]
        columns[column] = Column(*target)
    return columns


def resolve(
    names: Sequence[str],
    mapping: Mapping[str, Column] | None,
    units: Mapping[str, str],
    source: str,
) -> tuple[dict[str, Target], list[str]]:
    """Decide which columns of a file become channels, in its order; warnings besides.

    Of columns that a `mapping` does not name those of the paper's rig (time_s, u_left_V, …) go by
    their own names; without one all columns called NAME_UNIT do. LogError: a mapped column is not
    there, a unit is unknown or of another quantity, two columns have one name or channel.
    """
    if twice := repeated(sorted(filter(None, names))):
        raise LogError(f"{source}: column {twice!r} occurs {list(names).count(twice)} times")
    mapping = _as_named(names, dict(mapping or {}))
    missing = [column for column in mapping if column not in names]
    if missing:
        raise ColumnsError(f"{source}: no column {missing[0]!r}; {_near(missing[0], names)}")
    targets: dict[str, Target] = {}
    ignored, clocks, warnings = [], [], []
    clock = names_a_clock(mapping)
    for column in names:
        seen = {t.channel for t in targets.values()}
        if column in mapping:
            stated = units.get(column) or named_unit(column)[1]
            said = _in_its_unit(mapping[column], stated)
            targets[column] = _mapped(column, said, source)
            if other := _other_unit(said, stated):
                warnings.append(f"column {column!r} {other}")
        else:
            target = _by_name(column, units.get(column), source, strict=not mapping)
            if target is None or (mapping and target.channel not in CANONICAL):
                ignored.append(column)
            elif target.channel == "time" and (clock or "time" in seen):
                clocks.append(column)
            else:
                targets[column] = target
    _refuse_wrong(targets, source)
    if not clocks and not any(t.channel == "time" for t in targets.values()):
        free = [n for n in names if n not in mapping and n not in targets]
        if (found := _clock_of(free, [*names, ""][0], units)) is not None:
            factor = unit.factor if (unit := _unit_of(found, units)) is not None else 1.0
            targets[found] = Target("time", "s", factor)
            ignored = [n for n in ignored if n != found]
    if ignored and not mapping:
        warnings.append(
            f"ignored {listed(ignored)}: no known unit in the name, as in theta_L_deg or current_A"
        )
    if clocks and not mapping:
        warnings.append(f"ignored {listed(clocks)}: another clock")
    return targets, warnings


def names_a_clock(mapping: Mapping[str, Column]) -> bool:
    """Whether one of the columns is said to be the time."""
    return any(target.channel == "time" for target in mapping.values())


def _clock_of(names: Sequence[str], first: str, units: Mapping[str, str]) -> str | None:
    """Column that is the clock by its unit or, without one, by its name."""
    own = {n: _unit_of(n, units) for n in names}
    timed = [n for n, unit in own.items() if unit is not None and unit.symbol == "s"]
    dates = [n for n in names if units.get(n) == TIMES]
    named = [n for n in names if (n != "T" and n.lower() in CLOCKS) or n == CLOCK]
    best = [n for n in [*timed, *dates] if n.lower().startswith(CLOCKS)]
    best += [*(n for n in timed if n == first), *dates, *(n for n in named if own[n] is None)]
    return best[0] if best else None


def _unit_of(column: str, units: Mapping[str, str]) -> Unit | None:
    """Unit of a column, as the file or its name states it."""
    if stated := units.get(column) or named_unit(column)[1]:
        return unit_of(stated)
    split = split_column(column)
    return None if split is None else split[1]


def _as_named(names: Sequence[str], mapping: dict[str, Column]) -> dict[str, Column]:
    """Mapping with the names as the file has them: ``q [deg]`` where it says ``q``."""
    found = {}
    for column, target in mapping.items():
        if column not in names:
            alike = [n for n in names if n.strip(_BESIDE) == column.strip(_BESIDE)]
            alike = alike or [n for n in names if named_unit(n)[0] == column]
            alike = alike or [n for n in names if named_unit(column)[0] == n]
            alike = alike or [n for n in names if _BRACKET.sub("", n) == column]
            if not alike and target.channel == "time":
                alike = [n for n in names if n == CLOCK]
            column = alike[0] if len(alike) == 1 else column
        found[column] = target
    return found


def _in_its_unit(target: Column, stated: str) -> Column:
    """Target of a column; of a clock without a unit in that of the file, else in seconds."""
    if target.channel != "time" or target.unit:
        return target
    known = (unit := unit_of(stated)) is not None and unit.symbol == "s"
    return target._replace(unit=stated if known else "s")


def _other_unit(target: Column, stated: str) -> str:
    """How a unit that the file states contradicts the one that is used; empty if it does not."""
    try:
        used = parse_unit(target.unit)
        counted = used.symbol and stated.lower().partition("/")[0] in COUNTS
        # a scale is that of counts per turn
        unit = Unit("counts", 1.0) if counted and abs(target.scale) == 1 else parse_unit(stated)
    except LogError:
        return ""
    ratio = used.factor / unit.factor
    if not unit.symbol or (unit.symbol == used.symbol and abs(ratio - 1) < 1e-3):
        return ""
    taken = f"is in {stated} by the file, and taken in {target.unit or 'no unit'} as you say"
    times = f", {ratio:.6g} times that" if unit.symbol == used.symbol else ""
    return f"{taken}{times}; {_where_said(target.channel)} says the unit"


def _where_said(channel: str) -> str:
    """Where a rig file, or else the mapping, says the unit of a channel."""
    kind, _, name = channel.partition("_")
    table = {"in": "input", "out": "sensor"}.get(kind)
    return "time in [data]" if kind == "time" else f"[{table}.{name}]" if table else "the mapping"


def _mapped(column: str, target: Column, source: str) -> Target:
    unit, scale = parse_unit(target.unit), float(target.scale)
    if not np.isfinite(scale) or scale == 0:
        raise LogError(f"{source}: column {column!r} has the scale {scale}, not a number but 0")
    return Target(str(target.channel), unit.symbol, scale * unit.factor)


def _by_name(column: str, stated: str | None, source: str, *, strict: bool) -> Target | None:
    split = split_column(column)
    if split is None and stated == TIMES:
        return Target("time", "s", 1.0) if column.lower() in CLOCKS else None
    if split is None and stated:
        if (own := unit_of(stated)) is None:
            return None
        name = named_unit(column)[0]
        clock = column == CLOCK or (own.symbol == "s" and name.lower() in CLOCKS)
        return Target("time" if clock else name, own.symbol, own.factor)
    known = [c for c in CANONICAL if column == c or column.startswith(f"{c}_")]
    if split is not None:
        channel, unit = split
        if unit.symbol == "s" and channel.lower() in CLOCKS:
            channel = "time"
        if channel in CANONICAL or not known:
            return Target(channel, unit.symbol, unit.factor)
    if strict and known and column != "time":
        raise ColumnsError(
            f"{source}: column {column!r} ends in no known unit; write {known[-1]}_UNIT "
            f"with one of {', '.join(_suffixes_of(known[-1]))}"
        )
    return None


def _suffixes_of(channel: str) -> list[str]:
    return [suffix for suffix, unit in SUFFIXES.items() if unit.symbol == expected_symbol(channel)]


def _refuse_wrong(targets: Mapping[str, Target], source: str) -> None:
    seen: dict[str, str] = {}
    for column, target in targets.items():
        symbol = expected_symbol(target.channel)
        # ref is a speed on the paper's rig and may be a position elsewhere
        if symbol is not None and target.channel != "ref" and target.symbol != symbol:
            raise LogError(
                f"{source}: column {column!r} is in {target.symbol}, but {target.channel} is in "
                f"{symbol} or one of {', '.join(_suffixes_of(target.channel))}"
            )
        if target.channel in seen:
            raise LogError(
                f"{source}: columns {seen[target.channel]!r} and {column!r} are both "
                f"{target.channel}"
            )
        seen[target.channel] = column


def _near(name: str, names: Sequence[str]) -> str:
    """Columns that may be meant; else all."""
    alike = [n for n in names if name.lower() in n.lower()]
    alike = alike or difflib.get_close_matches(name, names, 3, 0.7)
    return f"did you mean {listed(alike, 3)}?" if alike else f"it has {listed(names)}"


def listed(names: Sequence[Any], most: int = 12) -> str:
    """Return the first names or numbers, and how many more there are."""
    shown = ", ".join(repr(name) for name in list(names)[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")
