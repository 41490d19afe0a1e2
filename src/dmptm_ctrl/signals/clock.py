"""Clocks that do not tick evenly."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.signals.checks import usual_step
from dmptm_ctrl.signals.errors import LogError

Array = NDArray[np.float64]

# Bridged by a straight line; over more than this at 1 kHz a drive does something unseen.
MAX_BRIDGED = 10


def resampled(
    source: str, time: Array, channels: Mapping[str, Array]
) -> tuple[Array, dict[str, Array], list[str]]:
    """Put shuffled, jittery or slightly gappy samples on an even clock.

    Rows are sorted by time, repeated rows dropped, values interpolated linearly at the usual
    (median) step.

    Parameters
    ----------
    source : str
        Name of the file, for messages.
    time : (n,) array [s]
    channels : mapping of str to (n,) array

    Returns
    -------
    time, channels
        On the even clock.
    notes : list of str
        What was done.

    Raises
    ------
    LogError
        Two values at one time, or a gap of more than ten steps.
    """
    notes = []
    channels = dict(channels)
    if not (np.diff(time) > 0).all():
        order = np.argsort(time, kind="stable")
        time = time[order]
        channels = {channel: values[order] for channel, values in channels.items()}
        again = np.flatnonzero(np.diff(time) == 0) + 1
        for channel, values in channels.items():
            if (values[again] != values[again - 1]).any():
                raise LogError(f"{source}: {channel} has two values at time {time[again[0]]:.6g} s")
        time = np.delete(time, again)
        channels = {channel: np.delete(values, again) for channel, values in channels.items()}
        notes.append(f"sorted by time, {again.size} repeated rows dropped")
    step = np.diff(time)
    usual = usual_step(source, step)
    if step.max() > (MAX_BRIDGED + 0.5) * usual:
        row = int(np.argmax(step))
        raise LogError(
            f"{source}: gap of {step[row]:.6g} s after {time[row]:.6g} s; at most {MAX_BRIDGED} "
            f"steps of {usual:.6g} s are bridged, cut the log there"
        )
    count = int(np.floor((time[-1] - time[0]) / usual + 1e-6)) + 1
    even = time[0] + usual * np.arange(count)
    resampled = {channel: np.interp(even, time, values) for channel, values in channels.items()}
    uneven = int((np.abs(step / usual - 1) > 0.05).sum())
    notes.append(
        f"resampled to even steps of {usual:.6g} s; {uneven} steps were off, "
        f"the longest {step.max():.6g} s"
    )
    return even, resampled, notes
