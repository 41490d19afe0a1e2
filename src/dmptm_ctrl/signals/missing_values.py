"""Values that are not there: at either end, between rarer samples, on another clock."""

import re
from collections.abc import Mapping

import numpy as np

from dmptm_ctrl.signals.checks import HUGE
from dmptm_ctrl.signals.clock import MAX_BRIDGED
from dmptm_ctrl.signals.log import Array

NINES = re.compile(r"-?9{3,}(\.(9+|25))?")  # what programs write where there is no value
LIMITS = {-(2.0**31), 2.0**31 - 1, -(2.0**63), 2.0**63}  # of whole numbers of many bits
# Limits of 16 bits, also in tenths, eights and powers of ten may be readings as well.
MAY_BE_NONE = re.compile(r"-?(?:0*(?:3276[78]|65535|8{4,})0*|1e\+\d+)")
SHORT = 4  # samples; a signal that is clipped stays there for longer, or comes often
SELDOM = 0.01  # of the samples
RARE = 2  # a column sampled more rarely has a value in every second row at most
EVEN_HOLES = 2.5  # the longest hole of such a column, in usual ones


def on_one_clock(
    time: Array,
    channels: Mapping[str, Array],
    clocks: Mapping[str, Array],
    labels: Mapping[str, str],
) -> tuple[Array, dict[str, Array], list[str]]:
    """Bring channels with clocks of their own [s] to the clock that ticks most often; say so.

    NaN where a channel has no value yet or no more. `labels`: what the file calls the channels.
    """
    if not clocks:
        return time, dict(channels), []
    # The densest; of equals the table's own.
    main = max([time, *clocks.values()], key=lambda t: int(np.isfinite(t).sum()))
    main = main[np.isfinite(main)]
    result, moved = {}, []
    for name, values in channels.items():
        own = clocks.get(name, time)
        good = np.isfinite(own) & np.isfinite(values)
        t, v = own[good], values[good]
        if np.array_equal(t, main):
            result[name] = v
            continue
        result[name] = np.interp(main, t, v, left=np.nan, right=np.nan) if t.size else main * np.nan
        moved.append(labels.get(name, name))
    notes = []
    if moved:
        notes = [
            f"{', '.join(moved)} on {'another clock' if len(moved) == 1 else 'other clocks'}: "
            "interpolated to the clock that ticks most often"
        ]
    return main, result, notes


def without_sentinels(values: Array) -> tuple[Array, float | None]:
    """Take what stands for "no value" as none: ∞, 1e38, -9999 and the like, far from all others.

    From the values as the file has them, (n,): these with NaN instead, and that number or None.
    """
    if (endless := np.isinf(values)).any():
        return np.where(endless, np.nan, values), np.inf
    good = values[np.isfinite(values)]
    huge = np.abs(good) >= HUGE
    if huge.any() and not huge.all():
        return np.where(np.abs(values) >= HUGE, np.nan, values), float(good[np.argmax(huge)])
    for end in (float(good.min()), float(good.max())) if good.size else ():
        if (NINES.fullmatch(f"{end:.9g}") or end in LIMITS) and _far_from(good, end):
            return np.where(values == end, np.nan, values), end
    return values, None


def without_isolated(values: Array, least: float = 0.0) -> tuple[Array, float | None]:
    """Take few single samples at a limit of 16 bits and the like, far from all others, as none.

    As `without_sentinels`; of numbers from `least` on.
    """
    good = values[np.isfinite(values)]
    for end in (float(good.min()), float(good.max())) if good.size else ():
        at = values == end
        edges = np.flatnonzero(np.diff(np.concatenate([[False], at, [False]])))
        few = (
            abs(end) >= least
            and at.sum() <= max(SHORT, SELDOM * at.size)
            and np.diff(edges)[::2].max() <= SHORT
        )
        if few and MAY_BE_NONE.fullmatch(f"{end:.9g}".replace(".", "")) and _far_from(good, end):
            return np.where(at, np.nan, values), end
    return values, None


def _far_from(good: Array, end: float) -> bool:
    """Whether a number is more than twice as large as all others, which are no constant."""
    others = good[good != end]
    return bool(others.size and 2 * np.abs(others).max() < abs(end) and np.ptp(others) > 0)


def without_missing(
    channels: Mapping[str, Array], labels: Mapping[str, str]
) -> tuple[slice, dict[str, Array], list[str]]:
    """Fill columns sampled more rarely; return the complete rows, filled channels, and notes.

    Rows at either end that are not complete are left out; holes of up to ten rows are filled.
    """
    filled: dict[str, Array] = {}
    notes = []
    for name, values in channels.items():
        filled[name] = values
        there = np.flatnonzero(~np.isnan(values))
        if there.size in (0, values.size):
            continue
        gaps = np.diff(there)
        inner = values[there[0] : there[-1] + 1]
        holes = int(np.isnan(inner).sum())
        usual = float(np.median(gaps)) if gaps.size else 0.0
        label = labels.get(name, name)
        if name != "time" and usual >= RARE and gaps.max() <= EVEN_HOLES * usual:
            notes.append(f"{label} has a value in one of {usual:g} rows only and was interpolated")
        elif not (holes and gaps.max() <= MAX_BRIDGED + 1 and name != "time"):
            continue
        else:
            notes.append(
                f"{label} lacks {holes} value{'s' * (holes > 1)}, at most {gaps.max() - 1} in a "
                "row: bridged"
            )
        rows_of = np.arange(values.size)
        filled[name] = np.interp(rows_of, there, values[there], left=np.nan, right=np.nan)
    complete = np.flatnonzero(np.all([np.isfinite(v) for v in filled.values()], axis=0))
    size = next(iter(filled.values())).size
    if not complete.size or complete.size == size:
        return slice(0, size), filled, notes
    rows = slice(int(complete[0]), int(complete[-1]) + 1)
    for what, part in (("first", slice(0, rows.start)), ("last", slice(rows.stop, size))):
        count = part.stop - part.start
        if count:
            lacking = [
                labels.get(n, n) for n, v in filled.items() if not np.isfinite(v[part]).all()
            ]
            gone = "row was" if count == 1 else f"{count} rows were"
            notes.append(f"the {what} {gone} left out: no value for {', '.join(lacking)}")
    return rows, filled, notes
