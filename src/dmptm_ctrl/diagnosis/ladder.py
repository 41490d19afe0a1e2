"""Find what a declared drive of any shape lacks, one effect after another.

Forward selection with backward deletion. A rung is taken when the logs that were fitted show
it beyond chance, block by block; when it is worth having; and when it lowers the error on logs,
or stretches of logs, that were not fitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis.ladder_candidates import candidates, structures
from dmptm_ctrl.diagnosis.ladder_held import held_outcome, held_state
from dmptm_ctrl.diagnosis.ladder_judge import (
    MIN_GAIN,
    MIN_SHARE,
    Errors,
    errors_of,
    exotic,
    gain_of,
    least_gain,
    plausible,
    rank,
    worthwhile,
)
from dmptm_ctrl.diagnosis.ladder_score import Score, Tangent, similarity
from dmptm_ctrl.diagnosis.ladder_tries import Candidate, joint
from dmptm_ctrl.identify.chain_fit import ChainFit, State, fit_chain
from dmptm_ctrl.identify.chain_start import rough_start
from dmptm_ctrl.identify.inverse_dynamics import Balance, Nuisance
from dmptm_ctrl.simulate.chain_model import ChainModel

ALPHA = 0.01  # chance that any rung of a ladder is taken by a drive that lacks nothing
HELD_SHARE = 0.3  # of the gain on the fitted logs that held-out ones must show
MAX_RUNGS = 10
SETTLE = 30  # iterations at most; an unsettled fit would lend its gain to the next effect
SHORTLIST = 4  # candidates refitted per rung
ALIKE = 0.7  # cosine between what two candidates explain, from which they compete
NEARLY = 0.85  # a simpler effect with this share of the best one's gain is preferred
STANDS_OUT = 0.3
ON_PROBATION = 0.2  # chance level at which an effect that stands out is tried
PAIRED = 6  # candidates that are tried in pairs
STRUCTURE = "shaft_compliance", "backlash"
CANDIDATES = 20  # about as many are looked at
PAIR = "drive_offset", "friction_asymmetry"  # may cancel over most of a log, and hide each other
PAIR_GAIN = 2.0  # times what either explains alone
SHAPES = ("stribeck_friction", "friction_asymmetry", "presliding", "thermal_drift")


class Rung(NamedTuple):
    """One step of the ladder: the errors before and after it."""

    key: str
    score: Score
    p_value: float
    gain: float
    held_gain: float
    fit_before: Errors
    fit_after: Errors
    held_before: Errors
    held_after: Errors


Steps = list[tuple[Rung, ChainFit]]


@dataclass(frozen=True, eq=False)
class Ladder:
    """What was found, and how.

    Attributes
    ----------
    base, final : ChainFit
    rungs : tuple of Rung
        As taken; those in `deleted` were given up again.
    scores : list of Candidate
        Of the last look.
    best : dict
        Effect name → largest gain that it showed at any look, with its p-value and survival.
    """

    base: ChainFit
    final: ChainFit
    rungs: tuple[Rung, ...]
    deleted: tuple[str, ...]
    scores: list[Candidate]
    best: dict[str, Candidate]
    fit_logs: Balance
    held_logs: Balance
    held_state: State
    warnings: tuple[str, ...] = field(default=())


def climb(
    model: ChainModel,
    fit_logs: Balance,
    held_logs: Balance,
    *,
    jobs: int = 2,
    tell: Callable[[str], None] | None = None,
) -> Ladder:
    """Find what a model lacks.

    Parameters
    ----------
    model : ChainModel
        As declared.
    fit_logs, held_logs : Balance
    jobs : int
        Threads; the result does not depend on it.
    tell : callable, optional
        Gets a line of text per step.

    Returns
    -------
    Ladder
    """
    say = tell or (lambda text: None)
    say("fitting the declared model")
    fit = fit_chain(State(rough_start(model, fit_logs)), fit_logs, jobs=jobs, iterations=SETTLE)
    base = fit
    rungs: list[Rung] = []
    best: dict[str, Candidate] = {}
    scores: list[Candidate] = []
    while len(rungs) < MAX_RUNGS:
        # Springs and gaps cost most to try: not while a plain effect stands out.
        say(f"{errors_of(fit.left, fit.drive).percent:.2f} % left; looking for what is missing")
        tangent = Tangent(fit, fit_logs)
        scores = candidates(tangent, structure=False)
        if not rungs or not any(c.score.gain >= STANDS_OUT for c in scores):
            scores = sorted([*scores, *structures(tangent)], key=lambda c: -c.score.gain)
        for candidate in scores:
            known = best.get(candidate.name)
            if known is None or candidate.score.gain > known.score.gain:
                best[candidate.name] = candidate
        taken = _pair(tangent, held_logs, scores, jobs)
        if taken is None:
            taken = _next_rung(fit, fit_logs, held_logs, scores, jobs)
        if taken is None:
            taken = _any_pair(tangent, held_logs, scores, jobs)
        if taken is None:
            break
        fit = taken[-1][1]
        for rung, _ in taken:
            rungs.append(rung)
            say(f"{rung.key}: {rung.held_before.percent:.2f} → {rung.held_after.percent:.2f} %")
    say("judging what was found")
    fit, deleted = _delete(fit, fit_logs, held_logs, rungs, jobs)
    return Ladder(
        base,
        fit,
        tuple(rungs),
        deleted,
        scores,
        best,
        fit_logs,
        held_logs,
        held_state(fit.state, held_logs, fit_logs, jobs=jobs),
    )


def _next_rung(
    fit: ChainFit,
    fit_logs: Balance,
    held_logs: Balance,
    scores: list[Candidate],
    jobs: int,
) -> Steps | None:
    """Take the best candidate that passes; None when none does.

    One that stands out may still be uncertain while much else is missing: it is taken on
    probation, and judged in the end.
    """
    level = ALPHA / max(len(scores), 1)
    worth = [
        c for c in scores
        if c.score.gain >= 0.5 * MIN_GAIN and (
            c.score.p_value * c.tries <= level
            or (c.score.gain >= STANDS_OUT and c.score.p_value <= ON_PROBATION)
        )
    ]  # fmt: skip
    refits = [(c, refit(fit, c, fit_logs, jobs)) for c in worth[:SHORTLIST]]
    old = fit.left, fit.drive
    before = errors_of(*old)
    held_old = held_outcome(fit.state, held_logs, fit_logs, jobs)
    trials = sorted(
        ((c, new, gain_of(old, (new.left, new.drive))) for c, new in refits), key=lambda t: -t[2]
    )
    least = (MIN_SHARE / before.percent) ** 2 if before.percent > 0 else 1.0
    trials = _simplest_first(
        [
            t for t in trials
            if worthwhile(t[0].name, t[2], old, (t[1].left, t[1].drive), least)
            and plausible(t[0], fit, t[1], fit_logs)
        ]
    )  # fmt: skip
    for candidate, new, gain in trials:
        held_new = held_outcome(new.state, held_logs, fit_logs, jobs)
        held_gain = gain_of(held_old, held_new)
        if held_gain < max(HELD_SHARE * gain, 0.5 * least_gain(candidate.name)):
            continue
        p_value = min(1.0, candidate.score.p_value * candidate.tries * len(scores))
        rung = Rung(
            candidate.placed.key, candidate.score, p_value, gain, held_gain,
            before, errors_of(new.left, new.drive), errors_of(*held_old), errors_of(*held_new),
        )  # fmt: skip
        return [(rung, new)]
    return None


def _pair(tangent: Tangent, held_logs: Balance, scores: list[Candidate], jobs: int) -> Steps | None:
    """Take two effects together that hide each other; None where they do not."""
    found = [next((c for c in scores if c.name == name), None) for name in PAIR]
    one, other = found
    if one is None or other is None:
        return None
    score, both = joint(tangent, one.placed, other.placed)
    alone = max(one.score.gain, other.score.gain)
    best = max(c.score.gain for c in scores)
    p_value = min(1.0, score.p_value * len(scores))
    if score.gain < max(PAIR_GAIN * alone, 2 * MIN_GAIN, best) or p_value > ALPHA:
        return None
    both_sized = [c._replace(placed=p) for c, p in zip((one, other), both, strict=True)]
    return _both(tangent, held_logs, both_sized, score, p_value, jobs)


def _any_pair(
    tangent: Tangent, held_logs: Balance, scores: list[Candidate], jobs: int
) -> Steps | None:
    """Take two effects together that are each uncertain while the other is missing."""
    plain = [c for c in scores if not exotic(c.name) or c.name == "cable_spring"]
    kept = [c for c in plain if c.name not in STRUCTURE and c.score.gain >= MIN_GAIN][:PAIRED]
    tried: list[tuple[float, int, Score, list[Candidate]]] = []
    for k, one in enumerate(kept):
        for other in kept[:k]:
            score = tangent.score(np.column_stack([one.score.direction, other.score.direction]))
            chance = score.p_value * one.tries * other.tries * len(scores) ** 2
            more = score.gain - max(one.score.gain, other.score.gain)
            if score.gain >= STANDS_OUT and more >= MIN_GAIN and chance <= ALPHA:
                order = rank(one.name) + rank(other.name)
                tried.append((score.gain, order, score._replace(p_value=chance), [other, one]))
    if not tried:
        return None
    top = max(t[0] for t in tried)
    tried = sorted((t for t in tried if t[0] >= NEARLY * top), key=lambda t: t[1])
    for _, _, score, both in tried[:2]:
        steps = _both(tangent, held_logs, both, score, score.p_value, jobs)
        if steps is not None:
            return steps
    return None


def _both(
    tangent: Tangent,
    held_logs: Balance,
    both: list[Candidate],
    score: Score,
    p_value: float,
    jobs: int,
) -> Steps | None:
    """Add two effects, if together they are worth it on held-out data as well."""
    fit, logs = tangent.fit, tangent.balance
    steps: Steps = []
    first = held_outcome(fit.state, held_logs, logs, jobs)
    held_old = first
    for candidate in both:
        new = refit(fit, candidate, logs, jobs)
        if not plausible(candidate, fit, new, logs):
            return None
        held_new = held_outcome(new.state, held_logs, logs, jobs)
        rung = Rung(
            candidate.placed.key, score, p_value,
            gain_of((fit.left, fit.drive), (new.left, new.drive)),
            gain_of(held_old, held_new), errors_of(fit.left, fit.drive),
            errors_of(new.left, new.drive), errors_of(*held_old), errors_of(*held_new),
        )  # fmt: skip
        steps.append((rung, new))
        fit, held_old = new, held_new
    old, last = (tangent.fit.left, tangent.fit.drive), (fit.left, fit.drive)
    gain = gain_of(old, last)
    if gain_of(first, held_old) < HELD_SHARE * gain or steps[1][0].gain < MIN_GAIN:
        return None
    return steps if worthwhile(both[1].name, gain, old, last, 2 * MIN_GAIN) else None


def refit(fit: ChainFit, candidate: Candidate, logs: Balance, jobs: int = 2) -> ChainFit:
    """Fit again with a candidate in the model, from its starting values."""
    model = fit.model.with_values(candidate.values).with_effect(candidate.placed)
    belongs = {m.name: fit.state.nuisance(m.name) for m in logs.motions}
    for log, shift in candidate.zero.items():
        old = belongs.get(log, Nuisance())
        belongs[log] = Nuisance({**old.zero, candidate.placed.key: shift}, old.twist)
    for log, twist in candidate.twist.items():
        belongs[log] = Nuisance(belongs[log].zero, {**belongs[log].twist, **twist})
    return fit_chain(State(model, belongs), logs, jobs=jobs, iterations=SETTLE)


def _simplest_first(
    trials: list[tuple[Candidate, ChainFit, float]],
) -> list[tuple[Candidate, ChainFit, float]]:
    """Best first, but a simpler effect that explains nearly the same goes before it."""
    if not trials:
        return []
    best, _, top = trials[0]
    near = [
        t for t in trials
        if t[2] >= NEARLY * top and similarity(t[0].score, best.score) >= ALIKE
    ]  # fmt: skip
    near.sort(key=lambda t: rank(t[0].name))
    return [*near, *(t for t in trials if all(t is not n for n in near))]


def _delete(
    fit: ChainFit, fit_logs: Balance, held_logs: Balance, rungs: Sequence[Rung], jobs: int
) -> tuple[ChainFit, tuple[str, ...]]:
    """Give up effects that later ones have made superfluous."""
    deleted: list[str] = []
    for number, rung in enumerate(rungs):
        uncertain = rung.p_value > ALPHA
        if number == len(rungs) - 1 and not uncertain:
            continue
        if rung.key not in {e.key for e in fit.model.effects}:
            continue
        if carries_others(fit.model, rung.key):
            continue
        state = State(_handed_over(fit.model, rung.key), fit.state.logs)
        without = fit_chain(without_zeros(state, rung.key), fit_logs, jobs=jobs)
        lost = gain_of((without.left, without.drive), (fit.left, fit.drive))
        chance = _chance(without, fit, fit_logs) if uncertain else 0.0
        if lost < least_gain(rung.key.partition("@")[0]) or chance > ALPHA / CANDIDATES:
            fit = without
            deleted.append(rung.key)
    return fit, tuple(deleted)


def _chance(without: ChainFit, fit: ChainFit, logs: Balance) -> float:
    """How often chance explains as much as the effect does that one of two fits lacks."""
    tangent = Tangent(fit, logs)
    rest = tangent.stack(fit.left)
    before = tangent.stack([p[: fit.left[0].shape[0]] for p in without.left])
    if before.size != rest.size:
        return 0.0  # a coordinate more or less: its gain is beyond doubt, or the rung was not taken
    lost = float(before @ before) - float(rest @ rest)
    count = max(len(fit.frees) - len(without.frees), 1)
    return tangent.chance(lost, rest, count, len(without.frees))


def _handed_over(model: ChainModel, key: str) -> ChainModel:
    """Return the model without an effect; a dead time passes to a lag beside it, and back."""
    gone = next(e for e in model.effects if e.key == key)
    other = {"drive_delay": "current_lag", "current_lag": "drive_delay"}.get(gone.name)
    heir = next((e for e in model.effects if e.name == other and e.on == gone.on), None)
    rest = model.without([key])
    if heir is None:
        return rest
    (late,), (name,) = gone.values.values(), heir.values
    return rest.with_effect(heir._replace(values={name: heir.values[name] + late}))


def carries_others(model: ChainModel, key: str) -> bool:
    """Whether other effects sit on a body or link that this one makes, or shape its friction."""
    name, _, on = key.partition("@")
    if name == "coulomb_friction" and any(e.on == on and e.name in SHAPES for e in model.effects):
        return True
    places = {e.on for e in model.effects if e.key != key}
    own = {b.name for b in model.rig.bodies} | {k.name for k in model.rig.links}
    made = set(model.layout.bodies) | set(model.layout.links)
    return key.startswith("shaft_compliance") and bool(places & (made - own))


def without_zeros(state: State, key: str) -> State:
    logs = {
        log: Nuisance({k: v for k, v in n.zero.items() if k != key}, n.twist)
        for log, n in state.logs.items()
    }
    return State(state.model, logs)
