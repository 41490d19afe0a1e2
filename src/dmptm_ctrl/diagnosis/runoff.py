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

from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.finish import MARGIN, OUT
from dmptm_ctrl.diagnosis.runners import (
    Runner,
    entrant,
    meshes_from,
    together,
)
from dmptm_ctrl.diagnosis.trace import Trial
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit, place
from dmptm_ctrl.identify.lock import HORIZONS, LOST, NEWS, UNEASY, cut, losses
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Model

ALIKE = 0.2  # share of a winner's evidence from which a rival runs beside it
MOST = 6  # rivals
FAR = 3.0 * MARGIN  # behind the best one, from where no other start would bring it back
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
    seconds : float
        For which it does.
    """

    out: tuple[str, ...]
    better: Trial | None
    model: Model
    seconds: float


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

    @property
    def total(self) -> float:
        """Loss on fitted and held-out logs."""
        return self.fitted + self.held

    def beyond(self, other: "Run") -> float:
        """Evidence for the other one, which keeps step; 0 unless the held-out logs agree."""
        fitted, held = self.fitted - other.fitted, self.held - other.held
        agree = other.level < UNEASY and min(fitted, held) > 0.0
        return fitted + held if agree else 0.0

    def loses_to(self, other: "Run") -> bool:
        """Whether it loses step altogether where the other keeps it, or nearly does."""
        ratio = self.level / other.level
        keeps = ratio > OUT if other.level < UNEASY else ratio > 2.0 * OUT and other.level < LOST
        return keeps and self.level > LOST and self.fitted > other.fitted and self.held > other.held


def run_off(
    fitted: Sequence[Record],
    held: Sequence[Record],
    winner: Trial,
    base: BalanceFit,
    after: Fit,
    rivals: Sequence[Trial],
    *,
    jobs: int = 2,
    seed: int = 0,
) -> Told | None:
    """Let the rivals of a name run beside it.

    Parameters
    ----------
    winner : Trial
        Of the name.
    base : BalanceFit
        Of the model with the name.
    after : Fit
        The same, refitted inside the simulator.
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
    trials = [winner, *close]
    runners = [runner(after, base, seed, 0), *(runner(after, t.fit, seed, 1) for t in close)]
    field, seconds = dict(enumerate(runners)), 0.0
    runs: dict[int, Run] = {}
    for horizon in horizons(0.0, SECONDS):
        parts = starts((fitted, held), horizon)
        lap(list(field.values()), parts[0], jobs)
        here = {i: run(parts, one.there, jobs) for i, one in field.items()}
        ahead = min(here.values(), key=lambda r: r.fitted)
        if ahead.level > UNEASY:
            if horizon >= SHORT_SECONDS or ahead.level > LOST:
                break
            continue
        seconds, runs = horizon, runs | here
        field = {i: one for i, one in field.items() if i == 0 or here[i].beyond(ahead) < MARGIN}
    if seconds < SHORT_SECONDS:
        return None
    first = 0
    if seconds >= KEEPS_SECONDS:
        for i in field:  # balances and runs have their say together
            told = runs[first].beyond(runs[i])
            if told > max(MARGIN, trials[first].evidence - trials[i].evidence):
                first = i
    behind = {i for i in field if runs[i].beyond(runs[first]) > MARGIN}
    out = tuple(trials[i].name for i in runs if i in behind or i not in field)
    better = trials[first] if first else None
    return Told(out, better, runners[first].there, seconds)


def lap(field: Sequence[Runner], records: Sequence[Record], jobs: int) -> None:
    """Fit everyone to one horizon; who is behind looks for other starts before it counts."""
    together(Runner.go, field, jobs, records, jobs)
    least = min(one.cost for one in field)

    def looks(one: Runner) -> None:
        behind = one.cost - least
        if behind < FAR and (one.level > UNEASY or behind > MARGIN):
            one.search()
        one.settle()

    together(looks, field, jobs)


def runner(after: Fit, fit: BalanceFit, *seed: int) -> Runner:
    """Enter a model from what balances make of it, and with a drive that keeps step already."""
    fit = meshes_from(after, fit)
    kept = {(k.effect, k.name): x for k, x in zip(after.unknowns, after.p, strict=True)}
    at = (kept.get((k.effect, k.name), x) for k, x in zip(fit.unknowns, fit.p, strict=True))
    low, high = ([getattr(k, end) for k in fit.unknowns] for end in ("low", "high"))
    model = place(fit.model, fit.unknowns, np.clip(fit.p, low, high))
    entered = entrant(None, model, fit.unknowns, loosened(fit), (np.array([*at]),))
    entered.rng = np.random.default_rng(seed)
    return entered


def lost(
    whole: Sequence[Sequence[Record]],
    bare: Model,
    other: Model,
    between: tuple[float, float],
    jobs: int,
) -> tuple[float, Run, Run] | None:
    """Find the longest horizon over which a model loses step where another keeps it.

    Parameters
    ----------
    whole : (fitted records, held-out records)
    between : (float, float)
        Shortest and longest horizon [s].

    Returns
    -------
    (seconds, run of `bare`, run of `other`) or None
        None if there is no such horizon.
    """
    for seconds in reversed(horizons(*between)):
        parts = starts(whole, seconds)
        runs = run(parts, bare, jobs), run(parts, other, jobs)
        if runs[0].loses_to(runs[1]):
            return seconds, *runs
    return None


def starts(whole: Sequence[Sequence[Record]], seconds: float) -> list[list[Record]]:
    """Return the starts of fitted and of held-out records."""
    return [[cut(rec, seconds) for rec in records] for records in whole]


def horizons(first: float, last: float) -> list[float]:
    """Return the horizons of a lock from one to another."""
    return [h for h in HORIZONS if first <= h <= last]


def run(parts: Sequence[Sequence[Record]], model: Model, jobs: int) -> Run:
    """Run a model over the fitted and the held-out logs."""
    fitted, held = (losses(model, records, jobs) for records in parts)
    return Run(float(fitted.mean()), float(NEWS * fitted.sum()), float(NEWS * held.sum()))
