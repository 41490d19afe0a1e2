"""Which effects are added: evidence against thresholds, pairs, backward deletion.

Evidence is a log-likelihood ratio (times two) of the balances on fitted and held-out logs
together. It is never judged by a p value: a model that is only nearly true reaches any. The
thresholds lie above the best evidence in the whole catalogue on rigs that lack nothing, and
beside the first effect on rigs that lack one (`benchmarks/campaign.py`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis import at_rest
from dmptm_ctrl.diagnosis.at_rest import AtRest
from dmptm_ctrl.diagnosis.bursts import BURSTS
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.residual import Residual, residual
from dmptm_ctrl.diagnosis.tables import Tables, clock_table, tabulate
from dmptm_ctrl.diagnosis.trace import BY_SIMULATOR, Trial, trace, unknowns_of
from dmptm_ctrl.diagnosis.unknown import ALIKE, CURVE, HELD, Unexplained, unexplained
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import drive_unknowns
from dmptm_ctrl.simulate.model import Model

FIRST = 70.0  # evidence of a first effect
SECOND = 90.0  # of a second one, beside the first
# The same where the model keeps step, so that its laws are the machine's, beyond what a search
# for the best shape finds anywhere; and the least share in it of fitted and of held-out logs. Of 31
# rigs that lack nothing 19 keep step: the best reach 11, and 6 on the held-out logs.
FAINT, FAINT_SHARE = 30.0, 8.0
# What an imperfectly fitted first effect leaves grows with it: a second one needs this share.
SECOND_SHARE = 0.01
MAX_EFFECTS = 2
SLACK = 10.0  # by which an effect may miss on the held-out logs, which need not show it
# Share of the best first effect's evidence from which others are tried with a second, too; most.
NEAR, MOST_FIRST = 0.8, 3
HOPE = 0.2  # share of the first effect's evidence from which it may lose its place to another
# Factors on what may be left: a soft reducer rings after each impact, faster than the windows
# follow; bristles carry more than the declared friction does near rest.
LEAVES = {"reducer_compliance": 3.0, at_rest.NAME: 2.0}
SUREST = 0.995  # probability of a name
RIVAL = 0.4  # share of the winner's evidence from which a candidate is named with it


@dataclass(eq=False)
class Found:
    """An accepted effect with what speaks for it and against it.

    Attributes
    ----------
    in_step : float
        Seconds over which it alone meets every bounce, where this and not the balances told it.
    out_of_step : tuple of str
        Rivals that lose step where it does not.
    at_most : float
        Probability that no evidence exceeds.
    everywhere : bool
        Whether the reversals of whole logs told it, not only their starts.
    """

    name: str
    evidence: float
    threshold: float
    trial: Trial
    rivals: tuple[Trial, ...]
    in_step: float = 0.0
    out_of_step: tuple[str, ...] = ()
    at_most: float = SUREST
    everywhere: bool = False

    @property
    def left(self) -> tuple[Trial, ...]:
        """Rivals that nothing has told from it."""
        return tuple(t for t in self.rivals if t.name not in self.out_of_step)

    @property
    def confusable_with(self) -> tuple[str, ...]:
        """Names that explain much of the same."""
        return tuple(t.name for t in self.left if t.evidence > RIVAL * self.evidence)

    @property
    def probability(self) -> float:
        """Probability that the name is right, from its evidence and its lead."""
        share = min(1.0, max([0.0, *(t.evidence for t in self.left)]) / self.evidence)
        surely = self.evidence / (self.evidence + 0.1 * self.threshold)
        return float(min(self.at_most, surely * (1.0 - 0.5 * share**4)))


@dataclass(eq=False)
class Decision:
    """What was added, and what each candidate reached on the way.

    Attributes
    ----------
    before, after : Residual
        Without any and with all effects.
    found : list of Found
    trials : mapping
        Name → its trial beside the declared model alone.
    rest : list of Trial
        Beside what was found; of two effects, beside the first.
    withdrawn : list of Found
        Names that free runs spoke against.
    """

    before: Residual
    after: Residual
    found: list[Found] = field(default_factory=list)
    trials: dict[str, Trial] = field(default_factory=dict)
    rest: list[Trial] = field(default_factory=list)
    unexplained: Unexplained | None = None
    tables: Tables | None = None
    at_rest: AtRest | None = None
    withdrawn: list[Found] = field(default_factory=list)

    def is_found(self, name: str) -> bool:
        """Whether an effect was accepted."""
        return any(found.name == name for found in self.found)


def convincing(trial: Trial, threshold: float) -> bool:
    """Whether there is enough evidence, no objection by held-out logs, and a possible size."""
    enough = trial.evidence > threshold and trial.held_gain > -SLACK
    return enough and not beyond(trial)


def beyond(trial: Trial) -> bool:
    """Whether the logs ask for more of an effect than it can be: it stands in for another."""
    amplitudes = CATALOGUE[trial.name].amplitudes
    return any(
        k.effect == trial.name and k.name in amplitudes and x != 0.0 and x in (k.low, k.high)
        for k, x in zip(trial.fit.unknowns, trial.fit.p, strict=True)
    )


def winner_of(trials: Sequence[Trial], threshold: float) -> Trial | None:
    """Return the trial with the most evidence that convinces."""
    return next((t for t in trials if convincing(t, threshold)), None)


def faint_one(trials: Sequence[Trial]) -> Trial | None:
    """Return what has the most of a little evidence, where laws that are not quite so have none.

    Fitted and held-out logs both have a share in it: what few logs leave open of the drive can
    show in the others as an effect.
    """
    able = [
        t
        for t in trials
        if convincing(t, FAINT + searched(t.name))
        and min(t.gain - searched(t.name), t.held_gain) > FAINT_SHARE
    ]
    return max(able, key=lambda t: t.evidence - searched(t.name), default=None)


def searched(name: str) -> float:
    """Evidence that the best of a bank of shapes finds where there is none: 2 log of its size."""
    banks = [len(p.bank) for p in CATALOGUE[name].parameters if p.bank]
    return 2.0 * float(np.log(np.prod(banks)))


def adopt(measured: Measured, trial: Trial, jobs: int) -> Residual:
    """Fit a trial's model to the end; who touches is told by it now."""
    return residual(measured, trial.fit.model, unknowns=trial.fit.unknowns, jobs=jobs)


def decide(left: Residual, *, skip: Sequence[str] = (), jobs: int = 2) -> Decision:
    """Add effects one after another while the logs demand them."""
    decision = by_balances(left, None, skip, jobs)
    shown = at_rest.presliding(decision.after, jobs)
    if shown.convincing:
        # what the balances called it without knowing of it does not count
        rested = slid(left, shown, jobs)
        trial = Trial(at_rest.NAME, shown.gain, shown.held_gain, rested.base)
        found = Found(at_rest.NAME, shown.evidence, at_rest.LEAST, trial, ())
        decision = by_balances(left, (found, rested), skip, jobs)
    decision.at_rest = shown
    if decision.unexplained is not None:
        put_into_tables(decision, jobs)
    if decision.tables is not None:
        decision.after = decision.tables.left
    return decision


def slid(left: Residual, shown: AtRest, jobs: int) -> Residual:
    """Fit balances beside pre-sliding."""
    model = left.base.model.with_effect(at_rest.NAME, **shown.fit.model.effects[at_rest.NAME])
    return residual(left.measured, model, unknowns=left.base.unknowns, jobs=jobs)


def by_balances(
    left: Residual, known: tuple[Found, Residual] | None, skip: Sequence[str], jobs: int
) -> Decision:
    """Add effects while the balances demand them, perhaps beside one that is known already."""
    measured, threshold = left.measured, FIRST
    decision = Decision(left, left)
    if known is not None:
        first, decision.after = known
        decision.found, threshold = [first], SECOND
    trials = trace(decision.after, skip)
    decision.trials = {t.name: t for t in trials}
    decision.rest = trials
    winner = winner_of(trials, threshold)
    if winner is not None and known is None:
        start = first_of(measured, trials, skip, jobs)
        decision.found.append(found_among(trials, start.trial, threshold))
        decision.after, decision.rest = start.after, start.rest
        threshold = start.threshold
        winner = winner_of(decision.rest, threshold)
    if winner is not None:
        decision.found.append(found_among(decision.rest, winner, threshold))
        decision.after = adopt(measured, winner, jobs)
    if len(decision.found) == 2 and known is None:
        reconsider(decision, skip, jobs)
    decision.unexplained = remainder(decision)
    if not decision.found and said_by_a_name(decision):
        decision.unexplained = None  # too little for either; keeping step may tell which
    if decision.unexplained is not None and len(decision.found) == 1:
        name_instead(decision, jobs)
    if decision.unexplained is not None and decision.unexplained.beyond_names:
        decision.found, decision.after = [], decision.before
    return decision


class Start(NamedTuple):
    """A first effect, and what is left for a second."""

    trial: Trial
    after: Residual
    rest: list[Trial]

    @classmethod
    def of(cls, measured: Measured, trial: Trial, skip: Sequence[str], jobs: int) -> "Start":
        """Adopt a first effect and try all others beside it."""
        after = adopt(measured, trial, jobs)
        return cls(trial, after, trace(after, skip))

    @property
    def threshold(self) -> float:
        """Evidence of a second one."""
        return max(SECOND, SECOND_SHARE * self.trial.evidence)

    def evidence(self) -> float:
        """Evidence of the first effect and of a second one, if one convinces."""
        second = winner_of(self.rest, self.threshold)
        return self.trial.evidence + (second.evidence if second is not None else 0.0)


def first_of(measured: Measured, trials: Sequence[Trial], skip: Sequence[str], jobs: int) -> Start:
    """Choose the first effect; of several that do nearly as well, by what a second adds.

    The one that does best alone may do so because it also takes up a part of another.
    """
    able = [t for t in trials if convincing(t, FIRST)]
    best = Start.of(measured, able[0], skip, jobs)
    if all(t.gain < SECOND for t in best.rest):
        return best  # no second one is in sight
    near = [t for t in able[1:MOST_FIRST] if t.evidence > NEAR * able[0].evidence]
    other = max((Start.of(measured, t, skip, jobs) for t in near), key=Start.evidence, default=best)
    return other if other.evidence() > best.evidence() + SECOND else best


def put_into_tables(decision: Decision, jobs: int) -> None:
    """Put what has no name into tables, where any can stand for it.

    What comes by the clock may be the log's excitation, and what moves the voltage may be its
    answer to what comes by the clock: the held-out logs tell.
    """
    what = decision.unexplained
    assert what is not None
    curve, left = what.curve, decision.after
    by_curve = None if curve is None else tabulate(left, curve.variables, jobs, order=curve.order)
    period = what.bursts.period
    by_clock = clock_table(left, period, jobs) if period > 0.0 else None
    told = max(one.held_gain if one else 0.0 for one in (curve, by_curve))
    if by_clock is not None and by_clock.held_gain > told and by_clock.evidence > CURVE:
        decision.tables = by_clock
        decision.unexplained = replace(what, variables=by_clock.variables, curve=None)
    elif curve is None and what.bursts.share < BURSTS and what.slips == 0.0:
        decision.unexplained = None
    else:
        decision.tables = by_curve


def found_among(trials: Sequence[Trial], winner: Trial, threshold: float) -> Found:
    """Describe the winner of some trials."""
    rivals = tuple(t for t in trials if t is not winner and t.evidence > 0.0)
    return Found(winner.name, winner.evidence, threshold, winner, rivals)


def remainder(decision: Decision) -> Unexplained | None:
    """Tell what the effects that were found leave."""
    explained = sum(found.evidence for found in decision.found)
    leave = max([1.0, *(LEAVES.get(found.name, 1.0) for found in decision.found)])
    return unexplained(decision.before, decision.after, explained, leave=leave)


def said_by_a_name(decision: Decision) -> bool:
    """Whether a name that little speaks for explains nearly as much as the curve that counts."""
    what = decision.unexplained
    if what is None or what.curve is None or what.bursts.share >= BURSTS:
        return False
    able = [trial.evidence for trial in decision.rest if trial.held_gain > HELD]
    return max(able, default=0.0) > ALIKE * what.curve.evidence


def name_instead(decision: Decision, jobs: int) -> None:
    """Prefer a name to a curve, if it leaves nothing: it says as much by fewer numbers."""
    winner = winner_of(decision.rest, FIRST)
    if winner is None:
        return
    without, curve = decision.after, decision.unexplained
    decision.found.append(found_among(decision.rest, winner, FIRST))
    decision.after = adopt(decision.before.measured, winner, jobs)
    decision.unexplained = remainder(decision)
    if decision.unexplained is not None:
        decision.found.pop()
        decision.after, decision.unexplained = without, curve


def withdraw(decision: Decision, jobs: int) -> None:
    """Take back the effect with the least evidence."""
    weakest = min(decision.found, key=lambda found: found.evidence)
    decision.found = [found for found in decision.found if found is not weakest]
    decision.withdrawn.append(weakest)
    model, unknowns = decision.before.base.model, decision.before.base.unknowns
    for found in decision.found:
        values = decision.after.base.model.effects[found.name]
        model = model.with_effect(found.name, **values)
        if found.name not in BY_SIMULATOR:
            unknowns = (*unknowns, *unknowns_of(found.name))
    decision.after = decision.before
    if decision.found:
        decision.after = residual(decision.before.measured, model, unknowns=unknowns, jobs=jobs)
    # candidates beside what is left, where they are known
    own, known = decision.after.base.unknowns, (*decision.trials.values(), *decision.rest)
    fits = {t.name: t for t in known if t.fit.unknowns == (*own, *unknowns_of(t.name))}
    decision.rest = [t for t in fits.values() if not decision.is_found(t.name)]


def reconsider(decision: Decision, skip: Sequence[str], jobs: int) -> None:
    """Choose the first effect anew beside the second, or drop it: it was chosen alone."""
    first, second = decision.found
    measured = decision.before.measured
    values = decision.after.base.model.effects[second.name]
    drive = decision.after.base.model.drive
    model = Model(drive, {**decision.before.base.model.effects, second.name: values})
    unknowns = (*drive_unknowns(model), *unknowns_of(second.name))
    alone = residual(measured, model, unknowns=unknowns, jobs=jobs)
    hopeful = [t.name for t in decision.trials.values() if t.evidence > HOPE * first.evidence]
    trials = trace(alone, skip, hopeful)
    winner = winner_of(trials, first.threshold)
    own = decision.trials[second.name]
    second = Found(second.name, second.evidence, second.threshold, own, second.rivals)
    if winner is None:
        decision.found = [Found(second.name, own.evidence, FIRST, own, ())]
        decision.after, decision.rest = alone, trials
        return
    anew = found_among(trials, winner, first.threshold)
    if winner.name != first.name:
        decision.after = adopt(measured, winner, jobs)
    decision.found = [anew, second]
