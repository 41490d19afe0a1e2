"""What belongs to a held-out log alone: its encoder zeros and twists."""

from dataclasses import replace

import numpy as np

from dmptm_ctrl.diagnosis.ladder_candidates import unit_columns
from dmptm_ctrl.diagnosis.ladder_judge import Outcome
from dmptm_ctrl.diagnosis.ladder_score import Tangent
from dmptm_ctrl.identify.chain_fit import ChainFit, State, fit_chain, residuals
from dmptm_ctrl.identify.chain_free import Free, has_phase, log_parameters
from dmptm_ctrl.identify.inverse_dynamics import Balance, Nuisance
from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE


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
