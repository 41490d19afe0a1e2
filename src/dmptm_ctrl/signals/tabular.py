"""Logs as tables: data frames, Parquet and JSON."""

import json
from pathlib import Path
from typing import Any

from dmptm_ctrl.signals.clock import times_of
from dmptm_ctrl.signals.columns import Choose, Table
from dmptm_ctrl.signals.errors import LogError, NotALogError


def from_frame(frame: Any) -> Table:
    """Columns of a `pandas.DataFrame`; an index called NAME_UNIT is a column too."""
    try:
        names = [str(column) for column in frame.columns]
        columns = {name: _values(frame.iloc[:, i]) for i, name in enumerate(names)}
        if frame.index.name is not None:
            names.append(str(frame.index.name))
            columns.setdefault(names[-1], _values(frame.index.to_series()))
    except AttributeError:
        raise LogError(f"a log is a path or a DataFrame, not {type(frame).__name__}") from None
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise LogError(
            f"column {twice[0]!r} of the data frame occurs {names.count(twice[0])} times"
        )
    return Table(columns, {}, {})


def _values(column: Any) -> Any:
    """Values of a column; dates with a time zone become such without."""
    zone = getattr(column.dtype, "tz", None)
    return (column.dt.tz_convert(None) if zone is not None else column).to_numpy()


def read_parquet(path: Path, choose: Choose, max_rows: int | None = None) -> Table:
    """Read columns of a Parquet file (extra ``parquet``)."""
    try:
        import pyarrow.parquet as pq
    except ImportError as error:
        raise LogError(
            f"{path.name}: Parquet files need pyarrow: pip install 'dmptm-ctrl[parquet]'"
        ) from error
    try:
        with pq.ParquetFile(path) as file:
            names = list(file.schema_arrow.names)
            chosen = choose(names, {})
            table = _rows(file, chosen, max_rows)
        columns = {name: table.column(name).to_numpy() for name in chosen}
    except (LogError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # pyarrow has its own family of errors
        raise LogError(f"{path.name}: not a readable Parquet file, or damaged") from error
    return Table(columns, {}, {})


def read_json(path: Path, choose: Choose) -> Table:
    """Read a JSON file of columns or of records, or a record in each line.

    Columns are ``{"t": [0, 1], …}``, records ``[{"t": 0, …}, …]``; also pandas' other forms and
    tables that stand under a key. ``units`` beside the table are read.
    """
    import pandas as pd

    try:
        text = path.read_text(encoding="utf-8-sig")
        try:
            content = json.loads(text)
        except ValueError:
            content = [json.loads(line) for line in text.splitlines() if line.strip()]
        frame, beside = _json_table(content, pd)
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise NotALogError(f"{path.name}: no JSON of columns or records") from error
    if frame is None:
        raise NotALogError(f"{path.name}: no table of columns or records in the file")
    units = beside.get("units")
    units = units if isinstance(units, dict) else {}
    names = [str(n) for n in frame.columns]
    stated = {str(n): u for n, u in units.items() if isinstance(u, str) and str(n) in names}
    chosen = choose(names, stated)
    frame.columns = names
    columns = {}
    for name in chosen:
        values = frame[name]
        if values.dtype.kind not in "fiub":
            texts = values.dropna()
            if len(texts) and texts.map(lambda v: isinstance(v, str)).all():
                numbers = pd.to_numeric(values, errors="coerce")
                if numbers.notna().sum() < len(texts):
                    columns[name] = times_of(values.to_numpy(object), path.name, name)
                    continue
                values = numbers
        columns[name] = values.to_numpy()
    return Table(columns, stated, {})


def _json_table(content: Any, pd: Any) -> tuple[Any, dict[str, Any]]:
    """Largest table in a JSON content, and what stands beside it."""
    if isinstance(content, list):
        records = [r for r in content if isinstance(r, dict)]
        if records and len(records) == len(content):
            return pd.json_normalize(records), {}
        return None, {}
    if not isinstance(content, dict):
        return None, {}
    if isinstance(content.get("columns"), list) and isinstance(content.get("data"), list):
        return pd.DataFrame(content["data"], columns=content["columns"]), content
    lists = {
        k: v for k, v in content.items() if isinstance(v, list) and not _holds(v, (list, dict))
    }
    longest = max(map(len, lists.values()), default=0)
    full = {k: v for k, v in lists.items() if len(v) == longest}
    if longest > 1:
        return pd.DataFrame(full), content
    by_row = [v for v in content.values() if isinstance(v, dict) and len(v) > 1]
    if (
        by_row
        and len(by_row) == len(content)
        and not any(_holds(v.values(), (list, dict)) for v in by_row)
    ):
        return pd.DataFrame(content), {}
    inner = [_json_table(v, pd) for v in content.values() if isinstance(v, list | dict)]
    tables = [(t, {**content, **b}) for t, b in inner if t is not None]
    return max(tables, key=lambda pair: len(pair[0]), default=(None, {}))


def _holds(values: Any, kinds: tuple[type, ...]) -> bool:
    return any(isinstance(v, kinds) for v in values)


def _rows(file: Any, columns: list[str], rows: int | None) -> Any:
    """All rows of a Parquet file, or the first ones, a batch at a time."""
    if rows is None:
        return file.read(columns=columns)
    import pyarrow as pa

    batches, left = [], rows
    for batch in file.iter_batches(columns=columns):
        batches.append(batch.slice(0, left))
        left -= len(batches[-1])
        if left <= 0:
            break
    schema = pa.schema([file.schema_arrow.field(name) for name in columns])
    return pa.Table.from_batches(batches, schema)
