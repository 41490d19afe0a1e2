"""Fit a rig's parameters to the balance of torques, by Gauss–Newton with bounds.

What is lowered is −2 log-likelihood: each equation normal at its own scale, every row counted
as the share of it that is independent; and Σ ((p − p0)/σ)² over declared ranges.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from dmptm_ctrl.identify.by_torque import Rubbing, friction_alone, torques_decide
from dmptm_ctrl.identify.fit import least_in_box, secant
from dmptm_ctrl.identify.free_parameters import ALL, Free, free_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import Balance, residual
from dmptm_ctrl.identify.likelihood import TOLERANCE, Likelihood
from dmptm_ctrl.identify.reading_noise import noise_in_balance
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.parallel import in_threads, small_matrices
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import RigModel

ROWS_PER_INDEPENDENT = 8.0  # rows that count as one, where nothing better is known
MOST_NOISE = 0.95  # of the curvature in any direction is taken for noise in one step
SINGULAR = 1e-12  # of its curvature; numbers that share one effect have none apart
DIFFERENCE = 1e-4  # step of the finite differences, in scales
PAST_IMPACTS = 0.05  # the same where impacts that nothing shows decide a run


@dataclass(frozen=True, eq=False)
class RigFit:
    """A fitted rig.

    Attributes
    ----------
    left : tuple of (equations, rows) arrays
        Residual per log.
    drive : tuple of (rows,) arrays
        Driving torque per log.
    derivatives : tuple of (equations, rows, free numbers) arrays
        Derivatives of the residual per log, per scale of each number.
    loss : float
        −2 log-likelihood, and the declared ranges.
    by_torque : mapping of label to float
        What the balance alone gives, where more than it was fitted.
    """

    state: State
    frees: tuple[Free, ...]
    left: tuple[Floats, ...]
    drive: tuple[Floats, ...]
    derivatives: tuple[Floats, ...]
    likelihood: Likelihood
    loss: float
    by_torque: Mapping[str, float] = field(default_factory=dict)

    @property
    def model(self) -> RigModel:
        """The fitted model."""
        return self.state.model

    @cached_property
    def _spread(self) -> tuple[Floats, Floats]:
        """Inverse of the curvature A, and covariance by the scatter of the score, in scales.

        The latter is robust against residuals that correlate, or come in bursts:
        A⁻¹ (Σ_blocks s sᵀ) A⁻¹, with s the score of a block. Where it is less than A⁻¹, that holds.
        """
        if not self.frees:
            return np.zeros((0, 0)), np.zeros((0, 0))
        likelihood = self.likelihood
        weights = likelihood.weights(self.left)
        rows = likelihood.stack(self.derivatives) * weights[:, None]
        extra = prior_rows(self.state, self.frees, likelihood)[0]
        whole = rows.T @ rows + extra.T @ extra + 1e-300 * np.eye(len(self.frees))
        clear, _ = noise_taken_out(
            self.state, self.frees, likelihood, likelihood.scales(self.left), whole, np.diag(whole)
        )
        size = np.sqrt(np.maximum(np.diag(whole), 1e-300))
        unit = np.linalg.pinv(clear / np.outer(size, size), rcond=1e-12)
        inverse = np.asarray(unit / np.outer(size, size), np.float64)
        products = rows * (weights * likelihood.stack(self.left))[:, None]
        ids = likelihood.blocks
        sums = np.array([np.bincount(ids, p) for p in products.T])
        # all together they are what the noise of readings and the declared ranges balance
        sums -= sums.mean(axis=-1, keepdims=True)
        sure = [likelihood.doubt.get(f.label, 1.0) for f in self.frees]
        ranges = (extra.T @ extra) * np.square(sure)
        return inverse, inverse @ (sums @ sums.T + ranges) @ inverse

    @cached_property
    def covariance(self) -> Floats:
        """Covariance of the fitted numbers, in their scales."""
        inverse, _ = self._spread
        return inverse * np.outer(self._doubt, self._doubt)

    @cached_property
    def _doubt(self) -> Floats:
        """How many times less surely each number is determined than its curvature says."""
        inverse, spread = (np.diag(m) for m in self._spread)
        return np.sqrt(np.maximum(spread / np.maximum(inverse, 1e-300), 1.0))

    @property
    def doubt(self) -> dict[str, float]:
        """The same by label, of the numbers that have a declared range."""
        pairs = zip(self.frees, self._doubt, strict=True)
        return {f.label: float(d) for f, d in pairs if f.prior is not None}

    @property
    def errors(self) -> dict[str, float]:
        """Standard errors of the fitted numbers by label."""
        se = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return {f.label: float(s * f.scale) for f, s in zip(self.frees, se, strict=True)}

    @property
    def values(self) -> dict[str, float]:
        """Fitted numbers by label."""
        return {f.label: self.state.get(f) for f in self.frees}

    @property
    def off_balance(self) -> dict[str, float]:
        """How far each number of the drive and its effects is from what the balance alone gives."""
        own = {f.label: f for f in self.frees if f.kind in ("value", "effect")}
        return {k: abs(self.state.get(own[k]) - v) for k, v in self.by_torque.items() if k in own}


class Beside(NamedTuple):
    """Weighted rows that count beside a balance, and what a state makes of them.

    Attributes
    ----------
    derivatives, left : (m, numbers) and (m,) arrays
    surprise : callable
        −2 log-likelihood of a state; infinite where it has none.
    """

    derivatives: Floats
    left: Floats
    surprise: Callable[[State], float]


def residuals(state: State, balance: Balance) -> tuple[tuple[Floats, ...], tuple[Floats, ...]]:
    """Return the residual and the driving torque per log, rows at rest set to zero."""
    done = [_one(state, balance, k) for k in range(len(balance.motions))]
    return tuple(d[0] for d in done), tuple(d[1] for d in done)


def _one(state: State, balance: Balance, k: int) -> tuple[Floats, Floats]:
    motion = balance.motions[k]
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # trials that run away
        left, drive = residual(state.model, balance, motion, state.nuisance(motion.name))
        return left * balance.counted[k], drive * motion.moving


def jacobian(
    state: State,
    balance: Balance,
    frees: Sequence[Free],
    left: Sequence[Floats],
    *,
    jobs: int = 2,
    fine: bool = False,
) -> tuple[Floats, ...]:
    """Return the derivatives of the residual per log, per scale of each number.

    With `fine` those nearby, even where impacts that nothing shows decide a run.
    """
    columns = [np.zeros((*part.shape, len(frees))) for part in left]
    rough = not fine and invisible_impacts(state.model, balance)
    rubbing = list[Rubbing]()
    others = any(free.kind in ("value", "effect") for free in frees)
    if others and torques_decide(state.model, balance):
        for m in balance.motions:
            rubbing.append(Rubbing.of(state.model, balance, m, state.nuisance(m.name)))

    def column(j: int) -> None:
        free = frees[j]
        here = state.get(free)
        step = _step(free, rough)
        if here + step > free.high:
            step = -step
        there = state.moved([free], [here + step])
        torques = free.kind in ("value", "effect") and rubbing
        groups = friction_alone(state.model, there.model) if torques else None
        for k, motion in enumerate(balance.motions):
            if groups is not None:
                change = rubbing[k].changed(there.model, there.nuisance(motion.name), groups)
                columns[k][:, :, j] = balance.counted[k] * change / (step / free.scale)
                continue
            if free.kind in ("zero", "twist") and free.owner not in (ALL, motion.name):
                continue
            try:
                moved, _ = _one(there, balance, k)
            except ArithmeticError:  # on the edge of what can be; the other side is inside
                moved, _ = _one(state.moved([free], [here - step]), balance, k)
                moved = 2.0 * left[k] - moved
            columns[k][:, :, j] = (moved - left[k]) / (step / free.scale)

    in_threads(column, range(len(frees)), jobs)
    return tuple(columns)


def _step(free: Free, rough: bool) -> float:
    return (PAST_IMPACTS if rough else _kink(free) or DIFFERENCE) * free.scale


def invisible_impacts(model: RigModel, balance: Balance) -> bool:
    """Whether bodies that nothing measures move behind a gap.

    When teeth meet depends on all that came before. Derivatives nearby are then chance.
    """
    layout, plant = model.layout, model.plant()
    seen = {*balance.seen(layout)}
    ends = plant.body_coordinate[plant.link_body[plant.link_gap > 0]]
    return not {*ends.ravel().tolist()} <= seen


@small_matrices
def fit_rig(
    state: State,
    balance: Balance,
    *,
    frees: Sequence[Free] | None = None,
    iterations: int = 6,
    like: Likelihood | None = None,
    near: RigFit | None = None,
    jobs: int = 2,
) -> RigFit:
    """Fit by Gauss–Newton.

    Without links, steps continue with derivatives that follow from how the residual moved (Broyden,
    Math. Comp. 19 (1965) 577). Differences are taken anew where these gain no more, and at the end.

    Parameters
    ----------
    state : State
        Where to start; every quantity has a value.
    frees : sequence of Free, optional
        By default all of `free_parameters`.
    iterations : int
        At most.
    like : Likelihood, optional
        How much rows say, as another fit found.
    near : RigFit, optional
        Of a model without some effects: the derivatives of what both have are nearly its own.
    """
    scales = scales_of(balance)
    if frees is None:
        frees = free_parameters(state.model, balance, scales)
    frees = tuple(frees)
    if any(not f.low <= state.get(f) <= f.high for f in frees):
        state = state.moved(frees, state.after(frees, np.zeros(len(frees))))
    left, drive = residuals(state, balance)
    count = left[0].shape[0]
    if like is None:
        like = Likelihood(balance, np.full(count, 1.0 / ROWS_PER_INDEPENDENT))
    likelihood = like.on(balance)
    derivatives = derivatives_near(state, balance, frees, left, near, jobs)
    fresh = near is None or not near.frees  # differences taken where the state is
    # where derivatives are rough, those of wide and of narrow differences find different steps
    rough = invisible_impacts(state.model, balance)
    vain, fine = 0, rough
    bends = balance.bends(state.model)  # too much for secants
    for _ in range(iterations if frees else 0):
        likelihood = likelihood.between(state.model)
        loss = total_loss(state, frees, left, likelihood)
        better = stepped(state, frees, left, derivatives, likelihood, loss)
        gain, was_fresh = 0.0, fresh
        if better is not None:
            gain, fresh = loss - better[3], False
            step = np.array([(better[0].get(f) - state.get(f)) / f.scale for f in frees])
            rows = zip(derivatives, left, better[1], strict=True)
            derivatives = tuple(secant(p, new - old, step) for p, old, new in rows)
            state, left, drive, _ = better
            frees, derivatives = _rescaled(frees, derivatives, state)
        vain = vain + 1 if gain < TOLERANCE and was_fresh else 0
        if vain > rough:
            break
        fine ^= vain > 0
        if gain < TOLERANCE or bends:
            derivatives, fresh = jacobian(state, balance, frees, left, jobs=jobs, fine=fine), True
    if rough:  # nearby derivatives would determine numbers far more surely than runs do
        derivatives = jacobian(state, balance, frees, left, jobs=jobs)
    elif not fresh:
        derivatives = derivatives_near(state, balance, frees, left, near, jobs)
    likelihood = likelihood.between(state.model)
    loss = total_loss(state, frees, left, likelihood)
    return RigFit(state, frees, left, drive, derivatives, likelihood, loss)


def stepped(
    state: State,
    frees: Sequence[Free],
    left: Sequence[Floats],
    derivatives: Sequence[Floats],
    likelihood: Likelihood,
    loss: float,
    beside: Beside | None = None,
) -> tuple[State, tuple[Floats, ...], tuple[Floats, ...], float] | None:
    """Return state, residual, drive and loss after a step that lowers the loss; else None.

    Where a whole step fails, numbers with kinks (a gap, a dead time) are left out of it.
    """
    smooth = [not _kink(f) for f in frees]
    for used in ([True] * len(frees), smooth):
        if used is smooth and (all(smooth) or not any(smooth)):
            continue
        own = [f for f, u in zip(frees, used, strict=True) if u]
        more = beside and (beside.derivatives[:, used], beside.left)
        step = _step_of(state, own, left, [p[..., used] for p in derivatives], likelihood, more)
        for shrink in (1.0, 0.3, 0.1, 0.03):
            trial = state.moved(own, state.after(own, step, shrink))
            try:
                new_left, new_drive = residuals(trial, likelihood.balance)
            except (ValueError, ArithmeticError):
                continue
            new_loss = total_loss(trial, frees, new_left, likelihood)
            new_loss += beside.surprise(trial) if beside else 0.0
            if isfinite(new_loss) and new_loss < loss:
                return trial, new_left, new_drive, new_loss
    return None


def _kink(free: Free) -> float:
    """Difference step that passes kinks, in scales; 0 where there are none."""
    if free.kind != "effect":
        return 0.0
    return PLACED_CATALOGUE[free.owner.partition("@")[0]].effect.kink


def derivatives_near(
    state: State,
    balance: Balance,
    frees: Sequence[Free],
    left: Sequence[Floats],
    near: RigFit | None,
    jobs: int,
) -> tuple[Floats, ...]:
    """Return the derivatives of a model: those of a fit nearby where it has the same number."""
    known = {} if near is None else {f.label: k for k, f in enumerate(near.frees)}
    new = [j for j, f in enumerate(frees) if f.label not in known]
    own = jacobian(state, balance, [frees[j] for j in new], left, jobs=jobs, fine=True)
    if near is None:
        return own
    derivatives = [np.empty((*part.shape, len(frees))) for part in left]
    for k, part in enumerate(derivatives):
        part[..., new] = own[k]
        for j, free in enumerate(frees):
            if free.label in known:
                other = known[free.label]
                part[..., j] = near.derivatives[k][..., other] * (
                    free.scale / near.frees[other].scale
                )
    return tuple(derivatives)


def _rescaled(
    frees: Sequence[Free], derivatives: Sequence[Floats], state: State
) -> tuple[tuple[Free, ...], tuple[Floats, ...]]:
    """Keep the difference steps in proportion to the values, and derivatives per scale."""
    scales = [
        (max(abs(state.get(f)), f.least) or f.scale) if f.kind == "value" else f.scale
        for f in frees
    ]
    ratio = np.array([new / f.scale for f, new in zip(frees, scales, strict=True)])
    after = tuple(replace(f, scale=new) for f, new in zip(frees, scales, strict=True))
    return after, tuple(part * ratio for part in derivatives)


def total_loss(
    state: State, frees: Sequence[Free], left: Sequence[Floats], likelihood: Likelihood
) -> float:
    """−2 log-likelihood, the declared ranges, and the price of the numbers of effects."""
    price = likelihood.price * sum(f.kind == "effect" for f in frees)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable trial is a costly one
        return (
            price
            + likelihood.surprise(left, state.model)
            + float(np.sum(prior_rows(state, frees, likelihood)[1] ** 2))
        )


def prior_rows(
    state: State, frees: Sequence[Free], likelihood: Likelihood
) -> tuple[Floats, Floats]:
    """Rows of the declared ranges in a least-squares step, (k, frees), and their misfit, (k,)."""
    known = [(j, f) for j, f in enumerate(frees) if f.prior is not None and f.prior[1] > 0]
    rows, miss = np.zeros((len(known), len(frees))), np.zeros(len(known))
    for k, (j, free) in enumerate(known):
        assert free.prior is not None
        sigma = free.prior[1] / likelihood.doubt.get(free.label, 1.0)
        rows[k, j] = free.scale / sigma
        miss[k] = (state.get(free) - free.prior[0]) / sigma
    return rows, miss


def _step_of(
    state: State,
    frees: Sequence[Free],
    left: Sequence[Floats],
    derivatives: Sequence[Floats],
    likelihood: Likelihood,
    more: tuple[Floats, Floats] | None = None,
) -> Floats:
    """Bounded least-squares step, in scales."""
    weights = likelihood.weights(left)
    rows = weights[:, None] * likelihood.stack(derivatives)
    target = weights * likelihood.stack(left)
    extra, miss = prior_rows(state, frees, likelihood)
    # A little of Levenberg's damping decides directions that the logs do not show.
    size = np.sqrt(np.mean(np.sum(rows**2, axis=0))) if rows.size else 1.0
    # Normal equations: numbers are scaled, and their condition is well below 1e8.
    square = rows.T @ rows + extra.T @ extra + (1e-6 * size) ** 2 * np.eye(len(frees))
    slope, scales = -rows.T @ target - extra.T @ miss, likelihood.scales(left)
    if more:
        square, slope = square + more[0].T @ more[0], slope - more[0].T @ more[1]
    clear = noise_taken_out(state, frees, likelihood, scales, square, slope)
    return least_in_box(*clear, *state.room(frees))


def noise_taken_out(
    state: State,
    frees: Sequence[Free],
    likelihood: Likelihood,
    scales: Floats,
    square: Floats,
    slope: Floats,
) -> tuple[Floats, Floats]:
    """Take what the noise of readings adds to normal equations out of them."""
    if likelihood.noise is None or not frees:
        return square, slope
    own, slope = np.zeros_like(square), slope.copy()
    here = noise_in_balance(state.model, likelihood.balance)
    moved, rough = [], invisible_impacts(state.model, likelihood.balance)
    for free in frees:
        if free.kind in ("zero", "twist"):
            moved.append([np.zeros_like(f) for f in here])
            continue
        step = _step(free, rough)
        there = state.moved([free], [state.get(free) + step]).model
        change = zip(noise_in_balance(there, likelihood.balance), here, strict=True)
        moved.append([(new - old) / (step / free.scale) for new, old in change])
    for e, noise in enumerate(here):
        weight = float(np.sum(likelihood.counts[e] / scales[e] ** 2))
        columns = np.array([m[e] for m in moved])
        own += weight * columns @ columns.T
        slope += weight * columns @ noise
    # where logs show little but noise, what is left of the curvature must stay positive
    size = np.sqrt(np.maximum(np.diag(square), 1e-300))
    unit = np.outer(size, size)
    ridge = SINGULAR * np.eye(len(frees))
    largest = float(eigh(own / unit, square / unit + ridge, eigvals_only=True)[-1])
    return square - min(1.0, MOST_NOISE / max(largest, 1e-300)) * own, slope
