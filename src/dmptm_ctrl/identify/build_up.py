"""How far friction takes to build up after a reversal, from logs in which nobody looked for it.

Dahl's presliding over some 20 µrad of the ring gear is a count of its encoder and no effect that
a diagnosis names; yet the free run of a fitted model misses less at every reversal with the
right distance, and a feed-forward of friction that comes too early or too late is the largest
error left to a controller.
"""

from collections.abc import Sequence

import numpy as np

from dmptm_ctrl.design.draws import slow_friction
from dmptm_ctrl.effects.presliding import PRESLIDING
from dmptm_ctrl.identify.fit import Misfit
from dmptm_ctrl.identify.records import records
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Model

# rad at the ring gear; the misfit of logs that rattle has a notch some 8 µrad wide at the true one
DISTANCES = np.arange(0.0, 65e-6, 4e-6)
SHARES = (0.0, 0.125, 0.25, 0.5, 1.0, 2.0)  # tried of each distance that a diagnosis gives


def friction_distance(model: Model, logs: Sequence[Log], *, n_jobs: int = 1) -> float:
    """Return the distance at the ring gear [rad] over which friction builds up.

    The one with the smallest misfit of the free runs, by a parabola through the three best
    neighbours; 0 where any distance only makes it worse.

    Parameters
    ----------
    model : Model
        Fitted to the logs, without presliding.
    logs : sequence of Log
        At their sample rate.
    n_jobs : int
        Threads.

    Raises
    ------
    ValueError
        A model that has presliding.
    """
    if PRESLIDING.name in model.effects:
        raise ValueError("the model has presliding; its distances are known")
    misfit = Misfit(records(logs, model.drive), jobs=n_jobs)
    misfit.weigh(model)
    costs = [misfit.square(_built_up(model, d) if d > 0.0 else model) for d in DISTANCES]
    k = int(np.argmin(costs))
    if k in (0, DISTANCES.size - 1):
        return float(DISTANCES[k])
    a, b, c = costs[k - 1 : k + 2]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c)
    return float(DISTANCES[k] + shift * (DISTANCES[1] - DISTANCES[0]))


def with_build_up(model: Model, logs: Sequence[Log], *, n_jobs: int = 1) -> Model:
    """Return the model with the distances that its logs' free runs tell, as presliding; 0 is none.

    A balance of torques hardly tells which body's friction builds up late. So of presliding that
    a model has, each distance is tried at :data:`SHARES` of itself.
    """
    if PRESLIDING.name not in model.effects:
        return _built_up(model, friction_distance(model, logs, n_jobs=n_jobs))
    misfit = Misfit(records(logs, model.drive), jobs=n_jobs)
    misfit.weigh(model)
    told = model.effects[PRESLIDING.name]
    best, least, before = model, misfit.square(model), np.inf
    while least < before:
        before = least
        for name in ("reducer_distance", "ring_distance"):
            for share in SHARES:
                tried = {**best.effects[PRESLIDING.name], name: share * told[name]}
                other = model.with_effect(PRESLIDING.name, **tried)
                cost = misfit.square(other)
                if cost < least:
                    best, least = other, cost
    return best


def _built_up(model: Model, distance: float) -> Model:
    found: Model = slow_friction(model, distance)
    return found
