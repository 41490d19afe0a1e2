"""Clocks: dates and ticks as seconds, and clocks that do not tick evenly."""

import re
from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime
from datetime import time as daytime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.signals.checks import usual_step
from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import EVEN_TOLERANCE, Array, is_even
from dmptm_ctrl.signals.numbers import roundest

# Bridged by a straight line; over more than this at 1 kHz a drive may do anything.
MAX_BRIDGED = 10
DAY, HOUR = 86400.0, 3600.0  # s
COARSE = 0.05  # of the steps are another multiple of a coarse clock's tick than most
_DURATION = re.compile(
    r"(-?\d+ days?\s+)?\d{1,2}:\d{2}(:\d{2})?([.,:]\d+)?$|\S+ (s|sec|ms|us|µs|ns|min|h|hr)$"
    r"|P\d+DT\S+$|L?T(IME)?#"
)
_ZONE = re.compile(r"\[[^\[\]]*\]$|\s?[A-Z]{3,4}$")  # CET
_ISO_DATE = re.compile(r"^(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})[T ,_-]+")
# What clocks count since an epoch, from 2001 to 2060: unit [s], epoch, and seconds since then.
EPOCHS = (
    *((u, f, "1970", 0.98e9, 2.84e9) for u, f in (("ms", 1e-3), ("us", 1e-6), ("ns", 1e-9))),
    ("ticks of 100 ns", 1e-7, "1601", 1.26e10, 1.45e10),
    ("ticks of 100 ns", 1e-7, "the year 1", 6.31e10, 6.5e10),
    ("days", DAY, "1900", 3.18e9, 5.06e9),
    ("days", DAY, "1858", 5.06e9, 6.35e9),  # modified Julian days
    ("days", DAY, "the year 0", 6.31e10, 6.5e10),
    ("days", DAY, "4713 BC", 2.11e11, 2.14e11),  # Julian days
)
ROUND = 1e-5  # of a step, from three digits
LATEST = 1e11  # s; no clock counts so many since any epoch
SHORTEST = 2e-6  # s; nothing samples a drive so fast
# Counters of 16 to 32 bits run over, also where they are printed in thousandths.
ROUNDS = tuple(2.0**b * 10.0**-e for b in (16, 24, 31, 32) for e in (0, 3, 6))


def times_of(texts: NDArray, source: str, column: str) -> NDArray:
    """Dates or times of day (NaN: none) as time since the first one, timedelta64[ns].

    ISO dates, dates with day or month first, times of day, durations; LogError if not all of
    one form.
    """
    import pandas as pd

    values = pd.Series(texts, dtype=object).map(
        lambda v: v.isoformat() if isinstance(v, datetime | daytime) else v
    )
    first = next((str(v).strip() for v in values if isinstance(v, str) and v.strip()), "")
    try:
        text = values.where(values.notna(), None).str.strip().str.replace(",", ".", regex=False)
        text = text.str.replace(_ZONE, "", regex=True)
        if _DURATION.match(first):
            if first.count(":") == 3:  # 09:27:03:010
                text = text.str.replace(r":(\d+)$", r".\1", regex=True)
            elif first.count(":") == 1:  # 27:03.010
                text = "00:" + text
            times = pd.to_timedelta(text.str.replace(r"^L?T(IME)?#", "", regex=True))
        elif re.match(r"\d{4}\D|\d{8}[T_-]", first):
            iso = text.str.replace(_ISO_DATE, r"\1-\2-\3 ", regex=True)
            iso = iso.str.replace(r"^(\d{8})[_-]", r"\1T", regex=True)
            times = pd.to_datetime(iso, format="ISO8601", utc=True)
        else:
            if ":" not in first:
                raise ValueError(first)
            # whole seconds may be written without a fraction
            text = text.str.replace(r"(:\d{2}:\d{2})(?![.:\d])", r"\1.0", regex=True)
            found = []
            for form in _formats_of(text[text.first_valid_index()]):
                with suppress(ValueError):
                    found.append(pd.to_datetime(text, format=form, utc=True))
            if not found:
                raise ValueError(first)
            # of day and month either may come first: then the one that leaves no gap at midnight
            times = min(found, key=lambda each: each.diff().abs().max())
    except (ValueError, OverflowError, AttributeError) as error:
        raise LogError(
            f"{source}: column {column!r} does not hold numbers, nor times as {first[:40]!r} all "
            "through; leave out time in [data] of the rig file and give sample_rate"
        ) from error
    return (times - times.dropna().iloc[0]).to_numpy("timedelta64[ns]")


_DAYS = (
    *("%d.%m.%Y", "%d.%m.%y", "%m/%d/%Y", "%d/%m/%Y", "%d-%b-%Y", "%d-%m-%Y"),
    *("%m/%d/%y", "%d/%m/%y"),
)


def _formats_of(text: str) -> list[str]:
    """Formats that a date may have whose day or month comes first; with dots the day does."""
    found = []
    for day in _DAYS:
        for clock in ("%H:%M:%S.%f", "%I:%M:%S.%f %p", "%H:%M"):
            try:
                datetime.strptime(text, f"{day} {clock}")
            except ValueError:
                continue
            found.append(f"{day} {clock}")
            break
    return found or ["mixed"]


def seconds_of(values: NDArray, factor: float) -> tuple[Array, str]:
    """Time [s] from a column of numbers, dates or differences of time; what was mended.

    Whole numbers beyond 2^53 and dates are counted from the first row: as floats they would
    lose their last digits.
    """
    if values.dtype.kind in "mM":
        since = values - values[~np.isnat(values)][:1]
        missing = np.where(np.isnat(values), np.nan, 0.0)
        return since.astype("timedelta64[ns]").astype(np.float64) * 1e-9 + missing, ""
    own = _epoch(values.astype(np.float64), factor)
    if values.dtype.kind in "iu" and values.size and abs(int(values[0])) > 2**53:
        values = values - values[0]
    raw = values.astype(np.float64)
    if own is not None:
        note, factor = own
        return (raw - raw[np.isfinite(raw)][0]) * factor, note
    return raw * factor, ""


def run_on(time: Array, channels: Mapping[str, Array], factor: float = 1.0) -> tuple[Array, str]:
    """Time [s] of a clock that ran over or was set back while its channels go on, and a note.

    `factor`: seconds of one count. A fall of unknown size must be the same each time and leave no
    mark in the channels; one fall back to the first time is a logger started again.
    """
    rows = np.flatnonzero(np.isfinite(time))
    step = np.diff(time[rows])
    falls = step < 0
    if not falls.any() or falls.mean() > COARSE:
        return time, ""
    usual = float(np.median(step))
    sizes = usual - step[falls]
    known = np.array([*(size * factor for size in ROUNDS), DAY])
    off = np.abs(sizes[:, None] - known).max(axis=0)  # rows may be lost there
    fits = off < np.maximum(np.minimum(MAX_BRIDGED * usual, 0.01 * known), 1e-3 * factor)
    size = float(known[fits][0]) if fits.any() else None
    if size is None:
        near = np.flatnonzero(falls)
        beside = step[np.concatenate([near[near > 0] - 1, near[near < falls.size - 1] + 1])]
        anew = sizes.size == 1 and abs(time[rows[near[0] + 1]] - time[rows[0]]) < 1.5 * usual
        if (
            anew
            or not channels
            or np.ptp(sizes) > usual
            or (np.abs(beside - usual) > 0.5 * usual).any()
        ):
            return time, ""  # or rows out of order
        for values in channels.values():
            change = np.nan_to_num(np.abs(np.diff(values[rows])))
            if change[falls].max() > change[~falls].max():
                return time, ""
        size = float(np.median(sizes))
    time = time.copy()
    time[rows[1:]] += size * np.cumsum(falls)
    times = f"{sizes.size} times" if sizes.size > 1 else "once"
    return time, f"the clock falls by {size:.10g} s {times} while the drive goes on: made to go on"


def _epoch(raw: Array, factor: float) -> tuple[str, float] | None:
    """What a clock must count, as no seconds since any epoch are that many, or tick so; and its s.

    A time of day as a number is a fraction of a day; hours are known by a round rate that days do
    not have. Oscilloscopes tick as fast, in round numbers.
    """
    good = raw[np.isfinite(raw)]
    if good.size < 2:
        return None
    step = np.diff(good)
    # of days that pass midnight, and of rows out of order
    mean = min(float(step[step > 0].sum()), float(np.ptp(good))) / step.size
    first = abs(float(good[0]))
    days = 0 < mean < SHORTEST and factor == 1.0
    for unit, size, since, low, high in EPOCHS:
        other = first * factor > LATEST if size < 1 else days
        if other and low < first * size < high:
            return f"counts {unit} since {since}: taken so", size
    hours = days and _is_round(1 / (mean * HOUR)) and not _is_round(1 / (mean * DAY))
    if days and (hours or first < 1) and not _is_round(mean):
        what, size, instead = ("hours", HOUR, "d") if hours else ("days", DAY, "h")
        note = (
            f"ticks by {mean:.4g}, no seconds of a drive: taken as {what} of {size:g} s, steps of "
            f'{mean * size:.4g} s; else give its unit, as in time = {{ column = "…", '
            f'unit = "{instead}" }}'
        )
        return note, size
    return None


def _is_round(value: float) -> bool:
    """Whether a number is one of three digits."""
    return abs(value / float(f"{value:.2e}") - 1) < ROUND


def mended(
    source: str, time: Array, channels: Mapping[str, Array], sample_time: float | None = None
) -> tuple[Array, dict[str, Array], list[str]]:
    """Put samples on an even clock, by the way that fits what is wrong; return what was done.

    A coarse clock is replaced by an even one, of `sample_time` [s] if that fits; of a run that
    was started again the longer part is taken; else as `resampled`.
    """
    channels = dict(channels)
    if is_even(time):
        usual_step(source, np.diff(time))
        return time, channels, []
    if (even := _spread(time, channels, sample_time)) is not None:
        tick = np.diff(np.unique(time)).min()
        return even, channels, [
            f"the clock is coarse, it steps by {tick:.4g} s or more: samples were spread evenly, "
            f"one each {np.ptp(even) / (even.size - 1):.6g} s; if the rate is known, give "
            "sample_rate in [data] of the rig file"
        ]  # fmt: skip
    if (part := _longest_run(time)) is not None:
        note = f"time starts anew: rows {part.start + 1} to {part.stop} of {time.size} are used"
        time, channels = time[part], {c: v[part] for c, v in channels.items()}
        time, channels, done = mended(source, time, channels, sample_time)
        return time, channels, [note, *done]
    try:
        return resampled(source, time, channels)
    except LogError as error:
        if "[data]" in str(error):
            raise
        raise LogError(
            f"{error}; or say in [data] of the rig file which part is good (start, stop), or "
            "leave out time there and give sample_rate"
        ) from None


def _spread(time: Array, channels: Mapping[str, Array], known: float | None) -> Array | None:
    """Even time where rows share stamps, or these are multiples of a tick; None where not."""
    step = np.diff(time)
    ticks = step[step > 0]
    if (step < 0).any() or ticks.size < 2:
        return None
    again = np.flatnonzero(step == 0)
    if again.size and channels and all((v[again] == v[again + 1]).all() for v in channels.values()):
        return None  # rows that occur twice
    index = np.arange(time.size, dtype=np.float64)
    edges = np.flatnonzero(step)
    if _shared(step):
        # the clock ticks before the first row of a stamp, or a buffer is stamped at its end
        fits = [_line(index[e], time[e]) for e in (edges + 1, edges)]
        most = 0.5 * float(np.median(ticks) + 2 * step.mean())  # else a buffer was lost
    else:
        usual = float(np.median(step))
        odd = np.abs(step - usual) > 0.25 * ticks.min()
        jitter = np.unique(np.round(step / ticks.min(), 1)).size > 6
        if again.size or jitter or odd.mean() < COARSE:
            return None  # steps of any length: a clock that jitters, not a coarse one
        fits = [_line(index, time)]
        most = 1.25 * float(ticks.min())
    rate, error, off = min(fits, key=lambda fit: fit[2])
    if off > most:
        return None
    close = known is not None and abs(known - rate) < 10 * error + 1e-3 * rate
    rate = known if known is not None and close else roundest(rate, 3 * error)
    return float(time[0]) + rate * index


def _shared(step: Array) -> bool:
    """Whether rows share stamps because these change more rarely than rows come."""
    ticks = step[step > 0]
    rare = 0.9 * step.mean() < ticks.min(initial=np.inf)
    return bool(ticks.size < (1 - COARSE if rare else 0.7) * step.size)


def _line(index: Array, time: Array) -> tuple[float, float, float]:
    """Slope of time over rows, its standard error, and the range of what is left."""
    time = time - time[0]  # seconds since 1970 have few digits left
    rate, offset = np.polyfit(index, time, 1)
    left = time - offset - rate * index
    each = np.sqrt(np.var(left) + rate**2 / 12)  # a stamp is known to a row
    return float(rate), float(each / (index.std() * np.sqrt(index.size))), float(np.ptp(left))


def _longest_run(time: Array) -> slice | None:
    """Longest part between falls of the clock, where they are few: a logger started again."""
    falls = np.flatnonzero(np.diff(time) < 0) + 1
    if not falls.size or falls.size > 0.01 * time.size:
        return None
    if any(time[f] > time[0] + 0.5 * (time[f - 1] - time[0]) for f in falls):
        return None  # rows out of order
    edges = [0, *falls.tolist(), time.size]
    return max(map(slice, edges[:-1], edges[1:]), key=lambda part: part.stop - part.start)


def resampled(
    source: str, time: Array, channels: Mapping[str, Array]
) -> tuple[Array, dict[str, Array], list[str]]:
    """Put shuffled, jittery or slightly gappy samples on an even clock; return what was done.

    Rows are sorted by time, repeated rows dropped, values interpolated linearly at the usual
    (median) step. Of rows within the clock's resolution the mean is taken. LogError for two values
    at one time, or a gap of more than ten steps.
    """
    notes = []
    channels = dict(channels)
    if not (np.diff(time) > 0).all():
        if not (np.diff(time) >= 0).all():
            order = np.argsort(time, kind="stable")
            time = time[order]
            channels = {channel: values[order] for channel, values in channels.items()}
            notes.append("sorted by time")
        step = np.diff(time)
        again = np.flatnonzero(step == 0) + 1
        fine = step[step > 0].min(initial=np.inf) < EVEN_TOLERANCE * np.median(step)
        other = [c for c, v in channels.items() if (v[again] != v[again - 1]).any()]
        if other and not fine:
            what = f"{other[0]} has two values" if step.any() else "the clock stands still"
            raise LogError(f"{source}: {what} at time {time[again[0]]:.6g} s")
        first = np.flatnonzero(np.concatenate([[True], step > 0]))
        rows = np.diff([*first, time.size])
        time = time[first]
        channels = {c: np.add.reduceat(v, first) / rows for c, v in channels.items()}
        if again.size:
            what = "rows within a tick of the clock averaged" if other else "repeated rows dropped"
            notes.append(f"{what}: {again.size}")
    step = np.diff(time)
    usual = usual_step(source, step)
    if step.max() > (MAX_BRIDGED + 0.5) * usual:
        row = int(np.argmax(step))
        raise LogError(
            f"{source}: gap of {step[row]:.6g} s after {time[row]:.6g} s; at most {MAX_BRIDGED} "
            f"steps of {usual:.6g} s are bridged, cut the log there"
        )
    each = roundest(usual, 0.1 * EVEN_TOLERANCE * usual)  # values are interpolated in any case
    count = int(np.floor((time[-1] - time[0]) / each + 1e-6)) + 1
    even = time[0] + each * np.arange(count)
    resampled = {channel: np.interp(even, time, values) for channel, values in channels.items()}
    uneven = int((np.abs(step / usual - 1) > 0.05).sum())
    notes.append(
        f"resampled to even steps of {each:.6g} s; {uneven} steps were off, "
        f"the longest {step.max():.6g} s"
    )
    return even, resampled, notes


def increases(values: Any) -> bool:
    """Whether values rise, and never fall, as a clock's do."""
    if values.dtype.kind == "O":
        return False
    steps = np.diff(values[~np.isnan(values)])
    return steps.size > 0 and bool((steps >= steps[:1] * 0).all()) and bool(steps.any())


def ticks(values: Any) -> bool:
    """Whether most rows are later than the ones before; a temperature rises in few."""
    steps = np.diff(values[~np.isnan(values)])
    return bool(2 * np.count_nonzero(steps > steps[:1] * 0) > steps.size)


def equal(one: Any, other: Any) -> bool:
    """Whether two columns have the same kind and the same values."""
    if one.dtype.kind == "O" or one.dtype != other.dtype:
        return bool((one == other).all())
    return bool(np.array_equal(one, other, equal_nan=True))


def same_clock(main: Any, other: Any) -> bool:
    """Whether two columns tick together, be it in other units."""
    if equal(main, other):
        return True
    main, other = (seconds_of(v, 1.0)[0] for v in (main, other))
    both = np.isfinite(main) & np.isfinite(other)
    if not both.any() or (np.isfinite(main) != np.isfinite(other)).any():
        return False
    x, y = main[both] - main[both][0], other[both] - other[both][0]
    if not x.any():
        return False
    rate = float(x @ y) / float(x @ x)
    step = abs(float(x[-1])) / max(x.size - 1, 1)
    same_unit = abs(rate - 1) < 1e-3
    shift = abs(float(other[both][0] - main[both][0])) if same_unit else 0.0
    return bool(np.abs(y - rate * x).max() <= 0.01 * abs(rate) * step and shift <= 0.01 * step)
