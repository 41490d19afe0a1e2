"""Counters of few bits: readings that jump where they run over, or count negative from the top."""

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.signals.errors import LogError

Array = NDArray[np.float64]

BITS = (8, 10, 12, 13, 14, 16, 18, 20, 24, 32)
WHOLE = 1e-6  # whole numbers are such within this
GRID = 0.01  # counts; readings that were scaled are whole numbers of steps within this
SLACK = 8  # counts; a counter may be read in two parts, or count to one less
PASSES = 4  # samples after which a failure that passes is over
FEW = 3  # times that a counter is set in a log
SINGLE = 10.0  # times the greatest other step; motion comes and goes over several samples
CALM = 0.5  # of the change that is left when a reading is taken with its sign


def whole_numbers(values: Array) -> bool:
    """Whether all readings are counts."""
    good = values[np.isfinite(values)]
    return good.size > 1 and float(np.ptp(good)) > 0 and bool(
        (np.abs(good - np.round(good)) < WHOLE).all()
    )  # fmt: skip


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
    for step in few:  # larger ones tell it better
        size = float(step) / round(step / size)
    counts = values / size
    return size if (np.abs(counts - np.round(counts)) < GRID).all() else 0.0


def unwrapped_counts(column: str, values: Array) -> tuple[Array, str]:
    """Position without the jumps of a counter that runs over, and a note if there were any.

    Values are as the file has them: counts, or counts times a factor; NaN is passed over.
    """
    good = np.isfinite(values)
    reading = values[good]
    far, usual = _jumps(reading)
    unit = step_of_counts(reading) if far.any() else 0.0
    if unit == 0.0:
        return values, ""
    step = np.diff(reading) / unit
    for bits in BITS:
        left = step - 2.0**bits * np.sign(step)
        if np.ptp(reading) / unit >= 2.0**bits:
            continue
        if unit == 1.0:
            fits = np.abs(left[far]) <= max(1.5 * usual, SLACK)
        else:  # any number is 2^n of something: the motion must go on as before
            before, after = (np.concatenate(p) for p in (([0.0], step[:-1]), (step[1:], [0.0])))
            fits = (np.abs(left - before) <= np.abs(after - before) + SLACK)[far]
        if fits.all():
            turns = np.where(far, np.sign(step), 0.0)
            result = values.copy()
            result[good] = reading - 2.0**bits * unit * np.concatenate([[0.0], np.cumsum(turns)])
            return result, (
                f"{column} is a {bits} bit counter that ran over {int(far.sum())} times and was "
                "unwrapped"
            )
    return values, ""


def refuse_jumps(source: str, column: str, values: Array, time: Array) -> None:
    """Refuse a position that jumps by half its range, or once, and stays elsewhere.

    Shorter failures pass.
    """
    far, usual = _jumps(values)
    if not far.any():
        far, usual = _single(np.abs(np.diff(values)))
    ways = np.sign(np.diff(values)) * far
    for row in np.flatnonzero(far):
        jump = abs(values[row + 1] - values[row])
        if -ways[row] in ways[max(row - PASSES, 0) : row + PASSES + 1]:
            continue
        raise LogError(
            f"{source}: {column} jumps by {jump:.6g} after "
            f"{time[row] - time[0]:.6g} s, where it changes by {usual:.6g} at most elsewhere: a "
            "counter that ran over, was set or failed; leave that part out (start and stop in "
            "[data] of the rig file)"
        )


def _jumps(values: Array) -> tuple[NDArray[np.bool_], float]:
    """Which steps are jumps, and the greatest of the others."""
    step = np.abs(np.diff(values))
    far = step > 0.5 * float(np.ptp(values)) if values.size > 2 else step > np.inf
    usual = float(step[~far].max(initial=0.0))
    if not far.any() or far.mean() > 0.2 or not 0 < usual <= 0.25 * float(step[far].min()):
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
    """Signal of 8, 16 or 32 bits whose negative values were read as large positive ones."""
    good = np.isfinite(values)
    reading = values[good]
    if reading.size < 3 or reading.min() < 0 or (unit := step_of_counts(reading)) == 0.0:
        return values, ""
    for bits in (8, 12, 16, 32) if unit == 1.0 else (16,):
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
    return values, ""
