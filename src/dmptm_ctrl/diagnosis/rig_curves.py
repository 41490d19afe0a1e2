"""Curves over what was measured: what no named effect explains, and how much of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from dmptm_ctrl.diagnosis.candidate import LEVEL, Floats
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.identify.inverse_dynamics import Balance, measured_motion
from dmptm_ctrl.identify.measured_motion import Motion
from dmptm_ctrl.identify.rig_fit import RigFit

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.rig_evidence import RigState

KNOTS = 17
STIFFNESS = (1e-3, 1e-1, 1e1)  # weights of the second differences, tried
EDGES = 0.002  # share of the rows beyond the first and last knot
STEADY = 0.02  # of the highest speed; slower is at rest

Signal = Callable[[Motion], Floats]


@dataclass(frozen=True, eq=False)
class Columns:
    """Hat functions of a variable: alike, odd in the direction, and as factor of the drive."""

    parts: tuple[Floats, ...]  # (equations, rows, kinds · knots) per log


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve over one variable, fitted to what a model leaves.

    Attributes
    ----------
    variable : str
    kind : str
        What the curve gives: a torque, a friction, or a factor of the drive.
    knots, values : (k,) array
    evidence : float
        Fall of −2 log-likelihood on all logs, less two per effective parameter.
    held_gain, share : float
        Fall on the held-out logs, and share of their mean square that goes.
    left : tuple of arrays
        What stays of the held-out logs' residual, (equations, rows) per log.
    """

    variable: str
    kind: str
    knots: Floats
    values: Floats
    evidence: float
    held_gain: float
    share: float
    left: tuple[Floats, ...]


KINDS = "torque", "friction", "gain"


def variables_of(fit: RigFit) -> dict[str, Signal]:
    """Signals that a residual may depend on, by name."""
    balance, model = fit.likelihood.balance, fit.model
    layout = model.layout
    _, bodies = measured_motion(model, balance, balance.motions[0])
    found: dict[str, Signal] = {}

    def motion_of(group: int, body: str, place: int) -> Signal:
        return lambda m: layout.ratio[body] * measured_motion(model, balance, m)[0][group][place]

    for group, body in bodies.items():
        found[f"theta:{body}"] = motion_of(group, body, 0)
        found[f"omega:{body}"] = motion_of(group, body, 1)
    for source in layout.inputs:
        found["u" if len(layout.inputs) == 1 else f"u:{source}"] = _input(source)
        if len(layout.inputs) == 1:
            found["du_dt"] = _rate(source)
    found["time"] = lambda m: m.time
    first = (
        next(iter(found.values())) if not bodies else found[f"omega:{next(iter(bodies.values()))}"]
    )
    found["time_at_rest"] = lambda m: _rested(first(m), m.dt)
    return found


def _input(source: str) -> Signal:
    return lambda m: m.u[source]


def _rate(source: str) -> Signal:
    return lambda m: np.gradient(m.u[source], m.dt)


def _rested(speed: Floats, dt: float) -> Floats:
    """Duration of the last rest before each sample [s]."""
    still = np.abs(speed) < STEADY * np.abs(speed).max(initial=0.0)
    out, current, last = np.zeros(speed.size), 0.0, 0.0
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    start = 0
    for stop in (*edges + 1, speed.size):
        if still[start]:
            last = current = (stop - start) * dt
        out[start:stop] = last if current else 0.0
        start = stop
    return out


def knots_of(fit: RigFit, signal: Signal) -> Floats:
    """Knots over the range of a variable, by its quantiles half, evenly half."""
    every = np.concatenate([signal(m) for m in fit.likelihood.balance.motions])
    low, high = np.quantile(every, [EDGES, 1 - EDGES])
    return np.linspace(low, high, KNOTS) if high > low else np.zeros(0)


def curve_columns(fit: RigFit, balance: Balance, signal: Signal) -> Columns:
    """Change of the residual by the value at each knot, per log."""
    knots, count = knots_of(fit, signal), fit.left[0].shape[0]
    gains = fit.model.plant().input_values[:, 0]
    parts = []
    _, bodies = measured_motion(fit.model, balance, balance.motions[0])
    group = next(iter(bodies))
    for m in balance.motions:
        if knots.size == 0:
            parts.append(np.zeros((count, m.rows.size, 0)))
            continue
        x = np.clip(signal(m), knots[0], knots[-1])
        place = (x - knots[0]) / (knots[1] - knots[0])
        hats = np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(KNOTS)))
        sign = np.sign(measured_motion(fit.model, balance, m)[0][group][1])
        push = sum(g * m.u[n] for g, n in zip(gains, fit.model.layout.inputs, strict=True))
        both = [m.reduce(f * h) for f in (np.ones_like(x), sign, push) for h in hats.T]
        part = np.zeros((count, m.rows.size, len(both)))
        part[0] = np.array(both).T
        parts.append(part)
    return Columns(tuple(parts))


def curves(state: "RigState") -> list[Curve]:
    """Fit curves over every variable to what a model leaves, most evidence first."""
    found = []
    for name, signal in variables_of(state.fit).items():
        knots = knots_of(state.fit, signal)
        if knots.size == 0:
            continue
        own = curve_columns(state.fit, state.fit.likelihood.balance, signal).parts
        held = curve_columns(state.fit, state.held, signal).parts
        for k, kind in enumerate(KINDS):
            if kind == "gain" and name.startswith("du"):
                continue
            cut = slice(k * KNOTS, (k + 1) * KNOTS)
            one = _fit(state, [p[..., cut] for p in own], [p[..., cut] for p in held])
            if one is not None:
                values, evidence, held_gain, share, left = one
                found.append(Curve(name, kind, knots, values, evidence, held_gain, share, left))
    return sorted(found, key=lambda c: -c.evidence)


def accepted(found: Sequence[Curve]) -> list[Curve]:
    """Curves that the logs demand, fitted and held-out ones alike."""
    return [c for c in found if c.evidence > LEVEL and c.held_gain > 0.0]


def better_without_names(selection: Selection) -> list[Curve]:
    """Return curves beside the declared model, where one explains more than all effects do.

    Names next to something that is on no list then explain only a part of it.
    """
    base, final = selection.base, selection.final
    found = accepted(curves(base))
    like, fall = base.fit.likelihood, 0.0
    for likelihood, before, after in (
        (like, base.fit.left, final.fit.left),
        (like.on(base.held), base.held_left[0], final.held_left[0]),
    ):
        both = likelihood.between(base.fit.model, final.fit.model)
        fall += both.surprise(before, base.fit.model) - both.surprise(after, final.fit.model)
    numbers = sum(f.kind == "effect" for f in final.fit.frees)
    return found if found and found[0].evidence > fall - 2.0 * numbers + LEVEL else []


def predicted(state: "RigState", found: Sequence[Curve]) -> float:
    """Mean square that no model predicts, held out.

    What neither the model nor the best curve takes, less what neighbouring rows share: the noise
    of sensors is as large from row to row as over all rows, what a drive lacks is not.
    """
    lefts = [state.held_left[0], *(c.left for c in found)]
    return min(mean_square(x, state.held) * noise_share(x, state.held) for x in lefts)


def noise_share(left: Sequence[Floats], balance: Balance) -> float:
    """Share of the first equation's mean square that neighbouring rows do not share."""
    rows = [p[0] * m.moving for p, m in zip(left, balance.motions, strict=True)]
    power = sum(float(x @ x) for x in rows)
    shared = sum(float(x[1:] @ x[:-1]) for x in rows)
    return 1.0 - max(shared, 0.0) / power if power > 0.0 else 1.0


def curve_share(state: "RigState", found: Sequence[Curve]) -> float:
    """Share of the held-out mean square that the best curve takes."""
    before = mean_square(state.held_left[0], state.held)
    after = min((mean_square(c.left, state.held) for c in found), default=before)
    return max(1.0 - after / before, 0.0) if before > 0.0 else 0.0


def mean_square(left: Sequence[Floats], balance: Balance) -> float:
    """Mean square of the first equation over the rows that count."""
    rows = np.concatenate([p[0][m.moving] for p, m in zip(left, balance.motions, strict=True)])
    return float(np.mean(rows**2)) if rows.size else 0.0


def _fit(
    state: "RigState", own: Sequence[Floats], held: Sequence[Floats]
) -> tuple[Floats, float, float, float, tuple[Floats, ...]] | None:
    tangent, likelihood = state.tangent, state.fit.likelihood
    table = tangent.project(tangent.stack(own))
    size = float(np.linalg.norm(table))
    if size == 0.0:
        return None
    second = np.diff(np.eye(table.shape[1]), 2, axis=0)
    square = table.T @ table
    beyond, model = likelihood.on(state.held), state.fit.model
    before = state.held_left[0]
    best: tuple[float, Floats] | None = None
    for stiff in STIFFNESS:
        whole = square + (size**2 / len(square)) * (
            stiff * second.T @ second + 1e-8 * np.eye(len(square))
        )
        inverse = np.linalg.inv(whole)
        values = -inverse @ (table.T @ tangent.target)
        free = float(np.trace(inverse @ square))
        rest = tangent.target + table @ values
        gain = float(tangent.target @ tangent.target - rest @ rest) - 2.0 * free
        if best is None or gain > best[0]:
            best = gain, values
    assert best is not None
    values = best[1]
    after = tuple(b + h @ values for b, h in zip(before, held, strict=True))
    held_gain = beyond.surprise(before, model) - beyond.surprise(after, model)
    was, now = (mean_square(x, state.held) for x in (before, after))
    return values, best[0] + held_gain, held_gain, 1 - now / was if was > 0 else 0.0, after
