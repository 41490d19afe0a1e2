"""Counters of few bits: readings that jump where they run over, or count negative from the top."""

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.signals.errors import LogError

Array = NDArray[np.float64]

BITS = (8, 10, 12, 13, 14, 16, 18, 20, 24, 32)
WHOLE = 1e-6  # counts are whole numbers within this
SLACK = 8  # counts; a counter may be read in two parts, or count to one less
CALM = 0.5  # of the change that is left when a reading is taken with its sign


def whole_numbers(values: Array) -> bool:
    """Whether all readings are counts."""
    good = values[np.isfinite(values)]
    return good.size > 1 and float(np.ptp(good)) > 0 and bool(
        (np.abs(good - np.round(good)) < WHOLE).all()
    )  # fmt: skip


def unwrapped_counts(source: str, column: str, values: Array) -> tuple[Array, str]:
    """Position without the jumps of a counter that runs over.

    Parameters
    ----------
    source, column : str
        For messages.
    values : (n,) array
        As the file has them; NaN is passed over.

    Returns
    -------
    values : (n,) array
    note : str
        What was done; empty if nothing was.

    Raises
    ------
    LogError
        Jumps of half the range and more between small steps, by no number that counters have.
    """
    good = np.isfinite(values)
    reading = values[good]
    if reading.size < 3 or not whole_numbers(reading):
        return values, ""
    step = np.diff(reading)
    span = float(np.ptp(reading))
    far = np.abs(step) > 0.5 * span
    calm = np.abs(step[~far])
    if not far.any() or not calm.size or far.mean() > 0.2:
        return values, ""
    usual = float(calm.max())
    if usual > 0.25 * float(np.abs(step[far]).min()):
        return values, ""
    for bits in BITS:
        size = 2.0**bits
        left = step[far] - size * np.sign(step[far])
        if span < size and (np.abs(left) <= max(1.5 * usual, SLACK)).all():
            turns = np.where(far, np.sign(step), 0.0)
            result = values.copy()
            result[good] = reading - size * np.concatenate([[0.0], np.cumsum(turns)])
            return result, (
                f"{column} is a {bits} bit counter that ran over {int(far.sum())} times and was "
                "unwrapped"
            )
    if far.sum() == 1 or float(np.ptp(np.abs(step[far]))) > 4 * usual + SLACK:
        row = int(np.flatnonzero(good)[np.argmax(far) + 1])
        raise LogError(
            f"{source}: {column} jumps by {np.abs(step).max():.6g} in row {row + 1}, where it "
            f"changes by {usual:.6g} at most elsewhere: a counter that was set or failed; leave "
            "that part out (start and stop in [data] of the rig file)"
        )
    return values, ""


def with_sign(column: str, values: Array) -> tuple[Array, str]:
    """Signal of 8, 16 or 32 bits whose negative values were read as large positive ones."""
    good = np.isfinite(values)
    reading = values[good]
    if reading.size < 3 or reading.min() < 0 or not whole_numbers(reading):
        return values, ""
    for bits in (8, 12, 16, 32):
        size = 2.0**bits
        if not size / 2 < reading.max() < size:
            continue
        signed = np.where(reading >= size / 2, reading - size, reading)
        step, calm = np.abs(np.diff(reading)), np.abs(np.diff(signed))
        crosses = signed.max() > 0 and (step > size / 2).any()
        if crosses and calm.max() < size / 2 and calm.sum() < CALM * step.sum():
            result = values.copy()
            result[good] = signed
            return result, (
                f"{column} holds numbers of {bits} bits with a sign, read without it: values "
                f"from {size / 2:.0f} on were taken as negative"
            )
    return values, ""
