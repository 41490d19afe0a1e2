"""Logs as tables: data frames, Parquet, and MDF 4 of measurement systems."""

from pathlib import Path
from typing import Any

import numpy as np

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


def read_parquet(path: Path, choose: Choose) -> Table:
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
            table = file.read(columns=chosen)
        columns = {name: table.column(name).to_numpy() for name in chosen}
    except (LogError, FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # pyarrow has its own family of errors
        raise LogError(f"{path.name}: not a readable Parquet file, or damaged") from error
    return Table(columns, {}, {})


def read_mdf(path: Path, choose: Choose) -> Table:
    """Read channels of an MDF 4 file (extra ``mf4``).

    All chosen channels must be on one clock; its time is the column time_s.

    Raises
    ------
    LogError
        Not readable, asammdf is not installed, channels on several clocks.
    """
    try:
        from asammdf import MDF
    except ImportError as error:
        raise LogError(
            f"{path.name}: MDF files need asammdf: pip install 'dmptm-ctrl[mf4]'"
        ) from error
    try:
        with MDF(str(path)) as file:
            signals = {s.name: s for s in file.iter_channels() if s.samples.dtype.kind in "fiub"}
    except (FileNotFoundError, PermissionError):
        raise
    except Exception as error:  # asammdf raises what its parser stumbles on
        raise LogError(f"{path.name}: not a readable MDF file, or damaged") from error
    units = {name: str(signal.unit) for name, signal in signals.items() if signal.unit}
    chosen = [name for name in choose([*signals, "time_s"], units) if name in signals]
    if not chosen:
        raise LogError(f"{path.name}: none of its channels {', '.join(signals)} is a signal in use")
    time = signals[chosen[0]].timestamps
    for name in chosen:
        if not np.array_equal(signals[name].timestamps, time):
            raise LogError(
                f"{path.name}: {chosen[0]} and {name} are on different clocks; "
                "resample the file to one (asammdf: MDF.resample), or map only columns of one clock"
            )
    columns = {name: signals[name].samples for name in chosen if name != "time_s"}
    return Table({"time_s": time, **columns}, units, {})
