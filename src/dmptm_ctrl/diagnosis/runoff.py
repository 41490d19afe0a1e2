"""Which of several names keeps step, where the balances take one for another.

Balances average over 40 ms, and over that long a torque that grows with the load is nearly one
that grows with the speed. Bounce by bounce it is not: an effect that is there carries the model
through the first tenths of a second of each log, see :mod:`dmptm_ctrl.identify.lock`, and another
in its place loses step at the first landings. On a machine whose laws of friction or contact are
not the model's every name loses step, and nothing is told.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.race import LEAST, MARGIN, OUT, UNEASY, loosely, meshes_from
from dmptm_ctrl.diagnosis.trace import Trial
from dmptm_ctrl.identify.fit import Fit, Known, place
from dmptm_ctrl.identify.lock import HORIZONS, LOST, NEWS, Locked, Steps, cut, lock, loss
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Floats, Model

ALIKE = 0.2  # share of a winner's evidence from which a rival runs beside it
MOST = 6  # rivals
SECONDS = 0.4  # of each log; later what is left of a wrong parameter grows into the bounces
SHORT_SECONDS = 0.15  # for which one of them keeps step at least, or nothing is told
KEEPS_SECONDS = 0.3  # the same, for one to take another's place


@dataclass(frozen=True, eq=False)
class Told:
    """What the runs tell of a name and its rivals.

    Attributes
    ----------
    out : tuple of str
        Names that lose step where another keeps it.
    better : Trial or None
        The rival that keeps step where the winner of the balances does not.
    model : Model
        Of the one that keeps step.
    horizon : float
        Seconds for which it does.
    """

    out: tuple[str, ...]
    better: Trial | None
    model: Model
    horizon: float


@dataclass(frozen=True, eq=False)
class Run:
    """Loss of a model's free runs over one horizon.

    Attributes
    ----------
    level : float
        Mean per sample of the fitted logs; noise alone gives 0.25.
    fitted, held : float
        Sum over the logs, of independent samples.
    """

    level: float
    fitted: float
    held: float

    def beyond(self, other: "Run") -> float:
        """Evidence for the other one, which keeps step; 0 unless the held-out logs agree."""
        fitted, held = self.fitted - other.fitted, self.held - other.held
        agree = other.level < UNEASY and min(fitted, held) > 0.0
        return fitted + held if agree else 0.0

    def loses_to(self, other: "Run") -> bool:
        """Whether it loses step altogether where the other keeps it."""
        return self.level > max(LOST, OUT * other.level) and self.beyond(other) > LEAST


def run_off(
    fitted: Sequence[Record],
    held: Sequence[Record],
    winner: Trial,
    after: Fit,
    rivals: Sequence[Trial],
    jobs: int = 2,
) -> Told | None:
    """Let the rivals of a name run beside it.

    Parameters
    ----------
    winner : Trial
        Of the name.
    after : Fit
        Refitted inside the simulator, with the name.
    rivals : sequence of Trial
        Beside the same other effects; the best first.

    Returns
    -------
    Told or None
        None if no one keeps step, or there is no rival.
    """
    close = [trial for trial in rivals if trial.evidence > ALIKE * winner.evidence][:MOST]
    if not close:
        return None
    starts = [cut(rec, SECONDS) for rec in fitted]
    locks = [rival_lock(starts, after, trial, jobs) for trial in close]
    models = [after.model, *(found.model for found in locks)]
    for seconds in reversed(horizons(SHORT_SECONDS, SECONDS)):
        parts = [[cut(rec, seconds) for rec in records] for records in (fitted, held)]
        own, *runs = (run(parts, model, jobs) for model in models)
        if min(r.level for r in (own, *runs)) < UNEASY:
            break
    else:
        return None
    best, keeps = winner, own
    if seconds >= KEEPS_SECONDS:
        for trial, r in zip(close, runs, strict=True):
            # balances and runs have their say together
            told = keeps.beyond(r)
            if told > MARGIN and told > best.evidence - trial.evidence:
                best, keeps = trial, r
    everyone = zip((winner, *close), (own, *runs), strict=True)
    out = tuple(trial.name for trial, r in everyone if r.beyond(keeps) > MARGIN)
    for trial, found in zip(close, locks, strict=True):
        if trial is best:
            return Told(out, trial, found.model, found.horizon)
    return Told(out, None, after.model, after.horizon)


def horizons(first: float, last: float) -> list[float]:
    """Return the horizons of a lock from one to another."""
    return [h for h in HORIZONS if first <= h <= last]


def rival_lock(records: Sequence[Record], after: Fit, trial: Trial, jobs: int) -> Locked:
    """Let a rival keep step for as long as it can, with the meshes of the winner."""
    fit = meshes_from(after, trial.fit)
    low, high = ([getattr(k, end) for k in fit.unknowns] for end in ("low", "high"))
    model = place(fit.model, fit.unknowns, np.clip(fit.p, low, high))
    return lock(records, model, fit.unknowns, loosely(fit), jobs=jobs)


def run(parts: Sequence[Sequence[Record]], model: Model, jobs: int) -> Run:
    """Run a model over the fitted and the held-out logs."""
    none: Floats = np.zeros(0)
    losses = [
        loss(Steps(records, model, (), Known(none, np.zeros((0, 0))), jobs).residuals([none]))
        for records in parts
    ]
    return Run(
        float(losses[0].mean()),
        float(NEWS * losses[0].sum()),
        float(NEWS * losses[1].sum()),
    )
