"""How a run changes with parameters, through contacts, stops and starts.

Each parameter is moved a little in a lane of its own beside the run, so that what changes is the
derivative of the scheme itself, whatever the run meets.
All parameters moved the other way together are a lane too: where the run is differentiable they
change minus the sum of the others, and where that is not so the derivative from one side is not
that from the other and does not exist. A derivative converges with the first order of the step
where events lie before it, the run itself with the second.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compiled import SEEN, SUBSTEPS
from dmptm_ctrl.simulate.dual import start
from dmptm_ctrl.simulate.lanes import LANES
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import Floats, Model

# Share of a parameter's size: truncation and rounding, grown by the run, are both far below 1 %
STEP = 1e-7
DIFFERENT = 0.02  # derivatives from both sides that differ by more are not the same
NOISE = 1e-4  # of an output's range per parameter's size, below which a difference is rounding
FEW = 8  # drives beside each other for which half as many lanes are enough
_NO_ROWS = np.zeros((0, 0))


class Sensitivities(NamedTuple):
    """A run and its derivatives."""

    time: Floats  # (n,) [s]
    outputs: Floats  # (8, n), in the order of :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS`
    parameters: tuple[str, ...]
    derivatives: Floats  # (p, 8, n), ∂output/∂parameter, SI
    exists: NDArray[np.bool_]  # (8, n), False where the derivatives from the two sides differ


def _step(model: Model, name: str) -> float:
    """How far a parameter is moved."""
    effect, _, parameter = name.rpartition(".")
    if not effect:
        if parameter not in model.drive:
            raise ValueError(f"the drive has no parameter {parameter!r}")
        value = model.drive[parameter]
        if value == 0.0:
            raise ValueError(f"{parameter} is zero: its size is not known; give it a value")
        return STEP * abs(value)
    known = {p.name: p for p in CATALOGUE[effect].parameters} if effect in CATALOGUE else {}
    if parameter not in known:
        raise ValueError(f"no parameter {name!r}; effects are named as in 'cogging.left_cosine'")
    found, value = known[parameter], _values(model, effect)[parameter]
    step = STEP * max(abs(value), found.step)
    if value - step < found.low:
        raise ValueError(f"{name} is at its lower bound {found.low:g}: no derivative from below")
    return step


def _values(model: Model, effect: str) -> dict[str, float]:
    return {**CATALOGUE[effect].absent(), **model.effects.get(effect, {})}


def _moved(model: Model, moves: Sequence[tuple[str, float]]) -> Model:
    """Return a model with parameters moved."""
    for name, step in moves:
        effect, _, parameter = name.rpartition(".")
        if effect:
            own = _values(model, effect)
            model = model.with_effect(effect, **{**own, parameter: own[parameter] + step})
        else:
            model = model.with_values(**{parameter: model.drive[parameter] + step})
    return model


def simulate_with_sensitivities(
    model: Model,
    timepts: ArrayLike,
    inputs: ArrayLike,
    parameters: Sequence[str],
    initial_state: ArrayLike | None = None,
    *,
    substeps: int = SUBSTEPS,
    jobs: int = 1,
) -> Sensitivities:
    """Run a drive open loop together with its derivatives with respect to parameters.

    Parameters
    ----------
    model : Model
    timepts, inputs, initial_state, substeps
        As for :func:`~dmptm_ctrl.simulate.simulate`; the initial state does not depend on
        the parameters.
    parameters : sequence of str
        Names of the drive's parameters, or "effect.parameter".
    jobs : int
        Threads, for more than fourteen parameters.

    Returns
    -------
    Sensitivities

    Raises
    ------
    ValueError
        No parameter of that name, or one whose size or range leaves no room for a difference.

    Examples
    --------
    >>> time, volts = np.arange(0.0, 1.0, 1e-3), np.full((2, 1000), 0.6)
    >>> run = dm.simulate_with_sensitivities(dm.Model(), time, volts, ["J_L", "TLc_plus"])
    """
    from dmptm_ctrl.simulate import _finite, _start, _timepts

    time = _timepts(timepts)
    u = _finite("inputs", inputs, (2, time.size), "left and right voltage at each time point")
    x0 = _start(model, initial_state)
    if len(parameters) == 0:
        raise ValueError("parameters is empty; name at least one")
    moves = [(name, _step(model, name)) for name in parameters]
    dt = (time[-1] - time[0]) / (time.size - 1)
    moved = [_moved(model, [move]) for move in moves]
    back = _moved(model, [(name, -step) for name, step in moves])
    models = [model, *moved, back]
    kept = tuple(SEEN.values())
    common = Common(dt, substeps, time.size, u[None], _NO_ROWS, _NO_ROWS, kept)
    starts = [start(one.plant(), x0) for one in models]
    width = FEW if len(models) <= FEW else LANES
    runs = np.array(run_many(models, starts, common, n_jobs=jobs, width=width)[0])
    outputs, changes = runs[0], runs[1:] - runs[0]
    steps = np.array([step for _, step in moves])
    derivatives = changes[:-1] / steps[:, None, None]
    exists = _existing(outputs, derivatives, changes[-1], steps)
    return Sensitivities(time, outputs, tuple(parameters), derivatives, exists)


def _existing(
    outputs: Floats, derivatives: Floats, back: Floats, steps: Floats
) -> NDArray[np.bool_]:
    """Where derivatives exist; `back` is what all parameters change the other way."""
    rounding = NOISE * STEP * np.ptp(outputs, axis=1) * steps.size
    together = back + np.tensordot(steps, derivatives, 1)
    size = np.abs(back) + np.tensordot(steps, np.abs(derivatives), 1)
    return np.abs(together) <= DIFFERENT * size + rounding[:, None]
