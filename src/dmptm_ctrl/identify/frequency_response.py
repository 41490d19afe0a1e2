"""Frequency responses that depend on amplitude, from the compiled simulator and from logs.

Stepped sine: one frequency after another, the fundamental over whole periods (the describing
function of the whole drive). Multisine: many frequencies at once with random phases, averaged
(the best linear approximation, Pintelon & Schoukens, System Identification, 2nd ed., ch. 3).
"""

import re
import warnings
from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.signal.windows import blackmanharris, hann

from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop, march, rest
from dmptm_ctrl.simulate.model import Floats, Model

SETTLE_SECONDS = 2.0  # seven time constants of the rigid drive against viscous friction
# names of channels that only a closed loop has
SET_POINT = re.compile(r"(^|_)(ref|reference|set_?point|target|demand|soll)(_|$)", re.IGNORECASE)
NEGLIGIBLE = 1e-6  # of the excitation's power: above the window's leakage, below any line meant
CHANCE = 0.05  # that one line of a log passes without any response
MIN_SAMPLES = 8  # per period; below, the held input is no sine


class FrequencyResponse(NamedTuple):
    """A measured response and how far it is linear.

    Attributes
    ----------
    response : FrequencyResponseData
        From one input to one output, SI.
    coherence : (n,) array
        Share of the output's power at each frequency that the linear response explains, in
        [0, 1]; harmonics, noise and impact chatter lower it.
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
        As of :func:`~dmptm_ctrl.simulate.simulate`: ``omega_L``, ``theta_ml``, ``torque_l``, …
    periods : int
        Whole periods that are evaluated, after two seconds and two periods to settle.
    sample_time : float [s]

    Returns
    -------
    FrequencyResponse
        ``response`` as FrequencyResponseData, ``coherence``, ``hz`` and ``values``.

    Raises
    ------
    ValueError
        An unknown output, or a frequency too near the sample rate.

    Examples
    --------
    >>> found = dm.stepped_sine(dm.Model(), [1.0, 5.0], 0.75)  # Hz, V
    >>> abs(found.values).round(3)  # (rad/s)/V
    array([0.327, 0.104])
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
    return _pack(omega, values, coherence, labels, f"stepped_sine_{amplitude:g}")


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
) -> FrequencyResponse:
    """Measure a response with random-phase multisines.

    Parameters
    ----------
    model : Model
    hz : (n,) array_like [Hz]
        Rounded to whole numbers of cycles per `period`; doubles are dropped.
    rms : float
        Of the input, equal on all lines [V], or with `loop` [rad/s].
    period : float [s]
        One period settles, the next is evaluated.
    realisations : int
        Draws of the phases; the coherence needs at least 2.
    seed : int
    loop, offset, preload, output, sample_time
        As in :func:`stepped_sine`.

    Returns
    -------
    FrequencyResponse
        `response` as FrequencyResponseData, and `coherence`.

    Raises
    ------
    ValueError
        An unknown output, a frequency too near the sample rate, fewer than 2 realisations.

    Examples
    --------
    >>> found = dm.multisine(dm.Model(), [1.0, 2.0, 5.0], 0.75, realisations=4)
    >>> plot = ct.bode_plot(found.response)
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
    cross, power, coherence = _average(np.array(inputs), np.array(outputs))
    omega = 2.0 * pi * bins / period
    labels = ("u" if loop is None else "ref", output)
    return _pack(omega, cross / power, coherence, labels, f"multisine_{rms:g}_rms")


def from_log(
    log: Log,
    input: str | Sequence[str],
    output: str,
    *,
    segment: float = 2.0,
    lines: ArrayLike | None = None,
    min_coherence: float = 0.0,
) -> FrequencyResponse:
    """Estimate a response from a log, only where the log excites it.

    With `lines`, sines of exactly these frequencies are fitted to segments. Without, a
    periodic excitation is cut into its periods, whose lines are exact, any other into segments;
    lines that chance alone could give are left out, too.

    In closed loop, the set point is the excitation: the response is that of the output to it
    over that of the input to it, which noise in the loop does not bias.

    Parameters
    ----------
    log : Log
    input : str or sequence of str
        A channel; of several the mean, such as ``("u_left", "u_right")``.
    output : str
        A channel.
    segment : float [s]
        Length of the windowed, overlapping segments; its inverse is the resolution.
    lines : (k,) array_like [Hz], optional
        Frequencies of the excitation, for a log that excites a few.
    min_coherence : float
        Leave out lines below.

    Returns
    -------
    FrequencyResponse
        Its coherence is that of the output with the excitation.

    Raises
    ------
    LogError
        A missing channel or uneven time.
    ValueError
        A log shorter than two segments, lines closer than a segment resolves or not below half
        the sample rate, or no line left.

    Warns
    -----
    UserWarning
        The log is of a closed loop, or a frequency of `lines` is not excited.

    Examples
    --------
    >>> log = dm.load_log("log.csv.gz")
    >>> found = dm.response_from_log(log, ("u_left", "u_right"), "omega_L")
    """
    names = (input,) if isinstance(input, str) else tuple(input)
    if not names:
        raise ValueError("no input; give a channel of the log, or several")
    u, y, dt = np.mean([log[n] for n in names], axis=0), log[output], log.sample_time
    x = _excitation(log, names, output, u)
    if np.ptp(x) == 0.0:
        raise ValueError(f"{log.name}: {'+'.join(names)} does not move; nothing is excited")
    period = None if lines is not None else _period(x)
    n = round(segment / dt) if period is None else period
    if u.size < 2 * n:
        raise ValueError(f"{log.name}: {log.duration:.3g} s are no two segments of {segment:g} s")
    if lines is not None:
        f = _asked(log.name, lines, segment, dt)
        spectra = _fitted((x, u, y), f * dt, n)
    elif period is not None:
        f = np.arange(1, (n + 1) // 2) / (n * dt)
        first = u.size % n if u.size < 3 * n else n  # of three periods the first may settle
        whole = [v[first:][: (u.size - first) // n * n].reshape(-1, n) for v in (x, u, y)]
        spectra = [np.fft.rfft(v)[:, 1 : f.size + 1] for v in whole]
    else:
        f, spectra = _windowed((x, u, y), n, dt)
    own, drive, out = spectra
    cross, power, coherence = _average(own, out)
    through = np.mean(drive * own.conj(), axis=0)
    total = power.sum() if lines is None else 0.5 * float(np.var(x))
    keep = _excited(power, total)
    if lines is not None and not keep.all():
        silent = ", ".join(f"{hz:g}" for hz in f[~keep])
        warnings.warn(
            f"{log.name}: nothing excites {silent} Hz; left out", UserWarning, stacklevel=2
        )
    if lines is None:
        independent = len(own) if period is not None else u.size // n
        keep &= coherence > 1.0 - (CHANCE / keep.sum()) ** (1.0 / (independent - 1))
    keep &= (coherence >= min_coherence) & (np.abs(through) > 0.0)
    if not keep.any():
        raise ValueError(f"{log.name}: no line from {'+'.join(names)} to {output} is left")
    values = cross[keep] / through[keep]
    label = names[0] if len(names) == 1 else f"mean({', '.join(names)})"
    return _pack(2.0 * pi * f[keep], values, coherence[keep], (label, output), log.name)


def _excitation(log: Log, names: tuple[str, ...], output: str, u: Floats) -> Floats:
    """Signal that moves the drive: the set point of a loop, else the input."""
    for point in log:
        if point in (*names, output) or not SET_POINT.search(point):
            continue
        ref = log[point]
        label = "+".join(names)
        if np.ptp(ref) > 0.0:
            said = f"the response of {label} is taken by way of {point}"
        else:
            said = f"{point} stands still, so from {label} it is the controller's as well"
        warnings.warn(f"{log.name} is of a closed loop; {said}", UserWarning, stacklevel=3)
        return ref if np.ptp(ref) > 0.0 else u
    return u


def _excited(power: Floats, total: float) -> NDArray[np.bool_]:
    """Whether a line carries the excitation: the weakest that hold a millionth do not."""
    order = np.argsort(power)
    keep = np.empty(power.size, bool)
    keep[order] = np.cumsum(power[order]) > NEGLIGIBLE * total
    return keep


def _period(x: Floats) -> int | None:
    """Samples after which a signal repeats itself, at least once; None if it does not."""
    n = x.size
    x = x - x.mean()
    spectrum = np.fft.rfft(x, 2 * n)
    lagged = np.fft.irfft(np.abs(spectrum) ** 2)[: n // 2 + 1]  # Σ x[i] x[i + lag]
    sums = np.concatenate([[0.0], np.cumsum(x**2)])
    lag = np.arange(n // 2 + 1)
    change = (sums[n - lag] + sums[n] - sums[lag] - 2.0 * lagged) / (n - lag)
    changing = np.flatnonzero(change > np.var(x))
    if changing.size == 0:
        return None
    alike = np.flatnonzero(change[changing[0] :] <= 2.0 * NEGLIGIBLE * np.var(x)) + changing[0]
    if alike.size == 0:
        return None
    run = alike[: np.argmax(np.append(np.diff(alike) > 1, True)) + 1]
    return int(run[change[run].argmin()])


def _asked(name: str, lines: ArrayLike, segment: float, dt: float) -> Floats:
    f = np.unique(np.atleast_1d(np.asarray(lines, float)))
    if not (f.size and f[0] > 0.0 and f[-1] < 0.5 / dt):
        raise ValueError(f"{name}: lines must be above 0 and below {0.5 / dt:g} Hz")
    nearest = min(f[0], *np.diff(f)) if f.size > 1 else f[0]
    if nearest * segment < 1.0:
        raise ValueError(
            f"{name}: lines {nearest:.3g} Hz apart, or from 0, need segments of at least "
            f"{1.0 / nearest:.3g} s, not {segment:g}"
        )
    return f


def _segments(signals: Sequence[Floats], n: int, step: int) -> list[Floats]:
    """Overlapping pieces of signals, (pieces, n) each, without their means."""
    pieces = [np.lib.stride_tricks.sliding_window_view(v, n)[::step] for v in signals]
    return [p - p.mean(axis=1, keepdims=True) for p in pieces]


def _fitted(signals: Sequence[Floats], cycles: Floats, n: int) -> list[NDArray[np.complex128]]:
    """Amplitudes of sines in segments by weighted least squares, (segments, lines) each."""
    phase = 2.0 * pi * np.outer(np.arange(n), cycles)
    root = np.sqrt(hann(n, sym=False))[:, None]
    basis = np.hstack([np.cos(phase), -np.sin(phase), np.ones((n, 1))])
    k = cycles.size
    found = []
    for pieces in _segments(signals, n, max(n // 2, 1)):
        fit = np.linalg.lstsq(root * basis, root * pieces.T, rcond=None)[0]
        found.append(0.5 * (fit[:k] + 1j * fit[k : 2 * k]).T)
    return found


def _windowed(
    signals: Sequence[Floats], n: int, dt: float
) -> tuple[Floats, list[NDArray[np.complex128]]]:
    """Frequencies and spectra of segments under a window that leaks less than is negligible."""
    window = blackmanharris(n, sym=False)
    pieces = _segments(signals, n, max(n // 3, 1))
    hz: Floats = np.fft.rfftfreq(n, dt)[1:-1].astype(np.float64)
    return hz, [np.fft.rfft(window * p)[:, 1:-1] for p in pieces]


def _average(inputs: NDArray, outputs: NDArray) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """Cross spectrum, power of the input and coherence over realisations or segments."""
    cross = np.mean(outputs * inputs.conj(), axis=0)
    power = np.mean(np.abs(inputs) ** 2, axis=0)
    total = np.mean(np.abs(outputs) ** 2, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(cross) ** 2 / (power * total))
    return cross, power, coherence


def _respond(model: Model, signal: Floats, loop: Loop | None, preload: float, dt: float) -> Floats:
    if loop is not None:
        return close_loop(model, loop, signal, dt)[1]
    u = np.array([signal + preload, signal - preload])
    return march(model, u, rest(model, 0.0), dt)


def _column(output: str) -> int:
    if output not in OUTPUTS:
        raise ValueError(f"no output {output!r}; there are {', '.join(OUTPUTS)}")
    return OUTPUTS.index(output)


def _samples_per_period(hz: ArrayLike, dt: float) -> NDArray[np.int_]:
    f = np.atleast_1d(np.asarray(hz, float))
    if f.size == 0:
        raise ValueError("no frequencies; give at least one [Hz]")
    top = 1.0 / (MIN_SAMPLES * dt)
    bad = f[~((f > 0.0) & (f <= top))]
    if bad.size:
        raise ValueError(
            f"{bad[0]:g} Hz is not above 0 and up to {top:g} Hz ({MIN_SAMPLES} samples)"
        )
    return np.round(1.0 / (f * dt)).astype(int)
