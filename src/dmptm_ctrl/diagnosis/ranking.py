"""The ranking: what became of every effect of the catalogue, and why."""

from collections.abc import Collection, Iterable
from math import isfinite
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.candidate import LEVEL, Candidate, name_of
from dmptm_ctrl.diagnosis.select import Selection

NOT_TESTABLE = "not testable with these logs"
TOP = 1e9  # score of what is sure


def ranking_of(
    selection: Selection,
    catalogue: Iterable[tuple[str, str, str]],
    *,
    sensors: Collection[str] = (),
    compared: Collection[str] = (),
    invisible: Collection[str] = (),
) -> list[dict[str, Any]]:
    """Return a row per effect: those in the model first, then by what the logs say for it.

    Parameters
    ----------
    catalogue : iterable of (name, location, reveals)
        Location of those that have one place only, else empty.
    sensors : collection of str
        Effects of sensors that are in the model.
    compared : collection of str
        Effects that sensors would have shown.
    invisible : collection of str
        Effects that these logs show only where they are large.
    """
    entries = {name_of(e.key): e for e in selection.entries}
    alone = best_of(selection.first)
    beside = best_of(selection.rest)
    rivals = {name_of(key) for e in selection.entries for key in e.confusable_with}
    rows = []
    for name, location, reveals in catalogue:
        one, status, reason = beside.get(name, alone.get(name)), NOT_TESTABLE, ""
        score = one.evidence if one else 0.0
        if name in entries or name in sensors:
            status = "supported"
            score = entries[name].evidence if name in entries else TOP
        elif one is not None and (name in beside or name not in invisible):
            status = "rejected"
            explained = name in rivals or alone.get(name, one).acceptable
            reason = why_rejected(one, explained)
        elif name in compared:
            status, reason = "rejected", "two sensors of the same motion do not show it"
        rows.append({
            "name": name, "location": location or (one.keys[0].partition("@")[2] if one else ""),
            "score": float(np.clip(score, -TOP, TOP)) if isfinite(score) else 0.0,
            "status": status, "reason": reason, "reveals": reveals, "detectable": {},
        })  # fmt: skip
    return sorted(rows, key=lambda row: (row["status"] != "supported", -row["score"]))


def why_rejected(one: Candidate, explained: bool) -> str:
    """Return the reason; `explained` says whether other effects do what it would."""
    if one.objection:
        return one.objection
    if explained:
        return "other effects explain the same as well"
    if one.evidence > LEVEL:
        return "held-out logs speak against it"
    return "too little evidence beside what was found"


def best_of(candidates: Iterable[Candidate]) -> dict[str, Candidate]:
    """Return the first candidate of each name: the best, where the best are first."""
    found: dict[str, Candidate] = {}
    for one in candidates:
        found.setdefault(name_of(one.keys[0]), one)
    return found
