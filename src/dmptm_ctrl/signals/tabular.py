"""Logs as tables: data frames, Parquet and JSON."""

import gzip
import json
import zlib
from pathlib import Path
from typing import Any

from dmptm_ctrl.signals.checks import MIN_SAMPLES
from dmptm_ctrl.signals.columns import CLOCK, CLOCKS, TIMES, Choose, Table
from dmptm_ctrl.signals.errors import LogError, NotALogError, optional, repeated

_INDEX = "__index_level_0__"  # pandas' name of an index without one
_GZIP = (EOFError, zlib.error, gzip.BadGzipFile)


def from_frame(frame: Any) -> Table:
    """Columns of a `pandas.DataFrame`; an index is a column, too, and a clock without a name."""
    try:
        frame = frame.to_pandas() if hasattr(frame, "to_pandas") else frame  # of polars or Arrow
        names = [str(column) for column in frame.columns]
        columns = {name: _values(frame.iloc[:, i]) for i, name in enumerate(names)}
        index = frame.index
        if index.name is not None or index.dtype.kind in "fmM":
            names.append(CLOCK if index.name is None else str(index.name))
            columns.setdefault(names[-1], _values(index.to_series()))
    except AttributeError:
        raise LogError(f"a log is a path or a DataFrame, not {type(frame).__name__}") from None
    if (twice := repeated(names)) is not None:
        raise LogError(f"column {twice!r} of the data frame occurs {names.count(twice)} times")
    units = {n: TIMES for n, values in columns.items() if values.dtype.kind in "mM"}
    return Table(columns, units | ({CLOCK: "s"} if CLOCK in columns else {}), {})


def _values(column: Any) -> Any:
    """Values of a column; dates with a time zone become such without."""
    zone = getattr(column.dtype, "tz", None)
    return (column.dt.tz_convert(None) if zone is not None else column).to_numpy()


def read_parquet(path: Path, choose: Choose) -> Table:
    """Read columns of a Parquet file (extra ``parquet``)."""
    pq = optional("pyarrow.parquet", "Parquet files", "parquet")
    is_temporal = optional("pyarrow.types", "Parquet files", "parquet").is_temporal
    try:
        with pq.ParquetFile(path) as file:
            own = {CLOCK if n == _INDEX else n: n for n in file.schema_arrow.names}
            units = {n: TIMES for n in own if is_temporal(file.schema_arrow.field(own[n]).type)}
            units |= {CLOCK: "s"} if CLOCK in own else {}
            chosen = choose(list(own), units)
            table = file.read(columns=[own[name] for name in chosen])
        columns = {name: table.column(own[name]).to_numpy() for name in chosen}
    except (LogError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # pyarrow has its own family of errors
        raise LogError(f"{path.name}: not a readable Parquet file, or damaged") from error
    return Table(columns, units, {})


def read_json(path: Path, choose: Choose) -> Table:
    """Read a JSON file of columns or of records, or a record in each line.

    Columns are ``{"t": [0, 1], …}``, records ``[{"t": 0, …}, …]``; also pandas' other forms and
    tables that stand under a key. ``units`` beside the table are read.
    """
    import pandas as pd

    notes: tuple[str, ...] = ()
    try:
        data = path.read_bytes()
        data = gzip.decompress(data) if data.startswith(b"\x1f\x8b") else data
        text = data.decode(json.detect_encoding(data))
        text = text if '"' in text else text.replace("'", '"')  # dicts as Python prints them
        try:
            content = json.loads(text)
        except ValueError:
            lines = [line for line in text.splitlines() if line.strip()]
            content = [json.loads(line) for line in lines[:-1]]
            try:
                content.append(json.loads(lines[-1]))
            except ValueError:
                notes = (f"left out incomplete rows in line {len(lines)}",)
        frame, beside = _json_table(content, pd)
    except (ValueError, TypeError, AttributeError, RecursionError, *_GZIP) as error:
        raise NotALogError(f"{path.name}: no JSON of columns or records") from error
    if frame is None:
        raise NotALogError(f"{path.name}: no table of columns or records in the file")
    units = beside.get("units")
    units = units if isinstance(units, dict) else {}
    names = [str(n) for n in frame.columns]
    stated = {str(n): u for n, u in units.items() if isinstance(u, str) and str(n) in names}
    chosen = choose(names, stated)
    frame.columns = names
    columns = {name: frame[name].to_numpy() for name in chosen}
    return Table(columns, stated, {}, notes, {}, _period(beside))


def _period(beside: dict[str, Any]) -> float | None:
    """Time between samples [s] that stands beside a table as dt, or as fs [Hz]."""
    for name, value in beside.items():
        if isinstance(value, int | float) and 0 < value < float("inf"):
            if name.lower() in ("fs", "sample_rate", "sampling_rate", "rate"):
                return 1 / value
            if name.lower() in ("dt", "ts", "sample_time", "sampling_time", "period"):
                return float(value)
    return None


def _json_table(content: Any, pd: Any) -> tuple[Any, dict[str, Any]]:
    """Largest table in a JSON content, and what stands beside it."""
    if not isinstance(content, dict | list):
        return None, {}
    tables = [] if (own := _own_table(content, pd)) is None else [own]
    if isinstance(content, dict) or own is None or len(own[0]) < MIN_SAMPLES:
        beside = content if isinstance(content, dict) else {}
        inner = beside.values() if beside else content
        found = (_json_table(v, pd) for v in inner if isinstance(v, list | dict))
        tables += [(t, {**beside, **b}) for t, b in found if t is not None]
    return max(tables, key=lambda pair: len(pair[0]), default=(None, {}))


def _own_table(content: Any, pd: Any) -> tuple[Any, dict[str, Any]] | None:
    """Table that lists or dicts make together, and what stands beside it."""
    if isinstance(content, list):
        if content and all(isinstance(r, dict) for r in content):
            return _signals(content, pd) or (pd.json_normalize(content), {})
        if len(content) > 1 and all(isinstance(r, list) and len(r) > 1 for r in content):
            first, *rest = content
            if all(len(r) == len(first) for r in rest):
                if all(isinstance(n, str) for n in first):
                    return pd.DataFrame(rest, columns=first), {}
                if not any(isinstance(v, list | dict | str) for r in content for v in r):
                    names = [f"column{c + 1}" for c in range(len(first))]
                    return pd.DataFrame(content, columns=names), {}
        return None
    plain = {k: v for k, v in content.items() if _is_plain(v)}
    for names in plain.values():
        for rows in content.values():
            if isinstance(rows, list) and all(isinstance(n, str) for n in names):
                whole = len(rows) > 1 and all(isinstance(r, list) for r in rows)
                if whole and all(len(r) == len(names) for r in rows):
                    return pd.DataFrame(rows, columns=names), content
    fields, values = (
        (content.get(k) or {}).get(n) if isinstance(content.get(k), dict) else None
        for k, n in (("schema", "fields"), ("data", "values"))
    )
    if isinstance(fields, list) and isinstance(values, list) and len(fields) == len(values):
        names = [str(f.get("name")) if isinstance(f, dict) else "" for f in fields]
        return pd.DataFrame(dict(zip(names, values, strict=True))), {}  # of Grafana
    by_name = [{"name": k, **v} for k, v in content.items() if isinstance(v, dict)]
    if (signals := _signals(by_name, pd)) is not None:
        return signals
    longest = max(map(len, plain.values()), default=0)
    if longest > 1:
        return pd.DataFrame({k: v for k, v in plain.items() if len(v) == longest}), content
    by_row = [v for v in content.values() if isinstance(v, dict) and len(v) > 1]
    whole = len(by_row) == len(content) > 0
    if whole and not any(isinstance(x, list | dict) for v in by_row for x in v.values()):
        frame = pd.DataFrame(content)
        return (frame.T.infer_objects() if len(frame) < len(content) else frame), {}
    return None


def _signals(content: list[dict[str, Any]], pd: Any) -> tuple[Any, dict[str, Any]] | None:
    """Signals of a name, perhaps a unit, and values each."""
    columns: dict[str, list[Any]] = {}
    units: dict[str, str] = {}
    clocks: list[list[Any]] = []
    for signal in content:
        pairs = signal.get("datapoints")  # of Grafana, value and time
        if isinstance(pairs, list) and all(isinstance(p, list) and len(p) == 2 for p in pairs):
            signal = {**signal, "datapoints": [v for v, _ in pairs], "t": [t for _, t in pairs]}
        lists = {k: v for k, v in signal.items() if _is_plain(v) and len(v) > 1}
        times = [k for k in lists if k.lower() in CLOCKS]
        if len(lists) == 2 and len(times) == 1:  # of all signals, if it is the same
            clocks.append(lists.pop(times[0]))
        name = next((signal[k] for k in _NAMES if isinstance(signal.get(k), str)), None)
        if name is None or len(lists) != 1:
            continue
        (columns[name],) = lists.values()
        unit = signal.get("unit", signal.get("units"))
        units |= {name: unit} if isinstance(unit, str) else {}
    longest = max(map(len, columns.values()), default=0)
    if len(columns) < 2 or any(clock != clocks[0] for clock in clocks):
        return None
    if clocks and len(clocks) == len(columns):
        columns = {"t": clocks[0], **columns}
    full = {n: v for n, v in columns.items() if len(v) == longest}
    return pd.DataFrame(full), {"units": units}


_NAMES = ("name", "label", "signal", "channel", "id", "key", "title", "target")  # of a signal


def _is_plain(value: Any) -> bool:
    return isinstance(value, list) and not any(isinstance(v, list | dict) for v in value)
