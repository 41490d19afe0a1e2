"""How firmly each effect stands in the final model of a ladder."""

from collections.abc import Sequence
from typing import NamedTuple

from dmptm_ctrl.diagnosis.ladder import ALIKE, Ladder, carries_others, without_zeros
from dmptm_ctrl.diagnosis.ladder_candidates import candidates
from dmptm_ctrl.diagnosis.ladder_judge import gain_of, rank
from dmptm_ctrl.diagnosis.ladder_score import NEWS, Tangent, similarity
from dmptm_ctrl.identify.chain_fit import State, fit_chain

RIVAL = 0.7  # share of an effect's gain from which another is named beside it
MORE_COMPLEX = 0.2  # prior odds of a rival that is the less simple one


class Standing(NamedTuple):
    """How firmly an effect stands in the final model.

    Attributes
    ----------
    gain : float
        Share of the residual's square that returns without it, the rest refitted.
    rivals : tuple of str
        Effects that would explain nearly the same in its place.
    probability : float
        That it, not a rival and not chance, is there.
    """

    gain: float
    rivals: tuple[str, ...]
    probability: float


def standing(ladder: Ladder, jobs: int = 2) -> dict[str, Standing]:
    """Compare every effect of the final model with what could stand in its place."""
    found = {}
    p_values = {r.key: r.p_value for r in ladder.rungs}
    for effect in ladder.final.model.effects:
        if carries_others(ladder.final.model, effect.key) or effect.key not in p_values:
            continue
        state = without_zeros(
            State(ladder.final.model.without([effect.key]), ladder.final.state.logs), effect.key
        )
        without = fit_chain(state, ladder.fit_logs, jobs=jobs)
        final = ladder.final.left, ladder.final.drive
        gain = gain_of((without.left, without.drive), final)
        if effect.name == "shaft_compliance":
            found[effect.key] = Standing(gain, (), _probability(gain, [], p_values[effect.key]))
            continue
        scores = candidates(Tangent(without, ladder.fit_logs), structure=False)
        own = next((c for c in scores if c.placed.key == effect.key), None)
        rivals = [
            c for c in scores
            if own is not None and c.placed.key != effect.key
            and c.score.gain >= RIVAL * own.score.gain and similarity(c.score, own.score) >= ALIKE
        ]  # fmt: skip
        top = own.score.gain if own is not None else gain
        odds = [
            (c.score.gain - top, 1.0 if rank(c.name) < rank(effect.name) else MORE_COMPLEX)
            for c in rivals
        ]
        names = tuple(dict.fromkeys(c.name for c in rivals if c.name != effect.name))
        found[effect.key] = Standing(gain, names, _probability(top, odds, p_values[effect.key]))
    return found


def _probability(gain: float, rivals: Sequence[tuple[float, float]], p_value: float) -> float:
    """Probability that the named effect, not a rival and not chance, explains the residual.

    Likelihoods of rival fits, with one piece of news per block; `rivals` are their gains less
    `gain`, and their prior odds.
    """
    odds = sum(
        prior * ((1.0 - gain) / max(1.0 - gain - more, 1e-9)) ** (0.5 * NEWS)
        for more, prior in rivals
    )
    return float(min(0.99, (1.0 - min(p_value, 1.0)) / (1.0 + odds)))
