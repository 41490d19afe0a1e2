"""Go on where a model keeps step with all logs: each log for as long as its run can be told.

Bounces grow whatever a run has wrong. Where that is fast, a fit meets the next impact by bending
the drive, and holds to it: of all other logs it then sees no more than before. Here a log ends
where the run of a drive with meshes a little other is elsewhere, unless it is met to the noise.
What is left goes on past the first reversals, which alone tell the friction of the way back.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dmptm_ctrl.identify.fit import Fit, Known, jogged
from dmptm_ctrl.identify.lock import HORIZONS, NOISE_LEVEL, ROUGH, Steps, compared, cut, loss
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

LONGER = (1.1, 1.3, 1.6, 2.0)  # s, behind the common horizons
LEAST_SECONDS = 0.6  # for which a model keeps step with all logs, or this is not its way
STEPS = 3  # of the fit per horizon
JOG = 2e-3  # relative, of the meshes; hardly any fit knows them more finely
WINDOW_SECONDS = 0.05  # over which one run is elsewhere, on the mean, if it is


def longer(records: Sequence[Record], done: Fit, known: Known, jobs: int) -> Fit:
    """Go on with a fit that keeps step.

    Parameters
    ----------
    records : sequence of Record
        Each from rest.
    done : Fit
        Comes back as it is if it keeps step for less than :data:`LEAST_SECONDS`.
    known : Known
        What is known of its unknowns beforehand.
    """
    if done.horizon < LEAST_SECONDS:
        return done
    model, p, covariance = done.model, done.p, done.covariance
    spread = None
    for horizon in (*(h for h in HORIZONS if h > done.horizon), *LONGER):
        ends = told(model, [cut(rec, horizon) for rec in records], jobs)
        parts = [cut(rec, end) for rec, end in zip(records, ends, strict=True)]
        steps = Steps(parts, model, done.unknowns, known, jobs, ROUGH, spread=spread)
        p = steps.descend(p, STEPS)
        model, covariance = steps.placed(p), steps.covariance
        spread = covariance
    return replace(done, model=model, p=p, covariance=covariance)


def told(model: Model, records: Sequence[Record], jobs: int) -> list[float]:
    """Seconds of each record for which a run tells of the drive.

    Up to where a drive with meshes a little other is elsewhere; or farther, as far as the model
    meets what is there as nearly as noise lets it.
    """
    several = [model.arrays(), *(other.arrays() for other in jogged(model, JOG))]

    def end(rec: Record) -> float:
        own, *others = compared([rec], several, 1)
        channels, dt = len(rec.channels), rec.block * rec.dt
        apart = loss(np.array(others) - own).reshape(len(others), channels, -1).mean((0, 1))
        missed = loss(own).reshape(channels, -1).mean(0)
        so_far = np.cumsum(missed) / np.arange(1, missed.size + 1)
        met = np.flatnonzero(so_far <= NOISE_LEVEL)
        return float(dt * max(_first(apart, dt), met[-1] + 1 if met.size else 0))

    return in_threads(end, records, jobs)


def _first(apart: Floats, dt: float) -> int:
    """Samples, `dt` long, after which a loss is more than noise has; all if never."""
    window = max(1, round(WINDOW_SECONDS / dt))
    mean = np.convolve(apart, np.full(window, 1.0 / window), "valid")
    lost = np.flatnonzero(mean > NOISE_LEVEL)
    return max(1, int(lost[0])) if lost.size else apart.size
