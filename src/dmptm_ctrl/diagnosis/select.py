"""Choose the effects that a model needs: forward steps, sets, deletion, rivals.

Evidence is the fall of −2 log-likelihood on the fitted logs plus that on the held-out logs, on
which nothing is fitted. Rows count by how independent they are under the larger model. One
acceptance level holds for every effect, place and drive.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, combinations
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.candidate import (
    LEVEL,
    NO_DIFFERENCE,
    Candidate,
    Evidence,
    Keys,
    Rows,
    State,
    needed,
    overlap,
)
from dmptm_ctrl.identify.fit import least_in_box
from dmptm_ctrl.simulate.model import Floats

# Evidence per unit of log-odds between rivals: 2 where the likelihood is right; laws that are
# only nearly right make it less sharp.
TEMPERATURE = 4.0
NEAR = 4.0 * TEMPERATURE  # evidence within which the logs hardly distinguish rivals
MOST = 16  # effects; a drive that seems to need more is not explained by effects
SET_BEAM = 12  # pairs that are made triples
SET_TRIALS = 3  # pairs, and triples, that are fitted
RIVALS = 3  # candidates that may take the place of an effect
HOPE = 0.3  # share of what an effect explains that a rival can explain, to first order
FLATTEST = 1e-12  # of the largest eigenvalue; flatter directions are rounding
DOUBTFUL = 3.0  # levels; an effect of more by its standard errors is not taken out to be tested


@dataclass(frozen=True, eq=False)
class Entry:
    """An effect of the selected model.

    Attributes
    ----------
    key : str
    gain, held_gain : float
        Rise of −2 log-likelihood when it alone is left out and the rest is refitted.
    rivals : tuple of Candidate
        What could take its place, best first.
    without : State
        The model refitted without it.
    """

    key: str
    gain: float
    held_gain: float
    rivals: tuple[Candidate, ...]
    without: Any

    @property
    def evidence(self) -> float:
        """Evidence of the effect beside all others."""
        return self.gain + self.held_gain

    @property
    def probability(self) -> float:
        """Probability of the name, from its evidence against that of its rivals and of none."""
        against = [LEVEL, *(r.evidence for r in self.rivals if not r.objection)]
        odds = np.exp(np.clip((np.array(against) - self.evidence) / TEMPERATURE, -50.0, 50.0))
        return float(1.0 / (1.0 + odds.sum()))

    @property
    def confusable_with(self) -> tuple[str, ...]:
        """Keys of rivals that the logs hardly distinguish from it."""
        least = self.evidence - NEAR
        return tuple(r.keys[0] for r in self.rivals if r.evidence > least and not r.objection)


@dataclass(eq=False)
class Selection:
    """The selected effects and the way to them.

    Attributes
    ----------
    base, final : State
        The declared model fitted inside its ranges, and the model with the effects.
    entries : list of Entry
        The effects, most evidence first.
    first, rest : list of Candidate
        All candidates beside the declared model, and beside the final one.
    known : dict of keys to Candidate
        Each effect at its first look: some have a place only beside another effect.
    path : list of str
        The steps in words.
    """

    base: Any
    final: Any
    entries: list[Entry] = field(default_factory=list)
    first: list[Candidate] = field(default_factory=list)
    rest: list[Candidate] = field(default_factory=list)
    known: dict[Keys, Candidate] = field(default_factory=dict)
    path: list[str] = field(default_factory=list)


def select_effects(
    evidence: Evidence,
    base: State,
    say: Callable[[str], None] = lambda _: None,
    *,
    begun: tuple[Selection, State] | None = None,
) -> Selection:
    """Select effects until no candidate and no small set of them is acceptable.

    `base` is the declared model, fitted; `say` hears each step. With `begun`, an earlier selection
    and a model with its effects, the steps begin at that model.
    """
    selection = Selection(base, base)
    state = base
    vain: set[Keys] = set()  # what led back to a model that was there already

    def step(text: str) -> None:
        selection.path.append(text)
        say(text)

    if begun is not None:
        earlier, state = begun
        selection.first, selection.known = earlier.first, dict(earlier.known)
        state = pruned(evidence, state, step, sure=0.0)  # it was fitted with other values
    seen: set[frozenset[str]] = {frozenset(state.keys)}
    while len(state.keys) < MOST and len(vain) < SET_TRIALS:
        candidates = ranked(evidence.candidates(state))
        selection.first = selection.first or candidates
        selection.rest = candidates
        selection.known = {c.keys: c for c in candidates} | selection.known
        able = [c for c in candidates if c.acceptable and c.keys not in vain]
        if not state.keys or not able:
            single = best_of(able, evidence.ratio(state)) if able else None
            sets = likely_sets(evidence, state, candidates, single)
            able += [c for c in sets if c.acceptable and c.keys not in vain]
        if not able:
            break
        chosen = best_of(able, evidence.ratio(state))
        before, grown = state, evidence.closed(evidence.adopt(state, chosen))
        step(
            f"+ {', '.join(chosen.keys)}: {chosen.gain:.0f} fitted, {chosen.held_gain:.0f} held out"
        )
        state = pruned(evidence, grown, step)
        kept = {*chosen.keys} & {*state.keys}
        needless = len(chosen.keys) > 1 and len(kept) <= 1  # one of a set: no set was needed
        known = frozenset(state.keys) in seen
        if needless or known or vain_exchange(evidence, grown, state, chosen.keys):
            vain.add(chosen.keys)
            state = before
        seen.add(frozenset(state.keys))
    return compared(evidence, selection, state, step)


def ranked(candidates: Sequence[Candidate]) -> list[Candidate]:
    """Candidates, most evidence first."""
    return sorted(candidates, key=lambda c: -c.evidence)


def best_of(able: Sequence[Candidate], ratio: float) -> Candidate:
    """The best candidate, or of those that the logs hardly distinguish from it the simplest.

    What both parts of the logs ask for goes before what only one of them does; each more effect
    has to be worth its level.
    """

    def worth(one: Candidate) -> float:
        return min(one.gain, ratio * one.held_gain) - LEVEL * len(one.keys)

    best = max(able, key=worth)
    # much more evidence on the fitted logs alone is not alike
    alike = [c for c in able if abs(c.evidence - best.evidence) < NEAR]
    alike = [c for c in alike if len(c.keys) <= len(best.keys)]
    return min(alike, key=lambda c: c.plainness)


def likely_sets(
    evidence: Evidence, state: State, candidates: Sequence[Candidate], single: Candidate | None
) -> list[Candidate]:
    """Fit the pairs and triples that may explain most; they may hide each other one by one.

    Those alone that are more to first order than their parts that were fitted, and than the best
    `single` one. What goes well with that is found beside it. Where effects were found and no more
    is, what is impossible beside them is so in a set.
    """
    finite = [c for c in candidates if np.isfinite(c.gain)]
    if state.keys and single is None:
        finite = [c for c in finite if c.objection in ("", NO_DIFFERENCE)]
    by_keys = {c.keys: c for c in finite}
    joint = JointGain(evidence.rows(state, list(by_keys.values())))
    gain = joint.bounded
    others = [keys for keys in by_keys if single is None or not overlap((*keys, *single.keys))]
    most = gain((single.keys,)) if single else 0.0
    pairs = [p for p in combinations(others, 2) if not overlap(chain.from_iterable(p))]
    best_pairs = joint.best(pairs, SET_BEAM)
    triples: set[tuple[Keys, ...]] = {
        tuple(sorted({*pair, keys}))
        for pair in best_pairs
        for keys in others
        if not overlap(chain.from_iterable((*pair, keys)))
    }
    likely: list[tuple[Keys, ...]] = list(best_pairs[:SET_TRIALS])
    likely += joint.best(sorted(triples), SET_TRIALS)
    known: list[tuple[Keys, ...]] = [(keys,) for keys in by_keys]  # what they are worth was seen
    found = []
    for group in likely:
        own = {part: gain(part) for part in known if {*part} < {*group}}
        if gain(group) > most + LEVEL * (len(group) - 1) and all(
            gain(group) > size + LEVEL * (len(group) - len(part)) for part, size in own.items()
        ):
            known.append(group)
            found.append(evidence.together(state, [by_keys[k] for k in group]))
    return found


class JointGain:
    """Fall of −2 log-likelihood by sets of effects, to first order.

    Parameters stay in their ranges: beyond, one would take up what a missing effect does.
    """

    def __init__(self, rows: Rows) -> None:
        names = list(rows.columns)
        table = np.column_stack([rows.derivatives, *rows.columns.values(), rows.left])
        size = np.sqrt(np.einsum("ij,ij->j", table, table))
        size[size == 0.0] = 1.0
        gram = (table.T @ table) / np.outer(size, size)
        self._gram, self._whole = gram, size[-1] ** 2
        self._own = own = rows.derivatives.shape[1]
        ends = own + np.cumsum([0, *(rows.columns[n].shape[1] for n in names)])
        self._places = {n: np.arange(ends[i], ends[i + 1]) for i, n in enumerate(names)}
        self._low, self._high = (x * size[:own] / size[-1] for x in (rows.low, rows.high))
        inner = np.linalg.pinv(gram[:own, :own], rcond=FLATTEST, hermitian=True)
        self._beyond = gram - gram[:, :own] @ inner @ gram[:own]  # what parameters cannot do
        self._known: dict[tuple[Keys, ...], float] = {}
        self._alone = self._left(())

    def bounded(self, group: tuple[Keys, ...]) -> float:
        """Return the fall by a set."""
        if group not in self._known:
            self._known[group] = self._alone - self._left(group)
        return self._known[group]

    def best(self, groups: Sequence[tuple[Keys, ...]], count: int) -> list[tuple[Keys, ...]]:
        """Return the sets that explain most, best first.

        Parameters free of their ranges could only do more: few sets need be looked at.
        """
        found: list[tuple[Keys, ...]] = []
        most_of = self._free(groups)
        for k in np.argsort(-most_of, kind="stable"):
            most, group = most_of[k], groups[k]
            if len(found) >= count and most < self.bounded(found[count - 1]):
                break
            found = sorted([*found, group], key=self.bounded, reverse=True)[:count]
        return found

    def _left(self, group: tuple[Keys, ...]) -> float:
        used = np.concatenate([np.arange(self._own), *(self._places[n] for n in group)])
        free = np.full(used.size - self._own, np.inf)
        low, high = np.concatenate([self._low, -free]), np.concatenate([self._high, free])
        square, slope = self._gram[np.ix_(used, used)], -self._gram[used, -1]
        x = least_in_box(square, slope, low, high)
        return self._whole * float(self._gram[-1, -1] + x @ square @ x - 2.0 * slope @ x)

    def _free(self, groups: Sequence[tuple[Keys, ...]]) -> Floats:
        """Upper bounds of the falls: with all parameters free."""
        places = [np.concatenate([self._places[n] for n in group]) for group in groups]
        sizes = np.array([p.size for p in places])
        found = np.zeros(len(groups))
        for size in np.unique(sizes):
            own = np.flatnonzero(sizes == size)
            used = np.array([places[k] for k in own])
            square = self._beyond[used[:, :, None], used[:, None, :]]
            along = self._beyond[used, -1]
            inverse = np.linalg.pinv(square, rcond=FLATTEST, hermitian=True)
            found[own] = np.einsum("gi,gij,gj->g", along, inverse, along)
        rest = max(self._beyond[-1, -1], 0.0)
        return self._alone - self._whole * (rest - found)


def explained(target: Floats, columns: Floats) -> float:
    """Square of a vector that columns can take up, to rounding."""
    size = np.linalg.norm(columns, axis=0)
    good = size > 0
    q, r = np.linalg.qr(columns[:, good] / size[good])
    clear = np.abs(np.diag(r)) > np.sqrt(np.finfo(float).eps)
    return float(np.sum((q[:, clear].T @ target) ** 2))


def pruned(
    evidence: Evidence, state: State, step: Callable[[str], None], sure: float = DOUBTFUL * LEVEL
) -> State:
    """Delete effects that the others have made superfluous, weakest first.

    One that is worth more by its standard errors than what is `sure` is not taken out to be
    tested; 0 is to test all.
    """
    while state.keys:
        wald = {key: evidence.wald(state, key) for key in state.keys}
        doubtful = [key for key in state.keys if not sure or wald[key] < sure]
        left_out = {key: evidence.without(state, key) for key in doubtful}
        spare = {key: beyond_need(evidence, one, state) for key, one in left_out.items()}
        weakest = min(spare, key=lambda key: spare[key], default=None)
        if weakest is None or spare[weakest] > 0.0:
            return state
        step(f"- {weakest}: {sum(evidence.gains(left_out[weakest], state)):.0f}")
        state = left_out[weakest]
    return state


def vain_exchange(evidence: Evidence, grown: State, state: State, chosen: Keys) -> bool:
    """Whether effects only replaced others, by less evidence than an effect needs."""
    if len(state.keys) > len(grown.keys) - len(chosen):
        return False
    before = grown
    for key in chosen:
        before = evidence.without(before, key)
    return beyond_need(evidence, before, state) <= 0.0


def beyond_need(evidence: Evidence, smaller: Any, larger: Any) -> float:
    """Evidence for a model with one effect more, less what is needed."""
    return sum(evidence.gains(smaller, larger)) - needed(1, *evidence.errors(smaller, larger))


def compared(
    evidence: Evidence, selection: Selection, state: State, step: Callable[[str], None]
) -> Selection:
    """Compare each effect with what could replace it or stand beside it; the best stays.

    An effect that others have made impossible gives way to a rival, or goes.
    """
    seen = {frozenset(state.keys)}
    while True:
        entries = []
        for key in state.keys:
            without = evidence.without(state, key)
            gains = evidence.gains(without, state)
            able = rivals_of(evidence, selection, state, without, key)
            rivals = ranked([in_place(evidence, without, state, gains, c) for c in able])
            better = other_way(evidence, selection, state, without, key, gains, rivals)
            if better is None and evidence.objection(without, state, key):
                better = given_way(evidence, without, rivals)
            if better is not None and len(seen) <= MOST:
                said: list[str] = []
                changed = pruned(evidence, better, said.append)
                if frozenset(changed.keys) not in seen:  # else effects would replace each other
                    added = [k for k in better.keys if k not in state.keys]
                    for text in (f"{key} → {', '.join(added) or 'nothing'}", *said):
                        step(text)
                    state = changed
                    seen.add(frozenset(state.keys))
                    break
            entries.append(Entry(key, *gains, tuple(rivals), without))
        else:
            break
    selection.entries = sorted(entries, key=lambda e: -e.evidence)
    selection.final = state
    return selection


def given_way(evidence: Evidence, without: State, rivals: Sequence[Candidate]) -> State:
    """Return the model in which the best rival stands for an impossible effect, or nothing."""
    possible = [r for r in rivals if r.acceptable]
    return evidence.adopt(without, possible[0]) if possible else without


def in_place(
    evidence: Evidence, without: State, state: State, gains: tuple[float, float], one: Candidate
) -> Candidate:
    """Return a rival with its evidence counted on the same rows as that of the effect."""
    short = evidence.gains(evidence.beside(without, one), state)
    return replace(one, gain=gains[0] - short[0], held_gain=gains[1] - short[1])


def other_way(
    evidence: Evidence,
    selection: Selection,
    state: State,
    without: State,
    key: str,
    gains: tuple[float, float],
    rivals: Sequence[Candidate],
) -> State | None:
    """Return a better model with a rival in an effect's place, or added before it.

    A fit that begins with one effect may bend all others to it, so that an effect which acts
    alike is not found beside it; begun with the rival, it is.
    """
    own, able = selection.known[(key,)], [r for r in rivals if r.acceptable]
    worth = beside_each(evidence, without, own, able) if able else []
    for rival, more in zip(able, worth, strict=True):
        ahead = 0.0 if rival.plainness < own.plainness else NEAR
        better = rival.evidence > sum(gains) + ahead
        if not better and more < LEVEL:
            continue
        first = evidence.adopt(without, rival)
        if impossible(evidence, without, first, rival.keys):
            continue
        if better:
            return first
        for second in evidence.candidates(first, [key]):
            if second.acceptable:
                both, new = evidence.adopt(first, second), (*rival.keys, key)
                needed_both = beyond_need(evidence, state, both) > 0.0
                if needed_both and not impossible(evidence, without, both, new):
                    return both
    return None


def beside_each(
    evidence: Evidence, without: State, one: Candidate, others: Sequence[Candidate]
) -> list[float]:
    """Evidence of each of others beside an effect, to first order and at most, (others,)."""
    joint = JointGain(evidence.rows(without, [one, *others]))
    alone = joint.bounded((one.keys,))
    most = evidence_per_gain(evidence.ratio(without))
    return [most * (joint.bounded((one.keys, c.keys)) - alone) for c in others]


def evidence_per_gain(ratio: float) -> float:
    """Evidence per gain on the fitted logs, at most: held-out ones say no more by rows."""
    return 1.0 + max(1.0 / ratio, 1.0)


def impossible(evidence: Evidence, without: State, state: State, keys: Keys) -> bool:
    """Whether effects of a settled model have impossible values."""
    return any(evidence.objection(without, state, key) for key in keys)


def rivals_of(
    evidence: Evidence, selection: Selection, state: State, without: State, key: str
) -> list[Candidate]:
    """Fit what could take an effect's place: what explains much of the same, to first order."""
    own = evidence.share(without, state, key)
    size = float(own @ own)
    alike: dict[str, float] = {}
    for (other,), one in selection.known.items():
        if other in without.keys or overlap((other, key)):
            continue
        alike[other] = explained(own, evidence.columns(without, one)) / max(size, 1e-300)
    likely = sorted((k for k in alike if alike[k] > HOPE), key=lambda k: -alike[k])[:RIVALS]
    return evidence.candidates(without, likely) if likely else []
