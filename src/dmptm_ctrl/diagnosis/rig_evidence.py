"""Evidence from the torque balance of a drive of any shape, for the selection of effects."""

from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from math import isfinite

import numpy as np

from dmptm_ctrl.diagnosis.candidate import (
    LEVEL,
    WEAKER,
    Candidate,
    Keys,
    Rows,
    members,
    name_of,
    standard_error,
)
from dmptm_ctrl.diagnosis.rig_candidates import structures, trials
from dmptm_ctrl.diagnosis.rig_objections import amplitudes_of, objection
from dmptm_ctrl.diagnosis.rig_shapes import MAX_ORDER, SPOT_BINS
from dmptm_ctrl.diagnosis.rig_state import (
    RigState,
    counted_rows,
    independent,
    whiter,
    with_standing_on,
)
from dmptm_ctrl.diagnosis.rig_tangent import Trial
from dmptm_ctrl.diagnosis.select import NEAR, evidence_per_gain, ranked
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.free_parameters import (
    free_parameters,
    scales_of,
)
from dmptm_ctrl.identify.gap_search import from_elsewhere
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.likelihood import Likelihood
from dmptm_ctrl.identify.measured_motion import Nuisance
from dmptm_ctrl.identify.pushing_teeth import marked
from dmptm_ctrl.identify.rig_fit import (
    RigFit,
    fit_rig,
    invisible_impacts,
    residuals,
    stepped,
    total_loss,
)
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import BACKLASH, PLACED_CATALOGUE

SETTLE = 30  # iterations at most; an unsettled fit would lend its gain to the next effect
FIRST = 6  # iterations of a candidate's fit
STRUCTURES = SHAFT_COMPLIANCE.name, BACKLASH.name


@dataclass(frozen=True, eq=False)
class RigEvidence:
    """Torque balances of the logs of a drive of any shape, or stretches of them.

    `logs` are fitted and `held` are not, as the declared model has them. `read` are the same as
    read, on which a better model shows anew when teeth touch. Nothing depends on `jobs`.
    """

    logs: Balance
    held: Balance
    jobs: int = 2
    read: Sequence[Log] = ()
    # springs and gaps that the last look at them did not ask for
    idle: set[str] = field(default_factory=set, init=False)

    def base(self, start: State) -> RigState:
        """Fit the declared model, from rough values."""
        fit = fit_rig(start, self.logs, jobs=self.jobs, iterations=SETTLE)
        return self._counted(RigState(fit, self.held))

    def refit(self, state: RigState, logs: Balance, held: Balance) -> RigState:
        """Fit a model that was fitted to other logs, or to other rows of them."""
        start, like = state.fit.state, state.fit.likelihood
        near = self._alike(start, state.fit) if logs is state.logs else None
        fit = fit_rig(start, logs, iterations=SETTLE, like=like, near=near, jobs=self.jobs)
        return RigState(fit, held, state.keys)

    def inside(self, state: RigState) -> RigState:
        """Fit again with declared quantities inside their ranges."""
        return self._ranged(state, True)

    def free(self, state: RigState) -> RigState:
        """Fit again with declared quantities free to leave their ranges.

        How surely rows show a quantity is taken from a fit without ranges. In a fit inside them,
        what is missing would make declared values look surer than they are.
        """
        doubtless = replace(state.fit.likelihood, doubt={})
        found = self._ranged(replace(state, fit=replace(state.fit, likelihood=doubtless)), False)
        like = replace(found.fit.likelihood, doubt=found.fit.doubt)
        again = replace(found, fit=replace(found.fit, likelihood=like))
        return self.refit(again, found.logs, found.held)

    def _ranged(self, state: RigState, ranged: bool) -> RigState:
        there = replace(state.fit.state, model=replace(state.fit.model, ranged=ranged))
        fit = replace(state.fit, state=there)
        return self.refit(replace(state, fit=fit), state.logs, state.held)

    def candidates(self, state: RigState, only: Sequence[str] | None = None) -> list[Candidate]:
        """Fit every effect that balances can show beside a model.

        The one that explains most is fitted, and others that are as good to first order. Springs
        and gaps that were not asked for are tried again where nothing else is.
        """
        if only is not None:
            named = [self._fitted(state, (t,), FIRST) for t in trials(state.tangent, only)]
            return [*named, *self._structures(state, only)]
        steps = sorted(state.trials, key=lambda t: -t.gain)
        candidates = [self._fitted(state, (t,), FIRST) for t in steps[:1]]
        if not state.keys:
            self.idle.clear()
        candidates += self._structures(state, left_out={*self.idle})

        def best() -> float:
            return max((c.evidence for c in candidates if c.acceptable), default=0.0)

        # none is chosen that was not fitted, and few could be
        most = evidence_per_gain(self.ratio(state))
        rough: list[Candidate] = []
        for trial in steps[1:]:
            if most * trial.gain < best() - NEAR:
                weaker = self._plain((trial,), state.fit)
                rough.append(replace(weaker, gain=trial.gain, objection=WEAKER))
                continue
            one = self._first_order(state, trial)
            if one.acceptable and one.evidence >= best():
                candidates.append(self._fitted(state, (trial,), FIRST))
            else:
                rough.append(one)
        if best() == 0.0 and self.idle:
            candidates += self._structures(state, only={*self.idle})
        return [*candidates, *ranked(rough)]

    def _structures(
        self, state: RigState, only: Collection[str] | None = None, left_out: Collection[str] = ()
    ) -> list[Candidate]:
        """Fit springs and gaps: from each start a little, the best of each to the end."""
        best: dict[Keys, Candidate] = {}
        for trial in structures(state.tangent, only, left_out):
            one = self._fitted(state, (trial,), FIRST)
            if one.keys not in best or one.evidence > best[one.keys].evidence:
                best[one.keys] = one
        for keys, one in best.items():
            group, fit = one.fitted
            if one.demanded or self._candidate(state, group, whiter(fit)).demanded:
                with suppress(ValueError, ArithmeticError):
                    done = self._to_the_end(fit.state, fit, (*state.keys, *keys))
                    best[keys] = self._candidate(state, group, whiter(done))
        tried = {keys[0]: one for keys, one in best.items()}
        self.idle.difference_update(tried)
        self.idle.update(key for key, one in tried.items() if not one.demanded)
        return list(best.values())

    def _first_order(self, state: RigState, trial: Trial) -> Candidate:
        """Judge a candidate after one step of the model's parameters, by known derivatives."""
        there, fit = trial.placed_in(state.fit.state), state.fit
        gain, most = trial.gain, evidence_per_gain(self.ratio(state))
        if most * gain < LEVEL and trial.columns:
            gain = max(gain, state.tangent.bounded_gain(trial.columns))
        if most * gain < LEVEL:
            return replace(self._plain((trial,), fit), gain=gain)
        try:
            left, drive = residuals(there, state.logs)
        except (ValueError, ArithmeticError):
            return Candidate((trial.key,), -np.inf, 0.0, ((trial,), fit), "cannot be simulated")
        loss = total_loss(there, fit.frees, left, fit.likelihood)
        found = stepped(there, fit.frees, left, fit.derivatives, fit.likelihood, loss)
        there, left, drive, loss = found or (there, left, drive, loss)
        rough = replace(fit, state=there, left=left, drive=drive, loss=loss)
        return self._candidate(state, (trial,), rough, look=False)

    def _fitted(self, state: RigState, group: Sequence[Trial], iterations: int) -> Candidate:
        there, like = state.fit.state, state.fit.likelihood
        for trial in group:
            there = trial.placed_in(there)
        alike = self._alike(there, state.fit)
        try:
            there = self._around(there, state, group)
            fit = fit_rig(
                there, state.logs, iterations=iterations, like=like, near=alike, jobs=self.jobs
            )
            found = self._candidate(state, tuple(group), fit)
            if found.objection and found.demanded and len(group) == 1:  # on the way, perhaps
                like = replace(like, doubt=fit.doubt)
                bare = fit_rig(state.fit.state, state.logs, like=like, jobs=self.jobs)
                fit = fit_rig(fit.state, state.logs, iterations=SETTLE, like=like, jobs=self.jobs)
                found = self._candidate(replace(state, fit=bare), tuple(group), fit)
        except (ValueError, ArithmeticError) as error:
            keys = tuple(t.key for t in group)
            return Candidate(
                keys, 0.0, 0.0, (tuple(group), state.fit), f"cannot be simulated: {error}"
            )
        return found

    def _around(self, there: State, state: RigState, group: Sequence[Trial]) -> State:
        """Fit the rest around gaps that are measured: else the first step leaves their starts."""
        gaps = [t for t in group if name_of(t.key) == BACKLASH.name]
        if not gaps or invisible_impacts(there.model, state.logs):
            return there
        kept = {key for t in gaps for key in (*members(t.key), *t.values)}
        frees = free_parameters(there.model, state.logs, scales_of(state.logs))
        rest = [f for f in frees if f.owner not in kept]
        like = state.fit.likelihood
        return fit_rig(there, state.logs, frees=rest, iterations=FIRST, like=like, jobs=1).state

    def _alike(self, state: State, fit: RigFit) -> RigFit | None:
        """Return a fit if its derivatives are nearly those of a state.

        Not where a gap is simulated, nor where a spring came or went.
        """
        same = state.model.layout.links == fit.model.layout.links
        return fit if same and not fit.likelihood.balance.bends(state.model) else None

    def _candidate(
        self, state: RigState, group: tuple[Trial, ...], fit: RigFit, *, look: bool = True
    ) -> Candidate:
        one = self._plain(group, fit)
        if look:
            found = (objection(key, fit, state.fit) for key in one.keys)
            one = replace(one, objection=next(filter(None, found), ""))
        try:
            there = self.beside(state, one)
            gain, held = self.gains(state, there)
        except (ValueError, ArithmeticError):
            return one
        if not isfinite(gain + held):
            return one
        error, held_error = self.errors(state, there)
        return replace(one, gain=gain, held_gain=held, error=error, held_error=held_error)

    @staticmethod
    def _plain(group: tuple[Trial, ...], fit: RigFit) -> Candidate:
        """Return a candidate before it is tested."""
        keys = tuple(t.key for t in group)
        numbers = sum(map(numbers_of, keys))
        order = sum(list(PLACED_CATALOGUE).index(name_of(k)) for k in keys)
        return Candidate(keys, -np.inf, 0.0, (group, fit), "", numbers, order)

    def beside(self, state: RigState, candidate: Candidate) -> RigState:
        return RigState(candidate.fitted[1], state.held, (*state.keys, *candidate.keys))

    def gains(self, smaller: RigState, larger: RigState) -> tuple[float, float]:
        """Fall of −2 log-likelihood on the fitted and on the held-out logs.

        On the fitted logs less what searches for the best shapes find anyway. A model that turns
        the same motion into less torque must leave less by as much.
        """
        likelihood, more = larger.fit.likelihood, larger.fit.model
        both = likelihood.between(smaller.fit.model, more)
        fitted = total_loss(smaller.fit.state, smaller.fit.frees, smaller.fit.left, both)
        fitted -= total_loss(larger.fit.state, larger.fit.frees, larger.fit.left, both)
        held = likelihood.on(larger.held).between(smaller.fit.model, more)
        fall = held.surprise(smaller.held_left[0], smaller.fit.model)
        fall -= held.surprise(larger.held_left[0], more)
        searched = sum(_searched(key, larger.logs) for key in larger.keys)
        searched -= sum(_searched(key, larger.logs) for key in smaller.keys)
        extra = larger.loudness - smaller.loudness
        if larger.on_inputs != smaller.on_inputs:
            extra += larger.effort - smaller.effort
        louder = 2.0 * float(likelihood.independent.mean()) * extra
        rows, held_rows = counted_rows(larger)
        return fitted - searched + rows * louder, fall + held_rows * louder

    def errors(self, smaller: RigState, larger: RigState) -> tuple[float, float]:
        shares = larger.fit.likelihood.independent

        def of(balance: Balance, few: Sequence[Floats], more: Sequence[Floats]) -> float:
            rows = larger.fit.likelihood.on(balance).row_surprises
            return standard_error(rows(few), rows(more), 1.0 / shares)

        return (
            of(larger.logs, smaller.fit.left, larger.fit.left),
            of(larger.held, smaller.held_left[0], larger.held_left[0]),
        )

    def held_residuals(self, smaller: RigState, larger: RigState) -> tuple[Floats, Floats]:
        held, left = larger.fit.likelihood.on(larger.held), larger.held_left[0]
        weights = held.weights(left)
        return weights * held.stack(smaller.held_left[0]), weights * held.stack(left)

    def ratio(self, state: RigState) -> float:
        fitted, held = counted_rows(state)
        return fitted / max(held, 1)

    def columns(self, state: RigState, candidate: Candidate) -> Floats:
        (trial,) = candidate.fitted[0]
        return state.tangent.project(state.tangent.stack(trial.columns))

    def rows(self, state: RigState, candidates: Sequence[Candidate]) -> Rows:
        tangent = state.tangent
        columns = {c.keys: tangent.stack(c.fitted[0][0].columns) for c in candidates}
        return Rows(tangent.whole, tangent.derivatives, *tangent.room, columns)

    def together(self, state: RigState, candidates: Sequence[Candidate]) -> Candidate:
        return self._fitted(state, [c.fitted[0][0] for c in candidates], 2 * FIRST)

    def adopt(self, state: RigState, candidate: Candidate) -> RigState:
        keys = (*state.keys, *candidate.keys)
        fit = self._to_the_end(candidate.fitted[1].state, state.fit, keys)
        return RigState(fit, state.held, keys, vars(state).get("trials", ()))

    def _to_the_end(self, start: State, like: RigFit, keys: Keys) -> RigFit:
        """Fit to the end; where an added gap lies before hidden bodies, from elsewhere as well."""
        known, near = like.likelihood, self._alike(start, like)
        logs = known.balance
        fit = fit_rig(start, logs, iterations=SETTLE, like=known, near=near, jobs=self.jobs)
        gap = any(name_of(key) == BACKLASH.name for key in keys)
        if gap and invisible_impacts(fit.model, logs):
            return from_elsewhere(fit, iterations=SETTLE, jobs=self.jobs)
        return fit

    def closed(self, state: RigState) -> RigState:
        """Let a model show anew when teeth touch, and on which flank, and fit again."""
        if not self.read:
            return self._counted(state)
        logs, held = (marked(one, state.fit.model, self.read) for one in (state.logs, state.held))
        if logs.teeth != state.logs.teeth:  # noise of another equation
            like = replace(state.fit.likelihood, noise=None)
            state = replace(state, fit=replace(state.fit, likelihood=like))
        if logs is not state.logs:
            state = replace(self.refit(state, logs, held), seen=state.seen)
        return self._counted(state)

    def _counted(self, state: RigState) -> RigState:
        """Count independent rows anew, separate the noise of readings, and fit again."""
        like = Likelihood(state.logs, independent(state), doubt=state.fit.doubt)
        like = like.knowing(state.fit.model, state.fit.left)
        known = replace(state, fit=replace(state.fit, likelihood=like))
        return self.refit(known, state.logs, state.held)

    def without(self, state: RigState, key: str) -> RigState:
        gone = with_standing_on(state.fit, key)
        model = state.fit.model.without(gone)
        logs = {
            log: Nuisance(
                {k: v for k, v in n.zero.items() if k not in gone},
                {k: v for k, v in n.twist.items() if k in model.layout.links},
            )
            for log, n in state.fit.state.logs.items()
        }
        keys = tuple(k for k in state.keys if gone.isdisjoint(members(k)))
        return RigState(self._to_the_end(State(model, logs), state.fit, keys), state.held, keys)

    def wald(self, state: RigState, key: str) -> float:
        """Square of an effect's amplitudes in standard errors; 0 where only a refit shows."""
        if name_of(key) in STRUCTURES:
            return 0.0
        own = amplitudes_of(state.fit, key)
        p = np.array([state.fit.state.get(state.fit.frees[j]) for j in own])
        scale = np.array([state.fit.frees[j].scale for j in own])
        covariance = state.fit.covariance[np.ix_(own, own)] * np.outer(scale, scale)
        return float(p @ np.linalg.pinv(covariance) @ p)

    def objection(self, without: RigState, state: RigState, key: str) -> str:
        return objection(key, state.fit, without.fit)

    def share(self, without: RigState, state: RigState, key: str) -> Floats:
        gone = with_standing_on(state.fit, key)
        bare, _ = residuals(State(state.fit.model.without(gone), state.fit.state.logs), state.logs)
        change = [b - e for b, e in zip(bare, state.fit.left, strict=True)]
        return without.tangent.project(without.tangent.stack(change))


def _searched(key: str, logs: Balance) -> float:
    """Evidence that the best of all starts finds where there is none: 2 log of their number."""
    name = name_of(key)
    starts = {"orders": MAX_ORDER, "places": SPOT_BINS,
              "frequencies": max(int(logs.longest * logs.bandwidth), 1)}  # fmt: skip
    return 2.0 * float(np.log(starts.get(PLACED_CATALOGUE[name].effect.search, 1)))


def numbers_of(key: str) -> int:
    """Numbers of an effect: those that places of one make share, and those of each."""
    entry = PLACED_CATALOGUE[name_of(key)]
    return len(entry.keep) + len(entry.own) * (len(members(key)) - 1)
