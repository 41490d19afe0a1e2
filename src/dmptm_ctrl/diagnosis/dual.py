"""Evidence from the torque balance of the dual-motor drive, for the selection of effects."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.residual import Residual, residual
from dmptm_ctrl.diagnosis.select import Candidate, Floats
from dmptm_ctrl.diagnosis.trace import Trace, Trial, effect_columns, trace, unknowns_of
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import BalanceFit, fit_balance, settled_fit

Keys = tuple[str, ...]


def key_of(name: str) -> str:
    """Return ``name@place`` of an effect of the dual-motor drive."""
    return f"{name}@{CATALOGUE[name].location}"


def name_of(key: str) -> str:
    """Return the name in a key."""
    return key.partition("@")[0]


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

    @property
    def loss(self) -> float:
        """−2 log-likelihood of the fitted logs."""
        return self.left.base.loss

    @property
    def held_loss(self) -> float:
        """−2 log-likelihood of the held-out logs."""
        return self.left.held_base

    @cached_property
    def trace(self) -> Trace:
        """What is left, with what the model's parameters could explain projected out."""
        return Trace(self.left)

    @property
    def target(self) -> Floats:
        """Weighted residual, projected, (m,)."""
        return self.trace.target


@dataclass(frozen=True, eq=False)
class DualEvidence:
    """Torque balances of the logs of one dual-motor drive.

    Parameters
    ----------
    measured : Measured
    skip : sequence of str
        Effects that the sensors have settled already.
    jobs : int
        Threads; nothing depends on it.
    """

    measured: Measured
    skip: Sequence[str] = ()
    jobs: int = 2

    def candidates(self, state: DualState, only: Sequence[str] | None = None) -> list[Candidate]:
        """Fit every effect that balances can show beside a model."""
        names = None if only is None else [name_of(key) for key in only]
        trials = trace(state.left, self.skip, names)
        return [self._candidate((t,), t.gain, t.held_gain) for t in trials]

    def _candidate(self, trials: tuple[Trial, ...], gain: float, held: float) -> Candidate:
        keys = tuple(key_of(t.name) for t in trials)
        return Candidate(keys, gain, held, trials, next(filter(None, map(objection, trials)), ""))

    def columns(self, state: DualState, candidate: Candidate) -> Floats:
        """Weighted change of the residual per amplitude, projected, (m, k)."""
        (trial,) = candidate.fitted
        effect = CATALOGUE[trial.name]
        values = trial.fit.model.effects[trial.name]
        shapes = {k: values[k] for k in effect.shapes if k in values}
        return state.trace.project(effect_columns(state.trace, effect, shapes))

    def together(self, state: DualState, candidates: Sequence[Candidate]) -> Candidate:
        """Fit several effects beside a model."""
        model, unknowns = state.left.base.model, state.left.base.unknowns
        names = [c.fitted[0].name for c in candidates]
        for c in candidates:
            (trial,) = c.fitted
            model = model.with_effect(trial.name, **trial.fit.model.effects[trial.name])
            unknowns = (*unknowns, *unknowns_of(trial.name))
        fit = fit_balance(state.left.balance, model, unknowns)
        gain = state.loss - fit.loss
        held = state.held_loss - state.left.held_loss(fit.model)
        return self._candidate(tuple(Trial(n, gain, held, fit) for n in names), gain, held)

    def adopt(self, state: DualState, candidate: Candidate) -> DualState:
        """Put a candidate into the model and fit to the end, on the same windows."""
        fit = candidate.fitted[0].fit
        done = settled_fit(state.left.balance, fit.model, fit.unknowns)
        return DualState(replace(state.left, base=done), (*state.keys, *candidate.keys))

    def closed(self, state: DualState) -> DualState:
        """Let the model decide anew which pinions touch where no encoder shows it."""
        if not state.left.balance.simulated:
            return state
        base = state.left.base
        left = residual(self.measured, base.model, unknowns=base.unknowns, jobs=self.jobs)
        return DualState(left, state.keys)

    def without(self, state: DualState, key: str) -> DualState:
        """Take an effect out and fit the rest again, on the same windows."""
        name, base = name_of(key), state.left.base
        unknowns = tuple(k for k in base.unknowns if k.effect != name)
        fit = settled_fit(state.left.balance, base.model.without([name]), unknowns)
        left = replace(state.left, base=fit)
        return DualState(left, tuple(k for k in state.keys if k != key))


    def wald(self, state: DualState, key: str) -> float:
        """Square of an effect's amplitudes in standard errors."""
        base = state.left.base
        own = own_places(base, name_of(key))
        p, covariance = base.p[own], base.covariance[np.ix_(own, own)]
        return float(p @ np.linalg.pinv(covariance) @ p)

    def share(self, without: DualState, state: DualState, key: str) -> Floats:
        """What an effect changes of the residual, weighted, the others projected out."""
        base = state.left.base
        own = own_places(base, name_of(key))
        changed = without.left.base.weights * (base.jacobian[:, own] @ base.p[own])
        return without.trace.project(changed)


def own_places(fit: BalanceFit, name: str) -> list[int]:
    """Places of an effect's amplitudes among the unknowns."""
    amplitudes = CATALOGUE[name].amplitudes
    return [
        j for j, k in enumerate(fit.unknowns) if k.effect == name and k.name in amplitudes
    ]


def objection(trial: Trial) -> str:
    """Why the fitted values of an effect are impossible; empty where they are not."""
    amplitudes = CATALOGUE[trial.name].amplitudes
    errors = np.sqrt(np.diag(trial.fit.covariance))
    firm = False
    for k, x, se in zip(trial.fit.unknowns, trial.fit.p, errors, strict=True):
        if k.effect != trial.name or k.name not in amplitudes:
            continue
        if x != 0.0 and x in (k.low, k.high):
            return f"{k.name} would lie beyond what is possible"
        firm = firm or abs(x) > SURE * se
    return "" if firm else "no amplitude differs from zero by three standard errors"


SURE = 3.0  # standard errors
