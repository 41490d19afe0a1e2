"""Frequency responses that depend on amplitude, from the compiled simulator and from logs.

Stepped sine: one frequency after another, the fundamental over whole periods (the describing
function of the whole drive). Multisine: many frequencies at once with random phases, averaged
(the best linear approximation, Pintelon & Schoukens, System Identification, 2nd ed., ch. 3).
"""

from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal import csd, welch

from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop, march, rest
from dmptm_ctrl.simulate.model import Floats, Model

SETTLE_SECONDS = 2.0  # seven time constants of the rigid drive against viscous friction
MIN_SAMPLES = 8  # per period; below, the held input is no sine


class FrequencyResponse(NamedTuple):
    """A measured response and how far it is linear.

    Attributes
    ----------
    response : FrequencyResponseData
        From one input to one output, SI.
    coherence : (n,) array
        Share of the output's power at each frequency that the linear response explains, in
        [0, 1]; harmonics, noise and rattle lower it.
    """

    response: ct.FrequencyResponseData
    coherence: Floats

    @property
    def hz(self) -> Floats:
        """Frequencies [Hz]."""
        return np.asarray(self.response.omega) / (2.0 * pi)

    @property
    def values(self) -> NDArray[np.complex128]:
        """Response as a vector, (n,)."""
        return np.asarray(self.response.frdata[0, 0])


def _pack(
    omega: ArrayLike, values: ArrayLike, coherence: ArrayLike, labels: tuple[str, str], name: str
) -> FrequencyResponse:
    data = ct.frd(
        np.asarray(values)[None, None],
        np.asarray(omega),
        inputs=[labels[0]],
        outputs=[labels[1]],
        name=name.replace(".", "_"),  # python-control allows no dot in a name
    )
    return FrequencyResponse(data, np.asarray(coherence, float))


def stepped_sine(
    model: Model,
    hz: ArrayLike,
    amplitude: float,
    *,
    loop: Loop | None = None,
    offset: float = 0.0,
    preload: float = 0.0,
    output: str = "omega_L",
    periods: int = 6,
    sample_time: float = 1e-3,
    name: str | None = None,
) -> FrequencyResponse:
    """Measure a response with sines of one amplitude.

    Parameters
    ----------
    model : Model
    hz : (n,) array_like [Hz]
        Rounded to whole samples per period.
    amplitude : float
        Of the common voltage [V], or with `loop` of the setpoint [rad/s].
    loop : Loop, optional
        Close the speed loop; the input is then ``ref``.
    offset : float
        Added to the sine, in its unit.
    preload : float [V]
        On the left motor, and its negative on the right one (open loop).
    output : str
        Of :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS`.
    periods : int
        Whole periods that are evaluated, after two seconds and two periods to settle.
    sample_time : float [s]
    name : str, optional
        Of the system in plots.

    Returns
    -------
    FrequencyResponse

    Raises
    ------
    ValueError
        An unknown output, or a frequency too near the sample rate.
    """
    column = _column(output)
    omega, values, coherence = [], [], []
    for samples in _samples_per_period(hz, sample_time):
        w = 2.0 * pi / (samples * sample_time)
        lead = samples * (2 + int(np.ceil(SETTLE_SECONDS / (samples * sample_time))))
        t = sample_time * np.arange(lead + periods * samples)
        signal = offset + amplitude * np.sin(w * t)
        y = _respond(model, signal, loop, preload, sample_time)[lead:, column]
        line = 2.0 * np.mean((y - y.mean()) * np.exp(-1j * w * t[lead:]))
        power = np.var(y)
        omega.append(w)
        values.append(line / (amplitude / 1j))
        coherence.append(min(0.5 * abs(line) ** 2 / power, 1.0) if power > 0.0 else 0.0)
    labels = ("u" if loop is None else "ref", output)
    return _pack(omega, values, coherence, labels, name or f"stepped_sine_{amplitude:g}")


def multisine(
    model: Model,
    hz: ArrayLike,
    rms: float,
    *,
    loop: Loop | None = None,
    offset: float = 0.0,
    preload: float = 0.0,
    output: str = "omega_L",
    period: float = 10.0,
    realisations: int = 8,
    seed: int = 0,
    sample_time: float = 1e-3,
    name: str | None = None,
) -> FrequencyResponse:
    """Measure a response with random-phase multisines.

    Parameters
    ----------
    hz : (n,) array_like [Hz]
        Rounded to whole numbers of cycles per `period`; doubles are dropped.
    rms : float
        Of the input, equal on all lines [V], or with `loop` [rad/s].
    period : float [s]
        One period settles, the next is evaluated.
    realisations : int
        Draws of the phases; the coherence needs at least 2.
    seed : int
    model, loop, offset, preload, output, sample_time, name
        As in :func:`stepped_sine`.

    Raises
    ------
    ValueError
        An unknown output, a frequency too near the sample rate, fewer than 2 realisations.
    """
    column = _column(output)
    if realisations < 2:
        raise ValueError(f"{realisations} realisations, a coherence needs at least 2")
    _samples_per_period(hz, sample_time)
    n = round(period / sample_time)
    bins = np.unique(np.maximum(1, np.round(np.asarray(hz, float) * period)).astype(int))
    rng = np.random.default_rng(seed)
    t = sample_time * np.arange(n)
    inputs, outputs = [], []
    for _ in range(realisations):
        phases = rng.uniform(0.0, 2.0 * pi, bins.size)
        signal = np.sum(np.sin(2.0 * pi * np.outer(t / period, bins) + phases), axis=1)
        signal *= rms * np.sqrt(2.0 / bins.size)
        twice = offset + np.tile(signal, 2)
        y = _respond(model, twice, loop, preload, sample_time)[n:, column]
        inputs.append(np.fft.rfft(signal)[bins])
        outputs.append(np.fft.rfft(y)[bins])
    values, coherence = _average(np.array(inputs), np.array(outputs))
    omega = 2.0 * pi * bins / period
    labels = ("u" if loop is None else "ref", output)
    return _pack(omega, values, coherence, labels, name or f"multisine_{rms:g}_rms")


def from_log(
    log: Log,
    input: str | Sequence[str],
    output: str,
    *,
    segment: float = 2.0,
    lines: ArrayLike | None = None,
    min_coherence: float = 0.0,
) -> FrequencyResponse:
    """Estimate a response from a log by averaged spectra (H1).

    Parameters
    ----------
    log : Log
    input : str or sequence of str
        A channel; of several the mean, such as ``("u_left", "u_right")``.
    output : str
        A channel.
    segment : float [s]
        Length of the Hann-windowed segments, half overlapping; its inverse is the resolution.
    lines : (k,) array_like [Hz], optional
        Keep the spectral lines nearest to these, for a log that excites a few.
    min_coherence : float
        Leave out lines below.

    Raises
    ------
    LogError
        A missing channel or uneven time.
    ValueError
        A log shorter than two segments, or no line left.
    """
    names = (input,) if isinstance(input, str) else tuple(input)
    u = np.mean([log[n] for n in names], axis=0)
    y = log[output]
    dt = log.sample_time
    n = round(segment / dt)
    if u.size < 2 * n:
        raise ValueError(f"{log.name}: {log.duration:.3g} s are no two segments of {segment:g} s")
    f, s_uy = csd(u, y, 1.0 / dt, nperseg=n)
    s_uu, s_yy = (welch(x, 1.0 / dt, nperseg=n)[1] for x in (u, y))
    keep = np.arange(1, f.size - 1)
    if lines is not None:
        nearest = np.abs(np.subtract.outer(np.asarray(lines, float), f)).argmin(axis=1)
        keep = np.unique(nearest[nearest > 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.abs(s_uy) ** 2 / (s_uu * s_yy)
    keep = keep[np.nan_to_num(coherence[keep]) >= min_coherence]
    keep = keep[s_uu[keep] > 0.0]
    if keep.size == 0:
        raise ValueError(f"{log.name}: no line from {'+'.join(names)} to {output} is left")
    values = s_uy[keep] / s_uu[keep]
    label = "+".join(names)
    return _pack(2.0 * pi * f[keep], values, coherence[keep], (label, output), log.name)


def _average(inputs: NDArray, outputs: NDArray) -> tuple[NDArray[np.complex128], Floats]:
    """H1 and coherence over realisations, (realisations, lines) each."""
    cross = np.mean(outputs * inputs.conj(), axis=0)
    power = np.mean(np.abs(inputs) ** 2, axis=0)
    total = np.mean(np.abs(outputs) ** 2, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(cross) ** 2 / (power * total))
    return cross / power, coherence


def _respond(model: Model, signal: Floats, loop: Loop | None, preload: float, dt: float) -> Floats:
    if loop is not None:
        return close_loop(model, loop, signal, dt)[1]
    u = np.array([signal + preload, signal - preload])
    return march(model.arrays(), u, rest(model, 0.0), dt)


def _column(output: str) -> int:
    if output not in OUTPUTS:
        raise ValueError(f"no output {output!r}; there are {', '.join(OUTPUTS)}")
    return OUTPUTS.index(output)


def _samples_per_period(hz: ArrayLike, dt: float) -> NDArray[np.int_]:
    f = np.atleast_1d(np.asarray(hz, float))
    top = 1.0 / (MIN_SAMPLES * dt)
    bad = f[~((f > 0.0) & (f <= top))]
    if bad.size:
        raise ValueError(
            f"{bad[0]:g} Hz is not above 0 and up to {top:g} Hz ({MIN_SAMPLES} samples)"
        )
    return np.round(1.0 / (f * dt)).astype(int)
