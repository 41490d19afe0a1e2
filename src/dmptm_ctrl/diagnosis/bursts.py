"""Windows too short and too large for the robust loss: when, where and at which voltage."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.curves import slew
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.identify.balance import scatter
from dmptm_ctrl.simulate.model import Floats

BURST = 12.0  # standard deviations of a window that no curve has to explain
FAINT = 6.0  # the same, if such windows come by the clock
BURSTS = 0.004  # share of windows that are bursts; impact chatter alone gives less
PERIODS = np.geomspace(0.25, 5.0, 1500)  # s, tried for bursts at fixed intervals
WHOLE = 0.8  # of the greatest regularity, at which a longer interval counts as well
FINE, FINER = 0.004, 101  # share about a period in which it is looked for once more, trials
REGULAR = 0.9  # |mean exp(2πi t/T)| of what comes by the clock; excitations differ from log to log
RAYLEIGH = 12.0  # n R² of burst onsets folded on a period: p below 1e-5 per period tried
ONSET_GAP = 0.1  # s between bursts that count as two
BINS = 12  # of a variable that may show where bursts are


@dataclass(frozen=True)
class Bursts:
    """Windows far outside of what the model leaves elsewhere.

    Attributes
    ----------
    share : float
        Of all windows of the total balance.
    variables : tuple of str
        What their coming depends on, most telling first.
    period : float
        Of their coming [s]; 0 if they do not come at fixed intervals.
    """

    share: float
    variables: tuple[str, ...]
    period: float = 0.0


def bursts(left: Residual) -> Bursts:
    """Look for windows of the total balance that stand far out."""
    flags, times, values = [], [], []
    for balance in (left.balance, left.held):
        parts = balance.missing(left.base.model)
        spread = scatter(parts, balance.kinds)
        for e, part, sigma in zip(balance.equations, parts, spread, strict=True):
            if e.kind != "total":
                continue
            mo = balance.motions[e.motion]
            flags.append(np.abs(part) > BURST * sigma)
            times.append(onsets(mo.time[e.used][np.abs(part) > FAINT * sigma]))
            middle = mo.starts[e.used] + mo.window.size // 2
            values.append(
                np.array(
                    [
                        np.mod(mo.run[middle, 0], 2 * np.pi),
                        mo.run[middle, 1],
                        np.abs(mo.rec.u).mean(0)[middle],
                        np.abs(slew(mo)).max(0)[middle],
                        np.mod(mo.run[middle, 2], 2 * np.pi),
                        mo.time[e.used],
                    ]
                )
            )
    if not flags:
        return Bursts(0.0, ())
    flag = np.concatenate(flags)
    share, period = float(flag.mean()), interval(times)
    if share < BURSTS:
        return Bursts(share, (), period)
    variables = ["time"] if period > 0.0 else []
    table = np.concatenate(values, axis=1)
    names = ("theta_L", "omega_L", "u", "du_dt", "theta_m", "time")
    variables.append(names[np.argsort([information(x, flag) for x in table])[-1]])
    return Bursts(share, tuple(dict.fromkeys(variables)), period)


def onsets(times: Floats) -> Floats:
    """First times of groups of bursts."""
    if times.size == 0:
        return times
    return np.asarray(times[np.concatenate([[True], np.diff(times) > ONSET_GAP])])


def interval(times: Sequence[Floats]) -> float:
    """Return the interval [s] at which bursts come from a log's start; 0 if there is none."""
    all_times = np.concatenate(list(times))
    if all_times.size < 6:
        return 0.0

    def order(periods: Floats) -> Floats:
        return np.asarray(np.abs(np.exp(2j * np.pi * all_times / periods[:, None]).mean(1)))

    regular = order(PERIODS)
    if regular.max() ** 2 * all_times.size < RAYLEIGH or regular.max() < REGULAR:
        return 0.0
    # a part of the interval is as regular as the whole: the longest it is
    high = np.flatnonzero(regular > WHOLE * regular.max())
    longest = np.split(high, np.flatnonzero(np.diff(high) > 1) + 1)[-1]
    whole = PERIODS[longest[np.argmax(regular[longest])]]
    near = whole * (1.0 + np.linspace(-FINE, FINE, FINER))
    return float(near[np.argmax(order(near))])


def information(x: Floats, flag: np.ndarray) -> float:
    """Mutual information [nat] of a variable in bins and the flag, less its bias."""
    edges = np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    place = np.searchsorted(edges, x)
    rate = flag.mean()
    total = 0.0
    for b in range(BINS):
        inside = flag[place == b]
        if inside.size == 0:
            continue
        for q, p in ((inside.mean(), rate), (1.0 - inside.mean(), 1.0 - rate)):
            if q > 0.0:
                total += inside.size / flag.size * q * np.log(q / p)
    return float(total) - (BINS - 1) / (2.0 * flag.size)
