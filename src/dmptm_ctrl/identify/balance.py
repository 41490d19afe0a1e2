"""Newton's law on the measured motion: what torque is missing, window by window.

Summed over all bodies the mesh torques cancel, so that the balance at the ring gear

    J_L α_L + N2 J̄3 (α_3l + α_3r) = N2 (N1 K (u_l + u_r) − F_3l − F_3r) − F_L + effects

holds through gaps and impact chatter, of which no simulation predicts the course; per side the
mesh torque follows from the measured twist while the pinion rests on a flank. Nothing is
integrated: no drift, no chaos, and nearly linear in everything unknown. What acts faster than a
window is long is measured by the gyro's fast part (`ripple`).
Source: paper Eqs. 16 to 18, 21, 25.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.compared_signals import correlation_length
from dmptm_ctrl.identify.fit import Fit, Normal, Unknown, place, placed, position, secant
from dmptm_ctrl.identify.heavy_tails import FREEDOM, robust_scale
from dmptm_ctrl.identify.measured_motion import recent
from dmptm_ctrl.identify.motion import GYRO_NOISE, Motion
from dmptm_ctrl.identify.observer_driven import ObserverRun
from dmptm_ctrl.identify.ripple import Ripple
from dmptm_ctrl.identify.windows import Windowed, frictions, inertias, pull_of
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

FIRM = 1.0  # N·m at the pinion; below, the flanks part and meet again within a window
MIN_WINDOWS = 8  # of a log and equation; fewer say nothing about their own scatter
GAUSSIAN = 1e6  # freedom of Student's t, where every window counts in full
# N·m, rad/s for ripple and observer; friction laws, and a sensor's noise, are not known more finely
FLOOR = {"total": 0.1, "side": 0.4, "ripple": 0.5 * GYRO_NOISE, "observer": 0.2 * GYRO_NOISE}
# Difference steps, in scales of an unknown; small for what enters a phase or an exponent.
PROBES = {"drive": 0.1, "amplitude": 1.0, "shape": 0.02}
ITERATIONS = 8
# Share and damping of a step, tried in turn: along a bent valley only a damped step is downhill.
STEPS = ((1.0, 0.0), (0.5, 0.0), (1.0, 0.01), (1.0, 0.1), (1.0, 1.0), (1.0, 10.0))
STALLED = 0.5  # fall of the loss that ends the iterations
RECENT = 16  # models whose missing torques are kept
# Share of the windows that are independent: they overlap by half, and the wobble of a pinion
# on its flank lasts for several. Not read off the misfit, which a missing effect correlates.
# Samples of the fast part are white. How much blocks of short predictions count is measured by
# benchmarks/short_weight.py.
INDEPENDENT = {"total": 0.6, "side": 0.25, "ripple": 1.0, "observer": 0.1}


@dataclass(frozen=True, eq=False)
class Equation:
    """One balance on one log: which windows of it count."""

    motion: int
    kind: str  # total; left, right; ripple, whose `used` are samples; observer, whose are blocks
    used: np.ndarray


@dataclass(eq=False)
class Balance:
    """Missing torque [N·m], and missing fast speed [rad/s], of a model on measured motions.

    Parameters
    ----------
    declared : Model
        Shows which meshes push firmly; which windows count does not follow a fit.
    jobs : int
        Threads; nothing depends on it.
    fast : bool
        Whether the fast part counts, after all windows.
    observer_driven : bool
        Whether short predictions count, last of all.
    """

    motions: Sequence[Motion]
    declared: Model
    jobs: int = 1
    fast: bool = False
    observer_driven: bool = False

    @cached_property
    def equations(self) -> tuple[Equation, ...]:
        """Equations with enough windows, log by log."""
        found = []
        for i, mo in enumerate(self.motions):
            kinds = [("total", mo.slides)]
            if mo.rec.twist is not None:
                firm = pushes(mo, self.declared)
                kinds += [
                    (k, mo.slides & mo.touches[:, s] & firm[:, s]) for s, k in enumerate(SIDES)
                ]
            found += [Equation(i, k, used) for k, used in kinds if used.sum() >= MIN_WINDOWS]
        if self.fast:
            found += [Equation(i, "ripple", r.used) for i, r in enumerate(self.ripples) if r.usable]
        if self.observer_driven:
            found += [
                Equation(i, "observer", np.ones(one.count, bool))
                for i, one in enumerate(self.observer_runs)
            ]
        return tuple(found)

    @cached_property
    def ripples(self) -> list[Ripple]:
        """The fast part of each motion."""
        return [Ripple(mo) for mo in self.motions]

    @cached_property
    def observer_runs(self) -> list[ObserverRun]:
        """Short predictions on each log."""
        return [ObserverRun(mo.rec) for mo in self.motions]

    @cached_property
    def windowed(self) -> list[Windowed]:
        """What motions that are alike give the balances."""
        return [Windowed([self.motions[i] for i in rows]) for rows in self.alike]

    @cached_property
    def alike(self) -> list[list[int]]:
        """Motions of the same length and sample time, with motor encoders or without."""
        found: dict[tuple[int, float, bool], list[int]] = {}
        for i, mo in enumerate(self.motions):
            found.setdefault((mo.run.shape[0], mo.rec.dt, mo.rec.twist is None), []).append(i)
        return list(found.values())

    @cached_property
    def places(self) -> list[tuple[int, int, np.ndarray]]:
        """Of each balance which group it is in, which row, and which windows of it count."""
        first = {}
        for group, rows in enumerate(self.alike):
            begin = 0
            for i in rows:
                first[i] = group, begin
                begin += self.motions[i].starts.size
        return [
            (first[e.motion][0], ROWS[e.kind], first[e.motion][1] + np.flatnonzero(e.used))
            for e in self.equations
            if e.kind in ROWS
        ]

    @property
    def simulated(self) -> bool:
        """Whether a simulation says which pinions touch."""
        return any(mo.rec.twist is None for mo in self.motions)

    @cached_property
    def kinds(self) -> list[str]:
        """Kind of each equation."""
        return [e.kind for e in self.equations]

    def missing_of(self, models: Sequence[Model]) -> list[list[Floats]]:
        """Return the missing torques of several models; their runs go together."""
        if not self.observer_driven:
            return in_threads(self.missing, models, self.jobs)
        windows = in_threads(self._of_windows, models, self.jobs)
        runs = in_threads(
            lambda one: one.missing_of(models), self.observer_runs, self.jobs, lambda one: one.count
        )
        return [[*parts, *(run[i] for run in runs)] for i, parts in enumerate(windows)]

    def missing(self, model: Model) -> list[Floats]:
        """Missing torque per equation, on the windows that count."""
        make = partial(self._missing, model)
        parts: list[Floats] = recent(self.known, id(model), make, RECENT)[1]
        return parts

    @cached_property
    def known(self) -> dict[int, tuple[Model, list[Floats]]]:
        """Missing torques of the last models, kept with them."""
        return {}

    def _missing(self, model: Model) -> tuple[Model, list[Floats]]:
        runs = self.observer_runs if self.observer_driven else []
        return model, [*self._of_windows(model), *(one.missing(model) for one in runs)]

    def _of_windows(self, model: Model) -> list[Floats]:
        tables = [w.missing(model.over(w.seconds)) for w in self.windowed]
        parts = [tables[group][row, windows] for group, row, windows in self.places]
        fast = [self.ripples[e.motion] for e in self.equations if e.kind == "ripple"]  # last of all
        return [*parts, *(ripple.missing(model.plant()) for ripple in fast)]


def pushes(mo: Motion, model: Model) -> np.ndarray:
    """Windows in which the mesh pushes so firmly that it does not lift in between, (w, 2)."""
    plant = model.plant()
    friction = mo.mean(frictions(mo, plant)[:2], held=False)
    left = pull_of(plant) * mo.mean(mo.rec.u) + friction - inertias(plant)[0] * mo.pinions.T
    return np.asarray((mo.mean(mo.flank.T) * left > FIRM).T)


SIDES = ("left", "right")
ROWS = {"total": 0, "left": 1, "right": 2}


def scatter(parts: Sequence[Floats], kinds: Sequence[str], freedom: float = FREEDOM) -> list[float]:
    """How far the windows, or samples, of each equation scatter."""
    return [
        float(np.hypot(robust_scale(part, freedom), FLOOR[role_of(kind)]))
        for part, kind in zip(parts, kinds, strict=True)
    ]


@dataclass(frozen=True, eq=False)
class BalanceFit(Fit):
    """Parameters that close the balances best.

    Attributes
    ----------
    loss : float
        Twice the negative log-likelihood of the independent windows, plus ‖p/s‖².
    parts : list of arrays
        Missing torque per equation.
    kinds : list of str
        Of each part.
    jacobian : (m, k) array
        d missing/dp, unweighted.
    """

    loss: float
    parts: list[Floats]
    kinds: list[str]
    jacobian: Floats

    @property
    def missing(self) -> Floats:
        """All parts in one vector."""
        return np.concatenate(self.parts)

    @cached_property
    def weights(self) -> Floats:
        """Square roots of what each window counts."""
        return weights(self.parts, self.kinds)


def weights(parts: Sequence[Floats], kinds: Sequence[str], freedom: float = FREEDOM) -> Floats:
    """Square roots of what each window counts: its scale, bent, and independent share."""
    return np.concatenate(
        [
            np.sqrt(INDEPENDENT[role_of(kind)] * (freedom + 1.0) / (freedom + (part / sigma) ** 2))
            / sigma
            for part, kind, sigma in zip(parts, kinds, scatter(parts, kinds, freedom), strict=True)
        ]
    )


def surprise(parts: Sequence[Floats], kinds: Sequence[str], freedom: float = FREEDOM) -> float:
    """Twice the negative log-likelihood of Student's t, each equation at its own scale."""
    return sum(float(row.sum()) for row in row_surprises(parts, kinds, freedom))


def row_surprises(
    parts: Sequence[Floats], kinds: Sequence[str], freedom: float = FREEDOM
) -> list[Floats]:
    """The same of each row of each equation."""
    return [
        INDEPENDENT[role_of(kind)]
        * (2.0 * np.log(s) + (freedom + 1.0) * np.log1p((x / s) ** 2 / freedom))
        for x, kind, s in zip(parts, kinds, scatter(parts, kinds, freedom), strict=True)
    ]


def surprises(parts: Sequence[Floats], kinds: Sequence[str]) -> Floats:
    """The same of each equation, as if its windows were independent but for their overlap."""
    return np.array([surprise([part], [kind]) for part, kind in zip(parts, kinds, strict=True)])


def correlation_lengths(parts: Sequence[Floats], kinds: Sequence[str]) -> Floats:
    """Windows of each equation that count as one, as what is left of them correlates.

    A law that is only nearly right is wrong alike in neighbouring windows; counted as
    independent, they would speak for any effect. Overlap is in :data:`INDEPENDENT` already.
    """
    lengths = []
    for part, kind, sigma in zip(parts, kinds, scatter(parts, kinds), strict=True):
        x = part / sigma
        x = x / np.sqrt(1.0 + x * x / FREEDOM)
        lengths.append(max(1.0, INDEPENDENT[role_of(kind)] * correlation_length(x - x.mean())))
    return np.array(lengths)


def loss(
    parts: Sequence[Floats],
    kinds: Sequence[str],
    unknowns: Sequence[Unknown],
    p: Floats,
    freedom: float = FREEDOM,
) -> float:
    """Scale-free misfit plus the prior's."""
    prior = sum((x / k.prior) ** 2 for x, k in zip(p, unknowns, strict=True))
    return surprise(parts, kinds, freedom) + float(prior)


def split(vector: Floats, like: Sequence[Floats]) -> list[Floats]:
    """Cut a vector into parts of the sizes of `like`."""
    return np.split(vector, np.cumsum([x.size for x in like])[:-1])


def role_of(kind: str) -> str:
    """Tell the balance of the whole, that of a side and the fast part apart."""
    return "side" if kind in SIDES else kind


def role(unknown: Unknown) -> str:
    """Tell the drive's parameters, an effect's amplitudes and its shapes apart."""
    if unknown.effect is None:
        return "drive"
    return "shape" if unknown.name in CATALOGUE[unknown.effect].shapes else "amplitude"


def columns(balance: Balance, model: Model, unknowns: Sequence[Unknown]) -> Floats:
    """Derivatives of the missing torques by differences, (m, k)."""
    p0 = position(model, unknowns)
    if not unknowns:
        return np.empty((sum(map(len, balance.missing(model))), 0))
    steps = np.array([PROBES[role(k)] for k in unknowns])
    steps[p0 + steps > [k.high for k in unknowns]] *= -1.0
    moved = [place(model, unknowns, p) for p in p0 + np.diag(steps)]
    # runs that go together round alike: their differences are taken from one of them
    first = [model] if balance.observer_driven else []
    rows = np.array([np.concatenate(parts) for parts in balance.missing_of([*first, *moved])])
    changed = rows[1:] - rows[0] if first else rows - np.concatenate(balance.missing(model))
    return np.asarray((changed / steps[:, None]).T)


def fit_balance(
    balance: Balance,
    model: Model,
    unknowns: Sequence[Unknown],
    *,
    jacobian: Floats | None = None,
    freedom: float = FREEDOM,
) -> BalanceFit:
    """Fit unknowns by Gauss–Newton with weights that follow the misfit.

    Parameters
    ----------
    jacobian : (m, j) array, optional
        Of the first j unknowns, kept as it is (the drive's are nearly constant).
    freedom : float
        Of Student's t; the larger, the more an outlier counts.
    """
    unknowns = tuple(unknowns)
    low = np.array([k.low for k in unknowns])
    high = np.array([k.high for k in unknowns])
    p = np.clip(position(model, unknowns), low, high)
    model = placed(model, unknowns, p)
    kinds = balance.kinds
    parts = balance.missing(model)
    value = loss(parts, kinds, unknowns, p, freedom)
    kept = np.empty((sum(map(len, parts)), 0)) if jacobian is None else jacobian
    own = unknowns[kept.shape[1] :]

    def derivatives() -> Floats:
        return np.hstack([kept, columns(balance, model, own)])

    jac, fresh = derivatives(), True
    for _ in range(ITERATIONS):
        e, p0 = np.concatenate(parts), p
        w = weights(parts, kinds, freedom)
        normal, gain = Normal.of(w * e, -w[:, None] * jac, p, unknowns), 0.0
        for shrink, damping in STEPS:
            trial = np.clip(p + shrink * normal.step(damping), low, high)
            moved = place(model, unknowns, trial)
            tried = balance.missing(moved)
            cost = loss(tried, kinds, unknowns, trial, freedom)
            if cost < value:
                gain = value - cost
                p, model, parts, value = trial, moved, tried, cost
                break
        stalled = gain < STALLED
        if stalled and fresh:
            break
        if not own:
            continue
        if stalled or balance.observer_driven:  # runs bend too much for secants: they meet impacts
            jac, fresh = derivatives(), True
        else:
            jac, fresh = secant(jac, np.concatenate(parts) - e, p - p0), False
    covariance = covariance_of(weights(parts, kinds)[:, None] * jac, unknowns)
    return BalanceFit(model, unknowns, p, covariance, value, parts, kinds, jac)


def covariance_of(rows: Floats, unknowns: Sequence[Unknown]) -> Floats:
    """Covariance of unknowns by weighted derivatives (m, k) and their declarations, (k, k)."""
    prior = np.array([1.0 / k.prior**2 + 1e-9 for k in unknowns])
    return np.asarray(np.linalg.inv(rows.T @ rows + np.diag(prior)), np.float64)


def robust_fit(
    balance: Balance, model: Model, unknowns: Sequence[Unknown], jacobian: Floats
) -> BalanceFit:
    """Fit from here, and from where outliers count in full; return the better.

    A robust loss has several minima: windows that one effect cannot follow pass for outliers.
    Both ways share derivatives `jacobian` (m, k), which change little.
    """
    here = fit_balance(balance, model, unknowns, jacobian=jacobian)
    whole = fit_balance(balance, model, unknowns, jacobian=jacobian, freedom=GAUSSIAN)
    there = fit_balance(balance, whole.model, unknowns, jacobian=jacobian)
    return min(here, there, key=lambda one: one.loss)


def settled_fit(
    balance: Balance, model: Model, unknowns: Sequence[Unknown], jacobian: Floats
) -> BalanceFit:
    """Fit to the end, with derivatives taken there."""
    return fit_balance(balance, robust_fit(balance, model, unknowns, jacobian).model, unknowns)
