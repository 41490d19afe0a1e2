"""Which refitted effects are added: thresholds calibrated on rigs without any, pairs, deletion.

The evidence of a trial is the fall of the weighted square on fitted and on held-out logs,
in units in which one independent sample counts one. It is never judged by a p value: a
model that is only nearly true reaches any. The thresholds are quantiles of the best
evidence in the whole catalogue on rigs that lack nothing (`benchmarks/blind.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dmptm_ctrl.diagnosis.augment import FIRST_LOOK, Trial, refit_all, shortlist, squares
from dmptm_ctrl.diagnosis.residual import Residual, linearised, near_declared
from dmptm_ctrl.diagnosis.trace import MIN_SURVIVAL, Score, best_by_name, confusable, rescore, trace
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import Fit, fit

FIRST = 150.0  # evidence of a first effect; above the best of the catalogue on null rigs
SECOND = 250.0  # of a second one, beside the first
SHORTLIST = 4  # candidates taken from each of the two starts
# What an imperfectly fitted first effect leaves grows with it: a second one needs this share.
SECOND_SHARE = 0.3
MAX_EFFECTS = 2
VALLEY = (1.5, 2.2)  # multiples of an amplitude to try where the drive's parameters imitate it
UNSEEN = 0.02  # relative change of the held-out error that says nothing either way
CORRELATED = 0.75  # canonical correlation of projected columns from which two are one set
RIVAL = 0.8  # evidence of a rival, as a share of the winner's, from which they are a set
SETTLE = 12  # iterations that settle an accepted effect under the new weights
SLOPE = 4.0  # of the logistic map from log evidence over threshold to probability


def evidence(trial: Trial) -> float:
    """Fall of the weighted square on all logs."""
    return trial.gain + trial.held_gain


@dataclass(eq=False)
class Found:
    """An accepted effect with what speaks for it and against it."""

    name: str
    evidence: float
    threshold: float
    trial: Trial
    probability: float
    confusable_with: tuple[str, ...]


@dataclass(eq=False)
class Decision:
    """What was added, and what each candidate reached on the way."""

    before: Fit
    after: Fit
    found: list[Found] = field(default_factory=list)
    scores: list[Score] = field(default_factory=list)
    trials: dict[str, Trial] = field(default_factory=dict)
    last: Residual | None = None


def convincing(trial: Trial, threshold: float) -> bool:
    """Whether a trial is accepted: enough evidence, and the held-out logs do not object."""
    if trial.gain > 0.0 and trial.held_gain > 0.0:
        return evidence(trial) > threshold
    # The held-out logs may not show the effect at all; then the others must show it twice over.
    unseen = abs(trial.held_ratio - 1.0) < UNSEEN
    return unseen and trial.gain > 2.0 * threshold


def challenge(left: Residual, trials: Sequence[Trial]) -> Residual:
    """Refit the reference from the best trial's parameters without its effect.

    Fits through contact events stop in local minima; a trial must not win by having found
    a better one.
    """
    if not trials:
        return left
    best = max(trials, key=lambda t: t.gain)
    bare = best.fit.model.without([best.name])
    again = fit(left.misfit, bare, left.base.unknowns, iterations=3)
    if again.cost >= left.base.cost:
        return left
    return linearised(again, left.misfit, left.held)


def step(
    left: Residual, drive: Drive, skip: Sequence[str]
) -> tuple[Residual, list[Score], list[Trial]]:
    """Trace and refit once; return the (better) reference, scores and trials."""
    shapes = trace(left, skip=skip)
    scores = best_by_name(shapes)
    nominal = near_declared(left, drive)
    short = shortlist(scores, rescore(shapes, nominal), SHORTLIST)
    trials = refit_all(left, nominal, short)
    better = challenge(left, trials)
    if better is not left:
        before = squares(left, better.base.model)
        shift = left.base.cost - better.base.cost
        held_before = squares(left, left.base.model)[1].sum()
        trials = [
            Trial(
                t.name,
                t.fit,
                t.gain - shift,
                t.held_gain - float(held_before - before[1].sum()),
                t.held_ratio * float(np.sqrt(held_before / before[1].sum())),
                t.improved,
            )
            for t in trials
        ]
    return better, scores, trials


def decide(left: Residual, drive: Drive, *, skip: Sequence[str] = ()) -> Decision:
    """Add effects one after another while the logs demand them."""
    decision = Decision(left.base, left.base)
    for turn in range(MAX_EFFECTS):
        left, scores, trials = step(left, drive, skip)
        if turn == 0:
            decision.before = left.base
            decision.scores = scores
            decision.trials = {t.name: t for t in trials}
        decision.after, decision.last = left.base, left
        threshold = FIRST
        if decision.found:
            threshold = max(SECOND, SECOND_SHARE * decision.found[0].evidence)
        accepted = [t for t in trials if convincing(t, threshold)]
        if not accepted:
            break
        winner = max(accepted, key=evidence)
        decision.found.append(
            Found(
                winner.name,
                evidence(winner),
                threshold,
                winner,
                _probability(winner, trials, threshold),
                _confusable(winner, trials, scores),
            )
        )
        # Which weights are right is known better now: the effect no longer inflates them.
        left.misfit.weigh(winner.fit.model)
        left.held.weigh(winner.fit.model)
        again = settle(left, winner, scores)
        left = linearised(again, left.misfit, left.held)
        decision.after, decision.last = again, left
    if len(decision.found) > 1:
        _delete(decision)
    return decision


def settle(left: Residual, winner: Trial, scores: Sequence[Score]) -> Fit:
    """Fit an accepted effect to the end.

    Where inertia and friction can imitate it, the cost is a long valley along their common
    scale; starts further along it keep the fit from stopping at the near end.
    """
    unknowns = winner.fit.unknowns
    fits = [fit(left.misfit, winner.fit.model, unknowns, iterations=SETTLE)]
    survival = {s.name: s.survival for s in scores}.get(winner.name, 1.0)
    if survival < MIN_SURVIVAL:
        values = fits[0].model.effects[winner.name]
        amplitudes = CATALOGUE[winner.name].amplitudes
        drive = tuple(k for k in unknowns if k.effect != winner.name)
        for factor in VALLEY:
            stretched = {k: v * (factor if k in amplitudes else 1.0) for k, v in values.items()}
            model = winner.fit.model.with_effect(winner.name, **stretched)
            near = fit(left.misfit, model, drive, iterations=FIRST_LOOK)
            fits.append(fit(left.misfit, near.model, unknowns, iterations=SETTLE))
    return min(fits, key=lambda f: f.cost)


def _probability(winner: Trial, trials: Sequence[Trial], threshold: float) -> float:
    """Probability that the winner is right, from its evidence and its lead."""
    rivals = [evidence(t) for t in trials if t.name != winner.name]
    lead = evidence(winner) - max([0.0, *rivals])
    surely = 1.0 / (1.0 + (threshold / evidence(winner)) ** SLOPE)
    alone = 0.5 + 0.5 * min(1.0, lead / threshold)
    return float(surely * alone)


def _confusable(winner: Trial, trials: Sequence[Trial], scores: Sequence[Score]) -> tuple[str, ...]:
    """Names that these logs cannot tell from the winner."""
    by_name = {s.name: s for s in scores}
    names = [
        t.name for t in trials if t.name != winner.name and evidence(t) > RIVAL * evidence(winner)
    ]
    mine = by_name.get(winner.name)
    if mine is not None:
        names += [
            s.name
            for s in scores
            if s.name != winner.name
            and s.survival > 0.0
            and s.gain > 0.5 * mine.gain
            and confusable(mine, s) > CORRELATED
        ]
    return tuple(dict.fromkeys(names))


def _delete(decision: Decision) -> None:
    """Drop effects without which the others fit as well."""
    assert decision.last is not None
    left = decision.last
    for found in list(decision.found[:-1]):
        bare = left.base.model.without([found.name])
        unknowns = tuple(k for k in left.base.unknowns if k.effect != found.name)
        without = fit(left.misfit, bare, unknowns, iterations=3)
        lost_held = squares(left, without.model)[1].sum() - squares(left, left.base.model)[1].sum()
        if without.cost - left.base.cost + lost_held < found.threshold:
            decision.found.remove(found)
            left = linearised(without, left.misfit, left.held)
            decision.after, decision.last = without, left
