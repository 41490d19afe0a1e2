"""Which entry of a model has moved: each alone, with what the model itself did not know.

With residual e, derivatives J and the model's own covariance P, the residual of an unchanged
machine has the covariance V = 1 + J P Jᵀ. A change d of an entry along v adds −J v d. So
d = −vᵀg / vᵀHv with g = Jᵀ V⁻¹ e, H = Jᵀ V⁻¹ J, and its standard error is (vᵀHv)^(−1/2).
Other parameters may differ within the tolerance; that is part of V, too.
Rows of one second may be wrong alike: where the scores of these stretches scatter by more than
rows of their own would, the standard error grows as much (the cluster-robust one of Liang & Zeger,
Biometrika 73 (1986) 13).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from sys import maxsize

import numpy as np
from scipy.stats import t as student

from dmptm_ctrl.check.evidence import LARGE, Evidence, Parameter
from dmptm_ctrl.simulate.model import Floats

FALSE_ALARMS = 0.01  # of checks of an unchanged machine, over all entries together
MOST = 4  # entries named in one check
TOLERANCE = 0.05  # of an entry's value: a change within it is none


@dataclass(frozen=True)
class Entry:
    """A direction in which a machine changes."""

    name: str
    along: Mapping[str, float]  # key -> change of the parameter [SI] per unit of the entry
    value: float  # in the model; 1 where it is a factor
    unit: str  # empty for a factor
    size: float  # what a change is compared with: the value, or that of several amplitudes together


@dataclass(frozen=True)
class Change:
    """An entry, refitted alone on new logs."""

    entry: Entry
    change: float  # in the entry's unit
    se: float  # with the model's own in it
    gain: float  # of 2 log-likelihood, with all else as in the model

    @property
    def errors(self) -> float:
        """Change in standard errors."""
        return self.change / self.se

    def beyond(self, tolerance: float) -> float:
        """Standard errors by which the change is larger than a share of the entry's size."""
        return max(abs(self.change) - tolerance * self.entry.size, 0.0) / self.se

    def text(self) -> str:
        """Return the change as a line of text."""
        return f"{self.entry.name}: {self.size_text()} ({self.errors:+.1f} standard errors)"

    def size_text(self) -> str:
        """Return its size and standard error as text."""
        entry = self.entry
        if not entry.unit:
            return f"{100.0 * self.change:+.3g} % ± {100.0 * self.se:.2g} %"
        new = entry.value + self.change
        return f"{entry.value:.4g} → {new:.4g} ± {self.se:.2g} {entry.unit}".removesuffix(" 1")


def entries_of(parameters: Sequence[Parameter]) -> tuple[Entry, ...]:
    """Return the entries of a model.

    Numbers that mean one thing for both directions, or the amplitudes of an effect, change by one
    factor. The amplitudes change alone as well: an effect can turn its phase.
    """
    groups: dict[str, list[Parameter]] = {}
    for p in parameters:
        groups.setdefault(_group(p), []).append(p)
    found = []
    for name, members in groups.items():
        along = {p.key: p.value for p in members if p.value != 0.0}
        if along:
            found.append(Entry(name, along, 1.0, "", 1.0))
        size = float(np.linalg.norm([p.value for p in members]))
        if members[0].effect and len(members) > 1 and len({p.unit for p in members}) == 1:
            found += [Entry(p.key, {p.key: 1.0}, p.value, p.unit or "1", size) for p in members]
    return tuple(found)


_DUAL = {
    "TL": "friction of the ring gear",
    "T3": "friction of the reducers",
    "BL": "viscous friction of the ring gear",
    "B3": "viscous friction of the reducers",
    "WL": "Stribeck speed of the ring gear",
    "W3": "Stribeck speed of the reducers",
    "gap_l": "gap of the left mesh",
    "gap_r": "gap of the right mesh",
}


def _group(parameter: Parameter) -> str:
    if parameter.effect:
        return parameter.effect
    key = parameter.key
    body, _, name = key.removeprefix("body.").rpartition(".")
    if key.startswith("body.") and (name != "inertia" or parameter.unit == "kg"):
        stem = name.removesuffix("_plus").removesuffix("_minus")
        words = {"coulomb": "friction", "static": "friction", "inertia": "mass"}  # a slide's
        word = words.get(stem, stem.replace("_", " "))
        return f"{word} of {body}"
    return _DUAL.get(key if key.startswith("gap") else key[:2], key)


@dataclass(frozen=True, eq=False)
class Information:
    """g and H of this module's head, in scales of the parameters."""

    parameters: tuple[Parameter, ...]
    gradient: Floats
    square: Floats
    rows: Floats  # (k, k): Jᵀ J, less what noise adds
    scores: Floats  # (stretches, k): Jᵀ r, r what is left with every parameter free
    seen: Floats  # (k, k): V⁻¹ J v is J (seen v)

    def vector(self, entry: Entry) -> Floats:
        """Direction of an entry."""
        return np.array([entry.along.get(p.key, 0.0) / p.scale for p in self.parameters])

    def change(self, entry: Entry, tolerance: float = 0.0) -> Change | None:
        """Refit an entry alone; None where the logs identify it no finer than its own size.

        All other parameters may differ by a share `tolerance` of their values; that is taken for
        three standard deviations.
        """
        v = self.vector(entry)
        values = np.array([abs(p.value) / p.scale for p in self.parameters])
        loose = np.where(v == 0.0, tolerance / 3.0 * values, 0.0)
        inner = np.eye(v.size) + loose[:, None] * self.square * loose
        own = v - loose * np.linalg.solve(inner, loose * (self.square @ v))
        curvature = float(own @ self.square @ v)
        if not curvature * entry.size**2 > 1.0:
            return None
        w = self.seen @ own
        single, alike = float(w @ self.rows @ w), float(np.sum((self.scores @ w) ** 2))
        variance = 1.0 / curvature + max(alike - single, 0.0) / curvature**2
        if variance > entry.size**2:
            return None
        gain = float(v @ self.gradient) ** 2 / float(v @ self.square @ v)
        return Change(entry, -float(own @ self.gradient) / curvature, variance**0.5, gain)

    def without(self, entry: Entry) -> "Information":
        """Return what is left once an entry is free."""
        v = self.vector(entry)
        h = self.square @ v
        curvature = float(v @ h)
        return Information(
            self.parameters,
            self.gradient - h * (float(v @ self.gradient) / curvature),
            self.square - np.outer(h, h) / curvature,
            self.rows,
            self.scores,
            self.seen - np.outer(self.seen @ v, h) / curvature,
        )


def information_of(evidence: Evidence, errors: Mapping[str, float]) -> Information:
    """Return what logs say, given the standard errors [SI] of the model's parameters, by key.

    A parameter without one is as uncertain as logs like these leave it, stretches that are wrong
    alike included: the logs of the fit had them too.
    """
    j, e = evidence.derivatives, evidence.left
    square, gradient = j.T @ j, j.T @ e
    if evidence.noise is not None:
        square, gradient = square - evidence.noise[0], gradient - evidence.noise[1]
    prior = np.array([min(p.prior, LARGE) for p in evidence.parameters])
    own = np.linalg.inv(square + np.diag(prior**-2.0))
    rest = e - j @ (own @ gradient)
    first = np.flatnonzero(np.diff(evidence.stretch, prepend=-1))
    scores = np.add.reduceat(j * rest[:, None], first, axis=0)
    scores -= scores.mean(axis=0)  # all together they are what noise and ranges balance
    sd = np.sqrt(np.diag(own))
    usual = np.maximum(sd, np.linalg.norm(scores @ own, axis=0))
    each = zip(evidence.parameters, usual, strict=True)
    given = np.array([errors.get(p.key, s * p.scale) / p.scale for p, s in each])
    known = own * np.outer(given / sd, given / sd)
    inner = np.linalg.inv(np.linalg.inv(known) + square)
    return Information(
        evidence.parameters,
        gradient - square @ inner @ gradient,
        square - square @ inner @ square,
        square,
        scores,
        np.eye(len(square)) - inner @ square,
    )


def beside(
    information: Information, entries: Sequence[Entry], moved: Sequence[Entry]
) -> list[Change]:
    """Return every entry refitted beside those that moved, which are free."""
    found = []
    for entry in entries:
        rest = information
        for other in moved:
            if other.name != entry.name:
                rest = rest.without(other)
        change = rest.change(entry)
        if change is not None:
            found.append(change)
    return found


def disagreement(
    logs: Mapping[str, Information],
    entries: Sequence[Entry],
    moved: Sequence[Entry],
    tolerance: float = TOLERANCE,
) -> str:
    """Return what two logs say of the entry about which they differ most; empty if they agree.

    They differ where it is by more than the tolerance and their errors allow, over all pairs and
    entries together. What `moved` in all logs together is free.
    """
    count, worst = len(entries) * len(logs) * (len(logs) - 1) // 2, (1.0, "")
    for entry in entries:
        found: dict[str, Change] = {}
        for log, information in logs.items():
            rest = information
            for other in moved:
                rest = rest.without(other) if other.name != entry.name else rest
            if (change := rest.change(entry, tolerance)) is not None:
                found[log] = change
        for one, two in combinations(found, 2):
            a, b = found[one], found[two]
            apart = Change(entry, a.change - b.change, float(np.hypot(a.se, b.se)), 0.0)
            stretches = len(logs[one].scores) + len(logs[two].scores) - 1
            clear = apart.beyond(tolerance) / threshold(count, stretches)
            said = f"{a.size_text()} in {one}, {b.size_text()} in {two}"
            text = f"the logs disagree about {entry.name}: {said}; check them one by one"
            worst = max(worst, (clear, text))
    return worst[1]


def threshold(count: int, stretches: int) -> float:
    """Standard errors beyond which one of `count` entries counts as moved.

    The errors themselves are known from `stretches` stretches of the logs: Student's t.
    """
    return float(student.isf(0.5 * FALSE_ALARMS / max(count, 1), max(stretches - 1, 1)))


def too_short(alone: Sequence[Change], stretches: int) -> list[str]:
    """Say which entries could change by their whole value and not count as moved.

    Only because so few stretches hardly show how errors scatter.
    """
    limit, least = (threshold(len(alone), count) for count in (stretches, maxsize))
    names = [c.entry.name for c in alone if least * c.se < c.entry.size < limit * c.se]
    if not names:
        return []
    return [f"too short to show whether these have changed: {', '.join(names)}"]


def find_moved(
    information: Information, entries: Sequence[Entry], tolerance: float = TOLERANCE
) -> tuple[list[Change], list[Change]]:
    """Return what has moved, the clearest first, and every entry refitted alone.

    Something has moved if an entry has while others may differ within the tolerance. Its name is
    that of the entry which explains most alone; that need not be the one of most standard errors,
    for these say how stretches scatter. An entry counts beside others only for what these leave.
    A factor goes before a single amplitude where it is enough.
    """
    alone = [c for entry in entries if (c := information.change(entry, tolerance)) is not None]
    limit = threshold(len(alone), len(information.scores))
    moved: list[Change] = []
    rest = information
    while len(moved) < MOST:
        names = {m.entry.name for m in moved}
        left_over = [c.entry for c in alone if c.entry.name not in names]
        clear = {
            slack: [
                c
                for entry in left_over
                if (c := rest.change(entry, slack)) is not None and c.beyond(tolerance) > limit
            ]
            for slack in (tolerance, 0.0)
        }
        if not clear[tolerance]:
            break
        plain = clear[0.0] or clear[tolerance]
        best = max(plain, key=lambda c: c.gain)
        for whole in plain:  # all amplitudes by one factor, where that is enough
            if whole.entry.unit == "" and best.entry.name.startswith(f"{whole.entry.name}."):
                left = rest.without(whole.entry).change(best.entry)
                if left is None or left.beyond(tolerance) <= limit:
                    best = whole
                    break
        moved.append(best)
        rest = rest.without(best.entry)
    return moved, alone
