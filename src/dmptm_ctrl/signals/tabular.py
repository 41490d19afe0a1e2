"""Logs as tables: data frames and Parquet."""

from pathlib import Path
from typing import Any

from dmptm_ctrl.signals.columns import Choose, Table
from dmptm_ctrl.signals.errors import LogError


def from_frame(frame: Any) -> Table:
    """Columns of a `pandas.DataFrame`; an index called NAME_UNIT is a column too.

    Raises
    ------
    LogError
        Not a data frame, or two columns of one name.
    """
    try:
        names = [str(column) for column in frame.columns]
        columns = {name: frame.iloc[:, i].to_numpy() for i, name in enumerate(names)}
        if frame.index.name is not None:
            names.append(str(frame.index.name))
            columns.setdefault(names[-1], frame.index.to_numpy())
    except AttributeError:
        raise LogError(f"a log is a path or a DataFrame, not {type(frame).__name__}") from None
    twice = [name for name in names if names.count(name) > 1]
    if twice:
        raise LogError(
            f"column {twice[0]!r} of the data frame occurs {names.count(twice[0])} times"
        )
    return Table(columns, {}, {})


def read_parquet(path: Path, choose: Choose, max_rows: int | None = None) -> Table:
    """Read columns of a Parquet file (extra ``parquet``).

    Raises
    ------
    LogError
        Not readable, or pyarrow is not installed.
    """
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
