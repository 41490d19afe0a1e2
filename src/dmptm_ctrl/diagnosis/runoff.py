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

from dmptm_ctrl.diagnosis.race import LEAST, OUT, UNEASY, loosely, meshes_from
from dmptm_ctrl.diagnosis.trace import Trial
from dmptm_ctrl.identify.fit import Fit, Known, place
from dmptm_ctrl.identify.lock import LOST, NEWS, Locked, Steps, cut, lock, loss
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Floats, Model

ALIKE = 0.2  # share of a winner's evidence from which a rival runs beside it
MOST = 6  # rivals
SECONDS = 0.4  # of each log; later what is left of a wrong parameter grows into the bounces
KEEPS_SECONDS = 0.3  # for which one of them keeps step, or nothing is told


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

    def loses_to(self, other: "Run") -> bool:
        """Whether it loses step where the other keeps it, on the held-out logs too."""
        fitted, held = self.fitted - other.fitted, self.held - other.held
        far = self.level > max(LOST, OUT * other.level)
        return far and other.level < UNEASY and held > 0.0 and fitted + held > LEAST


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
    parts = [[cut(rec, SECONDS) for rec in records] for records in (fitted, held)]
    locks = [rival_lock(parts[0], after, trial, jobs) for trial in close]
    seconds = max([after.horizon, *(found.horizon for found in locks)])
    if not close or seconds < KEEPS_SECONDS:
        return None
    runs = {t.name: run(parts, found.model, jobs) for t, found in zip(close, locks, strict=True)}
    runs[winner.name] = own = run(parts, after.model, jobs)
    best = min(runs.values(), key=lambda r: r.fitted + r.held)
    if not own.loses_to(best):
        best = own
    out = tuple(name for name, r in runs.items() if r.loses_to(best))
    for trial, found in zip(close, locks, strict=True):
        if best is runs[trial.name]:
            return Told(out, trial, found.model, found.horizon)
    return Told(out, None, after.model, after.horizon)


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
