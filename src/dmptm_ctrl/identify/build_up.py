"""How far friction takes to build up after a reversal, from logs in which nobody looked for it.

Dahl's presliding over some 20 µrad of the ring gear is a count of its encoder and no effect that
a diagnosis names; yet the free run of a fitted model misses less at every reversal with the
right distance, and a feed-forward of friction that comes too early or too late is the largest
error left to a controller.
"""

from collections.abc import Sequence
from itertools import product
from typing import cast

import numpy as np

from dmptm_ctrl.design.draws import slow_friction
from dmptm_ctrl.effects.presliding import PRESLIDING
from dmptm_ctrl.identify.balance import surprise
from dmptm_ctrl.identify.observer_driven import ObserverRun
from dmptm_ctrl.identify.records import records
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import SUBSTEPS
from dmptm_ctrl.simulate.model import Floats, Model

LEAD_HZ = 0.05  # of the lead by the angle; faster ones hide what friction does after a reversal
# rad at the ring gear; the misfit of logs with impacts has a notch some 8 µrad wide at the true one
DISTANCES = np.arange(0.0, 65e-6, 4e-6)
SHARES = (0.0, 0.125, 0.25, 0.5, 1.0, 2.0)  # tried of each distance that a diagnosis gives


def friction_distance(model: Model, logs: Sequence[Log], *, jobs: int = 1) -> float:
    """Return the distance at the ring gear [rad] over which friction builds up.

    The one with the smallest misfit of the free runs, by a parabola through the three best
    neighbours; 0 where any distance only makes it worse. The model is fitted to the logs, which are
    at their sample rate; ValueError where it has presliding.
    """
    if PRESLIDING.name in model.effects:
        raise ValueError("the model has presliding; its distances are known")
    costs = _missed([slow_friction(model, d) if d > 0.0 else model for d in DISTANCES], logs, jobs)
    k = int(np.argmin(costs))
    if k in (0, DISTANCES.size - 1):
        return float(DISTANCES[k])
    a, b, c = costs[k - 1 : k + 2]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c)
    return float(DISTANCES[k] + shift * (DISTANCES[1] - DISTANCES[0]))


def with_build_up(model: Model, logs: Sequence[Log], *, jobs: int = 1) -> Model:
    """Return the model with the distances that its logs' free runs show, as presliding; 0 is none.

    A balance of torques hardly shows which body's friction builds up late. So of presliding that
    a model has, both distances are tried at :data:`SHARES` of themselves, each with each.
    """
    if PRESLIDING.name not in model.effects:
        distance = friction_distance(model, logs, jobs=jobs)
        return cast(Model, slow_friction(model, distance))
    values = model.effects[PRESLIDING.name]
    names = ("reducer_distance", "ring_distance")
    tried = [
        model.with_effect(
            PRESLIDING.name,
            **{**values, **{n: share * values[n] for n, share in zip(names, shares, strict=True)}},
        )
        for shares in product(SHARES, repeat=2)
    ]
    return tried[int(np.argmin(_missed(tried, logs, jobs)))]


def _missed(models: Sequence[Model], logs: Sequence[Log], jobs: int) -> Floats:
    """What runs of each model miss of the speed, as twice a negative log-likelihood.

    They are free but for a slow lead by the angle, that impacts do not part them for good.
    """
    observed = [ObserverRun(rec, LEAD_HZ, SUBSTEPS) for rec in records(logs, models[0].drive)]
    rows = in_threads(lambda one: one.missing_of(models), observed, jobs, lambda one: one.count)
    kinds = ["observer"] * len(observed)
    return np.array([surprise([row[k] for row in rows], kinds) for k in range(len(models))])
