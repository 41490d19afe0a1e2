"""From files and tables to logs."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.signals import checks
from dmptm_ctrl.signals.campaign import Campaign
from dmptm_ctrl.signals.clock import resampled
from dmptm_ctrl.signals.columns import Mapped, Table, resolve
from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import Log
from dmptm_ctrl.signals.matlab import read_matlab
from dmptm_ctrl.signals.mdf import read_mdf
from dmptm_ctrl.signals.plausible import refuse_inconsistent, suspects, unwrapped
from dmptm_ctrl.signals.tabular import from_frame, read_parquet
from dmptm_ctrl.signals.text import read_text

if TYPE_CHECKING:
    import pandas as pd

Source = str | PathLike[str]

TEXT = (".csv", ".csv.gz", ".txt", ".txt.gz", ".tsv", ".tsv.gz", ".dat")
EXTENSIONS = (*TEXT, ".mat", ".parquet", ".mf4")


def load_log(
    source: "Source | pd.DataFrame",
    columns: Mapped | None = None,
    *,
    name: str | None = None,
    required: Sequence[str] = (),
    sample_time: float | None = None,
    resample: bool = False,
    ratio: float | None = None,
    max_rows: int | None = None,
) -> Log:
    """Read one log and check it.

    Parameters
    ----------
    source : path or DataFrame
        .csv, .txt, .tsv, .dat (plain or gzip), .mat, .parquet, .mf4. Columns are called
        NAME_UNIT: ``theta_L_deg``, ``omega_L_deg_s``, ``u_left_V``.
    columns : mapping, optional
        For files that name theirs otherwise: column -> ``"theta_L_deg"``, or
        ``("theta_L", "deg")``, or ``("theta_L", "deg", -1.0)`` with a factor, such as a sign.
        Of the columns not mentioned only those of the paper's rig are read.
    name : str, optional
        Name of the log; else the file's, without extension.
    required : sequence of str
        Channels that must be there.
    sample_time : float, optional
        For a file without a time column [s].
    resample : bool
        Sort shuffled rows, interpolate a jittery clock to even steps and bridge gaps of up to
        ten samples; else refuse them.
    ratio : float, optional
        Motor turns per turn of the ring gear, to check motor angles against theta_L.
    max_rows : int, optional
        Rows after this many are not read, with a warning: bounds the memory.

    Returns
    -------
    Log
        SI and radians; what is suspect is in its ``warnings``.

    Raises
    ------
    LogError
        No such file, not readable, a column missing, twice or in an unknown unit, a value that
        is no finite number, time that does not increase evenly, too few samples, channels that
        contradict each other (a mistaken unit or sign).
    """
    if isinstance(source, str | PathLike):
        path = Path(source)
        title = path.name
        table, ignored, digest = _read(path, columns, max_rows)
    else:
        title = name or "data frame"
        table, ignored, digest = from_frame(source), [], None
    if max_rows is not None:
        ignored += _cut(table, max_rows)
    channels, units, notes = _channels(table, columns, title)
    notes = [*ignored, *notes]
    _require(required, channels, title)
    time = _time(channels, sample_time, title)
    if resample:
        time, channels, done = resampled(title, time, channels)
        notes += done
    checks.even_time(title, time)
    notes += _unwrap(channels, units)
    log = Log(
        name=name or _stem(title), time=time, channels=channels, sha256=digest, meta=table.meta,
        units=units,
    )  # fmt: skip
    refuse_inconsistent(log, ratio)
    return replace(log, warnings=(*notes, *suspects(log)))


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

    Parameters
    ----------
    source : path
        A folder or a file.

    Returns
    -------
    list of Path
        In order of their names.

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


def _cut(table: Table, max_rows: int) -> list[str]:
    """Drop rows in place; say so."""
    longest = max((len(values) for values in table.columns.values()), default=0)
    if longest <= max_rows:
        return []
    for column, values in table.columns.items():
        table.columns[column] = values[:max_rows].copy()
    return [f"the first {max_rows} rows are read; there are more"]


def _read(path: Path, columns: Mapped | None, max_rows: int | None) -> tuple[Table, list[str], str]:
    """Columns in use, warnings about those that are not, and the file's SHA-256."""
    if not path.exists():
        raise LogError(f"no such file: {path}")
    if path.is_dir():
        raise LogError(f"{path.name} is a folder, not a log")
    extension = _extension(path)
    if not extension:
        raise LogError(f"{path.name}: not a log by its name, which ends in {', '.join(EXTENSIONS)}")

    ignored: list[str] = []

    def choose(names: list[str], units: Mapping[str, str]) -> list[str]:
        targets, ignored[:] = resolve(names, columns, units, path.name)
        return list(targets)

    reader = {".mat": read_matlab, ".mf4": read_mdf}
    try:
        if extension in reader:
            return reader[extension](path, choose), ignored, _sha256(path)
        stream = read_parquet if extension == ".parquet" else read_text
        # one row more, so that the cut is noticed
        most = None if max_rows is None else max_rows + 1
        return stream(path, choose, most), ignored, _sha256(path)
    except OSError as error:
        raise LogError(f"{path.name}: {error.strerror or 'not readable'}") from error


def _sha256(path: Path) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _channels(
    table: Table, columns: Mapped | None, title: str
) -> tuple[dict[str, Any], dict[str, str], list[str]]:
    """Channels in SI, their units, and warnings."""
    targets, notes = resolve(list(table.columns), columns, table.units, title)
    clock = next((c for c, target in targets.items() if target.channel == "time"), None)
    rows = len(table.columns[clock]) if clock else None
    channels, units = {}, {}
    for column, target in targets.items():
        values = _floats(table.columns.pop(column), column, title)
        if rows is None:
            rows = values.size
        if values.size != rows:
            if column in (columns or {}):
                raise LogError(
                    f"{title}: column {column!r} has {values.size} values, the others {rows}"
                )
            notes.append(f"ignored {column!r}: {values.size} values, the others have {rows}")
            continue
        checks.finite(title, column, values)
        channels[target.channel] = values if target.factor == 1.0 else values * target.factor
        units[target.channel] = target.symbol
    units.pop("time", None)
    return channels, units, notes


def _floats(values: Any, column: str, title: str) -> Any:
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "fiubO":  # text, complex numbers, dates
            raise TypeError(array.dtype)
        array = array.astype(np.float64, copy=False)
    except (TypeError, ValueError) as error:
        raise LogError(f"{title}: column {column!r} does not hold numbers") from error
    if array.ndim != 1:
        raise LogError(f"{title}: column {column!r} holds arrays, not numbers")
    return array


def _unwrap(channels: dict[str, Any], units: Mapping[str, str]) -> list[str]:
    """Undo jumps of whole turns in place; say so."""
    notes = []
    for channel in [c for c, symbol in units.items() if symbol == "rad"]:
        plain = unwrapped(channels[channel])
        if plain is not None:
            channels[channel] = plain
            notes.append(f"{channel} jumped by whole turns and was unwrapped")
    return notes


def _require(required: Sequence[str], channels: Any, title: str) -> None:
    missing = [channel for channel in required if channel not in channels]
    if missing:
        there = [channel for channel in channels if channel != "time"]
        raise LogError(
            f"{title}: no column for {', '.join(missing)}; it has {', '.join(there) or 'none'}"
        )


def _time(channels: dict[str, Any], sample_time: float | None, title: str) -> Any:
    if "time" in channels:
        time = channels.pop("time")
    elif sample_time is None:
        raise LogError(
            f"{title}: no time column; call it time_s, give the sample time, or say in a rig.toml "
            "what each column is (dmptm rig init makes one)"
        )
    elif not sample_time > checks.SHORTEST_STEP:
        raise LogError(f"{title}: sample time {sample_time} s is not positive")
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
