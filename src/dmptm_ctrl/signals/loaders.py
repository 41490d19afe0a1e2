"""From files and tables to logs."""

import hashlib
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.signals import checks
from dmptm_ctrl.signals.bags import read_bag
from dmptm_ctrl.signals.campaign import Campaign
from dmptm_ctrl.signals.clock import mended, run_on, seconds_of, times_of
from dmptm_ctrl.signals.columns import (
    CLOCK,
    CLOCKS,
    Choose,
    Column,
    Mapped,
    Table,
    Target,
    as_columns,
    names_a_clock,
    resolve,
)
from dmptm_ctrl.signals.counters import unwrapped_counts, with_sign, without_failures
from dmptm_ctrl.signals.dialect import Dialect, TextFormat, with_points
from dmptm_ctrl.signals.errors import ColumnsError, LogError, NotALogError
from dmptm_ctrl.signals.log import Log
from dmptm_ctrl.signals.matlab import read_matlab
from dmptm_ctrl.signals.mdf import read_mdf
from dmptm_ctrl.signals.missing_values import (
    on_one_clock,
    without_isolated,
    without_missing,
    without_sentinels,
)
from dmptm_ctrl.signals.plausible import refuse_inconsistent, suspects
from dmptm_ctrl.signals.tabular import from_frame, read_json, read_parquet
from dmptm_ctrl.signals.text import read_text

if TYPE_CHECKING:
    import pandas as pd

Source = str | PathLike[str]

NO_COUNTER = 2.0**32  # counts so far
LEFT_OUT = "left out: "  # begins what is said of a file
OTHER_RATE = 0.01  # relative; a nominal rate is as good as this
PACKED = ".mat, .parquet, .mf4, .json, .mcap, .bag"
OTHER = (  # what stands beside logs in a folder and is none by its name
    *(".toml", ".md", ".rst", ".html", ".htm", ".xml", ".yaml", ".yml", ".ini", ".cfg"),
    *(".png", ".jpg", ".jpeg", ".svg", ".gif", ".bmp", ".pdf", ".zip", ".7z", ".tar", ".rar"),
    *(".py", ".pyc", ".m", ".mlx", ".ipynb", ".slx", ".mdl", ".c", ".h", ".exe", ".dll"),
    *(".xlsx", ".ods", ".docx", ".doc", ".pptx", ".odt", ".bak", ".tmp", ".lock"),
)


def load_log(
    source: "Source | pd.DataFrame",
    columns: Mapped | None = None,
    *,
    name: str | None = None,
    sample_time: float | None = None,
    max_rows: int | None = None,
    window: tuple[float | None, float | None] = (None, None),
    how: TextFormat | None = None,
) -> Log:
    """Read one log, mend its clock and small holes with a warning, and check it.

    Parameters
    ----------
    source : path or DataFrame
        Text of any extension (plain or gzip), .mat, .parquet, .mf4, .json, .mcap, .bag. Columns
        are called NAME_UNIT: ``theta_L_deg``, ``omega_L_deg_s``, ``u_left_V``.
    columns : mapping, optional
        For files that name theirs otherwise: column -> ``"theta_L_deg"``, or
        ``("theta_L", "deg")``, or ``("theta_L", "deg", -1.0)`` with a factor, such as a sign.
        Of the columns not mentioned only those of the paper's rig are read.
    name : str, optional
        Name of the log; else the file's, without extension.
    sample_time : float, optional
        For a file without a time column [s].
    max_rows : int, optional
        Rows after this many are not read, with a warning: bounds the memory.
    window : (start, stop)
        Part that is used, from the log's first sample [s]; the rest is not checked.
    how : TextFormat, optional
        Layout of a text file, where it cannot be guessed.

    Returns
    -------
    Log
        SI and radians; what is suspect is in its ``warnings``.

    Raises
    ------
    LogError
        No such file, not readable, a column missing, twice or in an unknown unit, values that are
        missing for long, a clock that cannot be mended, too few samples, channels that contradict
        each other (a mistaken unit or sign).

    Examples
    --------
    >>> log = dm.load_log("log.csv.gz")
    >>> log["omega_L"].shape == log.time.shape
    True
    """
    path = Path(source) if isinstance(source, str | PathLike) else None
    title = (name or "data frame") if path is None else path.name
    mapped = as_columns(columns, title)
    if path is not None:
        table, ignored, digest = _read(path, mapped, max_rows, how)
    else:
        table, ignored, digest = from_frame(source), [], None
    if max_rows is not None:
        ignored += _cut(table, max_rows)
    return log_of(
        table._replace(notes=(*ignored, *table.notes)), title, digest, mapped, name or stem(title),
        sample_time, window,
    )  # fmt: skip


def log_of(
    table: Table,
    title: str,
    digest: str | None,
    mapped: Mapping[str, Column],
    name: str,
    sample_time: float | None = None,
    window: tuple[float | None, float | None] = (None, None),
) -> Log:
    """Log of a table that was read, see `load_log`; `title` is for messages."""
    targets, notes = resolve(list(table.columns), mapped, table.units, title)
    if sample_time is not None and mapped and not names_a_clock(mapped):
        left_out = {c: t for c, t in targets.items() if t.channel == "time"}
        targets = {c: t for c, t in targets.items() if c not in left_out}
        table = table._replace(period=_step_of(table, left_out, title) or table.period)
    read = _channels(table, targets, title, sample_time, window, set(mapped))
    time, channels, units, more = read
    notes = list(dict.fromkeys([*table.notes, *notes, *more]))
    if time.size < checks.MIN_SAMPLES:
        raise NotALogError(
            f"{title}: {time.size} sample{'s' * (time.size != 1)}, "
            f"at least {checks.MIN_SAMPLES} are needed"
        )
    time, channels, done = mended(title, time, channels, sample_time)
    notes += [*done, *checks.slow(time)]
    clocked = any(target.channel == "time" for target in targets.values())
    step = float(time[-1] - time[0]) / (time.size - 1) if clocked else table.period
    if sample_time and step and abs(step / sample_time - 1) > OTHER_RATE:
        notes.append(
            f"samples are {step:.6g} s apart by the {'clock' if clocked else 'file'}, and "
            f"{sample_time:.6g} s as you say; the {'clock' if clocked else 'latter'} is taken"
        )
    for column, target in targets.items():
        if units.get(target.channel) in ("rad", "m"):
            values = channels[target.channel] / target.factor
            values, note = without_failures(title, column, values, time)
            if note:
                channels[target.channel], notes = values * target.factor, [*notes, note]
    log = Log(name=name, time=time, channels=channels, sha256=digest, meta=table.meta, units=units)
    refuse_inconsistent(log)
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
        A sequence of Log, also by name: ``logs["sine_10"]``.

    Raises
    ------
    LogError
        As `load_log`; also an empty folder, and logs of different rigs.

    Examples
    --------
    >>> logs = dm.load_logs("logs")
    >>> [log.name for log in logs]
    """

    def load(source: Any, **name: Any) -> Log:
        return source if isinstance(source, Log) else load_log(source, columns, **name, **options)

    logs, left_out = gather(sources, load)
    return Campaign(logs, tuple(left_out))


def gather(
    sources: Any, load: Callable[..., Log], ignored: Callable[[Path], bool] = lambda _: False
) -> tuple[tuple[Log, ...], list[str]]:
    """Logs of folders, files, tables, read by `load`; and what was left out.

    Stray files of a folder are left out, `ignored` ones in silence. `load` gets a ``name=`` for a
    table.
    """
    single = isinstance(sources, str | PathLike | Log) or hasattr(sources, "columns")
    logs: list[Log] = []
    left_out: list[str] = []
    first: NotALogError | None = None
    if not single and not isinstance(sources, Iterable):
        raise LogError(f"logs are paths, tables or Logs, not {type(sources).__name__}")
    for source in [sources] if single else sources:
        if isinstance(source, Log):
            logs.append(load(source))
        elif not isinstance(source, str | PathLike):
            logs.append(load(source, name=f"table{len(logs) + 1}"))
        else:
            for path in _files(source):
                if ignored(path):
                    continue
                try:
                    logs.append(load(path))
                except NotALogError as error:
                    if not Path(source).is_dir():
                        raise
                    first = first or error
                    left_out.append(f"{LEFT_OUT}{error}")
    if not logs and first is not None:
        more = (
            f"; nor can {len(left_out) - 1} more of the files be used" if len(left_out) > 1 else ""
        )
        raise NotALogError(f"{first}{more}")
    return tuple(logs), left_out


def _files(source: Source) -> list[Path]:
    """Files of a folder that may be logs, in order of their names; a file stands for itself."""
    path = Path(source)
    if not path.is_dir():
        return [path]
    files = [p for p in path.iterdir() if p.is_file() and not p.name.startswith((".", "~"))]
    found = sorted(p for p in files if not p.name.lower().endswith(OTHER))
    if not found:
        raise LogError(f"no logs in {path.name or path}: no file of text or one of {PACKED}")
    return found


def stem(title: str) -> str:
    """Name of a log from its file's."""
    stem = title[:-3] if title.lower().endswith(".gz") else title
    return stem.rpartition(".")[0] or stem


def _cut(table: Table, max_rows: int) -> list[str]:
    """Drop rows in place; say so."""
    longest = max((len(values) for values in table.columns.values()), default=0)
    if longest <= max_rows:
        return []
    for column, values in table.columns.items():
        table.columns[column] = values[:max_rows].copy()
    return [f"the first {max_rows} rows are read; there are more"]


def _read(
    path: Path, columns: Mapping[str, Column], max_rows: int | None, how: TextFormat | None
) -> tuple[Table, list[str], str]:
    """Columns in use, warnings about those that are not, and the file's SHA-256."""
    ignored: list[str] = []

    def choose(names: list[str], units: Mapping[str, str]) -> list[str]:
        targets, ignored[:] = resolve(names, columns, units, path.name)
        return list(targets)

    most = None if max_rows is None else max_rows + 1  # one row more, so that the cut is noticed
    return read_table(path, choose, most, how, list(columns)), ignored, digest_of(path)


def digest_of(path: Path) -> str:
    """SHA-256 of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def read_table(
    path: Path,
    choose: Choose,
    max_rows: int | None = None,
    how: TextFormat | None = None,
    wanted: Collection[str] = (),
) -> Table:
    """Read the chosen columns of a file of any format; LogError if it is none."""
    if not path.exists():
        raise LogError(f"no such file: {path}")
    if path.is_dir():
        raise LogError(f"{path.name or path} is a folder, not a log; name a file in it")
    readers = {
        ".mat": read_matlab, ".mf4": read_mdf, ".json": read_json, ".mcap": read_bag,
        ".bag": read_bag, ".db3": read_bag,
    }  # fmt: skip
    extension = path.suffix.lower()
    try:
        if extension == ".gz" and path.stem.lower().endswith(".json"):
            extension = ".json"
        with path.open("rb") as stream:
            head = stream.read(64).lstrip(b"\xef\xbb\xbf \t\r\n")
        ascii = extension == ".mat" and re.fullmatch(rb"[\d\s.,eE+-]+", head)  # of save -ascii
        if extension in readers and not ascii:
            return readers[extension](path, choose)
        if head.startswith((b"PK\3\4", b"\xd0\xcf\x11\xe0")):
            raise NotALogError(f"{path.name}: a packed file, such as Excel's; save it as CSV")
        if head.startswith(b"MDF "):  # also called .mdf and .dat
            return read_mdf(path, choose)
        if extension == ".parquet" or head.startswith(b"PAR1"):
            return read_parquet(path, choose)
        if head.startswith((b"{", b"[{", b"[[")):  # JSON by another name
            return read_json(path, choose)
        return read_text(path, choose, max_rows, how, wanted)
    except OSError as error:
        raise LogError(f"{path.name}: {error.strerror or 'not readable'}") from error
    except ImportError as error:  # of an extra
        raise LogError(f"{path.name}: {error}") from error


def _channels(
    table: Table,
    targets: Mapping[str, Target],
    title: str,
    sample_time: float | None,
    window: tuple[float | None, float | None],
    needed: set[str],
) -> tuple[Any, dict[str, Any], dict[str, str], list[str]]:
    """Time [s], channels in SI without holes, their units, and warnings."""
    labels = {target.channel: column for column, target in targets.items()}
    time, notes = _time(table, targets, sample_time, title, needed)
    channels, units, clocks = {}, {}, {}
    shown = dict(labels)
    for column in table.words.keys() & targets.keys():
        shown[targets[column].channel] = f"{column}, which is {table.words[column]},"
    factors = {target.channel: target.factor for target in targets.values()}
    for column, target in targets.items():
        if target.channel == "time":
            continue
        values = _floats(table.columns.pop(column), column, title)
        other = time is not None and column not in table.clocks and values.size != time.size
        if other and column in needed:
            raise LogError(
                f"{title}: column {column!r} has {values.size} values, the others {time.size}"
            )
        if column not in needed and (other or np.isnan(values).all()):
            has = f"{values.size} values, the others have {time.size}" if other else "no value"
            notes.append(f"ignored {column!r}: {has}")
            continue
        turn = 2 * np.pi / abs(target.factor) if target.symbol == "rad" else 0.0
        values, nothing, note = _readings(column, values, target.symbol, turn)
        if nothing is not None:
            notes.append(
                f"{column} is {nothing:.6g} at times, far from all else: taken as no value"
            )
            shown[target.channel] = f"{column}, where {nothing:.6g} stands for no value,"
        notes += [note] if note else []
        channels[target.channel] = values if target.factor == 1.0 else values * target.factor
        units[target.channel] = target.symbol
        if column in table.clocks:
            own, _ = seconds_of(table.clocks[column], factors.get("time", 1.0))
            clocks[target.channel], _ = run_on(own, {column: values}, factors.get("time", 1.0))
    if time is None:
        if not channels:
            raise ColumnsError(f"{title}: no columns with a unit in their names")
        count = next(iter(channels.values())).size
        time = float(sample_time or table.period or 0) * np.arange(count)
    else:
        along = {c: v for c, v in channels.items() if c not in clocks}
        time, note = run_on(time, along, factors["time"])
        notes += [note] if note else []
    time, channels, done = on_one_clock(time, channels, clocks, labels)
    notes += done
    if window != (None, None) and np.isfinite(time).any():
        since = time - time[np.isfinite(time)][0]
        low, high = window[0] or 0.0, np.inf if window[1] is None else window[1]
        keep = (since >= low - 1e-9) & (since <= high + 1e-9)
        time, channels = time[keep], {c: v[keep] for c, v in channels.items()}
        if not keep.any():
            raise LogError(
                f"{title}: no sample from {low:.6g} to {high:.6g} s, the log is "
                f"{np.nanmax(since):.6g} s long"
            )
    timed = np.isfinite(time)
    if timed.any() and (lost := int((~np.trim_zeros(timed)).sum())):
        notes.append(f"{lost} row{'s' * (lost > 1)} without a time between others: left out")
        timed[: np.argmax(timed)] = timed[timed.size - np.argmax(timed[::-1]) :] = True
        time, channels = time[timed], {c: v[timed] for c, v in channels.items()}
    rows, filled, done = without_missing({"time": time, **channels}, labels)
    notes += done
    for channel, values in filled.items():
        filled[channel] = values[rows]
        read = filled[channel] / factors.get(channel, 1.0)  # as the file has it
        checks.finite(title, shown.get(channel, channel), read, rows.start)
    return filled.pop("time"), filled, units, notes


def _readings(column: str, values: Any, symbol: str, turn: float) -> tuple[Any, float | None, str]:
    """Readings of a counter unwrapped or with their sign; what stood for no value; and a note.

    A counter passes 65535 and the like as well: what may stand for no value comes after that.
    """

    def mended(values: Any) -> tuple[Any, str]:
        if symbol in ("rad", "m"):
            return unwrapped_counts(column, values, turn)
        return with_sign(column, values) if symbol != "s" else (values, "")

    values, nothing = without_sentinels(values)
    if nothing is None:
        values, nothing = without_isolated(values, NO_COUNTER)
    values, note = mended(values)
    if nothing is None and not note:
        values, nothing = without_isolated(values)
        values, note = (values, note) if nothing is None else mended(values)
    return values, nothing, note


def _time(
    table: Table,
    targets: Mapping[str, Target],
    sample_time: float | None,
    title: str,
    needed: set[str],
) -> tuple[Any, list[str]]:
    """Time [s]; None where the samples are counted."""
    clock = next((c for c, target in targets.items() if target.channel == "time"), None)
    if clock is not None:
        values = np.asarray(table.columns.pop(clock))
        if values.dtype.kind not in "mMiu":
            values = numbers_or_times(values, clock, title)
        time, note = seconds_of(values, targets[clock].factor)
        notes = [f"{clock}: {note}"] if note else []
        guessed = clock not in needed and clock not in table.units and not note
        if guessed and values.dtype.kind not in "mM" and clock.lower() in (*CLOCKS, CLOCK):
            notes.append(f"the clock is column {clock!r}, taken in seconds")
        return time, notes
    if sample_time is None and table.period is None:
        raise ColumnsError(
            f"{title}: no time column; call it time_s, or give time or sample_rate in [data] of a "
            "rig file (dmptm rig init makes one)"
        )
    if sample_time is not None and not sample_time > checks.SHORTEST_STEP:
        raise LogError(f"{title}: sample time {sample_time} s is not positive")
    if sample_time is None:
        return None, [f"no time column: the samples are {table.period:.6g} s apart by the preamble"]
    return None, []


def _step_of(table: Table, clock: Mapping[str, Target], title: str) -> float | None:
    """Mean step of a clock that is not used [s]; None for none, or one that runs back."""
    with suppress(LogError):
        time, _ = _time(table, clock, 1.0, title, set())
        if time is not None and time.size > 1 and (np.diff(time) >= 0).all():
            return float(time[-1] - time[0]) / (time.size - 1)
    return None


def numbers_or_times(values: Any, column: str, title: str) -> Any:
    """Column as floats, or as times where it holds texts of such; LogError if neither."""
    try:
        return _floats(values, column, title)
    except LogError:
        if values.ndim != 1 or values.dtype.kind not in "OUT":
            raise
        return times_of(values, title, column)


def _floats(values: Any, column: str, title: str) -> Any:
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "fiubO":  # text, complex numbers, dates
            raise TypeError(array.dtype)
        try:
            array = array.astype(np.float64, copy=False)
        except ValueError:
            array = np.array(with_points(array), dtype=np.float64)
    except (TypeError, ValueError) as error:
        words = (
            v for v in np.ravel(values) if isinstance(v, str) and Dialect("").number(v) is None
        )
        example = next(words, "")[:40]
        what = f"holds {example!r}, no number" if example else "does not hold numbers"
        raise LogError(f"{title}: column {column!r} {what}") from error
    if array.ndim != 1:
        raise LogError(f"{title}: column {column!r} holds arrays, not numbers")
    return array
