"""How a run changes with parameters, through contacts, stops and starts.

Each parameter is moved a little in a lane of its own beside the run, so that what changes is the
derivative of the scheme itself, whatever the run meets.
All parameters moved in reverse together are a lane too: where the run is differentiable they
change minus the sum of the others, and where that is not so the derivative from one side is not
that from the other and does not exist. A derivative converges with the first order of the step
where events lie before it, the run itself with the second.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.contract import Parameter
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.any_model import (
    AnyModel,
    at_rest,
    declared_in,
    inputs_of,
    seen_of,
    steps_of,
    with_numbers,
)
from dmptm_ctrl.simulate.dual import start
from dmptm_ctrl.simulate.lanes import LANES
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import NO_ROWS
from dmptm_ctrl.simulate.rig_model import RigModel

# Share of a parameter's size: truncation and rounding, grown by the run, are both far below 1 %
STEP = 1e-7
DIFFERENT = 0.02  # derivatives from both sides that differ by more are not the same
NOISE = 1e-4  # of an output's range per parameter's size, below which a difference is rounding
FEW = 8  # drives beside each other for which half as many lanes are enough


class Sensitivities(NamedTuple):
    """A run and its derivatives."""

    time: Floats  # (n,) [s]
    outputs: Floats  # (8, n), as :data:`.compiled.OUTPUTS`; of a rig its sensors
    parameters: tuple[str, ...]
    derivatives: Floats  # (p, 8, n), ∂output/∂parameter, SI
    exists: NDArray[np.bool_]  # (8, n), False where the derivatives from the two sides differ


def _of_effect(model: AnyModel, effect: str) -> tuple[dict[str, Parameter], dict[str, float]]:
    """Parameters of an effect, by what names it, and its values; empty where there is none."""
    known: dict[str, Parameter] = {}
    values: dict[str, float] = {}
    if isinstance(model, RigModel):
        for own in (e for e in model.effects if e.key == effect):
            placed = PLACED_CATALOGUE[own.name]
            known = {p.name: p for p in placed.keep}
            values = {**dict(zip(known, placed.defaults, strict=True)), **own.values}
    elif effect in CATALOGUE:
        known = {p.name: p for p in CATALOGUE[effect].parameters}
        values = {**CATALOGUE[effect].absent(), **model.effects.get(effect, {})}
    return known, values


def _step(model: AnyModel, name: str) -> float:
    """How far a parameter is moved."""
    values = declared_in(model)[1]
    if name in values:
        if values[name] == 0.0:
            raise ValueError(f"{name} is zero: its size is not known; give it a value")
        return STEP * abs(values[name])
    effect, _, parameter = name.rpartition(".")
    if not effect:
        raise ValueError(f"the drive has no parameter {parameter!r}")
    known, own = _of_effect(model, effect)
    if parameter not in known:
        raise ValueError(f"no parameter {name!r}; effects are named as in 'cogging.left_cosine'")
    found, value = known[parameter], own[parameter]
    step = STEP * max(abs(value), found.step)
    if value - step < found.low:
        raise ValueError(f"{name} is at its lower bound {found.low:g}: no derivative from below")
    return step


def _moved(model: AnyModel, moves: Sequence[tuple[str, float]]) -> AnyModel:
    """Return a model with parameters moved."""
    for name, step in moves:
        declared = declared_in(model)[1]
        effect, _, parameter = name.rpartition(".")
        values = _of_effect(model, effect)[1]
        if name in declared:
            model = with_numbers(model, {name: declared[name] + step}, lambda _, own: own)
        elif isinstance(model, RigModel):
            own = model.effect(effect)
            moved = {**values, parameter: values[parameter] + step}
            model = model.with_effect(own._replace(values=moved))
        else:
            model = model.with_effect(effect, **{**values, parameter: values[parameter] + step})
    return model


def simulate_with_sensitivities(
    model: AnyModel,
    timepts: ArrayLike,
    inputs: ArrayLike,
    parameters: Sequence[str],
    initial_state: ArrayLike | None = None,
    *,
    substeps: int | None = None,
    jobs: int = 1,
) -> Sensitivities:
    """Run a drive open loop together with its derivatives with respect to parameters.

    Parameters
    ----------
    model : Model or RigModel
    timepts, inputs, initial_state, substeps
        As for :func:`~dmptm_ctrl.simulate.simulate`; the initial state does not depend on
        the parameters.
    parameters : sequence of str
        Names of the drive's parameters, or "effect.parameter"; of a rig its keys, as
        "body.load.inertia", or "effect@place.parameter" of an effect that it has.
    jobs : int
        Threads, for more than fourteen parameters.

    Returns
    -------
    Sensitivities
        ``outputs`` (8, n) and their ``derivatives`` (p, 8, n), rows as in ``simulate``; ``exists``
        is False where the derivatives from the two sides differ.

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

    time, dt = _timepts(timepts)
    rows = np.atleast_2d(np.array(inputs, float))
    u = _finite("inputs", rows, (len(inputs_of(model)), time.size), "inputs by time points")
    if isinstance(model, RigModel) and initial_state is not None:
        raise ValueError("a rig starts from rest; leave initial_state out")
    if len(parameters) == 0:
        raise ValueError("parameters is empty; name at least one")
    moves = [(name, _step(model, name)) for name in parameters]
    moved = [_moved(model, [move]) for move in moves]
    back = _moved(model, [(name, -step) for name, step in moves])
    models = [model, *moved, back]
    kept = tuple(x for x in seen_of(model).values() if not x.startswith("signal"))
    fine = steps_of(model, dt) if substeps is None else substeps
    common = Common(dt, fine, time.size, u[None], NO_ROWS, NO_ROWS, kept)
    if isinstance(model, RigModel):
        starts = [at_rest(one) for one in models]
    else:
        x0 = _start(model, initial_state)
        starts = [start(one.plant(), x0) for one in models]
    width = FEW if len(models) <= FEW else LANES
    runs = np.array(run_many(models, starts, common, jobs=jobs, width=width)[0])
    outputs, changes = runs[0], runs[1:] - runs[0]
    steps = np.array([step for _, step in moves])
    derivatives = changes[:-1] / steps[:, None, None]
    exists = _existing(outputs, derivatives, changes[-1], steps)
    return Sensitivities(time, outputs, tuple(parameters), derivatives, exists)


def _existing(
    outputs: Floats, derivatives: Floats, back: Floats, steps: Floats
) -> NDArray[np.bool_]:
    """Where derivatives exist; `back` is what all parameters change in reverse."""
    rounding = NOISE * STEP * np.ptp(outputs, axis=1) * steps.size
    together = back + np.tensordot(steps, derivatives, 1)
    size = np.abs(back) + np.tensordot(steps, np.abs(derivatives), 1)
    return np.abs(together) <= DIFFERENT * size + rounding[:, None]
