"""Find what a declared drive of any shape lacks, one effect after another.

Forward selection with backward deletion. A rung is taken when the logs that were fitted show
it beyond chance, block by block; when it is worth having; and when it lowers the error on logs,
or stretches of logs, that were not fitted.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from dmptm_ctrl.diagnosis.ladder_candidates import candidates
from dmptm_ctrl.diagnosis.ladder_score import Score, Tangent, similarity
from dmptm_ctrl.diagnosis.ladder_tries import Candidate
from dmptm_ctrl.identify.chain_fit import (
    ChainFit,
    Free,
    State,
    fit_chain,
    has_phase,
    log_parameters,
    residuals,
)
from dmptm_ctrl.identify.chain_start import rough_start
from dmptm_ctrl.identify.inverse_dynamics import Balance, Nuisance
from dmptm_ctrl.simulate.chain_model import ChainModel

Floats = NDArray[np.float64]

MIN_GAIN = 0.05  # share of the residual's square; less is not worth a name
ALPHA = 0.01  # chance that any rung of a ladder is taken by a drive that lacks nothing
HELD_SHARE = 0.3  # of the gain on the fitted logs that held-out ones must show
MIN_SHARE = 0.5  # % of the driving torque; a smaller effect is of no interest
MAX_RUNGS = 10
SETTLE = 30  # iterations at most; an unsettled fit would lend its gain to the next effect
SHORTLIST = 4  # candidates refitted per rung
ALIKE = 0.7  # cosine between what two candidates explain, from which they compete
NEARLY = 0.85  # a simpler effect with this share of the best one's gain is preferred
IN_BAND = 0.9  # of the bandwidth; a resonance must lie below
CLIPS = 1.05  # largest input over a saturation's limit
OVERDAMPED = 0.5  # damping ratio from which there is no resonance to speak of
STANDS_OUT = 0.3
SHAPES = ("stribeck_friction", "friction_asymmetry", "presliding", "thermal_drift")
DRIVEN = 0.5  # of what a spring changes must be coherent with the drive
SEGMENTS = 8  # of a log, for a coherence
SHORTEST_SEGMENT = 16  # rows
EXOTIC_GAIN = 2.0  # times the gain that a plain effect must have, for those from here on in SIMPLE
FIRST_EXOTIC = "presliding"
SIMPLE = (  # the order in which engineers think of them
    *("coulomb_friction", "viscous_friction", "drive_offset", "friction_asymmetry"),
    *("stribeck_friction", "cogging", "unbalance", "shaft_compliance", "backlash"),
    *("drive_delay", "current_lag", "presliding", "quadratic_drag", "load_dependent_friction"),
    *("position_dependent_friction", "drive_dead_band", "drive_saturation", "cable_spring"),
    *("thermal_drift", "base_vibration"),
)


class Errors(NamedTuple):
    """Error of a balance of torques.

    Attributes
    ----------
    rmse : float [N·m or N, or the input's unit where the gain is unknown]
    percent : float
        100 · ‖residual‖/‖drive‖.
    fit_percent, pearson_r : float
        Of the torque that the model gives against the driving one.
    """

    rmse: float
    percent: float
    fit_percent: float
    pearson_r: float


class Rung(NamedTuple):
    """One step of the ladder: the errors before and after it."""

    key: str
    score: Score
    p_value: float
    gain: float
    held_gain: float
    fit_before: Errors
    fit_after: Errors
    held_before: Errors
    held_after: Errors


@dataclass(frozen=True, eq=False)
class Ladder:
    """What was found, and how.

    Attributes
    ----------
    base, final : ChainFit
    rungs : tuple of Rung
        As taken; those in `deleted` were given up again.
    scores : list of Candidate
        Of the last look.
    best : dict
        Effect name → largest gain that it showed at any look, with its p-value and survival.
    """

    base: ChainFit
    final: ChainFit
    rungs: tuple[Rung, ...]
    deleted: tuple[str, ...]
    scores: list[Candidate]
    best: dict[str, Candidate]
    fit_logs: Balance
    held_logs: Balance
    held_state: State
    warnings: tuple[str, ...] = field(default=())


def errors_of(left: Sequence[Floats], drive: Sequence[Floats]) -> Errors:
    """Errors of the first equation over logs together; rows at rest do not count."""
    e = np.concatenate([part[0] for part in left])
    f = np.concatenate(list(drive))
    use = f != 0
    e, f = e[use], f[use]
    if e.size == 0:
        return Errors(0.0, 0.0, 0.0, 0.0)
    rmse = float(np.sqrt(np.mean(e**2)))
    size = float(np.sqrt(np.mean(f**2)))
    spread = float(np.std(f))
    model = f - e
    both = spread * float(np.std(model))
    r = float(np.mean((f - f.mean()) * (model - model.mean())) / both) if both > 0 else 0.0
    return Errors(
        rmse,
        100.0 * rmse / size,
        100.0 * (1.0 - rmse / spread) if spread > 0 else 0.0,
        r,
    )


Outcome = tuple[Sequence[Floats], Sequence[Floats]]  # residual and drive per log


def gain_of(before: Outcome, after: Outcome) -> float:
    """Share of the residual's square that went, relative to the drive.

    Mean over the equations that both have: the first one does not see the torque between two
    bodies that are both measured.
    """
    count = min(before[0][0].shape[0], after[0][0].shape[0])
    old, new = (np.array([_power(left, drive, e) for e in range(count)])
                for left, drive in (before, after))  # fmt: skip
    left = np.divide(new, old, out=np.ones(count), where=old > 0)
    return 1.0 - float(np.mean(left))


def _power(left: Sequence[Floats], drive: Sequence[Floats], equation: int) -> float:
    total = sum(float(part[equation] @ part[equation]) for part in left)
    size = sum(float(part @ part) for part in drive)
    return total / size if size > 0 else inf


def climb(
    model: ChainModel,
    fit_logs: Balance,
    held_logs: Balance,
    *,
    jobs: int = 2,
    tell: Callable[[str], None] | None = None,
) -> Ladder:
    """Find what a model lacks.

    Parameters
    ----------
    model : ChainModel
        As declared.
    fit_logs, held_logs : Balance
    jobs : int
        Threads; the result does not depend on it.
    tell : callable, optional
        Gets a line per rung.

    Returns
    -------
    Ladder
    """
    fit = fit_chain(State(rough_start(model, fit_logs)), fit_logs, jobs=jobs, iterations=SETTLE)
    base = fit
    rungs: list[Rung] = []
    best: dict[str, Candidate] = {}
    scores: list[Candidate] = []
    while len(rungs) < MAX_RUNGS:
        # Springs and gaps cost most to try: not while a plain effect stands out.
        scores = candidates(Tangent(fit, fit_logs), structure=not rungs)
        if rungs and not any(c.score.gain >= STANDS_OUT for c in scores):
            scores = candidates(Tangent(fit, fit_logs))
        for candidate in scores:
            known = best.get(candidate.name)
            if known is None or candidate.score.gain > known.score.gain:
                best[candidate.name] = candidate
        taken = _next_rung(fit, fit_logs, held_logs, scores, jobs)
        if taken is None:
            break
        rung, fit = taken
        rungs.append(rung)
        if tell is not None:
            tell(f"{rung.key}: {rung.held_before.percent:.2f} → {rung.held_after.percent:.2f} %")
    fit, deleted = _delete(fit, fit_logs, held_logs, rungs, jobs)
    return Ladder(
        base,
        fit,
        tuple(rungs),
        deleted,
        scores,
        best,
        fit_logs,
        held_logs,
        held_state(fit.state, held_logs, fit_logs, jobs=jobs),
    )


def _next_rung(
    fit: ChainFit,
    fit_logs: Balance,
    held_logs: Balance,
    scores: list[Candidate],
    jobs: int,
) -> tuple[Rung, ChainFit] | None:
    """Take the best candidate that passes; None when none does.

    One that stands out is tested as if it were the only one: held-out data confirm it.
    """
    level = ALPHA / max(len(scores), 1)
    worth = [
        c for c in scores
        if c.score.gain >= 0.5 * MIN_GAIN and c.score.p_value * c.tries
        <= (ALPHA if c.score.gain >= STANDS_OUT else level)
    ]  # fmt: skip
    refits = [(c, refit(fit, c, fit_logs, jobs)) for c in worth[:SHORTLIST]]
    old = fit.left, fit.drive
    before = errors_of(*old)
    held_old = held_outcome(fit.state, held_logs, fit_logs, jobs)
    trials = sorted(
        ((c, new, gain_of(old, (new.left, new.drive))) for c, new in refits), key=lambda t: -t[2]
    )
    least = (MIN_SHARE / before.percent) ** 2 if before.percent > 0 else 1.0
    trials = _simplest_first(
        [
            t for t in trials
            if worthwhile(t[0].name, t[2], old, (t[1].left, t[1].drive), least)
            and plausible(t[0], fit, t[1], fit_logs)
        ]
    )  # fmt: skip
    for candidate, new, gain in trials:
        held_new = held_outcome(new.state, held_logs, fit_logs, jobs)
        held_gain = gain_of(held_old, held_new)
        if held_gain < max(HELD_SHARE * gain, 0.5 * least_gain(candidate.name)):
            continue
        p_value = min(1.0, candidate.score.p_value * candidate.tries * len(scores))
        rung = Rung(
            candidate.placed.key, candidate.score, p_value, gain, held_gain,
            before, errors_of(new.left, new.drive), errors_of(*held_old), errors_of(*held_new),
        )  # fmt: skip
        return rung, new
    return None


def least_gain(name: str) -> float:
    """Share of the residual's square that an effect must explain to be named."""
    return MIN_GAIN * (EXOTIC_GAIN if exotic(name) else 1.0)


def exotic(name: str) -> bool:
    """Whether an effect is a rare one."""
    return name not in SIMPLE or SIMPLE.index(name) >= SIMPLE.index(FIRST_EXOTIC)


def worthwhile(name: str, gain: float, before: Outcome, after: Outcome, least: float) -> bool:
    """Whether an effect explains enough, and of the whole balance as well.

    A gap acts between two bodies alone; that balance does not see it.
    """
    if gain < max(least, least_gain(name)):
        return False
    if name == "backlash":
        return True
    first = [([part[:1] for part in left], drive) for left, drive in (before, after)]
    return gain_of(*first) >= least_gain(name)


def plausible(candidate: Candidate, before: ChainFit, fit: ChainFit, logs: Balance) -> bool:
    """Whether a refitted effect is what its name says.

    A saturation clips more than the tips of the input. A resonance above the bandwidth is a delay
    or a filter by another name; what a spring changes must follow from the drive, or it only
    hides the noise of the acceleration.
    """
    effect = next(e for e in fit.model.effects if e.key == candidate.placed.key)
    if effect.name == "drive_saturation":
        peak = max(float(np.abs(m.u[effect.on]).max()) for m in logs.motions)
        return effect.values["inverse_limit"] * peak >= CLIPS
    if effect.name != "shaft_compliance":
        return True
    layout, plant = fit.model.layout, fit.model.plant()
    k = layout.links.index(effect.key if effect.key in layout.links else effect.on)
    ratio, stiffness = plant.link_values[k, :2]
    near, far = (plant.inertia[plant.body_coordinate[b]] for b in plant.link_body[k])
    # a sensor on the driven side sees the antiresonance first
    square = stiffness * (ratio**2 / far + (1 / near if effect.far else 0.0))
    if square > (2 * np.pi * IN_BAND * logs.bandwidth) ** 2:
        return False
    if effect.values["damping_ratio"] > OVERDAMPED:
        return False
    changes = [b[0] - a[0] for b, a in zip(before.left, fit.left, strict=True)]
    return driven_share(changes, fit.drive) >= DRIVEN


def driven_share(changes: Sequence[Floats], drive: Sequence[Floats]) -> float:
    """Share of the power of signals that is coherent with the drive."""
    driven = total = 0.0
    for change, push in zip(changes, drive, strict=True):
        length = change.size // SEGMENTS
        if length < SHORTEST_SEGMENT:
            continue
        _, cross = csd(push, change, nperseg=length)
        _, one = welch(push, nperseg=length)
        _, two = welch(change, nperseg=length)
        driven += float(np.sum(np.abs(cross) ** 2 / np.maximum(one, 1e-300)))
        total += float(np.sum(two))
    return driven / total if total > 0 else 1.0


def refit(fit: ChainFit, candidate: Candidate, logs: Balance, jobs: int = 2) -> ChainFit:
    """Fit again with a candidate in the model, from its starting values."""
    model = fit.model.with_values(candidate.values).with_effect(candidate.placed)
    belongs = {m.name: fit.state.nuisance(m.name) for m in logs.motions}
    for log, shift in candidate.zero.items():
        old = belongs.get(log, Nuisance())
        belongs[log] = Nuisance({**old.zero, candidate.placed.key: shift}, old.twist)
    for log, twist in candidate.twist.items():
        belongs[log] = Nuisance(belongs[log].zero, {**belongs[log].twist, **twist})
    return fit_chain(State(model, belongs), logs, jobs=jobs, iterations=SETTLE)


def _simplest_first(
    trials: list[tuple[Candidate, ChainFit, float]],
) -> list[tuple[Candidate, ChainFit, float]]:
    """Best first, but a simpler effect that explains nearly the same goes before it."""
    if not trials:
        return []
    best, _, top = trials[0]
    near = [
        t for t in trials
        if t[2] >= NEARLY * top and similarity(t[0].score, best.score) >= ALIKE
    ]  # fmt: skip
    near.sort(key=lambda t: rank(t[0].name))
    return [*near, *(t for t in trials if all(t is not n for n in near))]


def rank(name: str) -> int:
    """Place in the order in which engineers think of effects; dead time and lag alike."""
    name = "drive_delay" if name == "current_lag" else name
    return SIMPLE.index(name) if name in SIMPLE else len(SIMPLE)


def _delete(
    fit: ChainFit, fit_logs: Balance, held_logs: Balance, rungs: Sequence[Rung], jobs: int
) -> tuple[ChainFit, tuple[str, ...]]:
    """Give up effects that later ones have made superfluous."""
    deleted: list[str] = []
    for rung in rungs[:-1]:
        if rung.key not in {e.key for e in fit.model.effects}:
            continue
        if carries_others(fit.model, rung.key):
            continue
        state = State(_handed_over(fit.model, rung.key), fit.state.logs)
        without = fit_chain(without_zeros(state, rung.key), fit_logs, jobs=jobs)
        lost = gain_of((without.left, without.drive), (fit.left, fit.drive))
        if lost < least_gain(rung.key.partition("@")[0]):
            fit = without
            deleted.append(rung.key)
    return fit, tuple(deleted)


def _handed_over(model: ChainModel, key: str) -> ChainModel:
    """Return the model without an effect; a dead time passes to a lag beside it, and back."""
    gone = next(e for e in model.effects if e.key == key)
    other = {"drive_delay": "current_lag", "current_lag": "drive_delay"}.get(gone.name)
    heir = next((e for e in model.effects if e.name == other and e.on == gone.on), None)
    rest = model.without([key])
    if heir is None:
        return rest
    (late,), (name,) = gone.values.values(), heir.values
    return rest.with_effect(heir._replace(values={name: heir.values[name] + late}))


def carries_others(model: ChainModel, key: str) -> bool:
    """Whether other effects sit on a body or link that this one makes, or shape its friction."""
    name, _, on = key.partition("@")
    if name == "coulomb_friction" and any(e.on == on and e.name in SHAPES for e in model.effects):
        return True
    places = {e.on for e in model.effects if e.key != key}
    own = {b.name for b in model.rig.bodies} | {k.name for k in model.rig.links}
    made = set(model.layout.bodies) | set(model.layout.links)
    return key.startswith("shaft_compliance") and bool(places & (made - own))


def without_zeros(state: State, key: str) -> State:
    logs = {
        log: Nuisance({k: v for k, v in n.zero.items() if k != key}, n.twist)
        for log, n in state.logs.items()
    }
    return State(state.model, logs)


def held_outcome(state: State, held: Balance, fitted: Balance, jobs: int = 2) -> Outcome:
    """Residual and drive on held-out logs; what belongs to a log alone is fitted there."""
    return residuals(held_state(state, held, fitted, jobs=jobs), held)


def held_state(state: State, held: Balance, fitted: Balance, *, jobs: int = 2) -> State:
    """Fit the twists and encoder zeros of logs that were not fitted, and nothing else."""
    known = {m.name for m in fitted.motions}
    reference = fitted.motions[0].name
    frees: list[Free] = []
    for motion in held.motions:
        if motion.name not in known:
            frees += log_parameters(state.model, held, motion.name, reference)
    if not frees:
        return state
    state = _phases(state, held, known)
    return fit_chain(state, held, frees=frees, jobs=jobs, iterations=4).state


def _phases(state: State, held: Balance, known: set[str]) -> State:
    """Encoder zeros of new logs, by the phase that each harmonic effect has there."""
    from dmptm_ctrl.diagnosis.ladder_candidates import unit_columns
    from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE

    logs = dict(state.logs)
    for effect in state.model.effects:
        if not has_phase(state.model, held, effect):
            continue
        bare = State(state.model.without([effect.key]), logs)
        left, drive = residuals(bare, held)
        shapes = {k: v for k, v in effect.values.items() if k == "order"}
        order = shapes.get("order", 1.0)
        view = Tangent(
            ChainFit(bare, (), left, drive, tuple(p[..., None][..., :0] for p in left),
                     np.ones(left[0].shape[0]), 0.0),
            held,
        )  # fmt: skip
        chain = CHAIN_CATALOGUE[effect.name]
        columns = unit_columns(view, chain, effect.on, shapes, ("cosine", "sine"))
        here = effect.values["cosine"] - 1j * effect.values["sine"]
        for k, motion in enumerate(held.motions):
            if motion.name in known:
                continue
            found = np.linalg.lstsq(columns[k][0], -left[k][0], rcond=None)[0]
            there = found[0] - 1j * found[1]
            old = logs.get(motion.name, Nuisance())
            shift = float(np.angle(there / here) / order) if here != 0 else 0.0
            logs[motion.name] = Nuisance({**old.zero, effect.key: shift}, old.twist)
    return replace(state, logs=logs)
