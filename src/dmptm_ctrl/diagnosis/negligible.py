"""Effects that hardly change what is left: they are taken out of a selection."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from dmptm_ctrl.diagnosis.budget import NEGLIGIBLE
from dmptm_ctrl.diagnosis.select import Entry, Evidence, Selection


def without_negligible(
    evidence: Evidence, selection: Selection, rise: Callable[[Any, Any], float]
) -> Selection:
    """Take out effects that hardly change what is left, the least first.

    Laws that are only nearly right are imitated by them.

    Parameters
    ----------
    evidence : Evidence
    selection : Selection
    rise : callable
        Share by which what is left rises without an effect: of (without, with).

    Returns
    -------
    Selection
    """
    final = selection.final
    left_out = {e.key: e.without for e in selection.entries if rise(e.without, final) < NEGLIGIBLE}
    while left_out:
        by = {key: rise(one, final) for key, one in left_out.items()}
        least = min(by, key=lambda key: by[key])
        if by[least] >= NEGLIGIBLE:
            break
        final = left_out.pop(least)
        selection.path.append(f"- {least}: negligible")
        # the others may have hidden behind it
        left_out = {key: evidence.without(final, key) for key in left_out if key in final.keys}
    if final is selection.final:
        return selection
    kept = [_again(evidence, e, final) for e in selection.entries if e.key in final.keys]
    return replace(selection, final=final, entries=sorted(kept, key=lambda e: -e.evidence))


def _again(evidence: Evidence, entry: Entry, final: Any) -> Entry:
    """Count an effect's evidence, and its rivals' by as much, beside another model."""
    without = evidence.without(final, entry.key)
    gains = evidence.gains(without, final)
    fit, held = gains[0] - entry.gain, gains[1] - entry.held_gain
    rivals = tuple(
        replace(r, gain=r.gain + fit, held_gain=r.held_gain + held)
        for r in entry.rivals
        if r.keys[0] not in final.keys
    )
    return Entry(entry.key, *gains, rivals, without)
