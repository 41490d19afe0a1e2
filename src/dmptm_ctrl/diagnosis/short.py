"""Effects that the balances cannot see, chosen by short predictions.

What acts at reversals, between the flanks or near rest leaves no torque missing while a drive
slides. Short predictions of the speed over all logs (`identify/led.py`) count beside the balances
then, in the same likelihood, with the same acceptance.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState, fall, key_of
from dmptm_ctrl.diagnosis.judge import without_negligible
from dmptm_ctrl.diagnosis.residual import predicting
from dmptm_ctrl.diagnosis.select import (
    LEVEL,
    MOST,
    Candidate,
    Entry,
    Selection,
    best_of,
    explained,
    ranked,
)
from dmptm_ctrl.diagnosis.trace import bent, candidates, starts, weighted_changes
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.model import Model

FITTED = 2  # effects that are fitted at each look


def with_short_predictions(
    evidence: DualEvidence, selection: Selection, say: Callable[[str], None] = lambda _: None
) -> Selection:
    """Add what only short predictions ask for.

    Parameters
    ----------
    evidence : DualEvidence
    selection : Selection
        Of the balances.
    say : callable
        Hears each step.

    Returns
    -------
    Selection
        With its final model fitted to balances and short predictions where an effect was found;
        else the same.
    """
    state = DualState(predicting(selection.final.left), selection.final.keys)
    found: dict[str, list[Candidate]] = {}
    tried: list[Candidate] = []
    while len(state.keys) < MOST:
        names = likely(evidence, state, open_names(evidence, state))
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
    entries = []
    for key in state.keys:
        without = evidence.without(state, key)
        if key in old:
            entries.append(replace(old[key], without=without))
        else:
            gains = evidence.gains(without, state)
            rivals = (c for c in found[key] if c.keys[0] not in state.keys)
            entries.append(Entry(key, *gains, tuple(rivals), without))
    both = replace(selection, final=state, entries=sorted(entries, key=lambda e: -e.evidence))
    both = without_negligible(evidence, both)
    return both if found.keys() & {e.key for e in both.entries} else selection


def open_names(evidence: DualEvidence, state: DualState) -> list[str]:
    """Effects that are not in the model and that runs could show."""
    names = candidates(state.trace, evidence.skip, everything=True)
    return [name for name in names if key_of(name) not in state.keys]


def likely(evidence: DualEvidence, state: DualState, names: Sequence[str]) -> list[str]:
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
            worth[name] = max(fall(state.fitted, state.told(row)) for row in moved.T)
        else:
            worth[name] = explained(state.target, state.independent(view.project(some)))
    order = sorted(names, key=lambda name: -worth[name])
    return [name for name in order[:FITTED] if worth[name] > LEVEL / 2.0]
