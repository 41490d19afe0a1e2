"""A model fitted to balances of a drive of any shape, and how much it leaves."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dmptm_ctrl.diagnosis.budget import NONE, near
from dmptm_ctrl.diagnosis.candidate import members, name_of
from dmptm_ctrl.diagnosis.impedance import effort, loudness
from dmptm_ctrl.diagnosis.rig_candidates import trials
from dmptm_ctrl.diagnosis.rig_curves import columns_of, mean_square, torques_of, variables_of
from dmptm_ctrl.diagnosis.rig_held import held_state
from dmptm_ctrl.diagnosis.rig_tangent import Tangent, Trial
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.compared_signals import correlation_length
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.likelihood import Likelihood
from dmptm_ctrl.identify.rig_fit import RigFit, residuals
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.model import Floats


@dataclass(frozen=True, eq=False)
class RigState:
    """A model fitted to balances of a drive of any shape.

    Attributes
    ----------
    fit : RigFit
    held : Balance
        Logs or stretches on which nothing is fitted but what belongs to a log alone.
    keys : tuple of str
        Effects that were added.
    seen : sequence of Trial
        What was tried beside the model before the last was added.
    """

    fit: RigFit
    held: Balance
    keys: tuple[str, ...] = ()
    seen: Sequence[Trial] = ()

    @property
    def logs(self) -> Balance:
        """Logs or stretches that it is fitted to."""
        return self.fit.likelihood.balance

    @cached_property
    def loudness(self) -> float:
        """Logarithm of the torque that the model makes of a motion, over a rigid one's."""
        return loudness(self.fit.model, self.logs)

    @cached_property
    def effort(self) -> float:
        """Logarithm of the torque that all bodies take per acceleration, before the amplifiers."""
        return effort(self.fit.model, self.logs)

    @property
    def on_inputs(self) -> set[str]:
        """Effects on inputs, which may stand for inertia."""
        return {e.key for e in self.fit.model.effects if e.on in self.fit.model.layout.inputs}

    @cached_property
    def held_state(self) -> State:
        """The model with the encoder zeros and twists of the held-out logs."""
        return held_state(self.fit, self.held)

    @cached_property
    def held_left(self) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
        """Residual and drive on the held-out logs."""
        return residuals(self.held_state, self.held)

    @cached_property
    def tangent(self) -> Tangent:
        """What is left, with what the model's parameters could explain projected out."""
        return Tangent(self.fit)

    @property
    def target(self) -> Floats:
        """Weighted residual, projected, (m,)."""
        return self.tangent.target

    @cached_property
    def trials(self) -> list[Trial]:
        """Every effect at every place, with starting values."""
        return trials(self.tangent)


def counted_rows(state: RigState) -> tuple[int, int]:
    """Rows of the fitted and of the held-out logs that count."""
    fitted, held = (sum(int(m.moving.sum()) for m in b.motions) for b in (state.logs, state.held))
    return fitted, held


def within_floor(selection: Selection, floor: float) -> bool:
    """Whether the declared model is near what all effects leave, in every equation, held out.

    And near the floor: mean square of the first equation that no model predicts.
    """
    base, final = selection.base, selection.final
    if not near(mean_square(base.held_left[0], base.held), floor):
        return False
    held = final.fit.likelihood.on(final.held)
    before, after = (held.sizes(one.held_left[0]) for one in (base, final))
    return bool(np.all(before <= NONE * np.hypot(after, held.floor)))


def of_teeth(final: RigState) -> Callable[[Sequence[Floats]], float]:
    """Return what toothed links add to the mean square of the first equation, held out.

    Each equation counts in units of its scale under the final model.
    """
    likelihood = final.fit.likelihood.on(final.held)
    scales, rows = pooled(likelihood, final.held_left[0]), likelihood.rows.sum(axis=1)

    def more(left: Sequence[Floats]) -> float:
        ratio = likelihood.sizes(left) / scales
        of = (rows[k] / rows[0] * ratio[k] ** 2 for k in final.held.teeth.values())
        return float(scales[0] ** 2 * sum(of))

    return more


def pooled(likelihood: Likelihood, left: Sequence[Floats]) -> Floats:
    """Scale of each equation in all logs together, (equations,)."""
    return np.hypot(likelihood.sizes(left), likelihood.floor)


def beside_torques(balanced: RigState, state: RigState) -> RigState:
    """Return a state that more than the balance was fitted to, with what the balance alone gave."""
    if state is balanced:
        return state
    return replace(state, fit=replace(state.fit, by_torque=balanced.fit.values))


def rise(without: RigState, final: RigState) -> float:
    """What is left of all balances rises by without an effect, over what is left beyond noise.

    Noise has nothing in common with the next row but one; neighbouring rows overlap.
    """
    more = still = 0.0
    likelihood, held = final.fit.likelihood, final.fit.likelihood.on(final.held)
    for side, was, now in (
        (likelihood, without.fit.left, final.fit.left),
        (held, without.held_left[0], final.held_left[0]),
    ):
        weights = side.weights(now)
        before, after = weights * side.stack(was), weights * side.stack(now)
        more += float(before @ before - after @ after)
        equations = np.split(after, np.cumsum(side.rows.sum(axis=1))[:-1])
        still += sum(float(x[2:] @ x[:-2]) for x in equations)
    return more / max(still, 1e-300)


def independent(state: RigState) -> Floats:
    """Share of the rows of each equation that is independent.

    From the correlation of what neither the parameters, nor any effect, nor any curve explains:
    what is missing correlates too, and would hide itself.
    """
    tangent, likelihood = state.tangent, state.fit.likelihood
    table = [tangent.derivatives, *(tangent.stack(t.columns) for t in state.seen or state.trials)]
    for signal in variables_of(state.fit).values():
        for _, torque in torques_of(state.fit, signal):
            own = columns_of(state.fit.left[0].shape[0], likelihood.balance, torque)
            table.append(tangent.stack(own))
    columns = np.hstack(table)
    size = np.linalg.norm(columns, axis=0)
    good = np.isfinite(size) & (size > 0)
    scaled = columns[:, good] / size[good]
    square = scaled.T @ scaled + 1e-6 * np.eye(int(good.sum()))
    rest = tangent.target - scaled @ np.linalg.solve(square, scaled.T @ tangent.target)
    found, start = [], 0
    for part in likelihood.parts(state.fit.left):
        own = rest[start : start + len(part)]
        start += len(part)
        found.append(1.0 / correlation_length(own) if own.size > 2 else 1.0)
    return np.array(found)


def whiter(fit: RigFit) -> RigFit:
    """Count rows by their correlation in a fit where that is less than without its last effect.

    A twist that wanders in a gap correlates as long as the gap is not in the model.
    """
    like = fit.likelihood
    own = [1.0 / correlation_length(p) if p.size > 2 else 1.0 for p in like.parts(fit.left)]
    return replace(fit, likelihood=replace(like, independent=np.maximum(like.independent, own)))


def with_standing_on(fit: RigFit, key: str) -> set[str]:
    """Keys of an effect at each of its places, and of those on a body or link that it makes."""
    if name_of(key) != SHAFT_COMPLIANCE.name:
        return {*members(key)}
    rig, layout = fit.model.rig, fit.model.layout
    own = {b.name for b in rig.bodies} | {k.name for k in rig.links if not k.rigid}
    made = (set(layout.bodies) | set(layout.links)) - own
    return {*members(key), *(e.key for e in fit.model.effects if e.on in made)}
