"""Is what a model leaves only noise? Correlations of the residual, and its orders per turn.

A residual that a good model leaves correlates neither with itself nor with the input; 99 of a
hundred lags then lie inside the band (Ljung, System Identification, 2nd ed., 16.5-16.6).
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from dmptm_ctrl.diagnosis.figures import ARCMIN, OBSERVER_HZ, SLOWEST, models
from dmptm_ctrl.diagnosis.predict import BANDWIDTH_HZ, low_pass, speeds
from dmptm_ctrl.identify.records import Record, block_mean, predict
from dmptm_ctrl.plots.quality import Correlation, Orders
from dmptm_ctrl.simulate.model import Floats, Model

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.report import Diagnosis

BAND = 2.576  # standard deviations on either side that hold 99 % of a normal distribution
LAG_SECONDS = 1.0
MAX_ORDER = 12.0  # per motor turn
ORDERS_PER_TURN = 100  # lines per unit order


def correlations(diagnosis: "Diagnosis", which: str) -> tuple[Correlation, Correlation]:
    """Correlate the residual of the held-out logs with itself and with the input.

    Parameters
    ----------
    which : "before" or "after"

    Returns
    -------
    (Correlation, Correlation)
        Auto, and with the mean voltage: positive lags are residuals after the input.
    """
    model = models(diagnosis)[which == "after"]
    left, inputs, step = [], [], 1.0
    for log in diagnosis.measured.held_logs:
        seen, run = speeds(model, log)
        # Below 30 Hz two samples 1/60 s apart are the closest that can be independent.
        every = max(1, round(1.0 / (2.0 * BANDWIDTH_HZ * log.sample_time)))
        step = every * log.sample_time
        voltage = low_pass(0.5 * (log["u_left"] + log["u_right"]), log.sample_time)
        left.append((seen - run)[::every])
        inputs.append(voltage[::every])
    lags = round(LAG_SECONDS / step)
    return autocorrelation(left, lags, step), cross_correlation(left, inputs, lags, step)


def autocorrelation(signals: Sequence[Floats], lags: int, step: float) -> Correlation:
    """Pooled autocorrelation of several signals; the band is that of white noise.

    Parameters
    ----------
    signals : sequence of (n,) arrays
    lags : int
    step : float
        Time between samples [s].
    """
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


def orders(diagnosis: "Diagnosis") -> Orders:
    """Amplitude of what is left per order of the motor's turn, before and after.

    Of the transmission error (twist of the left chain, measured − model) where there are motor
    encoders, else of the speed.
    """
    records = {r.name: r for r in (*diagnosis.measured.fit, *diagnosis.measured.held)}.values()
    count = round(MAX_ORDER * ORDERS_PER_TURN)
    twisted = all(rec.twist is not None for rec in records)
    sides = []
    for model in models(diagnosis):
        parts = [_along_the_turn(rec, model, twisted) for rec in records]
        angle, left, weight = (np.concatenate([p[i] for p in parts]) for i in range(3))
        sides.append(order_amplitudes(angle, left, weight, 1.0 / ORDERS_PER_TURN, count))
    quantity = "transmission error [arcmin]" if twisted else "speed, measured − model [deg/s]"
    teeth = models(diagnosis)[1].drive["z_3"] / models(diagnosis)[1].drive["N_1"]
    marks = {"motor turn": 1.0, "tooth mesh": float(teeth)}
    bank = np.arange(1, count + 1) / ORDERS_PER_TURN
    return Orders(bank, sides[0], sides[1], quantity, marks)


def order_amplitudes(
    angle: Floats, signal: Floats, weight: Floats, step: float, count: int
) -> Floats:
    """Amplitude of cos and sin of each order.

    Parameters
    ----------
    angle : (n,) array [rad]
    signal, weight : (n,) arrays
        The weight is the angle that a sample stands for.
    step : float
        The first order, and from each to the next, per turn.
    count : int
        Of orders.

    Returns
    -------
    (count,) array
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


def _along_the_turn(rec: Record, model: Model, twisted: bool) -> tuple[Floats, Floats, Floats]:
    """Motor angle, what is left and the angle passed per block, where the drive moves."""
    run = predict(rec, model.arrays(), OBSERVER_HZ)
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    turn = rec.theta * n1 * n2
    if twisted:
        assert rec.twist is not None
        turn = turn + n1 * rec.twist[:, 0]
        left = ARCMIN * (rec.twist[:, 0] - (run[:, 2] / n1 - n2 * run[:, 0]))
        side = np.sign(rec.twist[:, 0]) * (np.abs(rec.twist[:, 0]) > 0.75 * model.drive["gap_l"])
        good = (side != 0.0) & (side == np.sign(run[:, 6]))
    else:
        left = np.rad2deg(low_pass(rec.omega - run[:, 1], rec.dt))
        good = np.ones(rec.theta.size, bool)
    good = good & (np.abs(low_pass(rec.omega, rec.dt)) > SLOWEST)
    rows = np.array([turn, left, good.astype(float)])
    angle, value, share = block_mean(rows, rec.block)
    weight = np.abs(np.gradient(angle)) * (share == 1.0)
    return angle, value, weight
