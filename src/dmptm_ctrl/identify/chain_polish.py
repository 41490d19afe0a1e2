"""Refine a chain's numbers so that its free run, not only its balance of torques, fits.

The balance of torques needs accelerations, whose noise biases what is fitted; a simulation does
not. The logs are run in stretches, each from the measured state; a stretch is the whole log
where the model follows it that long, and shorter where it does not.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import isfinite

import numpy as np

from dmptm_ctrl.identify.chain_fit import ChainFit, Free, State
from dmptm_ctrl.identify.chain_motion import Floats, Motion
from dmptm_ctrl.identify.inverse_dynamics import Balance, kinematic, measured_motion
from dmptm_ctrl.simulate.chain import march
from dmptm_ctrl.simulate.chain_model import ChainModel

FOLLOWS = 0.5  # normalised speed error above which a stretch is too long
SHORTEST = 40  # samples
LARGEST_STEP = 0.3  # of a number's scale, per iteration
SAMPLES = 100_000  # of all logs together; of longer campaigns the first ones
ITERATIONS = 6
DIFFERENCE = 1e-3
NEAR = 0.3  # normalised position error above which a position has drifted and says nothing


@dataclass(frozen=True)
class Stretch:
    """Samples of a log that are run from a measured state."""

    motion: Motion
    start: int
    stop: int


def stretches_of(state: State, balance: Balance) -> list[Stretch]:
    """Cut logs into the longest stretches that the model follows."""
    found = []
    left = SAMPLES
    for motion in balance.motions:
        size = min(motion.time.size, max(left, 0))
        if size < SHORTEST:
            continue
        left -= size
        length = size
        while length > 2 * SHORTEST:
            parts = _cut(motion, size, length)
            runs = [_differences(state, balance, part) for part in parts]
            speed = float(np.mean([np.mean(r[0] ** 2) for r in runs]))
            if isfinite(speed) and speed < FOLLOWS**2:
                break
            length = (length + 1) // 2
        found += _cut(motion, size, length)
    return found


def _cut(motion: Motion, size: int, length: int) -> list[Stretch]:
    count = max(size // length, 1)
    return [Stretch(motion, k * length, (k + 1) * length) for k in range(count)]


def _differences(state: State, balance: Balance, stretch: Stretch) -> Floats:
    """Simulated less measured speed and position per point, normalised, (signals, samples)."""
    model, motion = state.model, stretch.motion
    layout = model.layout
    nuisance = state.nuisance(motion.name)
    measured, bodies = measured_motion(model, balance, motion, nuisance)
    reach = kinematic(model)
    base = next(iter(measured))
    s, e = stretch.start, stretch.stop
    position: dict[str, float] = {}
    speed: dict[str, float] = {}
    seen: dict[int, str] = {}
    for body in layout.bodies:
        seen.setdefault(layout.coordinate[body], body)
    zeros: dict[int, float] = {}
    for group, body in seen.items():
        r = layout.ratio[body]
        if group in measured:
            q, v = measured[group][0][s], measured[group][1][s]
            zeros[group] = sum(
                value for link, value in nuisance.twist.items()
                if link in layout.links and _behind(model, link, group)
            ) / r  # fmt: skip
            position[body], speed[body] = r * (q + zeros[group]), r * v
        else:
            ratio = reach[group] / reach[base]
            position[body] = r * measured[base][0][s] * ratio
            speed[body] = r * measured[base][1][s] * ratio
    u = np.array([motion.u[name][s:e] for name in layout.inputs])
    run = march(model, u, motion.dt, position=position, speed=speed)
    rows = []
    for group, (q, v, _) in measured.items():
        if group not in bodies or group not in seen:
            continue
        body, r = seen[group], layout.ratio[seen[group]]
        size = float(np.sqrt(np.mean(v**2))) or 1.0
        rows.append((run.speed(body) / r - v[s:e]) / size)
        travel = float(np.std(q)) or 1.0
        away = run.position(body) / r - zeros[group] - q[s:e]
        rows.append(away / travel)
    out = np.array(rows)
    # speeds first
    return np.clip(np.nan_to_num(np.concatenate([out[0::2], out[1::2]]), nan=1e3), -1e3, 1e3)


def _behind(model: ChainModel, link: str, group: int) -> bool:
    plant, layout = model.plant(), model.layout
    k = layout.links.index(link)
    return plant.body_coordinate[plant.link_body[k, 1]] == group


def simulation_error(state: State, balance: Balance, stretches: Sequence[Stretch]) -> float:
    """Normalised rms error of the speed over stretches."""
    parts = [_differences(state, balance, s) for s in stretches]
    parts = [p[: p.shape[0] // 2] for p in parts]
    total = sum(p.size for p in parts)
    return float(np.sqrt(sum(float(np.sum(p**2)) for p in parts) / max(total, 1)))


def polish(fit: ChainFit, balance: Balance, *, jobs: int = 2) -> State:
    """Return a state that serves the free run as well as the balance of torques.

    Both errors, each relative to what it is after the fit, are lowered together; the balance by
    its tangent at the fit.

    Parameters
    ----------
    fit : ChainFit
        Of the balance.
    balance : Balance
        Logs to follow.
    """
    chosen = [
        j for j, f in enumerate(fit.frees) if f.kind in ("value", "effect") and f.name != "order"
    ]
    frees = [fit.frees[j] for j in chosen]
    state = fit.state
    stretches = stretches_of(state, balance)
    if not frees or not stretches:
        return state
    center = np.array([state.get(f) for f in frees])
    scales = np.array([f.scale for f in frees])
    # The first equation only: noise of the twist biases the others.
    left = np.concatenate([p[0] for p in fit.left])
    slopes = np.concatenate([p[0][:, chosen] for p in fit.slopes])
    size = float(left @ left) or 1.0
    bend, tilt = slopes.T @ slopes / size, slopes.T @ left / size
    near = [_keeps_place(_differences(state, balance, s)) for s in stretches]
    now = state
    vector = _vector(now, balance, stretches, near)
    unit = float(vector @ vector) or 1.0
    cost = 2.0
    for _ in range(ITERATIONS):
        columns = _slopes(now, balance, stretches, near, frees, scales, vector, jobs)
        moved = (np.array([now.get(f) for f in frees]) - center) / scales
        square = columns.T @ columns / unit + bend
        slope = columns.T @ vector / unit + tilt + bend @ moved
        damping = 1e-4 * np.trace(square) / len(frees)
        better = None
        for _ in range(5):
            step = -np.linalg.solve(square + damping * np.eye(len(frees)), slope)
            step = np.clip(step, -LARGEST_STEP, LARGEST_STEP)
            values = [
                float(np.clip(now.get(f) + s * d, f.low, f.high))
                for f, s, d in zip(frees, scales, step, strict=True)
            ]
            trial = now.moved(frees, values)
            new = _vector(trial, balance, stretches, near)
            away = (np.array(values) - center) / scales
            trial_cost = float(new @ new) / unit + 1.0 + float(2 * tilt @ away + away @ bend @ away)
            if isfinite(trial_cost) and trial_cost < cost:
                better = trial
                break
            damping = damping * 10 + 1e-9
        if better is None:
            break
        gain = 1 - trial_cost / cost
        now, vector, cost = better, new, trial_cost
        if gain < 1e-3:
            break
    return now


def _keeps_place(differences: Floats) -> bool:
    """Whether the positions of a stretch have not drifted off."""
    positions = differences[differences.shape[0] // 2 :]
    return bool(np.sqrt(np.mean(positions**2)) < NEAR)


def _vector(
    state: State, balance: Balance, stretches: Sequence[Stretch], near: Sequence[bool]
) -> Floats:
    """All differences in one vector, thinned to the bandwidth; positions where they tell."""
    parts = []
    for s, keeps in zip(stretches, near, strict=True):
        step = max(s.motion.step, 1)
        rows = _differences(state, balance, s)
        parts.append(rows[: rows.shape[0] if keeps else rows.shape[0] // 2, ::step].ravel())
    return np.concatenate(parts)


def _slopes(
    state: State,
    balance: Balance,
    stretches: Sequence[Stretch],
    near: Sequence[bool],
    frees: Sequence[Free],
    scales: Floats,
    vector: Floats,
    jobs: int,
) -> Floats:
    def column(j: int) -> Floats:
        step = DIFFERENCE * scales[j]
        here = state.get(frees[j])
        if here + step > frees[j].high:
            step = -step
        moved = _vector(state.moved([frees[j]], [here + step]), balance, stretches, near)
        return (moved - vector) / (step / scales[j])

    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        return np.array(list(pool.map(column, range(len(frees))))).T
