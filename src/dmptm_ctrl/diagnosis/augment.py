"""Fourth step: refit the best candidates inside the simulator, and decide on held-out logs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.trace import MIN_SURVIVAL, Score
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import Fit, Unknown, effect_unknowns, fit
from dmptm_ctrl.simulate.model import Model

FIRST_LOOK = 3  # iterations that show which candidates are worth more
LAST_LOOK = 6
FINALISTS = 3
STRETCH = 2.5  # of the amplitude to start from, where the drive's parameters imitate an effect
INTEGER_SHAPES = frozenset({"order", "pattern"})


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate refitted together with the drive's parameters.

    Attributes
    ----------
    gain : float
        Fall of the cost on the fitted logs.
    held_gain : float
        Fall of the weighted square on the held-out logs.
    held_ratio : float
        Held-out error after over before.
    improved : float
        Share of all logs on which the error falls.
    """

    name: str
    fit: Fit
    gain: float
    held_gain: float
    held_ratio: float
    improved: float


def unknowns_of(name: str) -> tuple[Unknown, ...]:
    """Parameters of an effect that a refit may move; a whole-numbered order is not."""
    return tuple(k for k in effect_unknowns(name) if k.name not in INTEGER_SHAPES)


def squares(left: Residual, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Weighted squares per log: fitted, held out."""
    parts = []
    for misfit in (left.misfit, left.held):
        residuals = misfit.parts(misfit.differences(model), bent=True)
        parts.append(np.array([float(np.sum(part**2)) for part in residuals]))
    return parts[0], parts[1]


def refit(
    left: Residual,
    start: Residual,
    score: Score,
    *,
    before: tuple[np.ndarray, np.ndarray],
    stretch: float = 1.0,
) -> Trial:
    """Fit an effect and the drive together, starting at the drive of `start`.

    `stretch` multiplies the amplitudes that the score estimated.
    """
    effect = CATALOGUE[score.name]
    low = {p.name: p.low for p in effect.parameters}
    high = {p.name: p.high for p in effect.parameters}
    guess = {
        n: float(np.clip(v, low[n], high[n]))
        for n, v in {
            **score.shapes,
            **{k: stretch * v for k, v in score.amplitudes.items()},
        }.items()
    }
    model = start.base.model.with_effect(score.name, **guess)
    unknowns = (*start.base.unknowns, *unknowns_of(score.name))
    done = fit(left.misfit, model, unknowns, iterations=FIRST_LOOK, jacobian=start.jacobian)
    return tried(left, score.name, done, before)


def tried(left: Residual, name: str, done: Fit, before: tuple[np.ndarray, np.ndarray]) -> Trial:
    """Compare a fit with the reference, log by log."""
    fitted, held = squares(left, done.model)
    change = np.concatenate([before[0] - fitted, before[1] - held])
    return Trial(
        name,
        done,
        left.base.cost - done.cost,
        float(before[1].sum() - held.sum()),
        float(np.sqrt(held.sum() / before[1].sum())),
        float(np.mean(change > 0)),
    )


def refit_all(
    left: Residual,
    nominal: Residual,
    scores: Mapping[str, tuple[Score | None, Score | None]],
) -> list[Trial]:
    """Refit candidates from both starts and keep the better; best first."""
    before = squares(left, left.base.model)
    trials = []
    for fitted, declared in scores.values():
        tries = [
            refit(left, start, score, before=before)
            for start, score in ((left, fitted), (nominal, declared))
            if score is not None
        ]
        if declared is not None and declared.survival < MIN_SURVIVAL:
            # Mostly absorbed by the drive's parameters: the estimate to first order is small.
            tries.append(refit(left, nominal, declared, before=before, stretch=STRETCH))
        trials.append(max(tries, key=lambda t: t.gain))
    trials.sort(key=lambda t: -t.gain)
    for i, trial in enumerate(trials[:FINALISTS]):
        done = fit(left.misfit, trial.fit.model, trial.fit.unknowns, iterations=LAST_LOOK)
        trials[i] = tried(left, trial.name, done, before)
    return sorted(trials, key=lambda t: -t.gain)


def shortlist(
    fitted: Sequence[Score], declared: Sequence[Score], size: int
) -> dict[str, tuple[Score | None, Score | None]]:
    """Best of both traces, with the score from each."""
    names = [s.name for s in fitted[:size]] + [s.name for s in declared[:size]]
    one = {s.name: s for s in fitted}
    two = {s.name: s for s in declared}
    return {name: (one.get(name), two.get(name)) for name in dict.fromkeys(names)}
