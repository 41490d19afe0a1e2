"""What cannot be: fitted values of effects that are impossible, whatever they explain."""

from collections.abc import Sequence
from math import isfinite, pi

import numpy as np
from scipy.signal import csd, welch

from dmptm_ctrl.diagnosis.candidate import (
    FIRM,
    NO_DIFFERENCE,
    differ,
    members,
    name_of,
)
from dmptm_ctrl.diagnosis.other_forms import other_form
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.measured_motion import NOISE_SHARE
from dmptm_ctrl.identify.rig_fit import RigFit
from dmptm_ctrl.simulate.along import acting_of, friction_along, law_along
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed

SPRING = SHAFT_COMPLIANCE.name
SHORTEST_LATE = 0.1  # sample times
PERIODS = 3.0  # of what goes by the clock that the longest log must hold
RESOLVED = 1.5  # lines of a log's spectrum within which frequencies are one
FURTHEST = 10  # harmonic looked at: of a square wave, friction's, it has a hundredth of the power
TURN = 72  # angles at which friction over a turn is looked at
FINER = 8  # points per line of that spectrum, between which a parabola finds its top
LINE = 0.3  # share of the input's power in one line, from which it is a wave
DRIVEN = 0.5  # of what a spring changes must be coherent with the drive
LEAST_LEFT = 0.1  # of the least that is declared of a part; less is nothing
SEGMENTS = 8  # of a log, for a coherence
SHORTEST_SEGMENT = 16  # rows


def amplitudes_of(fit: RigFit, key: str) -> list[int]:
    """Places of an effect's amplitudes among the fitted numbers.

    A constant beside another amplitude does not make an effect: it would be an offset.
    """
    entry = PLACED_CATALOGUE[name_of(key)]
    return _numbers_of(fit, key, [n for n in entry.amplitudes if n not in entry.effect.constants])


def _numbers_of(fit: RigFit, key: str, names: Sequence[str]) -> list[int]:
    """Places of parameters of an effect among the fitted numbers."""
    return [
        j for j, f in enumerate(fit.frees)
        if f.kind == "effect" and f.owner in members(key) and f.name in names
    ]  # fmt: skip


def objection(key: str, fit: RigFit, before: RigFit) -> str:
    """Why the fitted values of an effect are impossible; empty where they are not."""
    effect = fit.model.effect(members(key)[0])  # of several places of one make, at the first
    return (
        _nothing(key, fit)
        or _beyond(key, fit)
        or _too_short(effect, fit)
        or _pushes(effect, fit)
        or _by_the_drive(effect, fit)
        or _unseen(effect, fit, before)
        or _collapsed(fit, before)
        or other_form(effect, before)
    )


def _nothing(key: str, fit: RigFit) -> str:
    """An amplitude that does not differ from zero."""
    if name_of(key) == SPRING:
        return ""  # its absence is no value of its parameters
    own = amplitudes_of(fit, key)
    if not own:
        effect = fit.model.effect(members(key)[0])
        return "" if any(effect.values.values()) else "no amplitude differs from zero"
    sizes = np.array([fit.state.get(f := fit.frees[j]) / f.scale for j in own])
    return "" if differ(sizes, _covariance(fit, key, own)) else NO_DIFFERENCE


def _covariance(fit: RigFit, key: str, own: Sequence[int]) -> Floats:
    """Covariance of amplitudes beside the shape that was fitted with them.

    Whatever is known of the time constant of a slow drift, and so of its final size, it drifts.
    """
    shapes = _numbers_of(fit, key, PLACED_CATALOGUE[name_of(key)].shapes)
    both = fit.covariance[np.ix_([*own, *shapes], [*own, *shapes])]
    k = len(own)
    if not shapes:
        return both
    return both[:k, :k] - both[:k, k:] @ np.linalg.pinv(both[k:, k:], hermitian=True) @ both[k:, :k]


def _beyond(key: str, fit: RigFit) -> str:
    for free in (f for f in fit.frees if f.kind == "effect" and f.owner in members(key)):
        value = fit.state.get(free)
        if value != 0.0 and value in (free.low, free.high) and free.name != "share":
            return f"{free.name} would lie beyond what is possible"
    return ""


def _pushes(effect: Placed, fit: RigFit) -> str:
    """Friction that is more over a part of the turn, and would push over another."""
    order = effect.values.get("order")
    if PLACED_CATALOGUE[effect.name].site != "friction" or not order:  # on a slide it is a slope
        return ""
    layout, plant = fit.model.layout, fit.model.plant()
    angle = np.linspace(0.0, 2.0 * pi / float(order), TURN, endpoint=False)
    least, none, rubs = np.full(TURN, np.finfo(float).eps), np.zeros(TURN), np.zeros(TURN)
    for k, body in enumerate(layout.bodies):
        if layout.coordinate[body] == layout.coordinate[effect.on]:
            lever = abs(layout.ratio[body] / layout.ratio[effect.on])
            on = [e for e in fit.model.effects if e.on == body]
            acting = [acting_of(e) for e in on if PLACED_CATALOGUE[e.name].site == "friction"]
            factor, more = friction_along(acting, lever * angle, least, none, none)
            rubs = rubs + lever * (factor * law_along(least, plant.law[k]) + more)
    errors = [fit.errors[fit.frees[j].label] for j in amplitudes_of(fit, effect.key)]
    pushes = rubs.min() + FIRM * max(errors, default=0.0) < 0.0
    return "friction would push over a part of the turn" if pushes else ""


def _too_short(effect: Placed, fit: RigFit) -> str:
    """A time far below a sample is the sampling itself."""
    entry = PLACED_CATALOGUE[effect.name]
    least = SHORTEST_LATE * fit.likelihood.balance.motions[0].sample_time
    late = (p.name for p in entry.keep if entry.place == "input" and p.unit == "s")
    short = next((name for name in late if effect.values[name] <= least), "")
    return f"{short} is shorter than a tenth of a sample" if short else ""


def _by_the_drive(effect: Placed, fit: RigFit) -> str:
    """What goes by the clock must last, and must not be the drive itself."""
    motions = fit.likelihood.balance.motions
    f = effect.values.get("frequency")
    if f is None:
        return ""
    if f * fit.likelihood.balance.longest < PERIODS:
        return "the logs hold too few of its periods"
    error = fit.errors.get(f"{effect.key}.frequency", 0.0)
    if all(_harmonic(f, error, u, m.dt) for m in motions for u in m.u.values()):
        return "its frequency is a harmonic of the input"
    return ""


def _harmonic(f: float, error: float, u: Floats, dt: float) -> bool:
    """Whether a frequency is a multiple of that of a wave that the input is.

    A low multiple to the resolution of the log, or any to the frequency's own standard error.
    """
    size = FINER * u.size
    power = np.abs(np.fft.rfft((u - u.mean()) * np.hanning(u.size), size)) ** 2
    top = int(np.argmax(power))
    line = power[max(top - 2 * FINER, 0) : top + 2 * FINER + 1].sum()
    if not 0 < top < power.size - 1 or line < LINE * power.sum():
        return False
    before, peak, after = np.log(np.maximum(power[top - 1 : top + 2], 1e-300))
    wave = (top + 0.5 * (before - after) / (before - 2 * peak + after)) / (size * dt)
    nearest = max(round(f / wave), 1)
    distance = abs(f - nearest * wave)
    return distance <= FIRM * error or (nearest <= FURTHEST and distance * u.size * dt <= RESOLVED)


def _unseen(effect: Placed, fit: RigFit, before: RigFit) -> str:
    """A spring without a resonance that is seen, or that only filters a sensor's noise."""
    if effect.name != SPRING:
        return ""
    layout, plant = fit.model.layout, fit.model.plant()
    k = layout.links.index(effect.key if effect.key in layout.links else effect.on)
    ratio, stiffness = plant.link_values[k, :2]
    near, far = (plant.inertia[plant.body_coordinate[b]] for b in plant.link_body[k])
    # a sensor on the driven side sees the antiresonance first
    square = stiffness * (ratio**2 / far + (1 / near if effect.far else 0.0))
    if square > (2 * pi * fit.likelihood.balance.bandwidth) ** 2:
        return "its resonance lies above what the balance sees"
    if effect.values["damping_ratio"] > 0.5:
        return "it is damped so much that there is no resonance"
    changes = [b - a for b, a in zip(before.left, fit.left, strict=True)]
    drive = np.concatenate(fit.drive)
    for e in range(fit.left[0].shape[0]):
        rms = np.sqrt(np.mean(np.concatenate([c[e] for c in changes]) ** 2))
        loud = rms > FIRM * NOISE_SHARE * np.sqrt(np.mean(drive**2))
        if loud or driven_share([c[e] for c in changes], fit.drive) >= DRIVEN:
            return ""
    return "what it changes is no more than noise, and does not follow from the drive"


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


def gone(fit: RigFit) -> bool:
    """Whether next to nothing is left of an inertia or stiffness that is declared."""
    known = (f for f in fit.frees if f.kind == "value" and f.prior is not None)
    parts = (f for f in known if f.name in ("inertia", "stiffness"))
    least = ((f, LEAST_LEFT * fit.model.quantities[f.owner].range[0]) for f in parts)
    return any(fit.state.get(f) < value for f, value in least)


def _collapsed(fit: RigFit, before: RigFit) -> str:
    """A declared inertia or stiffness that is gone."""
    for free in fit.frees:
        if free.kind != "value" or free.name not in ("inertia", "stiffness"):
            continue
        low, high = fit.model.quantities[free.owner].range
        value, old = fit.state.get(free), before.model.value(free.owner)
        known = isfinite(low) and isfinite(high) and free.prior is not None
        least = low - (high - low) if known else 0.0
        if value < max(least, LEAST_LEFT * low if known else 0.02 * old) and value < old:
            return f"{free.owner} would collapse to {value:.3g}"
    return ""
