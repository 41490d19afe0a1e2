"""From files and tables to logs."""

import hashlib
from collections.abc import Iterable, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.signals import checks
from dmptm_ctrl.signals.campaign import Campaign
from dmptm_ctrl.signals.columns import Mapped, Table, resolve
from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import Log
from dmptm_ctrl.signals.text import read_text

if TYPE_CHECKING:
    import pandas as pd

Source = str | PathLike[str]

TEXT = (".csv", ".csv.gz", ".txt", ".txt.gz", ".tsv", ".tsv.gz", ".dat")
EXTENSIONS = (*TEXT,)


def load_log(
    source: "Source | pd.DataFrame",
    columns: Mapped | None = None,
    *,
    name: str | None = None,
    required: Sequence[str] = (),
    sample_time: float | None = None,
    resample: bool = False,
) -> Log:
    """Read one log.

    Parameters
    ----------
    source : path or DataFrame
        .csv, .txt, .tsv (plain or gzip). Columns are called NAME_UNIT: ``theta_L_deg``,
        ``omega_L_deg_s``, ``u_left_V``.
    columns : mapping, optional
        For files that name theirs otherwise: column -> ``"theta_L_deg"``, or
        ``("theta_L", "deg")``, or ``("theta_L", "deg", -1.0)`` with a factor, such as a sign.
        Columns not mentioned go by their own names.
    name : str, optional
        Name of the log; else the file's, without extension.
    required : sequence of str
        Channels that must be there.
    sample_time : float, optional
        For a file without a time column [s].
    resample : bool
        Interpolate a jittery clock to even steps and bridge short gaps; else refuse them.

    Returns
    -------
    Log
        SI and radians; what is suspect is in its ``warnings``.

    Raises
    ------
    LogError
        No such file, not readable, a column missing, twice or in an unknown unit, a value that
        is no finite number, time that does not increase evenly, too few samples.
    """
    if isinstance(source, str | PathLike):
        path = Path(source)
        table, digest = _read(path, columns), _sha256(path)
        title = path.name
    else:
        table, digest, title = _from_frame(source), None, name or "data frame"
    targets, warnings = resolve(list(table.columns), columns, table.units, title)
    channels, units = {}, {}
    for column, target in targets.items():
        values = _floats(table.columns.pop(column), column, title)
        checks.finite(title, column, values)
        channels[target.channel] = values if target.factor == 1.0 else values * target.factor
        units[target.channel] = target.symbol
    _require(required, channels, title)
    time = _time(channels, sample_time, title)
    checks.even_time(title, time)
    return Log(
        name=name or _stem(title),
        time=time,
        channels=channels,
        sha256=digest,
        meta=table.meta,
        units=units,
        warnings=tuple(warnings),
    )


def load_logs(
    sources: "Source | Iterable[Source | pd.DataFrame | Log]",
    columns: Mapped | None = None,
    **options: Any,
) -> Campaign:
    """Read the logs of one rig.

    Parameters
    ----------
    sources : path, or several paths, DataFrames or Logs
        A folder stands for all logs in it, in order of their names.
    columns, **options
        As in `load_log`.

    Returns
    -------
    Campaign

    Raises
    ------
    LogError
        As `load_log`; also an empty folder, and logs of different rigs.
    """
    if isinstance(sources, str | PathLike):
        sources = [sources]
    logs = []
    for source in sources:
        if isinstance(source, Log):
            logs.append(source)
        elif isinstance(source, str | PathLike):
            logs += [load_log(path, columns, **options) for path in find_logs(source)]
        else:
            logs.append(load_log(source, columns, name=f"table{len(logs) + 1}", **options))
    return Campaign(tuple(logs))


def find_logs(source: Source) -> list[Path]:
    """Files of a folder that are logs by their extension; a file stands for itself.

    Raises
    ------
    LogError
        No such file or folder, no log in it.
    """
    path = Path(source)
    if not path.is_dir():
        return [path]
    found = sorted(p for p in path.iterdir() if p.is_file() and _extension(p) in EXTENSIONS)
    if not found:
        raise LogError(f"no logs in {path.name or path}: no file ends in {', '.join(EXTENSIONS)}")
    return found


def _extension(path: Path) -> str:
    """Longest known extension that a file's name ends in."""
    lower = path.name.lower()
    return max((e for e in EXTENSIONS if lower.endswith(e)), key=len, default="")


def _stem(title: str) -> str:
    extension = _extension(Path(title))
    return title[: -len(extension)] if extension else title


def _read(path: Path, columns: Mapped | None) -> Table:
    if not path.exists():
        raise LogError(f"no such file: {path}")
    if path.is_dir():
        raise LogError(f"{path.name} is a folder, not a log")
    extension = _extension(path)
    if not extension:
        raise LogError(f"{path.name}: not a log by its name, which ends in {', '.join(EXTENSIONS)}")

    def wanted(names: list[str]) -> list[str]:
        return list(resolve(names, columns, {}, path.name)[0])

    return read_text(path, wanted)


def _from_frame(frame: Any) -> Table:
    try:
        columns = {str(column): frame[column].to_numpy() for column in frame.columns}
    except AttributeError:
        raise LogError(f"a log is a path or a DataFrame, not {type(frame).__name__}") from None
    if len(columns) < len(frame.columns):
        raise LogError("two columns of the data frame have one name")
    return Table(columns, {}, {})


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _floats(values: Any, column: str, title: str) -> Any:
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise LogError(f"{title}: column {column!r} does not hold numbers") from error


def _require(required: Sequence[str], channels: Any, title: str) -> None:
    missing = [channel for channel in required if channel not in channels]
    if missing:
        raise LogError(
            f"{title}: no column for {', '.join(missing)}; it has {', '.join(channels) or 'none'}"
        )


def _time(channels: dict[str, Any], sample_time: float | None, title: str) -> Any:
    if "time" in channels:
        time = channels.pop("time")
    elif sample_time is None:
        raise LogError(f"{title}: no time column; call it time_s, or give the sample time")
    elif not channels:
        raise LogError(f"{title}: no columns with a unit in their names")
    else:
        time = sample_time * np.arange(len(next(iter(channels.values()))))
    if time.size < checks.MIN_SAMPLES:
        raise LogError(
            f"{title}: {time.size} sample{'s' * (time.size != 1)}, "
            f"at least {checks.MIN_SAMPLES} are needed"
        )
    return time
