"""Candidates that are tried at finite sizes: springs, gaps, and what is no sum of amplitudes."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.diagnosis.ladder_score import Score, Tangent
from dmptm_ctrl.identify.chain_fit import ChainFit, State, jacobian, residuals
from dmptm_ctrl.identify.chain_free import Scales
from dmptm_ctrl.identify.chain_motion import Motion
from dmptm_ctrl.identify.chain_start import (
    drive_of,
    ends_of,
    regress,
    regress_gap,
    spring_values,
    unknown_inertias,
)
from dmptm_ctrl.identify.inverse_dynamics import Nuisance
from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE
from dmptm_ctrl.simulate.chain_model import Placed

Floats = NDArray[np.float64]

HIDDEN_MODES = 18  # antiresonances tried
SHARES = (0.25, 0.6)  # of the inertia behind a spring, tried
EXCERPT = 40_000  # samples on which many tries are compared
EXCERPT_ROWS = 400  # of the balance in them, at least
EXCERPT_LOGS = 3
FINALISTS = 3  # tries that are looked at on all logs


class Candidate(NamedTuple):
    """An effect at a place with starting values, and its score on the current residual.

    Attributes
    ----------
    tries : int
        How many independent starting values were looked at, for the test's level.
    zero : dict of log to float
        Shift of the angle in logs after the first.
    """

    placed: Placed
    score: Score
    tries: int
    zero: dict[str, float] = {}  # noqa: RUF012  (a NamedTuple's default is not changed)
    values: Mapping[str, float] = {}
    twist: Mapping[str, Mapping[str, float]] = {}

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.placed.name


def finite(tangent: Tangent, tries: list[Placed]) -> Candidate:
    """Best of several finite sizes; the gain is that of the size itself, parameters refitted."""
    best: Candidate | None = None
    power = float(tangent.left @ tangent.left)
    for placed in tries:
        state = State(tangent.fit.model.with_effect(placed), tangent.fit.state.logs)
        moved, _ = residuals(state, tangent.balance)
        change = tangent.stack(moved) - tangent.stack(tangent.fit.left)
        score = tangent.score(change[:, None])
        new = tangent.project(tangent.stack(moved))
        gain = 1.0 - float(new @ new) / power if power > 0 else 0.0
        if score.amplitudes[0] < 0 and _one_sided(placed):
            gain = min(gain, 0.0)
        elif not _one_sided(placed):
            gain = score.gain
            values = {
                k: v * float(score.amplitudes[0]) if k in CHAIN_CATALOGUE[placed.name].amplitudes
                else v
                for k, v in placed.values.items()
            }  # fmt: skip
            placed = placed._replace(values=values)
        if best is None or gain > best.score.gain:
            best = Candidate(placed, score._replace(gain=gain), len(tries))
    assert best is not None
    return best


def joint(tangent: Tangent, one: Placed, other: Placed) -> tuple[Score, tuple[Placed, Placed]]:
    """Score two effects together, and give both their sizes."""
    columns = []
    for placed in (one, other):
        state = State(tangent.fit.model.with_effect(placed), tangent.fit.state.logs)
        moved, _ = residuals(state, tangent.balance)
        columns.append(tangent.stack(moved) - tangent.stack(tangent.fit.left))
    score = tangent.score(np.column_stack(columns))

    def sized(placed: Placed, by: float) -> Placed:
        return placed._replace(values={k: v * by for k, v in placed.values.items()})

    return score, (sized(one, score.amplitudes[0]), sized(other, score.amplitudes[1]))


def _one_sided(placed: Placed) -> bool:
    """Whether an effect's size cannot be negative."""
    chain = CHAIN_CATALOGUE[placed.name]
    return all(p.low >= 0 for p in chain.keep if p.name in placed.values and not p.bank)


def compliance(tangent: Tangent, present: set[tuple[str, str]]) -> Iterator[Candidate]:
    """Springs in rigid links; of a drive without links, in its body."""
    model, balance = tangent.fit.model, tangent.balance
    if any(name == "shaft_compliance" for name, _ in present):
        return
    top = 1.5 * balance.bandwidth
    duration = max(float(m.time[-1]) for m in balance.motions)
    low = max(5.0 / duration, top / 300.0)
    modes = 2 * np.pi * np.geomspace(low, top, HIDDEN_MODES)
    for link in model.rig.links:
        if not link.rigid:
            continue
        ends = ends_of(model, balance, link.name)
        if ends is None:
            tries = [_placed(link.name, 0.5, float(w), 0.05) for w in modes]
            yield finite_structure(tangent, tries)
        else:
            spring = regress(balance, *ends, drive_of(model, balance))
            start = _placed(link.name, 0.5, spring.antiresonance, spring.damping_ratio)
            values = unknown_inertias(model, link.name, spring)
            yield finite_structure(tangent, [start], values)
    if model.rig.links:
        return
    for body in model.rig.bodies:
        own = [p for p in balance.points if p.body == body.name]
        far = tuple(s for p in own[1:] for s in p.sensors)
        if far:
            spring = regress(
                balance, (own[0].name, 1.0), (own[1].name, 1.0), drive_of(model, balance)
            )
            share = spring.far / (spring.near + spring.far)
            start = _placed(body.name, share, spring.antiresonance, spring.damping_ratio, far)
            yield finite_structure(tangent, [start])
            continue
        sides = [(), own[0].sensors] if own else [()]  # the sensor may be behind the spring
        for side in sides:
            tries = [
                _placed(body.name, share, float(w), 0.05, side) for w in modes for share in SHARES
            ]
            yield finite_structure(tangent, tries)


def _placed(
    on: str, share: float, antiresonance: float, damping: float, far: tuple[str, ...] = ()
) -> Placed:
    values = {"share": share, "antiresonance": antiresonance, "damping_ratio": damping}
    return Placed("shaft_compliance", on, values, far)


def finite_structure(
    tangent: Tangent,
    tries: list[Placed],
    values: Mapping[str, float] | None = None,
    twist: Mapping[str, Mapping[str, float]] | None = None,
) -> Candidate:
    """As `finite`, for changes that may add coordinates: then the first equation is compared.

    Parameters
    ----------
    values, twist : mappings, optional
        Declared quantities that change with it, and twists per log.
    """
    if len(tries) > FINALISTS:
        part = excerpt(tangent)
        if part is not tangent:
            scored = [(_structure(part, [t], values, twist).score.gain, t) for t in tries]
            scored.sort(key=lambda s: -s[0])
            best = _structure(tangent, [t for _, t in scored[:FINALISTS]], values, twist)
            return best._replace(tries=len(tries))
    return _structure(tangent, tries, values, twist)


def excerpt(tangent: Tangent) -> Tangent:
    """Return the stretches of the logs in which most is left; the same if that is all of them."""
    fit, balance = tangent.fit, tangent.balance
    total = sum(m.time.size for m in balance.motions)
    size = max(EXCERPT, EXCERPT_ROWS * max(m.step for m in balance.motions))
    if total <= 1.5 * size:
        return tangent
    power = [float(np.sum(part**2)) for part in fit.left]
    largest = sorted(range(len(power)), key=lambda k: -power[k])[:EXCERPT_LOGS]
    cut = [
        balance.motions[k].stretch(*_richest(balance.motions[k], fit.left[k], size // len(largest)))
        for k in largest
    ]
    few = replace(balance, motions=tuple(cut), columns={})
    left, drive = residuals(fit.state, few)
    frees = tuple(f for f in fit.frees if f.kind in ("value", "effect"))
    slopes = jacobian(fit.state, few, frees, left, jobs=1)
    return Tangent(replace(fit, frees=frees, left=left, drive=drive, slopes=slopes), few)


def _richest(motion: Motion, left: Floats, size: int) -> tuple[int, int]:
    """First and last sample of the stretch of a length in which most is left."""
    if motion.time.size <= size:
        return 0, motion.time.size
    power = np.concatenate(([0.0], np.cumsum(np.sum(left**2, axis=0))))
    rows = max(min(size // motion.step, power.size - 1), 1)
    start = int(np.argmax(power[rows:] - power[:-rows])) * motion.step
    start = min(start, motion.time.size - size)
    return start, start + size


def _structure(
    tangent: Tangent,
    tries: list[Placed],
    values: Mapping[str, float] | None,
    twist: Mapping[str, Mapping[str, float]] | None,
) -> Candidate:
    best: Candidate | None = None
    count = tangent.fit.left[0].shape[0]
    first = Tangent(_first_equation(tangent), tangent.balance)
    for placed in tries:
        model = tangent.fit.model.with_values(values or {}).with_effect(placed)
        logs = dict(tangent.fit.state.logs)
        for log, links in (twist or {}).items():
            old = logs.get(log, Nuisance())
            logs[log] = Nuisance(old.zero, {**old.twist, **links})
        state = State(model, logs)
        try:
            moved, _ = residuals(state, tangent.balance)
        except ValueError:
            continue
        if moved[0].shape[0] == count:
            first = tangent
        power = float(first.left @ first.left)
        change = first.stack(moved) - first.stack(first.fit.left)
        if not np.isfinite(change).all():
            continue
        score = first.score(change[:, None])
        new = first.project(first.stack(moved))
        gain = 1.0 - float(new @ new) / power if power > 0 else 0.0
        if best is None or gain > best.score.gain:
            best = Candidate(
                placed, score._replace(gain=gain), len(tries), {}, values or {}, twist or {},
            )  # fmt: skip
    if best is None:  # no start could be simulated
        nothing = tangent.score(np.zeros((tangent.left.size, 1)))
        return Candidate(tries[0], nothing, len(tries))
    return best


def _first_equation(tangent: Tangent) -> ChainFit:
    fit = tangent.fit
    return replace(
        fit,
        left=tuple(p[:1] for p in fit.left),
        slopes=tuple(p[:1] for p in fit.slopes),
        weights=fit.weights[:1],
    )


def backlash(
    tangent: Tangent, scales: Scales, present: set[tuple[str, str]]
) -> Iterator[Candidate]:
    """Gaps in links that are not rigid."""
    model, balance = tangent.fit.model, tangent.balance
    for link in model.layout.links:
        if ("backlash", link) in present:
            continue
        if any(k.name == link and k.half_gap is not None for k in model.rig.links):
            continue
        seen = {model.layout.coordinate[model.layout.sensor_body[p.name]] for p in balance.points}
        if 0 not in seen:
            continue  # through a gap, the driven body's motion does not follow from the other's
        ends = None
        if any(k.name == link for k in model.rig.links):
            ends = ends_of(model, balance, link)
        if ends is None:
            sizes = [s * scales.position for s in (1e-5, 1e-4, 1e-3, 1e-2)]
            yield finite(tangent, [Placed("backlash", link, {"half_gap": s}) for s in sizes])
            continue
        if not all(p in m.angles for m in balance.motions for p, _ in ends):
            continue  # an integrated speed drifts by more than a gap
        gap = regress_gap(balance, *ends, drive_of(model, balance))
        if gap.half_gap > 0:
            start = Placed("backlash", link, {"half_gap": gap.half_gap})
            values = {**unknown_inertias(model, link, gap.spring)}
            values |= spring_values(model, link, gap.spring)
            ratio = model.value(f"link.{link}.ratio")
            twist = {log: {link: zero / ratio} for log, zero in gap.zero.items()}
            yield finite_structure(tangent, [start], values, twist)
