"""How the pinions land tells the meshes' damping, of which the balances know nothing.

Each reversal ends in an impact, and how it rings down depends on the damping, though no run
predicts the rattle itself. So the damping is not fitted by slopes: whole free runs with values
throughout its range are compared, and each value counts by how well it does.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from dmptm_ctrl.diagnosis.predict import low_pass
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Misfit, position
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Floats, Model

DAMPING, GAP_DAMPING = "c", "c_f"
VALUES = 9  # of the damping, even on a logarithmic scale
GAP_SHARES = (0.1, 0.4)  # of the range of the gap's; one run more or less is chance
LANDINGS = 10.0  # that tell something, of a log
FLOOR = np.deg2rad(0.03)  # rad/s: speeds are not predicted more finely
PRIOR = 0.6  # standard deviation of the logarithm about the declared value
SMOOTH = (0.25, 0.5, 0.25)  # neighbours along the scale


def landed(records: Sequence[Record], start: BalanceFit, declared: Drive, jobs: int) -> BalanceFit:
    """Return a fit with the damping that free runs of the records speak for.

    It comes with its standard deviation. The gap's damping, which not even they tell, is the
    declared one. What is not among the unknowns of the fit stays as it is.
    """
    names = [k.name if k.effect is None else "" for k in start.unknowns]
    p, covariance = start.p.copy(), start.covariance.copy()
    model = start.model
    if GAP_DAMPING in names:
        model = model.with_values(**{GAP_DAMPING: declared[GAP_DAMPING]})
        uncouple(covariance, names.index(GAP_DAMPING))
    if DAMPING in names:
        j = names.index(DAMPING)
        value, error = damping(records, model, declared, jobs)
        model = model.with_values(**{DAMPING: value})
        uncouple(covariance, j)
        covariance[j, j] = (error / start.unknowns[j].scale) ** 2
    low, high = ([getattr(k, end) for k in start.unknowns] for end in ("low", "high"))
    p = np.clip(position(model, start.unknowns), low, high)
    return replace(start, model=model, p=p, covariance=covariance)


def uncouple(covariance: Floats, j: int) -> None:
    """Make an unknown independent of the others, in place."""
    own = covariance[j, j]
    covariance[j, :] = covariance[:, j] = 0.0
    covariance[j, j] = own


def damping(
    records: Sequence[Record], model: Model, declared: Drive, jobs: int
) -> tuple[float, float]:
    """Return the meshes' damping and its standard deviation [N·m·s/rad]."""
    quantities = declared.quantities
    low, high = quantities[DAMPING].range
    scale = np.log(np.geomspace(max(low, 1e-3 * high), high, VALUES))
    most = quantities[GAP_DAMPING].range[1]
    measured = [low_pass(rec.omega, rec.dt) for rec in records]

    def misses(values: tuple[float, float]) -> float:
        tried = model.with_values(**dict(zip((DAMPING, GAP_DAMPING), values, strict=True)))
        return sum(
            float(np.log(np.mean((seen - low_pass(run[:, 1], rec.dt)) ** 2) + FLOOR**2))
            for rec, run, seen in zip(
                records, Misfit(records, 0.0).runs(tried), measured, strict=True
            )
        )

    grid = [(float(np.exp(s)), share * most) for s in scale for share in GAP_SHARES]
    with ThreadPoolExecutor(jobs) as pool:
        missed = np.array(list(pool.map(misses, grid))).reshape(VALUES, -1).mean(1)
    missed = np.convolve(np.pad(missed, 1, mode="edge"), SMOOTH, "valid")
    cost = LANDINGS * missed + ((scale - np.log(declared[DAMPING])) / PRIOR) ** 2
    weight = np.exp(-0.5 * (cost - cost.min()))
    weight /= weight.sum()
    mean = float(weight @ scale)
    # half a step of the scale is what it resolves
    spread = max(float(np.sqrt(weight @ (scale - mean) ** 2)), 0.5 * float(scale[1] - scale[0]))
    return float(np.exp(mean)), float(np.exp(mean)) * spread
