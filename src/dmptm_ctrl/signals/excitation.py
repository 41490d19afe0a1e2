"""Inputs for experiments: (time, u) as `control.forced_response` takes them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def time_grid(duration: float, sample_time: float) -> Array:
    """Time from 0, `duration` / `sample_time` samples [s].

    Raises
    ------
    ValueError
        Not positive, or less than one sample.
    """
    if not (sample_time > 0 and duration >= sample_time and np.isfinite(duration)):
        raise ValueError(
            f"duration {duration} s and sample time {sample_time} s do not make one sample"
        )
    return sample_time * np.arange(round(duration / sample_time), dtype=np.float64)


def sine(
    amplitude: float, frequency: float, duration: float, *, sample_time: float = 1e-3
) -> tuple[Array, Array]:
    """Sine that starts at zero.

    Parameters
    ----------
    amplitude : float
        In the unit of the input.
    frequency : float [Hz]
        Below half the sample rate.
    duration, sample_time : float [s]

    Returns
    -------
    time, u : (n,) array

    Raises
    ------
    ValueError
        A frequency at or above half the sample rate.
    """
    time = time_grid(duration, sample_time)
    _refuse_alias([frequency], sample_time)
    return time, amplitude * np.sin(2 * np.pi * frequency * time)


def square(
    amplitude: float, frequency: float, duration: float, *, sample_time: float = 1e-3
) -> tuple[Array, Array]:
    """Square wave that starts high; parameters as `sine`."""
    time = time_grid(duration, sample_time)
    _refuse_alias([frequency], sample_time)
    # Half periods are counted in samples: time · frequency may round below a whole number.
    phase = np.floor(2 * frequency * time + 1e-9)
    return time, amplitude * np.where(phase % 2 == 0, 1.0, -1.0)


def multisine(
    frequencies: Sequence[float] | Array,
    rms: float,
    duration: float,
    *,
    sample_time: float = 1e-3,
    seed: int | None = None,
) -> tuple[Array, Array]:
    """Sum of equal sines, low in crest factor.

    Parameters
    ----------
    frequencies : sequence of float [Hz]
        Whole multiples of 1 / period make it periodic.
    rms : float
        Of the sum, in the unit of the input; equal on each line.
    duration, sample_time : float [s]
    seed : int, optional
        Random phases from this seed; Schroeder's phases without.

    Returns
    -------
    time, u : (n,) array

    Raises
    ------
    ValueError
        No frequency, or one at or above half the sample rate.

    Source
    ------
    Phases -π k (k - 1) / N: Schroeder, IEEE Trans. Inf. Theory 16 (1970) 85, for a flat spectrum.
    """
    time = time_grid(duration, sample_time)
    lines = np.asarray(frequencies, dtype=float)
    _refuse_alias(lines, sample_time)
    index = np.arange(1, lines.size + 1)
    phases = -np.pi * index * (index - 1) / lines.size
    if seed is not None:
        phases = np.random.default_rng(seed).uniform(0, 2 * np.pi, lines.size)
    u = np.zeros_like(time)
    for frequency, phase in zip(lines, phases, strict=True):
        u += np.cos(2 * np.pi * frequency * time + phase)
    return time, rms * np.sqrt(2 / lines.size) * u


def chirp(
    amplitude: float, start: float, stop: float, duration: float, *, sample_time: float = 1e-3
) -> tuple[Array, Array]:
    """Sine whose frequency grows by the same factor each second.

    Parameters
    ----------
    amplitude : float
        In the unit of the input.
    start, stop : float [Hz]
        Frequency at the first instant and at `duration`; positive and different.
    duration, sample_time : float [s]

    Returns
    -------
    time, u : (n,) array

    Raises
    ------
    ValueError
        A frequency that is not positive, or at or above half the sample rate.

    Source
    ------
    Farina, 108th AES Convention (2000), exponential sweep.
    """
    time = time_grid(duration, sample_time)
    _refuse_alias([start, stop], sample_time)
    if start == stop:
        raise ValueError(f"a chirp from {start} to {stop} Hz is a sine")
    rate = duration / np.log(stop / start)
    return time, amplitude * np.sin(2 * np.pi * start * rate * np.expm1(time / rate))


def stepped_sine(
    amplitude: float,
    frequencies: Sequence[float] | Array,
    periods: int,
    *,
    sample_time: float = 1e-3,
) -> tuple[Array, Array]:
    """Sines one after another, joined at their zero crossings.

    Parameters
    ----------
    amplitude : float
        In the unit of the input.
    frequencies : sequence of float [Hz]
    periods : int
        Of each frequency, 1 or more.
    sample_time : float [s]

    Returns
    -------
    time, u : (n,) array

    Raises
    ------
    ValueError
        No frequency, one not positive or at or above half the sample rate, no period.
    """
    lines = np.asarray(frequencies, dtype=float)
    _refuse_alias(lines, sample_time)
    if periods < 1:
        raise ValueError(f"{periods} periods of each frequency; 1 or more are needed")
    ends = np.cumsum(periods / lines)  # s
    time = time_grid(float(ends[-1]), sample_time)
    step = np.minimum(np.searchsorted(ends, time, side="right"), lines.size - 1)
    begun = np.concatenate([[0.0], ends[:-1]])[step]
    return time, amplitude * np.sin(2 * np.pi * lines[step] * (time - begun))


def _refuse_alias(frequencies: Sequence[float] | Array, sample_time: float) -> None:
    lines = np.asarray(frequencies, dtype=float)
    if lines.size == 0:
        raise ValueError("no frequency")
    half_rate = 0.5 / sample_time
    bad = lines[~((lines > 0) & (lines < half_rate))]
    if bad.size:
        raise ValueError(f"frequency {bad[0]:g} Hz is not between 0 and {half_rate:g} Hz")
