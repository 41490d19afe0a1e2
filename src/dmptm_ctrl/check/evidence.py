"""What new logs say about a model, as linear algebra: the one place that knows the balances.

A balance's residual is whitened, so that its rows are independent and of unit variance, and
has derivatives by each parameter of the model.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import orth

from dmptm_ctrl.check.ringing import at_rows, ringing, without
from dmptm_ctrl.diagnosis.measure import MIN_SAMPLES
from dmptm_ctrl.diagnosis.residual import balances
from dmptm_ctrl.diagnosis.rig_curves import mean_square
from dmptm_ctrl.diagnosis.sensors import put_right
from dmptm_ctrl.effects import CATALOGUE, TABLES
from dmptm_ctrl.identify.balance import columns as dual_columns
from dmptm_ctrl.identify.balance import role_of, split, weights
from dmptm_ctrl.identify.fit import Unknown, drive_unknowns, effect_unknowns
from dmptm_ctrl.identify.free_parameters import Free, free_parameters, log_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import Balance, balance_of
from dmptm_ctrl.identify.likelihood import Likelihood, size_of, weights_of
from dmptm_ctrl.identify.pushing_teeth import in_contact
from dmptm_ctrl.identify.records import Record, record, started
from dmptm_ctrl.identify.rig_fit import (
    ROWS_PER_INDEPENDENT,
    fit_rig,
    jacobian,
    noise_taken_out,
    residuals,
)
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.simulate.any_model import AnyModel
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import RigModel


@dataclass(frozen=True)
class Parameter:
    """One number of a model, SI."""

    key: str  # of the drive its own name, of an effect effect.parameter
    unit: str
    value: float
    scale: float  # unit of the derivatives
    prior: float  # standard deviation declared, in scales; infinite for nothing
    own: bool = True  # is the machine's, and these logs show it; else it is free in the balance

    @property
    def effect(self) -> str:
        """Effect that it belongs to; empty for the drive."""
        return self.key.rpartition(".")[0] if "@" in self.key or self.key in _OF_EFFECTS else ""


_OF_EFFECTS = frozenset(f"{e.name}.{p.name}" for e in CATALOGUE.values() for p in e.parameters)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Whitened residual of new logs."""

    left: Floats  # (m,)
    derivatives: Floats  # (m, k), per scale of each parameter
    parameters: tuple[Parameter, ...]
    stretch: NDArray[np.int64]  # (m,): rows of one second, log and equation may be wrong alike
    torque_rms: float  # of the whole drive's balance while it moves, robust against bursts
    unit: str
    # what the noise of readings adds to JᵀJ and Jᵀe, J the derivatives and e what is left
    noise: tuple[Floats, Floats] | None = None


def evidence_of(
    model: AnyModel, logs: Iterable[Log], jobs: int = 1, *, bandwidth: float | None = None
) -> Evidence:
    """Return what logs say about a model; LogError where too short or without motion.

    The balance of a rig is compared below `bandwidth` [Hz], or what the logs allow if that is less.
    """
    logs = tuple(logs)
    for log in logs:
        if len(log) < MIN_SAMPLES:
            raise LogError(f"{log.name}: {len(log)} samples; a check needs at least {MIN_SAMPLES}")
    if isinstance(model, RigModel):
        return _of_rig(model, logs, jobs, bandwidth)
    return _of_dual(model, logs, jobs)


def _of_dual(model: Model, logs: Sequence[Log], jobs: int) -> Evidence:
    records = tuple(started(record(log, model.drive), model) for log in logs)
    balance = balances(records, model, model, jobs)
    unknowns: list[Unknown] = list(drive_unknowns(model))
    for name in model.effects:
        sizes = () if name in TABLES else CATALOGUE[name].amplitudes
        unknowns += [k for k in effect_unknowns(name) if k.name in sizes]
    parts = balance.missing(model)
    left = np.concatenate(parts)
    derivatives = dual_columns(balance, model, unknowns)
    prior = np.array([k.prior for k in unknowns])
    kinds = balance.kinds
    weight = _settled(left, derivatives, prior, lambda rest: weights(split(rest, parts), kinds))
    total = np.concatenate(
        [part for part, kind in zip(parts, balance.kinds, strict=True) if role_of(kind) == "total"]
        or parts
    )
    seconds = [rec.dt * rec.omega.size for rec in records]
    lengths = [(p.size, seconds[e.motion]) for p, e in zip(parts, balance.equations, strict=True)]
    return Evidence(
        weight * left,
        weight[:, None] * derivatives,
        tuple(
            Parameter(
                k.label, _unit(model, k), k.of(model), k.scale, float(k.prior), _shows(k, records),
            )
            for k in unknowns
        ),
        _stretches(lengths),
        float(1.4826 * np.median(np.abs(total))),
        "N·m",
    )  # fmt: skip


def _stretches(parts: Sequence[tuple[int, float]]) -> NDArray[np.int64]:
    """Number the stretches of one second in parts of so many rows and seconds."""
    found, first = [], 0
    for rows, seconds in parts:
        count = max(int(seconds), 1)
        found.append(first + np.arange(rows) * count // max(rows, 1))
        first += count
    return np.concatenate(found)


def _shows(unknown: Unknown, records: Sequence[Record]) -> bool:
    """Whether a log can identify it; no sensor of the ring gear shows a motor inside its gap."""
    turns = unknown.effect is not None and "theta_m" in CATALOGUE[unknown.effect].depends_on
    return not turns or all(rec.twist is not None for rec in records)


def _unit(model: Model, unknown: Unknown) -> str:
    if unknown.effect is None:
        return model.drive.quantities[unknown.name].unit
    return next(p.unit for p in CATALOGUE[unknown.effect].parameters if p.name == unknown.name)


def _settled(
    left: Floats, derivatives: Floats, prior: Floats, weigh: Callable[[Floats], Floats]
) -> Floats:
    """Weights by what is left once every parameter has moved: a changed machine is no noise."""
    rest = left
    for _ in range(ROUNDS):
        weight = weigh(rest)
        j = weight[:, None] * derivatives
        square = j.T @ j + np.diag(np.clip(LOOSE * prior, 1.0, LARGE) ** -2.0)
        rest = left - derivatives @ np.linalg.solve(square, j.T @ (weight * left))
    return weigh(rest)


LARGE = 1e3  # scales, standard deviation of what is not known at all
PLACES = 8  # of a zero, tried in one period
ROUNDS = 3
LOOSE = 10.0  # of the declared ranges: a worn machine may leave them


def _of_rig(model: RigModel, logs: Sequence[Log], jobs: int, bandwidth: float | None) -> Evidence:
    sensors = {s.name: s.channel for s in model.rig.sensors}
    if not any(np.ptp(log[channel]) > 0.0 for log in logs for channel in sensors.values()):
        raise LogError("nothing to check: the drive does not move in these logs")
    wrong = [e for e in model.effects if e.on in sensors]
    logs = [put_right(model.rig, log, wrong) for log in logs]
    model = model.without([e.key for e in wrong])
    most = inf if bandwidth is None else bandwidth
    balance = in_contact(balance_of(model.rig, logs, most=most), model, logs)
    model = replace(model, closed=balance.closed)
    of_logs = [log_parameters(model, balance, m.name, "") for m in balance.motions]
    state = _zeroed(State(model), balance, of_logs)
    machine = free_parameters(model, balance, scales_of(balance), nuisances=False)
    frees = (*machine, *(free for frees in of_logs for free in frees))
    left, _ = residuals(state, balance)
    derivatives = jacobian(state, balance, frees, left, jobs=jobs)
    waves = ringing(state.model, balance)
    left = without(waves, left, balance)
    count = left[0].shape[0]
    sizes = [part.shape[1] for part in left]
    use = np.concatenate([rows.ravel() for rows in balance.counted])
    flat = np.concatenate([part.ravel() for part in left])[use]
    columns = np.concatenate([part.reshape(-1, len(frees)) for part in derivatives])
    columns = np.hstack([columns, at_rows(waves, left)])[use]
    logged = zip(sizes, balance.log_of, strict=True)
    group = np.concatenate(  # equation and log
        [np.repeat(np.arange(count) + count * log, n) for n, log in logged]
    )[use]
    groups = count * len(balance.logs)

    def weigh(rest: Floats) -> Floats:
        weight = np.empty(rest.size)
        for k in range(groups):  # as a fit weighs them
            own, heavy = group == k, balance.bursts[k % count]
            level = (size_of(rest[own], heavy) if own.any() else 0.0) or 1.0
            weight[own] = weights_of(rest[own], 1.0 / ROWS_PER_INDEPENDENT, level, heavy)
        return weight

    known = [inf if f.prior is None else f.prior[1] / f.scale for f in frees]
    prior = np.array([*known, *[inf] * (columns.shape[1] - len(frees))])
    weight = _settled(flat, columns, prior, weigh)
    flat, columns = weight * flat, weight[:, None] * columns
    like = Likelihood(balance, np.full(count, 1.0 / ROWS_PER_INDEPENDENT)).knowing(model, left)
    sums = np.bincount(group, weight**2, groups).reshape(-1, count).T
    scales = np.sqrt(np.where(sums > 0.0, like.counts / np.maximum(sums, 1e-300), 1.0))
    own = columns[:, : len(frees)]
    square, gradient = own.T @ own, own.T @ flat
    clear = noise_taken_out(state, frees, like, scales, square, -gradient)
    units = {key: q.unit for key, q in model.quantities.items()}
    parameters = []
    for free, sd in zip(frees, known, strict=True):
        unit = units.get(free.owner, "")
        if free.kind == "effect":
            keep = PLACED_CATALOGUE[free.owner.partition("@")[0]].keep
            unit = next(p.unit for p in keep if p.name == free.name)
        own = free.kind in ("value", "effect")
        value = state.get(free) if own else 0.0
        parameters.append(Parameter(free.label, unit, value, free.scale, float(sd), own))
    starts = columns.shape[1] - len(frees)
    parameters += [Parameter("log.start", "", 0.0, 1.0, inf, own=False)] * starts
    linear = model.rig.body(model.rig.inputs[0].body).linear
    return Evidence(
        flat,
        columns,
        tuple(parameters),
        _stretches(
            [
                (part.shape[1], motion.dt * motion.time.size)
                for part, motion in zip(left, balance.motions, strict=True)
                for _ in range(count)
            ]
        )[use],
        float(np.sqrt(mean_square(left, balance))),
        "N" if linear else "N·m",
        (square - clear[0], gradient + clear[1]),
    )


def _zeroed(state: State, balance: Balance, of_logs: Sequence[Sequence[Free]]) -> State:
    """Find where each log's encoder has its zero: any angle, so derivatives alone would not do."""
    for motion, frees in zip(balance.motions, of_logs, strict=True):
        alone = balance.only([motion.name])
        for free in frees:
            if free.kind != "zero":
                continue
            effect = state.model.effect(free.name)
            turn = 2.0 * np.pi / effect.values.get("order", 1.0)
            tried = [state.moved([free], [turn * k / PLACES]) for k in range(PLACES)]
            state = min(tried, key=lambda one: sum(np.sum(e**2) for e in residuals(one, alone)[0]))
    flat = [free for frees in of_logs for free in frees]
    return fit_rig(state, balance, frees=flat).state if flat else state


def only_own(evidence: Evidence) -> Evidence:
    """Return the evidence with what belongs to single logs left free and out of sight."""
    own = [k for k, p in enumerate(evidence.parameters) if p.own]
    other = [k for k, p in enumerate(evidence.parameters) if not p.own]
    if not other:
        return evidence
    q = orth(evidence.derivatives[:, other])  # some may show nowhere in these logs
    left = evidence.left - q @ (q.T @ evidence.left)
    derivatives = evidence.derivatives[:, own]
    derivatives = derivatives - q @ (q.T @ derivatives)
    parameters = tuple(evidence.parameters[k] for k in own)
    noise = evidence.noise and (evidence.noise[0][np.ix_(own, own)], evidence.noise[1][own])
    return replace(evidence, left=left, derivatives=derivatives, parameters=parameters, noise=noise)
