"""What of a signal is compared: below a bandwidth, against its noise, and how far apart two are."""

from collections.abc import Sequence
from functools import cache
from math import ceil

import numpy as np
from scipy.signal import butter, sosfiltfilt

from dmptm_ctrl.simulate.model import Floats

NORMAL_MEDIAN = 0.6745  # median of |x| over the standard deviation, x normal
BANDWIDTH_HZ = 30.0  # above it, impact chatter that no model predicts sample by sample
ORDER = 4  # of the filter that leaves it out
# of the bandwidth; a signal goes on so far beyond its ends, or the filter rings there
PERIODS = 3.0


def low_pass(signal: Floats, dt: float, bandwidth_hz: float = BANDWIDTH_HZ) -> Floats:
    """Zero-phase Butterworth low-pass; a signal that has no more than that stays as it is."""
    if 2.0 * bandwidth_hz * dt >= 1.0:
        return signal
    beyond = min(ceil(PERIODS / (bandwidth_hz * dt)), signal.size - 1)
    return np.asarray(sosfiltfilt(_sections(1.0 / dt, bandwidth_hz), signal, padlen=beyond))


@cache  # to design it takes longer than to filter a log
def _sections(rate: float, bandwidth_hz: float) -> Floats:
    return np.asarray(butter(ORDER, bandwidth_hz, fs=rate, output="sos"), np.float64)


def agreement(pairs: Sequence[tuple[Floats, Floats]]) -> dict[str, float]:
    """How far runs are from what was measured, by pairs of (measured, run), over all logs together.

    `rmse` in their unit, `fit_percent` = 100 (1 − NRMSE), `pearson_r`.
    """
    seen, run = (np.concatenate([p[k] for p in pairs]) for k in (0, 1))
    rmse = float(np.sqrt(np.mean((seen - run) ** 2)))
    spread = float(np.std(seen))
    both = spread * float(np.std(run))
    r = float(np.mean((seen - seen.mean()) * (run - run.mean())) / both) if both > 0 else 0.0
    fit = 100.0 * (1.0 - rmse / spread) if spread > 0 else 0.0
    return {"rmse": rmse, "fit_percent": fit, "pearson_r": r}


def noise_below(signal: Floats, dt: float, bandwidth_hz: float = BANDWIDTH_HZ) -> float:
    """Standard deviation of white noise below a bandwidth, in the unit of the signal.

    The second difference of a smooth motion is small, that of white noise is √6 times it; the
    median leaves impacts out.
    """
    rough = np.diff(signal, 2)
    white = float(np.median(np.abs(rough))) / NORMAL_MEDIAN / np.sqrt(6.0)
    return white * float(np.sqrt(min(2.0 * bandwidth_hz * dt, 1.0)))


def correlation_length(x: Floats) -> float:
    """Rows that count as one: 1 + 2 Σ ρ, up to the first that is not positive."""
    power = np.abs(np.fft.rfft(x, 2 * x.size)) ** 2
    rho = np.fft.irfft(power)[: x.size]
    rho = rho / rho[0] if rho[0] > 0.0 else rho
    ends = np.flatnonzero(rho <= 0.0)
    return 1.0 + 2.0 * float(np.sum(rho[1 : ends[0] if ends.size else x.size]))
