"""Evidence from the torque balance of the dual-motor drive, for the selection of effects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis.candidate import (
    LEVEL,
    NO_DIFFERENCE,
    WEAKER,
    Candidate,
    Keys,
    Rows,
    differ,
    name_of,
    standard_error,
)
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.residual import Residual, predicting_fit, residual
from dmptm_ctrl.diagnosis.select import NEAR, evidence_per_gain
from dmptm_ctrl.diagnosis.trace import (
    FINALISTS,
    SEARCHES,
    Start,
    Trace,
    Trial,
    begun,
    candidates,
    effect_columns,
    finished,
    try_effect,
    unknowns_of,
)
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import (
    BalanceFit,
    correlation_lengths,
    fit_balance,
    robust_fit,
    row_surprises,
    settled_fit,
    surprises,
    weights,
)
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats


class Scores(NamedTuple):
    """−2 log-likelihood per equation, rows of each that count as one, and the prior's part."""

    surprises: Floats
    lengths: Floats
    prior: float


def scores(parts: Sequence[Floats], kinds: Sequence[str], prior: float) -> Scores:
    """Return what the residuals of all equations say."""
    return Scores(surprises(parts, kinds), correlation_lengths(parts, kinds), prior)


def fall(smaller: Scores, larger: Scores) -> float:
    """Fall of −2 log-likelihood by the larger model, per independent row as it leaves them."""
    change = (smaller.surprises - larger.surprises) / larger.lengths
    return float(np.sum(change)) + smaller.prior - larger.prior


def root_shares(parts: Sequence[Floats], of: Scores) -> Floats:
    """Square root of the share of each row of all equations that is independent, (m,)."""
    return np.sqrt(np.repeat(1.0 / of.lengths, [part.size for part in parts]))


def key_of(name: str) -> str:
    """Return ``name@place`` of an effect of the dual-motor drive."""
    return f"{name}@{CATALOGUE[name].location}"


@dataclass(frozen=True, eq=False)
class DualState:
    """A model fitted to balances of the dual-motor drive.

    Attributes
    ----------
    left : Residual
    keys : tuple of str
        Effects that were added.
    """

    left: Residual
    keys: Keys = ()

    @cached_property
    def fitted(self) -> Scores:
        """What the fitted logs say of the model."""
        return self.scores(self.left.base.missing)

    def scores(self, missing: Floats) -> Scores:
        """What a residual on the fitted logs, (m,), would say of it."""
        base = self.left.base
        prior = sum((x / k.prior) ** 2 for x, k in zip(base.p, base.unknowns, strict=True))
        ends = np.cumsum([part.size for part in base.parts])[:-1]
        return scores(np.split(missing, ends), base.kinds, float(prior))

    @cached_property
    def held(self) -> Scores:
        """What the held-out logs say of it."""
        return scores(self.held_missing, self.left.held.kinds, 0.0)

    @cached_property
    def held_missing(self) -> list[Floats]:
        """What it leaves of the held-out logs, per equation."""
        return self.left.held.missing(self.left.base.model)

    @cached_property
    def rows(self) -> list[Floats]:
        """What each row of the fitted logs says of the model, per equation."""
        return row_surprises(self.left.base.parts, self.left.base.kinds)

    @cached_property
    def held_rows(self) -> list[Floats]:
        """What each row of the held-out logs says of it, per equation."""
        return row_surprises(self.held_missing, self.left.held.kinds)

    @cached_property
    def trace(self) -> Trace:
        """What is left, with what the model's parameters could explain projected out."""
        return Trace(self.left)

    @cached_property
    def independence(self) -> Floats:
        """Square root of the share of each row of the fitted logs that is independent."""
        return root_shares(self.left.base.parts, self.fitted)

    def independent(self, rows: Floats) -> Floats:
        """Weighted rows, (m,) or (m, k), in units in which an independent one counts one."""
        count = self.independence.size
        return (rows[:count].T * self.independence).T

    @property
    def target(self) -> Floats:
        """Weighted residual, projected, (m,)."""
        return self.independent(self.trace.target)


@dataclass(frozen=True, eq=False)
class DualEvidence:
    """Torque balances of the logs of one dual-motor drive.

    The sensors have settled the effects in `skip` already; nothing depends on `jobs`.
    """

    measured: Measured
    skip: Sequence[str] = ()
    jobs: int = 2

    def candidates(self, state: DualState, only: Sequence[str] | None = None) -> list[Candidate]:
        view = state.trace
        names = candidates(view, self.skip)
        if only is not None:
            named = {name_of(key) for key in only}
            found = self._tried(begun(view, [n for n in names if n in named]))
            return [self._candidate(state, (t,)) for t in finished(view, found)]
        starts = begun(view, names)
        searching = [CATALOGUE[name].search in SEARCHES for name in names]  # they take longest
        gains = in_threads(
            lambda k: starts[k].gain, range(len(names)), self.jobs, lambda k: searching[k]
        )
        # beside the declared model all stay: the report says what each could have been
        least = LEVEL / 2.0 if state.keys else 0.0
        order = [k for k in np.argsort(gains)[::-1] if gains[k] >= least]
        first = int(np.isinf(gains).sum()) + FINALISTS
        found = self._tried([starts[k] for k in order[:first]])
        judged = {t: self._candidate(state, (t,)) for t in found}
        # none is chosen that was not fitted, and few could be
        best = max((c.evidence for c in judged.values() if c.acceptable), default=LEVEL + NEAR)
        most = evidence_per_gain(self.ratio(state))
        could = [k for k in order[first:] if most * gains[k] >= best - NEAR]
        found += self._tried([starts[k] for k in could])
        rest = [k for k in order[first:] if k not in could]
        return [
            *(judged.get(t) or self._candidate(state, (t,)) for t in finished(view, found)),
            *(self._rough(starts[k]) for k in rest),
        ]

    def _tried(self, starts: Sequence[Start]) -> list[Trial]:
        """Fit effects; what takes longest begins first."""
        return in_threads(try_effect, starts, self.jobs, lambda one: len(one.models))

    def beyond(self, state: DualState, names: Sequence[str]) -> list[Candidate]:
        """Fit effects beside a model that short predictions count for."""

        def one(start: Start) -> Trial | None:
            return try_effect(start) if start.gain >= LEVEL / 2.0 else None

        found = in_threads(one, begun(state.trace, names), self.jobs)
        return [self._candidate(state, (t,)) for t in found if t is not None]

    def _rough(self, start: Start) -> Candidate:
        """Return an effect that others leave too little for, to first order."""
        trial = start.rough
        objection = WEAKER if trial.gain > LEVEL else ""
        return replace(self._plain((trial,)), gain=trial.gain, objection=objection)

    def _candidate(self, state: DualState, trials: tuple[Trial, ...]) -> Candidate:
        why = next(filter(None, (objection(t.fit, t.name) for t in trials)), "")
        one = replace(self._plain(trials), objection=why)
        there = self.beside(state, one)
        gain, held = self.gains(state, there)
        error, held_error = self.errors(state, there)
        return replace(one, gain=gain, held_gain=held, error=error, held_error=held_error)

    @staticmethod
    def _plain(trials: tuple[Trial, ...]) -> Candidate:
        """Return a candidate before it is tested."""
        keys = tuple(key_of(t.name) for t in trials)
        numbers = sum(len(unknowns_of(t.name)) for t in trials)
        order = sum(list(CATALOGUE).index(t.name) for t in trials)
        return Candidate(keys, 0.0, 0.0, trials, "", numbers, order)

    def beside(self, state: DualState, candidate: Candidate) -> DualState:
        left = replace(state.left, base=candidate.fitted[0].fit)
        return DualState(left, (*state.keys, *candidate.keys))

    def gains(self, smaller: DualState, larger: DualState) -> tuple[float, float]:
        """Fall of −2 log-likelihood on the fitted and on the held-out logs.

        On the fitted logs less what searches for the best shapes find anyway.
        """
        more = sum(searched(name_of(k)) for k in larger.keys)
        more -= sum(searched(name_of(k)) for k in smaller.keys)
        return fall(smaller.fitted, larger.fitted) - more, fall(smaller.held, larger.held)

    def errors(self, smaller: DualState, larger: DualState) -> tuple[float, float]:
        return (
            standard_error(smaller.rows, larger.rows, larger.fitted.lengths),
            standard_error(smaller.held_rows, larger.held_rows, larger.held.lengths),
        )

    def held_residuals(self, smaller: DualState, larger: DualState) -> tuple[Floats, Floats]:
        left, kinds = larger.held_missing, larger.left.held.kinds
        each = weights(left, kinds) * root_shares(left, larger.held)
        return each * np.concatenate(smaller.held_missing), each * np.concatenate(left)

    def ratio(self, state: DualState) -> float:
        counts = (sum(int(e.used.sum()) for e in b.equations) for b in (
            state.left.balance, state.left.held))  # fmt: skip
        fitted, held = counts
        return fitted / max(held, 1)

    def columns(self, state: DualState, candidate: Candidate) -> Floats:
        return state.independent(state.trace.project(_columns(state.trace, candidate)))

    def rows(self, state: DualState, candidates: Sequence[Candidate]) -> Rows:
        view = state.trace
        columns = {c.keys: np.pad(_columns(view, c), ((0, view.rows), (0, 0))) for c in candidates}
        return Rows(view.whole, view.derivatives, *view.room, columns)

    def together(self, state: DualState, candidates: Sequence[Candidate]) -> Candidate:
        model, unknowns = state.left.base.model, state.left.base.unknowns
        names = [c.fitted[0].name for c in candidates]
        for c in candidates:
            (trial,) = c.fitted
            model = model.with_effect(trial.name, **trial.fit.model.effects[trial.name])
            unknowns = (*unknowns, *unknowns_of(trial.name))
        derivatives = state.left.base.jacobian
        fit = fit_balance(state.left.balance, model, unknowns, jacobian=derivatives)
        return self._candidate(state, tuple(Trial(n, 0.0, 0.0, fit) for n in names))

    def adopt(self, state: DualState, candidate: Candidate) -> DualState:
        fit, balance = candidate.fitted[0].fit, state.left.balance
        if balance.observer_driven:
            done = predicting_fit(balance, fit)
        else:
            done = settled_fit(balance, fit.model, fit.unknowns, fit.jacobian)
        return DualState(replace(state.left, base=done), (*state.keys, *candidate.keys))

    def closed(self, state: DualState) -> DualState:
        """Let the model decide anew which pinions touch where no encoder shows it."""
        if not state.left.balance.simulated:
            return state
        base = state.left.base
        left = residual(self.measured, base.model, unknowns=base.unknowns, jobs=self.jobs)
        return DualState(left, state.keys)

    def without(self, state: DualState, key: str) -> DualState:
        name, base = name_of(key), state.left.base
        kept = [j for j, k in enumerate(base.unknowns) if k.effect != name]
        unknowns = tuple(base.unknowns[j] for j in kept)
        model, derivatives = base.model.without([name]), base.jacobian[:, kept]
        fitted = fit_balance if state.left.balance.observer_driven else robust_fit
        fit = fitted(state.left.balance, model, unknowns, jacobian=derivatives)
        left = replace(state.left, base=fit)
        return DualState(left, tuple(k for k in state.keys if k != key))

    def wald(self, state: DualState, key: str) -> float:
        base = state.left.base
        own = own_places(base, name_of(key))
        p, covariance = base.p[own], base.covariance[np.ix_(own, own)]
        whole = float(np.mean(state.independence**2))
        return whole * float(p @ np.linalg.pinv(covariance) @ p)

    def objection(self, without: DualState, state: DualState, key: str) -> str:
        return objection(state.left.base, name_of(key))

    def share(self, without: DualState, state: DualState, key: str) -> Floats:
        base = state.left.base
        own = own_places(base, name_of(key))
        changed = without.left.base.weights * (base.jacobian[:, own] @ base.p[own])
        return without.independent(without.trace.project(changed))


def _columns(view: Trace, candidate: Candidate) -> Floats:
    """Weighted change of the residual per amplitude, (m, k)."""
    (trial,) = candidate.fitted
    effect = CATALOGUE[trial.name]
    values = trial.fit.model.effects[trial.name]
    shapes = {k: values[k] for k in effect.shapes if k in values}
    return effect_columns(view, effect, shapes)


def own_places(fit: BalanceFit, name: str) -> list[int]:
    """Places of an effect's amplitudes among the unknowns."""
    amplitudes = CATALOGUE[name].amplitudes
    return [j for j, k in enumerate(fit.unknowns) if k.effect == name and k.name in amplitudes]


def searched(name: str) -> float:
    """Evidence that the best of a bank of shapes finds where there is none: 2 log of its size."""
    banks = [len(p.bank) for p in CATALOGUE[name].parameters if p.bank]
    return 2.0 * float(np.log(np.prod(banks)))


def objection(fit: BalanceFit, name: str) -> str:
    """Why the fitted values of an effect are impossible; empty where they are not."""
    own = own_places(fit, name)
    for k, x in ((fit.unknowns[j], fit.p[j]) for j in own):
        if x != 0.0 and x in (k.low, k.high):
            return f"{k.name} would lie beyond what is possible"
    telling = [j for j in own if fit.unknowns[j].name not in CATALOGUE[name].constants]
    firm = differ(fit.p[telling], fit.covariance[np.ix_(telling, telling)])
    return "" if firm else NO_DIFFERENCE
