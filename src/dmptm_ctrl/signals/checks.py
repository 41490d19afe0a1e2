"""Is a log usable? Errors say in one sentence what is wrong, warnings what is suspect."""

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import EVEN_TOLERANCE

Array = NDArray[np.float64]

MIN_SAMPLES = 100  # fewer tell nothing about a drive
GAP_STEPS = 1.5  # a step longer than this many usual ones has lost samples


def finite(source: str, column: str, values: Array) -> None:
    """Refuse NaN and infinity.

    Raises
    ------
    LogError
        Names the row (first row of numbers = 1), the column and how many there are.
    """
    bad = ~np.isfinite(values)
    if bad.any():
        row, count = int(np.argmax(bad)), int(bad.sum())
        more = f" ({count} such values)" if count > 1 else ""
        kind = "missing (NaN)" if np.isnan(values[row]) else "infinite"
        raise LogError(f"{source}: {column} is {kind} in row {row + 1}{more}")


def even_time(source: str, time: Array, *, resample: bool = False) -> None:
    """Refuse a clock that runs backwards, repeats, has gaps or is uneven.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    time : (n,) array [s]
    resample : bool
        Uneven steps will be interpolated: only a clock that does not increase is refused.

    Raises
    ------
    LogError
    """
    step = np.diff(time)
    if (step < 0).all():
        raise LogError(f"{source}: time runs backwards; reverse the rows")
    if (step <= 0).any():
        row = int(np.argmax(step <= 0)) + 1
        what = "repeats" if step[row - 1] == 0 else "goes back"
        raise LogError(
            f"{source}: time {what} in row {row + 1} "
            f"({time[row - 1]:.6g} s, then {time[row]:.6g} s)"
        )
    if resample:
        return
    usual = float(np.median(step))
    if (step > GAP_STEPS * usual).any():
        row, count = int(np.argmax(step)), int((step > GAP_STEPS * usual).sum())
        lost = round(step[row] / usual) - 1
        raise LogError(
            f"{source}: {count} gap{'s' * (count > 1)} in time, the longest after row {row + 1} "
            f"({time[row]:.6g} s): {step[row]:.6g} s, {lost} sample{'s' * (lost > 1)} lost; "
            "cut the log there, or resample it if the gaps are short"
        )
    grid = time[0] + (time[-1] - time[0]) / step.size * np.arange(time.size)
    if np.abs(time - grid).max() > EVEN_TOLERANCE * usual:
        raise LogError(
            f"{source}: uneven sample rate, steps {step.min():.6g} to {step.max():.6g} s; "
            "resample the log to even steps"
        )
