"""Read the [data] table of a rig file: which logs, which part of them, how the text is read."""

from typing import Any

from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import DataSpec
from dmptm_ctrl.drive.rig_tables import TableReader, suffix_unit
from dmptm_ctrl.signals import TextFormat
from dmptm_ctrl.signals.units import TICKS, split_column

_DATA = (
    *("time", "sample_time", "sample_rate", "fit", "held_out", "ignore", "start", "stop"),
    *("header", "separator", "decimal", "skip"),
)
_SEPARATORS = {"tab": "\t", "blank": " ", "space": " ", "comma": ",", "semicolon": ";"}


class DataReader(TableReader):
    """What [data] stands for."""

    def _data(self, raw: Any) -> DataSpec:
        where = "data"
        if not isinstance(raw, dict):
            self._fail("", where, "[data] is a table")
        self._only(where, raw, _DATA)
        time = raw.get("time")
        if isinstance(time, str):
            split = split_column(time)
            time = (time, "" if split is None else split[1].symbol and suffix_unit(time))
        elif isinstance(time, dict):
            column = self._text(where, time, "column")
            time = (column, str(time.get("unit", "")))
            if time[1].lower() not in ("", *TICKS):
                self._check_unit(where, "time", time[1], "s")
        elif time is not None:
            self._fail(where, "time", 'time = "t" or { column = "t", unit = "ms" }')
        step = self._number(where, raw, "sample_time", "s")
        rate = self._number(where, raw, "sample_rate", "Hz")
        if rate is not None:
            if step is not None or not rate.value > 0:
                self._fail(where, "sample_rate", "sample_rate above 0, or sample_time, not both")
            step = Quantity(1 / rate.value, "s", 0.0, "sample_rate")
        names = {}
        for key in ("fit", "held_out", "ignore"):
            value = raw.get(key, [])
            value = [value] if isinstance(value, str) else value
            if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
                self._fail(where, key, f'{key} = ["name", "pattern*"], names of logs')
            names[key] = tuple(value)
        return DataSpec(
            time, step.value if step else None, names["fit"], names["held_out"], names["ignore"],
            self._per_log(raw, "start"), self._per_log(raw, "stop"), self._text_format(raw),
        )  # fmt: skip

    def _per_log(self, raw: dict[str, Any], key: str) -> dict[str, float]:
        """Seconds for all logs, or in a table for some: start = { run_a = 1.5 }."""
        given = raw.get(key, {})
        table = given if isinstance(given, dict) else {"*": given}
        return {str(n): self._read("data", key, v, "s").value for n, v in table.items()}

    def _text_format(self, raw: dict[str, Any]) -> TextFormat:
        where = "data"
        for key in ("header", "skip"):
            value = raw.get(key, 0)
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                self._fail(where, key, f"{key} = {value!r} is no number of lines")
        separator, decimal = raw.get("separator"), raw.get("decimal")
        if separator is not None:
            separator = _SEPARATORS.get(str(separator).lower(), separator)
            if not isinstance(separator, str) or len(separator) != 1 or separator in "0123456789.":
                self._fail(where, "separator", 'separator = ";", ",", "|", "tab" or "blank"')
        if decimal not in (None, ".", ","):
            self._fail(where, "decimal", 'decimal = "." or ","')
        return TextFormat(raw.get("header"), separator, decimal, raw.get("skip", 0))
