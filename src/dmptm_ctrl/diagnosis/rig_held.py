"""What belongs to held-out logs alone: zeros of encoders and twists, fitted beside a model."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dmptm_ctrl.diagnosis.rig_shapes import unit_columns
from dmptm_ctrl.identify.free_parameters import has_phase, log_parameters
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.measured_motion import Nuisance
from dmptm_ctrl.identify.rig_fit import RigFit, fit_rig, residuals
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.rig_model import Placed


def held_state(fit: RigFit, held: Balance) -> State:
    """Fit the twists and encoder zeros of logs that were not fitted, and nothing else."""
    state, logs = fit.state, fit.likelihood.balance
    new = [log for log in held.logs if log not in logs.logs]
    frees = [free for log in new for free in log_parameters(state.model, held, log, logs.logs[0])]
    if not frees:
        return state
    for effect in (e for e in state.model.effects if has_phase(state.model, held, e)):
        state = _phases(fit, state, held, effect, new)
    linear = not held.simulates(state.model) and all(f.kind == "twist" for f in frees)
    return fit_rig(state, held, frees=frees, iterations=1 if linear else 4, jobs=1).state


def _phases(fit: RigFit, state: State, held: Balance, effect: Placed, new: Sequence[str]) -> State:
    """Encoder zeros of new logs, by the phase that a harmonic effect has there."""
    logs, bare = dict(state.logs), State(state.model.without([effect.key]), state.logs)
    left, _ = residuals(bare, held)
    order = effect.values.get("order", 1.0)
    shape = {k: v for k, v in effect.values.items() if k == "order"}
    columns = unit_columns(fit, held, effect._replace(values=shape), ("cosine", "sine"))
    here = effect.values["cosine"] - 1j * effect.values["sine"]
    for log in new if here != 0 else ():
        own = [k for k, m in enumerate(held.motions) if m.name == log]
        table, rest = (
            np.concatenate([part[k][0][held.motions[k].moving] for k in own])
            for part in (columns, left)
        )
        c, s = np.linalg.lstsq(table, -rest, rcond=None)[0]
        old = logs.get(log, Nuisance())
        shift = float(np.angle((c - 1j * s) / here) / order)
        logs[log] = Nuisance({**old.zero, effect.key: shift}, old.twist)
    return replace(state, logs=logs)
