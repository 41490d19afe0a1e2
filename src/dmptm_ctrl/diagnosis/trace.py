"""Third step: which effect would supply the torque, or the twist, that is missing.

Every catalogue effect is fitted to the balances beside the drive's own parameters, from the
best of its bank of shapes; what it lowers the loss by is its evidence.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.contract import BALANCE, MOTOR_ENCODERS, RUNS, Effect
from dmptm_ctrl.diagnosis.candidate import Rows
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.select import JointGain
from dmptm_ctrl.effects import CATALOGUE, TABLES
from dmptm_ctrl.identify.balance import (
    ROWS,
    Balance,
    BalanceFit,
    columns,
    covariance_of,
    fit_balance,
    split,
    surprise,
)
from dmptm_ctrl.identify.fit import Unknown, effect_unknowns, position
from dmptm_ctrl.identify.ripple import order_gains
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

SATURATED = (0.5, 0.7, 0.85, 0.95)  # of the largest voltage, where a limit is looked for
SMALL = 3.0  # steps
STARTS = 2  # best shapes that are fitted
# Evidence of a first step from nothing, nearly all that there is, below which no more are taken;
# a second effect of a tenth of what it needs has that much.
WORTH = 8.0
FEW = 12  # orders that a thread asks for at a time
SINGULAR = 1e-9  # share of a column's square, below which nothing of it is left but rounding
FINALISTS = 3  # fitted to the end before they are compared


@dataclass(frozen=True, eq=False)
class Trial:
    """An effect fitted to the balances.

    Attributes
    ----------
    gain : float
        Fall of the loss on the fitted logs, a log-likelihood ratio times two.
    held_gain : float
        Fall of the loss on the held-out logs, nothing refitted.
    """

    name: str
    gain: float
    held_gain: float
    fit: BalanceFit

    @property
    def evidence(self) -> float:
        """Fall of the loss on all logs."""
        return self.gain + self.held_gain


@dataclass(eq=False)
class Trace:
    """What the parameters of a fitted model could explain of the balances, projected out."""

    left: Residual

    def __post_init__(self) -> None:
        self.balance: Balance = self.left.balance
        self.base: BalanceFit = self.left.base
        w = self.base.weights
        self.prior = np.diag(
            [1.0 / k.prior if np.isfinite(k.prior) else 1e-3 for k in self.base.unknowns]
        )
        self.derivatives = np.vstack([w[:, None] * self.base.jacobian, self.prior])
        self.basis, self.triangle = np.linalg.qr(self.derivatives)
        self.rows = self.prior.shape[0]
        self.target = self.project(-w * self.base.missing)
        self.whole = np.concatenate([w * self.base.missing, self.prior @ self.base.p])

    @cached_property
    def fast(self) -> "Trace":
        """The same for effects that act faster than a window passes."""
        return self if self.left.fast is self.left else Trace(self.left.fast)

    def of(self, name: str) -> "Trace":
        """The same, as it counts for an effect."""
        return self.fast if CATALOGUE[name].fast else self

    def project(self, columns: Floats) -> Floats:
        """Take out what the drive's parameters could explain; (m,) or (m, k) weighted."""
        pad = [(0, self.rows)] + [(0, 0)] * (columns.ndim - 1)
        tall = np.pad(columns, pad)
        return np.asarray(tall - self.basis @ (self.basis.T @ tall))

    @cached_property
    def totals(self) -> NDArray[np.intp]:
        """Rows of the balances of the whole; any others a torque on the ring gear leaves alone."""
        counts = [(e.kind == "total", int(e.used.sum())) for e in self.balance.equations]
        return np.flatnonzero(np.concatenate([np.full(count, whole) for whole, count in counts]))

    def left_of(self, columns: Floats) -> tuple[Floats, Floats]:
        """Squares of projected columns of the totals, and their products with the target.

        By the columns' own products: to project them takes longer.
        """
        squares = np.einsum("ij,ij->j", columns, columns)
        shared = self.basis[self.totals].T @ columns
        left = squares - np.einsum("ij,ij->j", shared, shared)
        return np.maximum(left, SINGULAR * squares), self.target[self.totals] @ columns

    def gain(self, columns: Floats) -> float:
        """Fall of the weighted square by columns (m, k), to first order; by their products."""
        size = np.maximum(np.sqrt(np.einsum("ij,ij->j", columns, columns)), np.finfo(float).tiny)
        unit = columns / size  # a column may be nothing at all
        shared = self.basis[: -self.rows].T @ unit
        own = unit.T @ unit - shared.T @ shared
        product = self.target[: -self.rows] @ unit
        return float(product @ np.linalg.pinv(own, SINGULAR, hermitian=True) @ product)

    @cached_property
    def room(self) -> tuple[Floats, Floats]:
        """How far the parameters may still move, down and up."""
        low, high = np.array([(k.low, k.high) for k in self.base.unknowns]).T - self.base.p
        return low, high

    def bounded_gain(self, columns: Floats) -> float:
        """Fall of the weighted square by columns (m, k), the drive's parameters in their ranges."""
        tall = np.column_stack([np.pad(columns, [(0, self.rows), (0, 0)]), self.whole])
        # turned so that the derivatives are few rows, and what they leave of the others few more
        shared = self.basis.T @ tall
        left = np.linalg.qr(tall - self.basis @ shared, mode="r")
        own, turned = np.pad(self.triangle, [(0, len(left)), (0, 0)]), np.vstack([shared, left])
        rows = Rows(turned[:, -1], own, *self.room, {(): turned[:, :-1]})
        return JointGain(rows).bounded(((),))


def effect_columns(trace: Trace, effect: Effect, shapes: Mapping[str, float]) -> Floats:
    """Weighted columns per `step` of each amplitude, (m, amplitudes)."""
    base = trace.base.model
    models = [
        base.with_effect(effect.name, **{**shapes, p.name: p.step})
        for p in effect.parameters
        if not p.bank
    ]
    return weighted_changes(trace, models)


def weighted_changes(trace: Trace, models: Sequence[Model]) -> Floats:
    """Weighted change of the residual by each of some models, (m, models)."""
    first = [trace.base.model] if trace.balance.observer_driven else []
    rows = np.array([np.concatenate(one) for one in trace.balance.missing_of([*first, *models])])
    changed = rows[1:] - rows[0] if first else rows - trace.base.missing
    return np.asarray(trace.base.weights[:, None] * changed.T)


def total_columns(trace: Trace, rows: Sequence[Floats]) -> Floats:
    """Weighted columns of torques on the ring gear, (k, w) per motion, in windows of the totals."""
    eqs = trace.balance.equations
    parts = [-rows[e.motion][:, e.used] for e in eqs if e.kind == "total"]
    columns = np.concatenate(parts, axis=1).T
    return np.asarray(trace.base.weights[trace.totals, None] * columns)


def pair_gains(trace: Trace, cosine: Floats, sine: Floats) -> Floats:
    """Gain of each (cosine, sine) pair of columns of the totals."""
    (cc, rc), (ss, rs) = trace.left_of(cosine), trace.left_of(sine)
    basis = trace.basis[trace.totals]
    cs = np.einsum("ij,ij->j", cosine, sine)
    cs -= np.einsum("ij,ij->j", basis.T @ cosine, basis.T @ sine)
    det = np.maximum(cc * ss - cs**2, SINGULAR * cc * ss + 1e-300)
    return np.asarray((ss * rc**2 - 2 * cs * rc * rs + cc * rs**2) / det)


def best(gains: Floats, keep: int, spacing: int) -> list[int]:
    """Indices of the largest gains, no two closer than `apart`."""
    chosen: list[int] = []
    for i in np.argsort(-gains):
        if all(abs(i - j) >= spacing for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return chosen


def frequencies(trace: Trace, effect: Effect) -> list[dict[str, float]]:
    """Clock frequencies [Hz] of a torque on the ring gear."""
    (bank,) = (np.array(p.bank) for p in effect.parameters if p.bank)
    gains = []
    for part in np.array_split(bank, max(1, bank.size // 128)):
        waves = []
        for function in (np.cos, np.sin):
            rows = [function(2 * np.pi * part[:, None] * mo.time) for mo in trace.balance.motions]
            waves.append(total_columns(trace, rows))
        gains.append(pair_gains(trace, *waves))
    found = best(np.concatenate(gains), STARTS, 10)
    return [{"frequency": float(bank[i])} for i in found]


def orders(trace: Trace, effect: Effect) -> list[dict[str, float]]:
    """Orders per motor turn of a torque on either motor."""
    (bank,) = (p.bank for p in effect.parameters if p.bank)
    balance, base = trace.balance, trace.base.model.drive
    n1, n2 = base["N_1"], base["N_2"]
    turns = [np.exp(1j * mo.run[:, 2:4].T) for mo in balance.motions]

    def some(few: Floats) -> list[float]:
        """Gain of each of some orders that follow one another; a wave is the one before turned."""
        waves, gains = [turn ** few[0] for turn in turns], []
        for i, _ in enumerate(few):
            if i > 0:
                waves = [wave * turn for wave, turn in zip(waves, turns, strict=True)]
            gains.append(gain(waves))
        return gains

    def gain(waves: Sequence[NDArray[np.complex128]]) -> float:
        parts: list[list[Floats]] = [[] for _ in range(4)]
        tables = [
            mo.mean(np.array([wave[0].real, wave[0].imag, wave[1].real, wave[1].imag]))
            for mo, wave in zip(balance.motions, waves, strict=True)
        ]
        for e in balance.equations:
            if e.kind not in ROWS:
                for part in parts:
                    part.append(np.zeros(int(e.used.sum())))
                continue
            table = n1 * tables[e.motion][:, e.used]
            for j in range(4):
                if e.kind == "total":
                    parts[j].append(-n2 * table[j])
                else:
                    mine = e.kind == ("left", "right")[j // 2]
                    parts[j].append(-table[j] if mine else np.zeros(table.shape[1]))
        return trace.gain(np.array([trace.base.weights * np.concatenate(p) for p in parts]).T)

    runs = np.split(np.array(bank), np.flatnonzero(np.diff(bank) != 1.0) + 1)
    several = [few for run in runs for few in np.array_split(run, max(1, run.size // FEW))]
    found = in_threads(some, several, balance.jobs)
    by_windows = np.array([gain for gains in found for gain in gains])
    gains = by_windows + fast_gains(trace, bank)
    return [{"order": float(bank[i])} for i in best(gains, STARTS, 1)]


def fast_gains(trace: Trace, bank: Sequence[float]) -> Floats:
    """What the same orders explain of the fast part."""
    counts = split(trace.base.weights**2, trace.base.parts)
    fast = [
        (trace.balance.ripples[e.motion], part, count)
        for e, part, count in zip(trace.balance.equations, trace.base.parts, counts, strict=True)
        if e.kind == "ripple"
    ]
    return order_gains(fast, round(max(bank)))[np.array(bank, int) - 1]


def places(trace: Trace, effect: Effect) -> list[dict[str, float]]:
    """Places and widths of a bump of friction over the ring-gear angle."""
    banks = {p.name: np.array(p.bank) for p in effect.parameters if p.bank}
    trials, gains = [], []
    for width in banks["width"]:
        rows = []
        for mo in trace.balance.motions:
            middle = mo.starts + mo.window.size // 2
            theta, direction = mo.run[middle, 0], np.sign(mo.run[middle, 1])
            away = (theta - banks["place"][:, None] + np.pi) % (2 * np.pi) - np.pi
            rows.append(-direction * np.exp(-0.5 * (away / width) ** 2))
        square, product = trace.left_of(total_columns(trace, rows))
        gain = np.maximum(product, 0.0) ** 2 / np.maximum(square, 1e-9)
        for i in best(gain, STARTS, 3):
            trials.append({"place": float(banks["place"][i]), "width": float(width)})
            gains.append(gain[i])
    return [trials[i] for i in np.argsort(-np.array(gains))[:STARTS]]


SEARCHES = {"frequencies": frequencies, "orders": orders, "places": places}


def starts(trace: Trace, effect: Effect) -> list[dict[str, float]]:
    """Values to start fits of an effect at."""
    if effect.search == "limits":
        top = max(float(np.abs(mo.rec.u).max()) for mo in trace.balance.motions)
        return [{"inverse_limit": 1.0 / (share * top)} for share in SATURATED]
    if effect.starts:
        still = dict.fromkeys(effect.amplitudes, 0.0)
        steps = {p.name: p.step for p in effect.parameters}
        return [{**still, name: k * steps[name]} for name, k in effect.starts]
    shapes: list[dict[str, float]]
    if effect.search:
        shapes = SEARCHES[effect.search](trace, effect)
    elif effect.shapes and not effect.ringing:
        banks = [p.bank for p in effect.parameters if p.bank]
        shapes = [dict(zip(effect.shapes, values, strict=True)) for values in product(*banks)]
    else:
        shapes = [{}]
    if len(shapes) > STARTS:
        gains = [trace.gain(effect_columns(trace, effect, values)) for values in shapes]
        shapes = [shapes[i] for i in best(np.array(gains), STARTS, 1)]
    # From a small one: where it may act one way only, from none there is no way down.
    own = effect.amplitudes
    small = {p.name: SMALL * p.step for p in effect.parameters if p.name in own and p.low >= 0.0}
    return [{**values, **dict.fromkeys(own, 0.0), **small} for values in shapes]


def bent(name: str) -> bool:
    """Whether the first step says little about the rest of the way."""
    return bool(CATALOGUE[name].starts) or CATALOGUE[name].search == "limits"


def unknowns_of(name: str) -> tuple[Unknown, ...]:
    """Parameters of an effect that are fitted; whole numbers stay as they were found."""
    effect = CATALOGUE[name]
    fixed = (*(p.name for p in effect.parameters if p.fixed), *effect.ringing)
    return tuple(k for k in effect_unknowns(name) if k.name not in fixed)


@dataclass(frozen=True, eq=False)
class Start:
    """Where fits of an effect beside a model begin."""

    trace: Trace
    name: str

    @cached_property
    def models(self) -> list[Model]:
        """The model with the effect as it may be."""
        values = starts(self.trace, CATALOGUE[self.name])
        return [self.trace.base.model.with_effect(self.name, **one) for one in values]

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """What is fitted."""
        return (*self.trace.base.unknowns, *unknowns_of(self.name))

    @cached_property
    def _slopes(self) -> list[Floats]:
        own = unknowns_of(self.name)
        return [columns(self.trace.balance, model, own) for model in self.models]

    @cached_property
    def _gains(self) -> list[float]:
        weights = self.trace.base.weights[:, None]
        return [self.trace.bounded_gain(weights * one) for one in self._slopes]

    @property
    def gain(self) -> float:
        """Fall of the weighted square to first order; infinite where that says little."""
        return np.inf if bent(self.name) else max(self._gains)

    @property
    def rough(self) -> "Trial":
        """The best start, nothing fitted."""
        base, k = self.trace.base, int(np.argmax(self._gains))
        jacobian = np.hstack([base.jacobian, self._slopes[k]])
        there = replace(
            base,
            model=self.models[k],
            unknowns=self.unknowns,
            p=position(self.models[k], self.unknowns),
            covariance=covariance_of(base.weights[:, None] * jacobian, self.unknowns),
            jacobian=jacobian,
        )
        return Trial(self.name, self._gains[k], 0.0, there)


def begun(trace: Trace, names: Iterable[str]) -> list[Start]:
    """Return the starts of effects."""
    return [Start(trace.of(name), name) for name in names]


def try_effect(start: Start) -> Trial:
    """Fit an effect from its best starts."""
    trace, models = start.trace, start.models
    if trace.balance.observer_driven:  # runs cost most: from the best start alone
        parts = trace.balance.missing_of(models)
        models = [models[int(np.argmin([surprise(one, trace.base.kinds) for one in parts]))]]
    own, jacobian = start.unknowns, trace.base.jacobian
    fits = [fit_balance(trace.balance, model, own, jacobian=jacobian) for model in models]
    return tried(trace, start.name, min(fits, key=lambda f: f.loss))


def tried(trace: Trace, name: str, done: BalanceFit) -> Trial:
    """Compare a fit with the base."""
    held = trace.left.held_base - trace.left.held_loss(done.model)
    return Trial(name, trace.base.loss - done.loss, held, done)


def settled(trace: Trace, trial: Trial) -> Trial:
    """Fit a trial to the end, with the drive's columns taken where it is."""
    trace = trace.of(trial.name)
    own = trace.base.unknowns
    there = columns(trace.balance, trial.fit.model, own)
    again = fit_balance(trace.balance, trial.fit.model, trial.fit.unknowns, jacobian=there)
    return tried(trace, trial.name, again) if again.loss < trial.fit.loss else trial


def candidates(trace: Trace, skip: Iterable[str], *, everything: bool = False) -> list[str]:
    """Effects that the balances can show, or everything that runs can; `skip` are left out."""
    twisted = any(mo.rec.twist is not None for mo in trace.balance.motions)
    out = {*skip, *trace.base.model.effects, *TABLES}
    seen = {BALANCE, *([MOTOR_ENCODERS] if twisted else [])}
    if everything:
        seen = {BALANCE, MOTOR_ENCODERS, RUNS}
    return [name for name, e in CATALOGUE.items() if name not in out and e.seen_by in seen]


def finished(trace: Trace, done: Sequence[Trial]) -> list[Trial]:
    """Fit those of most evidence to the end; most evidence first."""
    done = sorted(done, key=lambda t: -t.evidence)
    done[:FINALISTS] = [settled(trace, t) if t.gain > WORTH else t for t in done[:FINALISTS]]
    return sorted(done, key=lambda t: -t.evidence)
