"""How strongly the pinions chatter shows the meshes' damping, of which the balances know nothing.

Each reversal ends in impacts that ring at 60 and 230 Hz. No run predicts their phase, and a
fit by mean squares would choose too much damping, since silence misses less than a chatter out
of step. But their power follows the damping closely: whole free runs are compared with the
logs by it. Not with logs of a closed loop: there the controller shakes the pinions by what it
reads of their chatter, a free run with the same voltages does not chatter in step with them.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.signal import butter, sosfiltfilt
from scipy.stats import chi2

from dmptm_ctrl.diagnosis.predict import SPEED
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Unknown, position
from dmptm_ctrl.identify.records import Record, block_mean
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.compiled import SUBSTEPS
from dmptm_ctrl.simulate.model import Floats, Model

DAMPING, GAP_DAMPING = "c", "c_f"
VALUES = 9  # of the damping, even on a logarithmic scale
FINER = 101  # values between which the powers are interpolated
BANDS_HZ = ((30.0, 120.0), (120.0, 400.0))  # about the two modes
NYQUIST_SHARE = 0.9  # of half the sample rate, where the last band ends at the latest
ORDER = 4
WINDOW_SECONDS = 0.1
QUIET = 0.05  # share of the windows in which there is nothing but the sensor's noise
# Of the voltages' power in the upper band, explained by the speed of the same or one of the last
# samples, above which a loop is closed. Closed: 0.1 to 1, open: 0.01 at most (benchmarks/rigs).
FED_BACK, LAGS = 0.05, 4
LEAST = 0.1  # scatter of the logarithm of a power from log to log; less is chance
PRIOR = 0.6  # standard deviation of the logarithm about the declared value
# What it takes beside: a wider gap, or one that damps less, makes the pinions chatter more.
BESIDE = ("gap_l", "gap_r", GAP_DAMPING)
STEP = 0.3  # relative, of the damping itself, for the slope of the power over it
APART = 0.3  # half-ranges, by which such a value is changed at least, or chance is larger


def with_chatter(
    records: Sequence[Record], start: BalanceFit, declared: Drive, jobs: int
) -> BalanceFit:
    """Return a fit with the damping that the chatter of the records speaks for.

    It comes with its standard deviation, and with how it follows the gaps: who knows these better
    later knows it better, too. The gap's damping, which not even the chatter shows, is the declared
    one. What is not among the unknowns of the fit stays as it is.
    """
    names = [k.name if k.effect is None else "" for k in start.unknowns]
    covariance = start.covariance.copy()
    model = start.model
    if GAP_DAMPING in names:
        model = model.with_values(**{GAP_DAMPING: declared[GAP_DAMPING]})
        j = names.index(GAP_DAMPING)
        tie(covariance, j, np.zeros(len(names)), covariance[j, j])
    if DAMPING in names:
        j = names.index(DAMPING)
        chatter = Chatter(records, declared, jobs)
        value, error = chatter.damping(model)
        model = model.with_values(**{DAMPING: value})
        others = [i for i, name in enumerate(names) if name in BESIDE]
        sigmas = np.sqrt(covariance[others, others])
        relative = value / start.unknowns[j].scale
        derivatives = np.zeros(len(names))
        derivatives[others] = relative * chatter.derivatives(
            model, [start.unknowns[i] for i in others], sigmas
        )
        tie(covariance, j, derivatives, (relative * error) ** 2)
    low, high = ([getattr(k, end) for k in start.unknowns] for end in ("low", "high"))
    p = np.clip(position(model, start.unknowns), low, high)
    return replace(start, model=model, p=p, covariance=covariance)


def tie(covariance: Floats, j: int, derivatives: Floats, variance: float) -> None:
    """Let an unknown follow others by `derivatives` and else vary by itself alone, in place."""
    covariance[j, :] = covariance[:, j] = 0.0
    along = covariance @ derivatives
    covariance[j, :] = covariance[:, j] = along
    covariance[j, j] = variance + derivatives @ along


class Chatter:
    """The power of the records' chatter, to be compared with that of free runs."""

    def __init__(self, records: Sequence[Record], declared: Drive, jobs: int) -> None:
        self.records = [rec for rec in records if not fed_back(rec)] or list(records)
        self.declared, self.jobs = declared, jobs
        self.seen = [powers(rec.omega, rec.dt) for rec in self.records]
        pairs = zip(self.records, self.seen, strict=True)
        self.noise = np.min([quiet(part, rec.dt) for rec, part in pairs], axis=0)

    def ratios(self, models: Sequence[Model]) -> Floats:
        """Logarithm of simulated over measured power, (len(models), logs times bands)."""

        def power_of(task: tuple[Record, Floats]) -> Floats:
            rec, seen = task
            timed = [model.over(rec.seconds) for model in models]
            runs = march_any(timed, rec.u, rec.x0, rec.dt, substeps=SUBSTEPS, columns=SPEED)
            rows = np.array([powers(run[:, 0], rec.dt).mean(1) for run in runs])
            return np.asarray(np.log((rows + self.noise) / seen.mean(1)))

        pairs = list(zip(self.records, self.seen, strict=True))
        done = in_threads(power_of, pairs, self.jobs, lambda task: task[0].omega.size)
        return np.concatenate(done, axis=1)

    def damping(self, model: Model) -> tuple[float, float]:
        """Return the meshes' damping and its relative standard deviation."""
        (low, high), declared = self.declared.quantities[DAMPING].range, self.declared[DAMPING]
        scale = np.log(np.geomspace(max(low, 1e-3 * high), high, VALUES))
        off = self.ratios([model.with_values(**{DAMPING: float(np.exp(x))}) for x in scale])
        fine = np.linspace(scale[0], scale[-1], FINER)
        off = np.array([np.interp(fine, scale, column) for column in off.T])
        scatter = np.maximum(np.sqrt(np.mean(off**2, axis=0).min()), LEAST)
        expected = np.log(declared)
        cost = np.sum((off / scatter) ** 2, axis=0) + ((fine - expected) / PRIOR) ** 2
        weight = np.exp(-0.5 * (cost - cost.min()))
        weight /= weight.sum()
        mean = float(weight @ fine)
        return float(np.exp(mean)), float(np.sqrt(weight @ (fine - mean) ** 2))

    def derivatives(self, model: Model, others: Sequence[Unknown], sigmas: Floats) -> Floats:
        """Relative change of the damping, per unit of others, that leaves the power as it is."""
        value = model.drive[DAMPING]
        spreads = np.maximum(sigmas, APART)
        ends = [model.with_values(**{DAMPING: value * (1.0 + x)}) for x in (STEP, -STEP)]
        for k, d in zip(others, spreads, strict=True):
            here, by = model.drive[k.name], k.scale * d
            ends += [model.with_values(**{k.name: here + x}) for x in (by, -by)]
        off = self.ratios(ends)  # all at once: they fill the lanes
        own, *rows = (off[::2] - off[1::2]) / np.array([STEP, *spreads])[:, None]
        return np.array([-(own @ row) / (own @ own) for row in rows])


def powers(speed: Floats, dt: float) -> Floats:
    """Power of a speed in each band and window [rad²/s²], (bands, windows)."""
    rows = [sosfiltfilt(_sections(band, 1.0 / dt), speed) ** 2 for band in bands(dt)]
    return block_mean(np.array(rows), max(1, round(WINDOW_SECONDS / dt)))


def bands(dt: float) -> list[tuple[float, float]]:
    """Bands [Hz] that a sample time leaves."""
    top = NYQUIST_SHARE * 0.5 / dt
    return [(a, min(b, top)) for a, b in BANDS_HZ if a < NYQUIST_SHARE * top]


def quiet(power: Floats, dt: float) -> Floats:
    """Power of white noise alone [rad²/s²], (bands,), from the quietest windows.

    Of noise these are below the mean by chance: by the chi-square distribution of two values per
    hertz and second.
    """
    freedom = np.array([2.0 * (b - a) * WINDOW_SECONDS for a, b in bands(dt)])
    return np.asarray(np.quantile(power, QUIET, axis=1) / (chi2.ppf(QUIET, freedom) / freedom))


def fed_back(rec: Record) -> bool:
    """Tell whether the voltages follow from the speed reading: the loop was closed."""
    sections = _sections(bands(rec.dt)[-1], 1.0 / rec.dt)
    u, speed = sosfiltfilt(sections, rec.u.sum(0)), sosfiltfilt(sections, rec.omega)
    size = float(np.sqrt((u @ u) * (speed @ speed)))
    if size == 0.0:
        return False
    products = [u[lag:] @ speed[: speed.size - lag] for lag in range(LAGS)]
    return bool((np.max(np.abs(products)) / size) ** 2 > FED_BACK)


@cache  # to design it takes longer than to filter a log
def _sections(band: tuple[float, float], rate: float) -> Floats:
    return np.asarray(butter(ORDER, band, "bandpass", fs=rate, output="sos"), np.float64)
