"""Counters of few bits: readings that jump where they run over, or count negative from the top."""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import Array
from dmptm_ctrl.signals.numbers import roundest

BITS = range(8, 33)
WHOLE = 1e-6  # whole numbers are such within this
GRID = 0.01  # counts; readings that were scaled are whole numbers of steps within this
SLACK = 8  # counts; a counter may be read in two parts, or count to one less
FEWEST = 100  # readings of a counter
SMOOTH = 0.25  # of a modulus; steps that differ by more are noise or spikes
OFTEN = 0.2  # of the steps may be jumps
PASSES = 4  # samples; a failure that is over by then is bridged
FEW = 3  # times that a counter is set in a log
SINGLE = 10.0  # times the greatest other step; motion comes and goes over several samples
NEAR_TOP = 0.75  # of a counter's range; numbers below zero of a load that hangs are above
CALM = 0.5  # of the change that is left when a reading is taken with its sign


def whole_numbers(values: Array) -> bool:
    """Whether all readings are counts."""
    good = values[np.isfinite(values)]
    whole = np.abs(good - np.round(good)) < WHOLE
    return good.size > 1 and float(np.ptp(good)) > 0 and bool(whole.all())


def step_of_counts(values: Array) -> float:
    """Size of a count: 1 of whole numbers, else that of readings that were scaled; 0 for none."""
    if whole_numbers(values):
        return 1.0
    steps = np.unique(np.abs(np.diff(values)))
    steps = steps[steps > WHOLE * steps.max(initial=0.0)]
    if not steps.size:
        return 0.0
    few = steps[np.unique(np.geomspace(1, steps.size, 300).astype(int)) - 1]
    size = float(few[0])
    for step in few:  # larger ones show it better
        size = float(step) / round(step / size)
    counts = values / size
    return size if (np.abs(counts - np.round(counts)) < GRID).all() else 0.0


def unwrapped_counts(column: str, values: Array, turn: float = 0.0) -> tuple[Array, str]:
    """Position without the jumps of a counter that runs over, and a note if there were any.

    Values are as the file has them, `turn` is a whole turn in them (0: they slide); NaN is passed
    over. Moduli of whole turns, of 2^n counts and of round numbers come first, then what the jumps
    show. The motion must go on across each jump.
    """
    good = np.isfinite(values)
    reading = values[good]
    step = np.diff(reading)
    span = float(np.ptp(reading)) if reading.size else 0.0
    if step.size < 2 or not (np.abs(step) > 0.5 * span).any():
        return values, ""
    unit = step_of_counts(reading)
    unit *= span > FEWEST * unit  # a few levels are no counter
    best = None
    for size, what in _known_moduli(span, unit, turn):
        turns, misfit = _jumps_of(step, size, span, SLACK * unit)
        if turns is not None and (best is None or misfit < best[0]):
            best = misfit, size, turns, what
    if best is None and (usual_one := _usual_modulus(step, unit)) is not None:
        turns, misfit = _jumps_of(step, usual_one, span, SLACK * unit)
        if turns is not None and span < usual_one + 0.5 * unit:
            best = misfit, usual_one, turns, f"started anew after {usual_one:.6g}"
    if best is None:
        return values, ""
    _, size, turns, what = best
    result = values.copy()
    result[good] = reading - size * np.concatenate([[0.0], np.cumsum(turns)])
    return result, f"{column} {what}, {int((turns != 0).sum())} times: unwrapped"


def _known_moduli(span: float, unit: float, turn: float) -> Iterator[tuple[float, str]]:
    """Usual moduli of counters whose readings have this span."""
    if turn:
        yield max(np.ceil(span / turn - WHOLE), 1.0) * turn, "jumped by whole turns"
    for bits in BITS if unit else ():
        if 0.5 * 2.0**bits * unit <= span < (2.0**bits - 0.5) * unit:
            yield 2.0**bits * unit, f"is a {bits} bit counter that ran over"
    decade = 10.0 ** np.floor(np.log10(span))
    for size in (decade, 2 * decade, 3.6 * decade, 5 * decade, 10 * decade):
        if 0.5 * size <= span < size:
            yield size, f"started anew after {size:g}"


def _usual_modulus(step: Array, unit: float) -> float | None:
    """Modulus by two jumps or more, through which the motion goes on at a speed that shows."""
    size = np.abs(step)
    far = size > 0.5 * size.max()
    if far.mean() > OFTEN or size[~far].max(initial=0.0) > 0.5 * size[far].min():
        return None
    middle, change = _around(step, far)
    ahead = -np.sign(step[far]) * middle
    moving = ahead > np.abs(change)
    if moving.sum() < 2:
        return None
    sizes = (size[far] + ahead)[moving]
    usual_one = float(np.median(sizes))
    error = max(3 / np.sqrt(sizes.size), 1.0) * float(np.std(sizes)) + 0.6 * unit
    return roundest(usual_one, error)


def _around(step: Array, over: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Steps at jumps by a cubic through two calm ones before and after them, and their change."""
    calm = np.flatnonzero(~over)
    right = np.searchsorted(calm, np.flatnonzero(over))
    far, before, after, beyond = (
        step[calm[(right + k).clip(0, calm.size - 1)]] for k in (-2, -1, 0, 1)
    )
    return (4 * (before + after) - far - beyond) / 6, after - before


def _jumps_of(step: Array, size: float, span: float, slack: float) -> tuple[Array | None, float]:
    """Times that each step runs over a modulus (None: not so), and misfit of the motion there."""
    turns = np.round(step / size)
    over = turns != 0
    if not over.any() or over.mean() > OFTEN:
        return None, 0.0
    left = (step - size * turns)[over]
    misfit = float(np.abs(left - _around(step, over)[0]).max())
    usual = float(np.abs(np.diff(step[~over])).max(initial=0.0))
    smooth = misfit <= usual + slack and usual < SMOOTH * size
    fits = smooth and span >= size - np.abs(left).min() - slack
    return (turns, misfit) if fits else (None, misfit)


def without_failures(source: str, column: str, values: Array, time: Array) -> tuple[Array, str]:
    """Position with readings that fail for a few samples bridged, and a note if there were any.

    LogError for a jump by half the range, or far beyond all others, after which it stays elsewhere.
    """
    around = sliding_window_view(np.pad(values, PASSES, mode="edge"), 2 * PASSES + 1)
    calm = np.median(around, axis=1)
    failed = np.abs(values - calm) > SINGLE * np.abs(np.diff(calm)).max()
    note = ""
    if failed.any() and np.ptp(calm) > 0:
        row, count = int(np.argmax(failed)), int(failed.sum())
        note = (
            f"{column} fails in {count} sample{'s' * (count > 1)}, first by "
            f"{values[row] - calm[row]:.6g} after {time[row] - time[0]:.6g} s: bridged"
        )
        values = np.interp(time, time[~failed], values[~failed])
    far, usual = _jumps(values)
    if not far.any():
        far, usual = _single(np.abs(np.diff(values)))
    if far.any():
        row = int(np.argmax(far))
        raise LogError(
            f"{source}: {column} jumps by {abs(values[row + 1] - values[row]):.6g} after "
            f"{time[row] - time[0]:.6g} s, where it changes by {usual:.6g} at most elsewhere: a "
            "counter that ran over, was set or failed; leave that part out (start and stop in "
            "[data] of the rig file)"
        )
    return values, note


def _jumps(values: Array) -> tuple[NDArray[np.bool_], float]:
    """Which steps are jumps, and the greatest of the others."""
    step = np.abs(np.diff(values))
    far = step > 0.5 * float(np.ptp(values)) if values.size > 2 else step > np.inf
    usual = float(step[~far].max(initial=0.0))
    if not far.any() or far.mean() > OFTEN or not 0 < usual <= 0.25 * float(step[far].min()):
        return np.zeros(step.size, bool), usual
    return far, usual


def _single(step: Array) -> tuple[NDArray[np.bool_], float]:
    """Which few steps are far greater than all others, as where a counter was set."""
    largest = np.sort(step)[-FEW - 1 :]
    for usual, next_one in pairwise(largest):
        if 0 < SINGLE * usual < next_one:
            return step > usual, float(usual)
    return np.zeros(step.size, bool), 0.0


def with_sign(column: str, values: Array) -> tuple[Array, str]:
    """Signal of 8 to 32 bits whose negative values were read as large positive ones."""
    good = np.isfinite(values)
    reading = values[good]
    if reading.size < 3 or reading.min() < 0 or (unit := step_of_counts(reading)) == 0.0:
        return values, ""
    for bits in BITS if unit == 1.0 else (16,):
        size = 2.0**bits * unit
        if not size / 2 < reading.max() < size:
            continue
        signed = np.where(reading >= size / 2, reading - size, reading)
        step, calm = np.abs(np.diff(reading)), np.abs(np.diff(signed))
        crosses = signed.max() > 0 and (step > size / 2).any()
        near = reading.max() >= size - calm.max()  # the first one below zero
        if crosses and near and calm.max() < size / 2 and calm.sum() < CALM * step.sum():
            result = values.copy()
            result[good] = signed
            return result, (
                f"{column} holds numbers of {bits} bits with a sign, read without it: values "
                f"from {size / 2:.6g} on were taken as negative"
            )
    for bits in (16, 32) if unit == 1.0 else ():
        size, low, high = 2.0**bits, float(reading.min()), float(reading.max())
        if not (NEAR_TOP * size <= low and high < size):
            continue
        below = f"{low - size:.6g} to {high - size:.6g}"
        if bits == 32 or size - high <= high - low:  # nearer to zero than it changes
            note = f"{column} holds negative numbers of {bits} bits, read without a sign: {below}"
            return values - size, note
        return values, (
            f"{column} is {low:.6g} to {high:.6g} in all rows: perhaps numbers of {bits} bits with "
            f"a sign, {below}, read without it"
        )
    return values, ""
