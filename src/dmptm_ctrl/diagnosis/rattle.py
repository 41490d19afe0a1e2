"""How strongly the pinions rattle tells the meshes' damping, of which the balances know nothing.

Each reversal ends in impacts that ring at 60 and 230 Hz. No run predicts their phase, and a
fit by mean squares would choose too much damping, since silence misses less than a rattle out
of step. But their power follows the damping closely: whole free runs are compared with the
logs by it.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
from scipy.signal import butter, sosfiltfilt

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Misfit, position
from dmptm_ctrl.identify.records import Record, block_mean
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

DAMPING, GAP_DAMPING = "c", "c_f"
VALUES = 9  # of the damping, even on a logarithmic scale
FINER = 101  # values between which the powers are interpolated
BANDS_HZ = ((30.0, 120.0), (120.0, 400.0))  # about the two modes
NYQUIST_SHARE = 0.9  # of half the sample rate, where the last band ends at the latest
ORDER = 4
WINDOW_SECONDS = 0.1
QUIET = 0.05  # share of the windows in which there is nothing but the sensor's noise
LEAST = 0.1  # scatter of the logarithm of a power from log to log; less is chance
PRIOR = 0.6  # standard deviation of the logarithm about the declared value
# Of the logarithm, by what is wrong alike in all logs: the fit's gaps and friction. On thirty rigs
# that lack nothing (seed 1607 of benchmarks/rigs) values are off by 0.19, where the logs' scatter
# alone claims 0.06; what takes this up widens it twofold, as all that balances know.
COMMON = 0.1


def rattled(records: Sequence[Record], start: BalanceFit, declared: Drive, jobs: int) -> BalanceFit:
    """Return a fit with the damping that the rattle of the records speaks for.

    It comes with its standard deviation. The gap's damping, which not even that tells, is the
    declared one. What is not among the unknowns of the fit stays as it is.
    """
    names = [k.name if k.effect is None else "" for k in start.unknowns]
    covariance = start.covariance.copy()
    model = start.model
    if GAP_DAMPING in names:
        model = model.with_values(**{GAP_DAMPING: declared[GAP_DAMPING]})
        uncouple(covariance, names.index(GAP_DAMPING))
    if DAMPING in names:
        j = names.index(DAMPING)
        value, error = damping(records, model, declared, jobs)
        model = model.with_values(**{DAMPING: value})
        uncouple(covariance, j)
        covariance[j, j] = (error / start.unknowns[j].scale) ** 2
    low, high = ([getattr(k, end) for k in start.unknowns] for end in ("low", "high"))
    p = np.clip(position(model, start.unknowns), low, high)
    return replace(start, model=model, p=p, covariance=covariance)


def uncouple(covariance: Floats, j: int) -> None:
    """Make an unknown independent of the others, in place."""
    own = covariance[j, j]
    covariance[j, :] = covariance[:, j] = 0.0
    covariance[j, j] = own


def damping(
    records: Sequence[Record], model: Model, declared: Drive, jobs: int
) -> tuple[float, float]:
    """Return the meshes' damping and its standard deviation [N·m·s/rad]."""
    low, high = declared.quantities[DAMPING].range
    scale = np.log(np.geomspace(max(low, 1e-3 * high), high, VALUES))
    seen = [powers(rec.omega, rec.dt) for rec in records]
    noise = np.min([np.quantile(part, QUIET, axis=1) for part in seen], axis=0)

    def ratios(logarithm: float) -> Floats:
        tried = model.with_values(**{DAMPING: float(np.exp(logarithm))})
        runs = Misfit(records, 0.0).runs(tried)
        return np.array(
            [
                np.log((powers(run[:, 1], rec.dt).mean(1) + noise) / part.mean(1))
                for rec, run, part in zip(records, runs, seen, strict=True)
            ]
        ).ravel()

    off = np.array(in_threads(ratios, scale, jobs))
    fine = np.linspace(scale[0], scale[-1], FINER)
    off = np.array([np.interp(fine, scale, column) for column in off.T])
    scatter = np.maximum(np.sqrt(np.mean(off**2, axis=0).min()), LEAST)
    cost = np.sum((off / scatter) ** 2, axis=0) + ((fine - np.log(declared[DAMPING])) / PRIOR) ** 2
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    mean = float(weight @ fine)
    spread = float(np.sqrt(weight @ (fine - mean) ** 2))
    return float(np.exp(mean)), float(np.exp(mean) * np.hypot(spread, COMMON))


def powers(speed: Floats, dt: float) -> Floats:
    """Power of a speed in each band and window [rad²/s²], (bands, windows)."""
    top = NYQUIST_SHARE * 0.5 / dt
    bands = [(a, min(b, top)) for a, b in BANDS_HZ if a < 0.9 * top]
    rows = [sosfiltfilt(_sections(band, 1.0 / dt), speed) ** 2 for band in bands]
    return block_mean(np.array(rows), max(1, round(WINDOW_SECONDS / dt)))


@cache  # to design it takes longer than to filter a log
def _sections(band: tuple[float, float], rate: float) -> Floats:
    return np.asarray(butter(ORDER, band, "bandpass", fs=rate, output="sos"), np.float64)
