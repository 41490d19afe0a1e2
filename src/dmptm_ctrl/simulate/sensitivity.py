"""How a run changes with parameters: differences of runs side by side in vector lanes.

The lanes share the steps, so a difference is the derivative of the scheme itself, through
contacts, stops and starts: the perturbation is so small that an event stays in its step
unless it is at its edge. One lane more has all parameters moved the other way: where the
run is differentiable its difference is minus the sum of the others', and where that is not so
the derivative from one side is not that from the other and does not exist. A derivative
converges with the first order of the step where events lie before it, the run itself with
the second.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.batch import march_many
from dmptm_ctrl.simulate.compiled import SUBSTEPS, rest
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.model import Floats, Model

# Share of a parameter's size: truncation and rounding, grown by the run, are both far below 1 %
STEP = 1e-7
DIFFERENT = 0.02  # derivatives from both sides that differ by more are not the same
NOISE = 1e-4  # of an output's range per parameter's size, below which a difference is rounding


class Sensitivities(NamedTuple):
    """A run and its derivatives.

    Attributes
    ----------
    time : (n,) array [s]
    outputs : (8, n) array
        Of the run, in the order of :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS`.
    parameters : tuple of str
    derivatives : (p, 8, n) array
        ∂output/∂parameter, SI.
    exists : (8, n) array of bool
        False where the run is not differentiable: the derivatives from the two sides differ.
    """

    time: Floats
    outputs: Floats
    parameters: tuple[str, ...]
    derivatives: Floats
    exists: NDArray[np.bool_]


def _moved(model: Model, name: str, share: float) -> tuple[Model, float]:
    """Return the model with one parameter moved by a share of its size, and by how much."""
    effect, _, parameter = name.rpartition(".")
    if not effect:
        if parameter not in model.drive:
            raise ValueError(f"the drive has no parameter {parameter!r}")
        value = model.drive[parameter]
        if value == 0.0:
            raise ValueError(f"{parameter} is zero: its size is not known; give it a value")
        step = share * abs(value)
        return model.with_values(**{parameter: value + step}), step
    places = [p.name for p in CATALOGUE[effect].parameters] if effect in CATALOGUE else []
    if parameter not in places:
        raise ValueError(f"no parameter {name!r}; effects are named as in 'cogging.left_cosine'")
    found = CATALOGUE[effect].parameters[places.index(parameter)]
    values = dict(zip(places, CATALOGUE[effect].defaults(), strict=True))
    values.update(model.effects.get(effect, {}))
    value = values[parameter]
    step = share * max(abs(value), found.step)
    if value + step < found.low and share < 0.0:
        raise ValueError(f"{name} is at its lower bound {found.low:g}: no derivative from below")
    values[parameter] = value + step
    return model.with_effect(effect, **values), step


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
        Threads, for more than six parameters.

    Returns
    -------
    Sensitivities

    Raises
    ------
    ValueError
        No parameter of that name, or one whose size or range leaves no room for a difference.
    """
    from dmptm_ctrl.simulate import _finite, _timepts

    time = _timepts(timepts)
    u = _finite("inputs", inputs, (2, time.size), "left and right voltage at each time point")
    x0 = (
        rest(model, 0.0)
        if initial_state is None
        else _finite("initial_state", initial_state, (6,), "three angles and their speeds")
    )
    if len(parameters) == 0:
        raise ValueError("parameters is empty; name at least one")
    moved = [_moved(model, name, STEP) for name in parameters]
    back = model
    for name in parameters:
        back, _ = _moved(back, name, -STEP)
    arrays = [m.arrays() for m in (model, back, *(m for m, _ in moved))]
    dt = (time[-1] - time[0]) / (time.size - 1)
    runs = march_many(arrays, u, x0, dt, substeps=substeps, jobs=jobs).transpose(0, 2, 1)
    steps = np.array([step for _, step in moved])
    rounding = NOISE * STEP * np.ptp(runs[0], axis=1) * len(parameters)
    exists = _judge(runs, steps, rounding, DIFFERENT)
    return Sensitivities(time, runs[0], tuple(parameters), runs[2:], exists)


@cached(nogil=True)
def _judge(runs, steps, rounding, different):
    """Where one side says the same as the other; runs 0 as is, 1 back, others to derivatives."""
    p, rows, n = steps.size, runs.shape[1], runs.shape[2]
    exists = np.empty((rows, n), np.bool_)
    for row in range(rows):
        together, size = runs[1, row] - runs[0, row], np.abs(runs[1, row] - runs[0, row])
        for k in range(p):
            for i in range(n):
                change = runs[2 + k, row, i] - runs[0, row, i]
                together[i] += change
                size[i] += abs(change)
                runs[2 + k, row, i] = change / steps[k]
        for i in range(n):
            exists[row, i] = abs(together[i]) <= different * size[i] + rounding[row]
    return exists
