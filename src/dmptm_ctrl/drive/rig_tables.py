"""Tables of a rig file: keys, numbers with units, and messages that name the line."""

import difflib
import re
from collections.abc import Mapping, Sequence
from math import inf
from typing import Any, NoReturn

from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import DataSpec
from dmptm_ctrl.drive.rig_units import UnitError, factor, quantity
from dmptm_ctrl.signals import LogError, TextFormat
from dmptm_ctrl.signals.units import TICKS, parse_unit, split_column


class RigError(LogError):
    """A rig file cannot be used; the message names the line, the key and what would be right."""


_DATA = (
    *("time", "sample_time", "sample_rate", "fit", "held_out", "ignore", "start", "stop"),
    *("header", "separator", "decimal", "skip"),
)
_SEPARATORS = {"tab": "\t", "blank": " ", "space": " ", "comma": ",", "semicolon": ";"}


class TableReader:
    """Reads tables; knows where in the file it is, for messages."""

    def __init__(self, text: str, source: str) -> None:
        self._lines = text.splitlines()
        self._source = source

    def fail(self, where: str, key: str, message: str) -> NoReturn:
        """Refuse the file for what a key of a table says."""
        line = _line_of(self._lines, where, key)
        place = f"{self._source}, line {line}" if line else self._source
        table = f"[{where}] " if where else ""
        raise RigError(f"{place}: {table}{message}")

    def tables(self, raw: dict[str, Any], kind: str) -> dict[str, dict[str, Any]]:
        """[kind.NAME] tables, or [[kind]] with a name in each."""
        found = raw.get(kind, {})
        if isinstance(found, list):
            named = {}
            for table in found:
                if not isinstance(table, dict) or not isinstance(table.get("name"), str):
                    self.fail(kind, "name", f"each [[{kind}]] needs a name")
                named[table["name"]] = {k: v for k, v in table.items() if k != "name"}
            return named
        if not isinstance(found, dict) or not all(isinstance(t, dict) for t in found.values()):
            self.fail(kind, "", f"write [{kind}.NAME] and its keys below, NAME your own")
        return found

    def data(self, raw: Any) -> DataSpec:
        """How logs come in, of the table [data]."""
        t = Table(self, "data", raw, _DATA)
        time = t.get("time")
        if isinstance(time, str):
            split = split_column(time)
            time = (time, "" if split is None else split[1].symbol and suffix_unit(time))
        elif isinstance(time, dict):
            time = (Table(self, "data", time).text("column"), str(time.get("unit", "")))
            if time[1].lower() not in ("", *TICKS):
                try:
                    factor(time[1], "s")
                except UnitError as error:
                    t.fail("time", str(error))
        elif time is not None:
            t.fail("time", 'time = "t" or { column = "t", unit = "ms" }')
        step, rate = t.number("sample_time", "s"), t.number("sample_rate", "Hz")
        if rate is not None:
            if step is not None or not rate.value > 0:
                t.fail("sample_rate", "sample_rate above 0, or sample_time, not both")
            step = Quantity(1 / rate.value, "s", 0.0, "sample_rate")
        names = {}
        for key in ("fit", "held_out", "ignore"):
            value = t.get(key, [])
            value = [value] if isinstance(value, str) else value
            if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
                t.fail(key, f'{key} = ["name", "pattern*"], names of logs')
            names[key] = tuple(value)
        return DataSpec(
            time, step.value if step else None, names["fit"], names["held_out"], names["ignore"],
            _per_log(t, "start"), _per_log(t, "stop"), _text_format(t),
        )  # fmt: skip


class Table(dict[str, Any]):
    """A table of a file, with these `keys` (none: any); refuses what it cannot read."""

    def __init__(self, file: TableReader, where: str, raw: Any, keys: Sequence[str] = ()) -> None:
        if not isinstance(raw, dict):
            file.fail("", where, f"[{where}] is a table")
        super().__init__(raw)
        self._file, self._where = file, where
        for key in raw if keys else ():
            if key not in keys:
                near = difflib.get_close_matches(key, keys, 1)
                hint = f"did you mean {near[0]!r}? " if near else ""
                self.fail(key, f"no key {key!r} here; {hint}keys are {', '.join(keys)}")

    def fail(self, key: str, message: str) -> NoReturn:
        """Refuse the file for what a key says."""
        self._file.fail(self._where, key, message)

    def either(self, key: str, *others: str) -> None:
        """Refuse keys that say what another one says."""
        for other in others:
            if key in self and other in self:
                self.fail(other, f"give either {key} or {other}")

    def known(self, key: str, name: Any, things: Mapping, kind: str) -> None:
        """Refuse a name of nothing."""
        if name not in things:
            self.fail(key, f"no {kind} {name!r}; there are {', '.join(things)}")

    def column_unit(self, column: str, implied: str | None = None) -> tuple[str, str]:
        """Unit of a column as the loaders take it, and its SI symbol."""
        unit = self.get("unit", suffix_unit(column) or implied)
        if unit is None:
            self.fail(
                "unit",
                f'column {column!r} states no unit; add one: "V", "deg" of angle, "deg/s" of speed',
            )
        if not isinstance(unit, str):
            self.fail("unit", f"unit = {unit!r} is no text; write it in quotes")
        try:
            return unit, parse_unit(unit).symbol
        except ValueError as error:
            other = (
                'for one of your own give a known one and scale, as in unit = "deg", scale = 0.001'
            )
            self.fail("unit", f"{error}; {other}")

    def sign(self) -> float:
        """Factor on a column."""
        sign, scale = self.get("sign", 1), self.get("scale", 1)
        if isinstance(sign, bool) or sign not in (1, -1):
            self.fail("sign", f"sign = 1 or -1, not {sign!r}; scale takes any factor")
        number = isinstance(scale, int | float) and not isinstance(scale, bool)
        if not number or not 0 < abs(scale) < inf:
            self.fail("scale", "scale is a number other than 0")
        return float(sign) * float(scale)

    def text(self, key: str) -> str:
        """Text that must be there."""
        value = self.get(key)
        if not isinstance(value, str) or not value:
            self.fail(key, f'{key} = "name in the log" is needed')
        return value

    def need(self, key: str, si: str, **how: Any) -> Quantity:
        """Number that must be there, in a unit."""
        if key not in self:
            self.fail(key, f"{key} = '… {si}' is needed")
        return self.read(key, self[key], si, **how)

    def number(self, key: str, si: str) -> Quantity | None:
        """Number in a unit, None if it is not there."""
        return self.read(key, self[key], si) if key in self else None

    def read(self, key: str, value: Any, si: str, **how: Any) -> Quantity:
        """Value of a key as a number in a unit."""
        try:
            return quantity(value, si, **how)
        except UnitError as error:
            self.fail(key, f"{key}: {error}")


def _per_log(t: Table, key: str) -> dict[str, float]:
    """Seconds for all logs, or in a table for some: start = { run_a = 1.5 }."""
    given = t.get(key, {})
    table = given if isinstance(given, dict) else {"*": given}
    return {str(n): t.read(key, v, "s").value for n, v in table.items()}


def _text_format(t: Table) -> TextFormat:
    for key in ("header", "skip"):
        value = t.get(key, 0)
        if isinstance(value, bool) or not isinstance(value, int) or value < 0:
            t.fail(key, f"{key} = {value!r} is no number of lines")
    separator, decimal = t.get("separator"), t.get("decimal")
    if separator is not None:
        separator = _SEPARATORS.get(str(separator).lower(), separator)
        if not isinstance(separator, str) or len(separator) != 1 or separator in "0123456789.":
            t.fail("separator", 'separator = ";", ",", "|", "tab" or "blank"')
    if decimal not in (None, ".", ","):
        t.fail("decimal", 'decimal = "." or ","')
    return TextFormat(t.get("header"), separator, decimal, t.get("skip", 0))


def suffix_unit(column: str) -> str:
    """Unit that a column's name ends in, as the loaders spell it: omega_deg_s → deg_s."""
    split = split_column(column)
    return column[len(split[0]) + 1 :] if split is not None else ""


_HEADER = re.compile(r"^\s*\[\[?\s*(.+?)\s*\]\]?\s*(?:#.*)?$")


def _line_of(lines: list[str], where: str, key: str) -> int:
    """Line number of a key, else of its table; 0 where neither is found."""
    here, table_line, name = "", 0, where.rpartition(".")[2]
    for number, line in enumerate(lines, start=1):
        header = _HEADER.match(line)
        if header:
            here = header[1].replace('"', "").replace("'", "").replace(" ", "")
            if here == where:
                table_line = number
            if not where and key and here.partition(".")[0] == key:
                return number
            continue
        own = re.match(rf"^\s*[\"']?name[\"']?\s*=\s*[\"']{re.escape(name)}[\"']", line)
        if own and here == where.partition(".")[0] and here:
            here, table_line = where, number  # [[body]] with its name
        if here == where and key and re.match(rf"^\s*[\"']?{re.escape(key)}[\"']?\s*[=.]", line):
            return number
        dotted = rf"^\s*{re.escape(where)}\.{re.escape(key)}\s*="
        if where and key and re.match(dotted, line):
            return number
    return table_line
