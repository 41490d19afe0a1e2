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
from dmptm_ctrl.simulate.compiled import OUTPUTS, SUBSTEPS, rest
from dmptm_ctrl.simulate.dual import columns_seen, dual_plant, start
from dmptm_ctrl.simulate.elementary import cached
from dmptm_ctrl.simulate.kernel_calls import layout
from dmptm_ctrl.simulate.lanes import LANES
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats, Model

# Share of a parameter's size: truncation and rounding, grown by the run, are both far below 1 %
STEP = 1e-7
DIFFERENT = 0.02  # derivatives from both sides that differ by more are not the same
NOISE = 1e-4  # of an output's range per parameter's size, below which a difference is rounding
FEW = 8  # drives beside each other for which half as many lanes are enough
_NO_ROWS = np.zeros((0, 0))


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


class _Place(NamedTuple):
    """Where a parameter stands in the arrays of a model, and how far it is moved."""

    slot: int  # of the drive's numbers, or of the effects'
    step: float
    effect: str  # or "" for the drive

    def move(self, arrays: Arrays, ways: float = 1.0) -> None:
        """Move the parameter by some steps in the numbers of a drive."""
        base, on, values = arrays
        if not self.effect:
            base[self.slot] += ways * self.step
            return
        values[self.slot] += ways * self.step
        number, first = layout()[self.effect]
        parameters = CATALOGUE[self.effect].parameters
        own = values[first : first + len(parameters)]
        on[number] = any(x and not p.bank for p, x in zip(parameters, own, strict=True))


def _place(model: Model, name: str, values: Floats) -> _Place:
    """Where a parameter is; `values` are those of all effects."""
    effect, _, parameter = name.rpartition(".")
    if not effect:
        if parameter not in model.drive:
            raise ValueError(f"the drive has no parameter {parameter!r}")
        value = model.drive[parameter]
        if value == 0.0:
            raise ValueError(f"{parameter} is zero: its size is not known; give it a value")
        return _Place(BASE.index(parameter), STEP * abs(value), "")
    names = [p.name for p in CATALOGUE[effect].parameters] if effect in CATALOGUE else []
    if parameter not in names:
        raise ValueError(f"no parameter {name!r}; effects are named as in 'cogging.left_cosine'")
    found = CATALOGUE[effect].parameters[names.index(parameter)]
    index = layout()[effect][1] + names.index(parameter)
    step = STEP * max(abs(values[index]), found.step)
    if values[index] - step < found.low:
        raise ValueError(f"{name} is at its lower bound {found.low:g}: no derivative from below")
    return _Place(index, step, effect)


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
    here = model.arrays()
    places = [_place(model, name, here[2]) for name in parameters]
    dt = (time[-1] - time[0]) / (time.size - 1)
    steps = np.array([place.step for place in places])
    moved = [_moved(here, [place]) for place in places]
    plants = [dual_plant(a) for a in (here, *moved, _moved(here, places, -1.0))]
    seen = columns_seen(plants[0])[: len(OUTPUTS)]
    common = Common(
        dt, substeps, time.size, u[None], _NO_ROWS, _NO_ROWS, np.array(seen), statistics=False
    )
    starts = [start(plant, x0) for plant in plants]
    width = FEW if len(plants) <= FEW else LANES
    runs = np.array(run_many(plants, starts, common, n_jobs=jobs, width=width)[0])
    outputs, changes = runs[0], runs[1:] - runs[0]
    derivatives = changes[:-1] / steps[:, None, None]
    exists = _existing(outputs, derivatives, changes[-1], steps)
    return Sensitivities(time, outputs, tuple(parameters), derivatives, exists)


def _moved(arrays: Arrays, places: Sequence[_Place], ways: float = 1.0) -> Arrays:
    """Numbers of a drive with parameters moved by some of their steps."""
    found = arrays[0].copy(), arrays[1].copy(), arrays[2].copy()
    for place in places:
        place.move(found, ways)
    return found


def _existing(
    outputs: Floats, derivatives: Floats, back: Floats, steps: Floats
) -> NDArray[np.bool_]:
    """Where derivatives exist; `back` is what all parameters change the other way."""
    exists = np.ones(outputs.shape, np.bool_)
    rounding = NOISE * STEP * np.ptp(outputs, axis=1) * steps.size
    _judge(derivatives, back, steps, rounding, DIFFERENT, exists)
    return exists


@cached(nogil=True)
def _judge(derivatives, back, steps, rounding, different, exists):
    """Where one side says the same as the other."""
    p, rows, n = derivatives.shape
    for row in range(rows):
        for i in range(n):
            together, size = back[row, i], abs(back[row, i])
            for k in range(p):
                change = derivatives[k, row, i] * steps[k]
                together += change
                size += abs(change)
            exists[row, i] = abs(together) <= different * size + rounding[row]
