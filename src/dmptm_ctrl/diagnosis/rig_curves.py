"""Curves over what was measured: what no named effect explains, and how much of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import pi
from typing import TYPE_CHECKING

import numpy as np
from scipy.fft import rfft
from scipy.linalg import null_space

from dmptm_ctrl.diagnosis.budget import EXPLAINED, share
from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.identify.forces import measured_motion, resting
from dmptm_ctrl.identify.free_parameters import on_slide
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.likelihood import size_of
from dmptm_ctrl.identify.measured_motion import Motion
from dmptm_ctrl.identify.rig_fit import RigFit, residuals
from dmptm_ctrl.simulate.along import stops_along
from dmptm_ctrl.simulate.model import Floats

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.rig_state import RigState

KNOTS = 17
STIFFNESS = (1e-3, 1e-1, 1e1)  # weights of the second differences, tried
EDGES = 0.002  # share of the rows beyond the first and last knot
STEADY = 0.02  # of the highest speed; slower is at rest
HARMONICS = KNOTS // 2  # of a clock that knots over its period resolve
FINE = 2 * HARMONICS  # frequencies tried per one that a log separates: the last one in step
PERIODS = 2  # in the longest log, from which something comes by the clock

Signal = Callable[[Motion], Floats]


@dataclass(frozen=True, eq=False)
class Curve:
    """A curve over one variable, fitted to what a model leaves.

    Attributes
    ----------
    variable : str
    evidence : float
        Fall of −2 log-likelihood on all logs, less two per effective parameter.
    held_gain, share : float
        Fall on the held-out logs, and share of their mean square that goes.
    left : tuple of arrays
        What stays of the held-out logs' residual, (equations, rows) per log.
    kind : str
        "torque", "friction" (odd in the speed), "gain" (times the drive's torque), "hysteresis".
    period : float
        After which it comes again, in SI of the variable; 0 where it does not.
    """

    variable: str
    evidence: float
    held_gain: float
    share: float
    left: tuple[Floats, ...]
    kind: str = "torque"
    period: float = 0.0


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
        found["du_dt"] = lambda m: np.gradient(m.u[layout.inputs[0]], m.dt)
    found["time"] = lambda m: m.time
    first = next(s for name, s in found.items() if name.startswith("omega"))
    found["time_at_rest"] = lambda m: _rested(first(m), m.dt)
    return found


def _input(source: str) -> Signal:
    return lambda m: m.u[source]


def _rested(speed: Floats, dt: float) -> Floats:
    """Duration of the last rest before each sample [s]."""
    still = np.abs(speed) < STEADY * np.abs(speed).max(initial=0.0)
    out, last = np.zeros(speed.size), 0.0
    edges = np.flatnonzero(np.diff(still.astype(np.int8)))
    start = 0
    for stop in (*edges + 1, speed.size):
        if still[start]:
            last = (stop - start) * dt
        out[start:stop] = last
        start = stop
    return out


def _range(fit: RigFit, signal: Signal) -> tuple[float, float]:
    every = np.concatenate([signal(m) for m in fit.likelihood.balance.motions])
    low, high = np.quantile(every, [EDGES, 1 - EDGES])
    return float(low), float(high)


def _hats(x: Floats, low: float, high: float) -> Floats:
    """Hat functions at even knots, (n, knots)."""
    place = (np.clip(x, low, high) - low) / (high - low) * (KNOTS - 1)
    return np.maximum(0.0, 1.0 - np.abs(place[:, None] - np.arange(KNOTS)))


def torques_of(fit: RigFit, signal: Signal) -> list[tuple[str, Signal]]:
    """Torques that curves over a variable give, (n, knots) each: alike, odd, and by the drive."""
    low, high = _range(fit, signal)
    if not high > low:
        return []
    model, balance = fit.model, fit.likelihood.balance
    gains, inputs = model.plant().input_values[:, 0], model.layout.inputs
    group = next(iter(measured_motion(model, balance, balance.motions[0])[1]))

    def torque(m: Motion) -> Floats:
        return _hats(signal(m), low, high)

    def friction(m: Motion) -> Floats:
        speed = measured_motion(model, balance, m)[0][group][1]
        return (np.sign(speed) * ~resting(speed, m.rest_share))[:, None] * torque(m)

    def gain(m: Motion) -> Floats:
        push = np.sum([g * m.u[n] for g, n in zip(gains, inputs, strict=True)], axis=0)
        return np.asarray(push[:, None] * torque(m))

    return [("torque", torque), ("friction", friction), ("gain", gain)]


def columns_of(count: int, balance: Balance, torque: Signal) -> tuple[Floats, ...]:
    """Change of the residual by each column of a torque, (equations, rows, columns) per log."""
    parts = []
    for m in balance.motions:
        own = np.array([m.reduce(column) for column in torque(m).T]).T
        part = np.zeros((count, *own.shape))
        part[0] = own
        parts.append(part)
    return tuple(parts)


def curves(state: "RigState") -> list[Curve]:
    """Fit curves over every variable to what a model leaves, most evidence first."""
    fit, found = state.fit, []
    count = fit.left[0].shape[0]
    tried = variables_of(fit)
    families = [(n, *one, 0.0, 0.0) for n, s in tried.items() for one in torques_of(fit, s)]
    for name in (n for n in tried if n.startswith(("theta", "u"))):
        low, high = _range(fit, tried[name])
        if high > low:
            families.append((name, "hysteresis", _within(tried[name], low, high), 0.0, 0.0))
        body = name.partition(":")[2]
        if name.startswith("theta") and high - low > 2 * pi and not on_slide(fit.model, body):
            turn = _folded(tried[name], 2 * pi)
            families += [(name, *one, 2 * pi, 0.0) for one in torques_of(fit, turn)]
    over_time = dict(torques_of(fit, tried["time"]))
    for kind in ("torque", "gain"):
        period, price = _clock(state, over_time[kind])
        if period > 0.0:
            again = dict(torques_of(fit, _folded(tried["time"], period)))
            families.append(("time", kind, again[kind], period, price))
    push = columns_of(count, fit.likelihood.balance, over_time["gain"])
    drive = state.tangent.stack(push).sum(1)
    for name, kind, torque, period, price in families:
        if kind == "gain" and name.startswith("du"):
            continue
        own, held = (columns_of(count, b, torque) for b in (fit.likelihood.balance, state.held))
        # a drive that gives nothing and a model that needs nothing leave nothing
        of_drive = kind == "gain" or name.startswith("u")
        free = null_space(drive[None] @ state.tangent.stack(own)) if of_drive else np.eye(KNOTS)
        one = _fit(state, own, held, free, price)
        if one is not None:
            found.append(Curve(name, *one, kind, period))
    return sorted(found, key=lambda c: -c.evidence)


def _within(signal: Signal, low: float, high: float) -> Signal:
    half = 0.5 * (high - low) * np.geomspace(1.0 / KNOTS**2, 1.0, KNOTS)
    return lambda m: stops_along(np.asarray(signal(m), float), half)


def _folded(signal: Signal, period: float) -> Signal:
    return lambda m: signal(m) % period


def _clock(state: "RigState", torque: Signal) -> tuple[float, float]:
    """Period in a log's time that what is left follows most, and the price of looking for it.

    By the power of its harmonics, of all logs together: each begins the clock anew.
    """
    motions = state.fit.likelihood.balance.motions
    spacing = motions[0].dt * motions[0].step
    alike = [k for k, m in enumerate(motions) if np.isclose(m.dt * m.step, spacing)]
    rows = max(motions[k].rows.size for k in alike)
    size = FINE * rows
    total = np.zeros(size // 2 + 1, complex)
    for k in alike:
        m = motions[k]
        total += rfft(state.fit.left[k][0] * m.moving * m.reduce(torque(m).sum(1)), size)
    power = np.abs(total) ** 2
    first = PERIODS * FINE
    trials = np.arange(first, power.size // HARMONICS)
    if trials.size == 0:
        return 0.0, 0.0
    best = trials[np.argmax(sum(power[h * trials] for h in range(1, HARMONICS + 1)))]
    return size * spacing / float(best), 2.0 * float(np.log(trials.size / FINE))


def accepted(found: Sequence[Curve]) -> list[Curve]:
    """Curves that the logs demand, fitted and held-out ones alike."""
    return [c for c in found if c.evidence > LEVEL and c.held_gain > 0.0]


def better_without_names(selection: Selection) -> list[Curve]:
    """Return curves beside the declared model, where one explains more than all effects do.

    Names next to something that is on no list then explain only a part of it. They stay where they
    explain most of what the curve does: it bends as it likes, and a law is never quite right.
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
    if not found or found[0].evidence < fall - 2.0 * numbers + LEVEL:
        return []
    was, now = (mean_square(one.held_left[0], one.held) for one in (base, final))
    return [] if share(was, now, (1.0 - found[0].share) * was) >= EXPLAINED else found


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
    return size_of(rows, balance.bursts[0]) ** 2 if rows.size else 0.0


def _fit(
    state: "RigState",
    own: Sequence[Floats],
    held: Sequence[Floats],
    free: Floats,
    price: float,
) -> tuple[float, float, float, tuple[Floats, ...]] | None:
    """Fit values at the knots, of what `free` spans, and look at the logs that are held out."""
    fit, tangent = state.fit, state.tangent
    table = tangent.stack(own) @ free
    alone = tangent.project(table)
    square, aim = alone.T @ alone, -alone.T @ tangent.target
    size = float(np.trace(square))
    if size <= 1e-12 * float(np.sum(table**2)):
        return None
    second = np.diff(np.eye(len(free)), 2, axis=0) @ free
    best: tuple[float, float, Floats] | None = None
    for stiff in STIFFNESS:
        smooth = size / len(square) * (stiff * second.T @ second + 1e-8 * np.eye(len(square)))
        solved = np.linalg.inv(square + smooth)
        values = solved @ aim
        used = float(np.trace(solved @ square))
        gain = float(values @ (2.0 * aim - square @ values)) - 2.0 * used
        if best is None or gain > best[0]:
            best = gain, used, values
    assert best is not None
    values, shift = free @ best[2], tangent.shift(table @ best[2])
    moved = fit.state.after(fit.frees, shift)
    gains = []
    for balance, before, columns, start in (
        (fit.likelihood.balance, fit.left, own, fit.state),
        (state.held, state.held_left[0], held, state.held_state),
    ):
        there = start.moved(fit.frees, moved)
        try:
            left, _ = residuals(there, balance)
        except (ValueError, ArithmeticError):
            return None
        after = tuple(b + c @ values for b, c in zip(left, columns, strict=True))
        # a model that makes less of the readings' noise leaves less; that is no evidence
        like = fit.likelihood.on(balance).between(fit.model, there.model)
        with np.errstate(over="ignore", invalid="ignore"):  # moved numbers may run away
            gains.append(like.surprise(before, fit.model) - like.surprise(after, there.model))
        if not np.isfinite(gains[-1]):
            return None
    was, now = (mean_square(x, state.held) for x in (state.held_left[0], after))
    if like.noise is not None:
        now += float(like.noise_of(fit.model)[0] - like.noise_of(there.model)[0])
    evidence = sum(gains) - 2.0 * best[1] - price
    return evidence, gains[1], 1 - now / was if was > 0 else 0.0, after
