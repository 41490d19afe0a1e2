"""Is what a model leaves only noise? Correlations, orders, and means over what explains it.

A residual that a good model leaves correlates neither with itself nor with the input; 99 of a
hundred lags then lie inside the band (Ljung, System Identification, 2nd ed., 16.5-16.6).
"""

from collections.abc import Iterable, Sequence

import numpy as np

from dmptm_ctrl.identify.compared_signals import BANDWIDTH_HZ
from dmptm_ctrl.plots.diagnosis import Curve, Evidence, Overlay
from dmptm_ctrl.plots.quality import Correlation
from dmptm_ctrl.simulate.model import Floats

# variable, residual, direction of motion, share of a sample that is independent
Rows = tuple[Floats, Floats, Floats, float]

BAND = 2.576  # standard deviations on either side that hold 99 % of a normal distribution
LAG_SECONDS = 1.0
BINS = 24
TAILS = (0.5, 99.5)  # percentiles of the variable; what lies beyond has too few samples
MIN_INDEPENDENT = 3.0  # independent samples that a bin's mean and spread need


def correlations(overlays: Sequence[Overlay]) -> list[tuple[str, Correlation, Correlation]]:
    """Correlate residuals of held-out logs: each with its title, before and after.

    With themselves and with the mean input: positive lags are residuals after the input. There are
    none where the logs are shorter than the lags.
    """
    before: list[Floats] = []
    after: list[Floats] = []
    inputs, step = [], 1.0
    for overlay in overlays:
        dt = float(overlay.time[1] - overlay.time[0])
        # Below 30 Hz two samples 1/60 s apart are the closest that can be independent.
        every = max(1, round(1.0 / (2.0 * BANDWIDTH_HZ * dt)))
        step = every * dt
        for part in overlay.stretches():
            before.append((overlay.measured[part] - overlay.before[part])[::every])
            after.append((overlay.measured[part] - overlay.after[part])[::every])
            inputs.append(overlay.push[part][::every])
    lags = round(LAG_SECONDS / step)
    if not any(s.size > 2 * lags for s in inputs):
        return []
    own = [autocorrelation(left, lags, step) for left in (before, after)]
    crossed = [cross_correlation(left, inputs, lags, step) for left in (before, after)]
    return [
        ("residual with itself", own[0], own[1]),
        ("residual with the input", crossed[0], crossed[1]),
    ]


def autocorrelation(signals: Sequence[Floats], lags: int, step: float) -> Correlation:
    """Pooled autocorrelation of several signals, `step` [s] apart; the band is of white noise."""
    rows = [s - s.mean() for s in signals]
    values = _lagged(rows, rows, range(1, lags + 1))
    count = sum(s.size for s in rows)
    band = np.full(lags, BAND / np.sqrt(count))
    return Correlation(step * np.arange(1.0, lags + 1.0), values, band)


def cross_correlation(
    left: Sequence[Floats], inputs: Sequence[Floats], lags: int, step: float
) -> Correlation:
    """Pooled correlation of residuals with an input over lags of both signs.

    The band is Bartlett's for independent signals, each with its own autocorrelation.
    """
    e, u = ([s - s.mean() for s in signals] for signals in (left, inputs))
    around = range(-lags, lags + 1)
    values = _lagged(u, e, around)
    own = np.concatenate([[1.0], 2.0 * _lagged(e, e, range(1, lags + 1))])
    other = np.concatenate([[1.0], _lagged(u, u, range(1, lags + 1))])
    count = sum(s.size for s in e)
    band = BAND * np.sqrt(max(float(own @ other), 1.0) / count)
    return Correlation(step * np.array(around, float), values, np.full(len(around), band))


def _lagged(one: Sequence[Floats], other: Sequence[Floats], lags: Iterable[int]) -> Floats:
    """Σ one(t) other(t + lag), relative to what the two could reach."""
    size = np.sqrt(sum(float(a @ a) for a in one) * sum(float(b @ b) for b in other))
    sums = []
    for k in lags:
        pairs = zip(one, other, strict=True)
        if k >= 0:
            sums.append(sum(float(a[: a.size - k] @ b[k:]) for a, b in pairs if k < a.size))
        else:
            sums.append(sum(float(a[-k:] @ b[: b.size + k]) for a, b in pairs if -k < a.size))
    return np.array(sums, np.float64) / (size or 1.0)


def order_amplitudes(
    angle: Floats, signal: Floats, weight: Floats, step: float, count: int
) -> Floats:
    """Amplitude of cos and sin of each order, (count,): whole multiples of `step` per turn.

    Of a signal, (n,), over an angle, (n,) [rad]; the weight, (n,), is the angle that a sample
    stands for.
    """
    total = float(weight.sum())
    if total == 0.0:
        return np.zeros(count)
    centred = weight * (signal - float(weight @ signal) / total)
    turning = np.exp(-1j * step * angle)
    wave, sums = centred.astype(np.complex128), np.empty(count, np.complex128)
    for k in range(count):
        wave *= turning
        sums[k] = wave.sum()
    return np.asarray(2.0 * np.abs(sums) / total)


def fold(
    without: Sequence[Rows], after: Sequence[Rows], variable: str, quantity: str, effect: str
) -> Evidence:
    """Fold residuals of two models, one entry per log, over a variable, by direction of motion.

    `variable` and `quantity` are labels with units; `effect` is empty where there is none.
    """
    pooled = np.concatenate([row[0] for row in (*without, *after)])
    low, high = np.percentile(pooled, TAILS) if pooled.size else (0.0, 1.0)
    edges = np.linspace(low, max(high, low + 1e-9), BINS + 1)
    return Evidence(variable, quantity, binned(without, edges), binned(after, edges), effect)


def binned(rows: Sequence[Rows], edges: Floats) -> dict[str, Curve]:
    """Mean and standard error per bin and direction."""
    curves = {}
    x, y, way = (np.concatenate([row[i] for row in rows]) for i in range(3))
    shares = np.concatenate([np.full(row[0].size, row[3]) for row in rows])
    place = np.digitize(x, edges) - 1
    for direction, sign in (("forward", 1.0), ("backward", -1.0)):
        centres, means, errors = [], [], []
        for i in range(edges.size - 1):
            inside = (place == i) & (way == sign)
            count = float(shares[inside].sum())
            if count >= MIN_INDEPENDENT:
                centres.append(0.5 * (edges[i] + edges[i + 1]))
                means.append(float(y[inside].mean()))
                errors.append(float(y[inside].std()) / np.sqrt(count))
        if centres:
            curves[direction] = Curve(np.array(centres), np.array(means), np.array(errors))
    return curves
