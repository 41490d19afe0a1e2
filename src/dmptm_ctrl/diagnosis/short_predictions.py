"""Effects that the balances cannot see, chosen by short predictions.

What acts at reversals, between the flanks or near rest leaves no torque missing while a drive
slides. Then short predictions of the speed over all logs (`identify/observer_driven.py`) count
beside the balances, in the same likelihood, with the same acceptance.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf

from dmptm_ctrl.contract import RUNS
from dmptm_ctrl.diagnosis.candidate import LEVEL, Candidate, name_of, needed
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState, fall
from dmptm_ctrl.diagnosis.dual_budget import rise
from dmptm_ctrl.diagnosis.negligible import without_negligible
from dmptm_ctrl.diagnosis.residual import predicting
from dmptm_ctrl.diagnosis.select import MOST, Entry, Selection, best_of, explained, ranked
from dmptm_ctrl.diagnosis.trace import bent, candidates, starts, weighted_changes
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.model import Model

FITTED = 2  # effects that are fitted at each look


def with_short_predictions(
    evidence: DualEvidence, selection: Selection, say: Callable[[str], None] = lambda _: None
) -> Selection:
    """Add what only short predictions ask for to the selection of the balances.

    Where an effect is found, the final model is fitted to balances and short predictions.
    """
    state = DualState(predicting(selection.final.left), selection.final.keys)
    found: dict[str, list[Candidate]] = {}
    tried: list[Candidate] = []
    while len(state.keys) < MOST:
        names = likely(state, candidates(state.trace, evidence.skip, everything=True))
        tried = ranked(evidence.beyond(state, names))
        able = [c for c in tried if c.acceptable]
        if not able:
            break
        chosen = best_of(able, evidence.ratio(state))
        (key,) = chosen.keys
        step = f"+ {key}: {chosen.gain:.0f} fitted, {chosen.held_gain:.0f} held out, ahead"
        selection.path.append(step)
        say(step)
        state = evidence.adopt(state, chosen)
        found[key] = [c for c in tried if c.keys != chosen.keys]
    selection.rest = [*selection.rest, *tried]
    if not found:
        return selection
    old = {e.key: e for e in selection.entries}
    while True:
        entries = [entry_of(evidence, state, key, old, found) for key in state.keys]
        weakest = min(entries, key=lambda e: e.evidence if e.key in found else inf)
        if weakest.key not in found:
            break
        better = next((c for c in weakest.rivals if c.evidence > weakest.evidence), None)
        if better is not None:
            again = evidence.beyond(weakest.without, [name_of(better.keys[0])])
            if again and again[0].acceptable and again[0].evidence > weakest.evidence:
                found[better.keys[0]] = [c for c in found.pop(weakest.key) if c is not better]
                state = evidence.adopt(weakest.without, again[0])
                continue
        if weakest.evidence > needed(1, *evidence.errors(weakest.without, state)):
            break
        state = weakest.without
    both = replace(selection, final=state, entries=sorted(entries, key=lambda e: -e.evidence))
    both = without_negligible(evidence, both, rise)
    return both if found.keys() & {e.key for e in both.entries} else selection


def entry_of(
    evidence: DualEvidence,
    state: DualState,
    key: str,
    old: Mapping[str, Entry],
    found: Mapping[str, Sequence[Candidate]],
) -> Entry:
    """What an effect is worth: that of the balances as it was, beside the model without it now."""
    without = evidence.without(state, key)
    if key in old:
        return replace(old[key], without=without)
    rivals = tuple(c for c in found[key] if c.keys[0] not in state.keys and c.acceptable)
    return Entry(key, *evidence.gains(without, state), rivals, without)


def likely(state: DualState, names: Sequence[str]) -> list[str]:
    """Effects that may explain most: to first order, or as they are at a clearly visible size."""
    base, view = state.left.base, state.trace
    models: list[Model] = []
    owners: list[str] = []
    for name in names:
        effect = CATALOGUE[name]
        own = [p for p in effect.parameters if not p.bank]
        sizes = starts(view, effect) if bent(name) else [{p.name: p.step} for p in own]
        models += [base.model.with_effect(name, **{**effect.absent(), **one}) for one in sizes]
        owners += [name] * len(sizes)
    changes = weighted_changes(view, models)
    worth = {}
    for name in names:
        some = changes[:, [owner == name for owner in owners]]
        if bent(name):
            moved = base.missing[:, None] + some / base.weights[:, None]
            worth[name] = max(fall(state.fitted, state.scores(row)) for row in moved.T)
        else:
            worth[name] = explained(state.target, state.independent(view.project(some)))
    order = sorted(names, key=lambda name: -worth[name])
    best = [name for name in order[:FITTED] if worth[name] > LEVEL / 2.0]
    # what balances never see has been tested by nothing yet
    return [*best, *(n for n in names if CATALOGUE[n].seen_by == RUNS and n not in best)]
