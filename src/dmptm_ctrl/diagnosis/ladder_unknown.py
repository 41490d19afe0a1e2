"""Is what the ladder leaves a function of something measured? Then an effect is on no list."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from dmptm_ctrl.diagnosis.ladder import Ladder
from dmptm_ctrl.diagnosis.ladder_score import Tangent
from dmptm_ctrl.identify.chain_fit import residuals
from dmptm_ctrl.identify.chain_motion import Motion

Floats = NDArray[np.float64]

KNOTS = 10
WORTH = 0.25  # share of the residual's square that one variable must explain, held out
ALPHA = 1e-4
SMALL = 1.0  # % of the torque; what is left below it is nobody's effect


def unexplained(ladder: Ladder) -> tuple[str, ...]:
    """Return the variables that the final residual depends on; empty where none stands out.

    Smooth curves of each variable, alike or odd in the direction of motion, are fitted to the
    residual of the fitted logs and must lower that of the held-out ones.
    """
    fit = ladder.final
    point = ladder.fit_logs.points[0].name
    left = np.concatenate([part[0] for part in fit.left])
    drive = np.concatenate(list(fit.drive))
    if not np.any(drive) or 100 * np.linalg.norm(left) / np.linalg.norm(drive) < SMALL:
        return ()
    tangent = Tangent(fit, ladder.fit_logs)
    held, _ = residuals(ladder.held_state, ladder.held_logs)
    found: list[tuple[float, str]] = []
    for name, signal in _variables(point, ladder).items():
        motions = (*ladder.fit_logs.motions, *ladder.held_logs.motions)
        everything = np.concatenate([signal(m) for m in motions])
        low, high = np.quantile(everything, [0.005, 0.995])
        if not high > low:
            continue
        columns = [_columns(signal(m), m.v[point], low, high, m) for m in ladder.fit_logs.motions]
        count = fit.left[0].shape[0]
        parts = []
        for c in columns:
            part = np.zeros((count, *c.shape))
            part[0] = c
            parts.append(part)
        score = tangent.score(tangent.stack(parts))
        if score.p_value > ALPHA or score.gain < WORTH:
            continue
        before = after = 0.0
        for m, part in zip(ladder.held_logs.motions, held, strict=True):
            curve = _columns(signal(m), m.v[point], low, high, m) @ score.amplitudes
            before += float(part[0] @ part[0])
            after += float(np.sum((part[0] + curve) ** 2))
        if before > 0 and 1 - after / before >= WORTH:
            found.append((1 - after / before, name))
    return tuple(name for _, name in sorted(found, reverse=True)[:2])


def _variables(point: str, ladder: Ladder) -> dict[str, Callable[[Motion], Floats]]:
    source = next(iter(ladder.fit_logs.motions[0].u))
    found: dict[str, Callable[[Motion], Floats]] = {
        "omega_L": lambda m: m.v[point],
        "u": lambda m: m.u[source],
        "time": lambda m: m.time,
    }
    if any(point in m.angles for m in ladder.fit_logs.motions):
        found["theta_L"] = lambda m: m.q[point]
    return found


def _columns(x: Floats, v: Floats, low: float, high: float, motion: Motion) -> Floats:
    """Cubic B-splines of a variable, alike and odd in the direction, reduced: (rows, p)."""
    inner = np.linspace(low, high, KNOTS - 2)
    knots = np.concatenate(([low] * 3, inner, [high] * 3))
    clipped = np.clip(x, low, high - 1e-9 * (high - low))
    basis = BSpline.design_matrix(clipped, knots, 3).toarray()
    both = np.hstack([basis, basis * np.sign(v)[:, None]])
    return np.array([motion.reduce(column) * motion.moving for column in both.T]).T
