"""An effect at a place, and the residual that it is held against."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf, isfinite
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.candidate import JOINED, Keys, Rows
from dmptm_ctrl.diagnosis.select import JointGain
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.measured_motion import Nuisance
from dmptm_ctrl.identify.rig_fit import RigFit, fit_rig, prior_rows, residuals
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

LOOK = 6  # iterations of a fit whose meshes are held
Parts = tuple[Floats, ...]  # (equations, rows, k) per log


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect at a place, and what it changes of the residual.

    Attributes
    ----------
    placed : tuple of Placed
        Its starting values, at one place or at several of one make.
    columns : tuple of (equations, rows, k) arrays
        Change of the residual per amplitude, or by the whole effect.
    zero : dict of log to dict
        Shift of each effect's angle in logs after the first.
    values, twist : mapping
        Declared quantities that change with it, and twists per log.
    gain : float
        Fall of −2 log-likelihood to first order.
    """

    placed: tuple[Placed, ...]
    columns: Parts
    zero: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    values: Mapping[str, float] = field(default_factory=dict)
    twist: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gain: float = 0.0

    @property
    def key(self) -> str:
        """Name and places."""
        return JOINED.join((self.placed[0].key, *(p.on for p in self.placed[1:])))

    def placed_in(self, state: State) -> State:
        """Return a state with the effect in it, at its starting values."""
        model = state.model.with_values(self.values)
        for placed in self.placed:
            model = model.with_effect(placed)
        logs = dict(state.logs)
        for log in {*self.zero, *self.twist}:
            old = logs.get(log, Nuisance())
            logs[log] = Nuisance(
                {**old.zero, **self.zero.get(log, {})}, {**old.twist, **self.twist.get(log, {})}
            )
        return State(model, logs)


@dataclass(frozen=True, eq=False)
class Tangent:
    """Weighted residual of a fit, and what its parameters can change."""

    fit: RigFit
    columns: dict[Any, list[Floats]] = field(default_factory=dict)  # of amplitudes looked at

    @property
    def balance(self) -> Balance:
        """Logs that were fitted."""
        return self.fit.likelihood.balance

    @cached_property
    def beside_declared_meshes(self) -> "Tangent":
        """The same of a fit whose meshes are as declared: errors of teeth bend them."""
        model = self.fit.model
        meshes = tuple(f"link.{k.name}." for k in model.rig.links if k.mesh and not k.rigid)
        known = model.declared(lambda key: key.startswith(meshes))
        state = replace(self.fit.state, model=model.with_values(known))
        rest = [f for f in self.fit.frees if f.label not in known]
        like = self.fit.likelihood
        near = None if self.balance.bends(model) else self.fit
        fit = fit_rig(state, self.balance, frees=rest, iterations=LOOK, like=like, near=near)
        return Tangent(fit)

    @cached_property
    def weights(self) -> Floats:
        """What each row counts; the last ones are the declared ranges."""
        own = self.fit.likelihood.weights(self.fit.left)
        return np.concatenate([own, np.ones(len(self._priors[1]))])

    @cached_property
    def _priors(self) -> tuple[Floats, Floats]:
        return prior_rows(self.fit.state, self.fit.frees, self.fit.likelihood)

    def stack(self, parts: Sequence[Floats]) -> Floats:
        """Weight (equations, rows[, k]) per log and put them into one array, (m[, k])."""
        rows = self.fit.likelihood.stack(parts)
        still = np.zeros((len(self._priors[1]), *rows.shape[1:]))
        return self.weights.reshape(-1, *[1] * (rows.ndim - 1)) * np.concatenate([rows, still])

    @cached_property
    def derivatives(self) -> Floats:
        """Weighted derivatives by the fitted numbers, (m, p)."""
        table = self.stack(self.fit.derivatives)
        if table.shape[1]:
            table[len(table) - len(self._priors[1]) :] = self._priors[0]
        return table

    @cached_property
    def basis(self) -> Floats:
        """Orthonormal basis of what the fitted numbers change, (m, p)."""
        norm = np.linalg.norm(self.derivatives, axis=0)
        push, (low, high) = -self.derivatives.T @ self.whole, self.room
        keep = norm > 1e-12 * norm.max(initial=0.0)
        keep &= ~(((low >= 0.0) & (push < 0.0)) | ((high <= 0.0) & (push > 0.0)))
        if not keep.any():
            return self.derivatives[:, :0]
        u, s, _ = np.linalg.svd(self.derivatives[:, keep] / norm[keep], full_matrices=False)
        return u[:, s > 1e-7 * s.max()]

    @cached_property
    def whole(self) -> Floats:
        """Weighted residual, (m,)."""
        whole = self.stack(self.fit.left)
        whole[len(whole) - len(self._priors[1]) :] = self._priors[1]
        return whole

    @cached_property
    def target(self) -> Floats:
        """Weighted residual, projected, (m,)."""
        return self.project(self.whole)

    def surprise(self, model: RigModel) -> float:
        """−2 log-likelihood of another model on the same rows, infinite where it has none."""
        try:
            left, _ = residuals(replace(self.fit.state, model=model), self.balance)
        except (ValueError, ArithmeticError):
            return inf
        with np.errstate(over="ignore", invalid="ignore"):  # a model that runs away
            found = self.fit.likelihood.surprise(left, model)
        return found if isfinite(found) else inf

    def project(self, columns: Floats) -> Floats:
        """Take out what the fitted numbers could do."""
        return columns - self.basis @ (self.basis.T @ columns)

    def shift(self, change: Floats) -> Floats:
        """Change of the fitted numbers that does most against a weighted change, (p,)."""
        norm = np.linalg.norm(self.derivatives, axis=0)
        norm[norm <= 1e-12 * norm.max(initial=0.0)] = np.inf
        return -np.linalg.lstsq(self.derivatives / norm, change, rcond=1e-7)[0] / norm

    @cached_property
    def room(self) -> tuple[Floats, Floats]:
        """How far the fitted numbers may still move, down and up, in scales."""
        return self.fit.state.room(self.fit.frees)

    def bounded_gain(self, parts: Sequence[Floats]) -> float:
        """Fall of −2 log-likelihood to first order, the fitted numbers in their ranges."""
        columns: dict[Keys, Floats] = {(): self.stack(parts)}
        return JointGain(Rows(self.whole, self.derivatives, *self.room, columns)).bounded(((),))

    def score(self, parts: Sequence[Floats]) -> tuple[float, Floats]:
        """Return the fall of −2 log-likelihood to first order, and the amplitudes."""
        table = self.stack(parts)
        size = np.linalg.norm(table, axis=0)
        free = self.project(table)
        square = free.T @ free
        norm = np.sqrt(np.diag(square))
        good = norm > 1e-6 * np.maximum(size, 1e-300)
        amplitudes = np.zeros(table.shape[1])
        if not good.any():
            return 0.0, amplitudes
        own = norm[good]
        values, vectors = np.linalg.eigh(square[np.ix_(good, good)] / np.outer(own, own))
        keep = values > 1e-8 * values[-1]
        root = np.sqrt(values[keep])
        along = vectors[:, keep].T @ ((self.target @ free)[good] / own) / root
        amplitudes[good] = -(vectors[:, keep] @ (along / root)) / own
        return float(along @ along), amplitudes
