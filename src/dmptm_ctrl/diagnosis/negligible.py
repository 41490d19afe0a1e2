"""Effects that hardly change what is left: alone, or with others that stand for them."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from dmptm_ctrl.diagnosis.budget import MATERIAL, NEGLIGIBLE
from dmptm_ctrl.diagnosis.candidate import Evidence
from dmptm_ctrl.diagnosis.select import Entry, Selection, given_way, ranked, rivals_of


def without_negligible(
    evidence: Evidence, selection: Selection, rise: Callable[[Any, Any], float]
) -> Selection:
    """Take out effects that hardly change what is left, the least first.

    Laws that are only nearly right are imitated by them. `rise` of (without, with) is the share by
    which what is left rises without an effect.
    """
    return without_weak(evidence, selection, rise, NEGLIGIBLE, "negligible")


def without_weak(
    evidence: Evidence,
    selection: Selection,
    worth: Callable[[Any, Any], float],
    least: float,
    why: str,
) -> Selection:
    """Take out effects whose worth, of the model (without, with), is below `least`.

    The one that is worth least goes first, as long as the others still are worth too little.
    """
    final = selection.final
    left_out = {e.key: e.without for e in selection.entries if worth(e.without, final) < least}
    while left_out:
        by = {key: worth(one, final) for key, one in left_out.items()}
        weakest = min(by, key=lambda key: by[key])
        if by[weakest] >= least:
            break
        final = left_out.pop(weakest)
        selection.path.append(f"- {weakest}: {why}")
        # the others may have hidden behind it
        left_out = {key: evidence.without(final, key) for key in left_out if key in final.keys}
    if final is selection.final:
        return selection
    for key in final.keys:
        if key not in final.keys:  # it stood on one that went
            continue
        without = evidence.without(final, key)
        if evidence.objection(without, final, key):  # nothing stands for what went, but it
            rivals = ranked(rivals_of(evidence, selection, final, without, key))
            final = given_way(evidence, without, rivals)
            selection.path.append(f"- {key}: impossible beside the others")
    known = {e.key: e for e in selection.entries}
    kept = [_again(evidence, known.get(key), key, final) for key in final.keys]
    return replace(selection, final=final, entries=sorted(kept, key=lambda e: -e.evidence))


def _again(evidence: Evidence, entry: Entry | None, key: str, final: Any) -> Entry:
    """Count an effect's evidence, and its rivals' by as much, beside another model."""
    without = evidence.without(final, key)
    gains = evidence.gains(without, final)
    if entry is None:
        return Entry(key, *gains, (), without)
    fit, held = gains[0] - entry.gain, gains[1] - entry.held_gain
    rivals = tuple(
        replace(r, gain=r.gain + fit, held_gain=r.held_gain + held)
        for r in entry.rivals
        if r.keys[0] not in final.keys
    )
    return Entry(key, *gains, rivals, without)


def material_together(
    evidence: Evidence, selection: Selection, share: Callable[[Any], float]
) -> frozenset[str]:
    """Return keys of effects that only look immaterial, since others stand for them.

    Weakest first, effects are left out together as long as that hardly moves the budget. `share` is
    that of the removable mean square that a model lacks.
    """
    alone = {e.key: share(e.without) for e in selection.entries}
    small = sorted((key for key in alone if alone[key] < MATERIAL), key=lambda key: alone[key])
    if len(small) < 2:
        return frozenset()
    state = next(e.without for e in selection.entries if e.key == small[0])
    for k, key in enumerate(small[1:], 1):
        if key in state.keys:  # else it stood on one that went
            state = evidence.without(state, key)
        if share(state) >= MATERIAL:
            return frozenset(small[k:])
    return frozenset()
