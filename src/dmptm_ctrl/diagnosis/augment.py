"""Fourth step: the effects that were found go into the simulator, and everything is refitted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dmptm_ctrl.diagnosis.predict import expected, low_pass
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import LEAD_HZ
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.balance import BalanceFit, role_of
from dmptm_ctrl.identify.ensemble import smoothed
from dmptm_ctrl.identify.fit import Fit, Known, Misfit, Unknown, fit, place, position
from dmptm_ctrl.identify.led import SPEED
from dmptm_ctrl.identify.lock import HORIZONS, LOOSE, Locked, level, lock
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.identify.ripple import FAST
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.compiled import SUBSTEPS
from dmptm_ctrl.simulate.model import Floats, Model

# Factor on the variance: what a friction law has wrong is wrong alike in neighbouring windows.
NOT_NEWS = 2.0
FIRM_SECONDS = 0.2  # a lock that holds for so long needs no other fit beside it
AGAIN = 0.5  # share of a horizon that was reached, from which other logs begin
NOISE = np.deg2rad(0.01)  # rad/s, of a gyro below 30 Hz
LAST = 3  # steps over whole logs, of which the mean is tried
RUNS = 8  # of which the expected motion is the mean, where models are compared
ITERATIONS = 2  # from the values of balances and the rattle; more moved nothing on held-out logs


def augment(
    records: Sequence[Record],
    start: BalanceFit,
    declared: Drive,
    *,
    beside: Sequence[Unknown] = (),
    near: Fit | None = None,
    also: Sequence[Record] = (),
    onward: bool = False,
    jobs: int = 2,
) -> Fit:
    """Refit a model inside the simulator, from what the balances know.

    The balances know nothing of what happens inside a gap or at rest; the simulation does,
    and from values this near it does not lose its way among the rattle.

    Parameters
    ----------
    declared : Drive
        As it was before any fit.
    beside : sequence of Unknown
        Also fitted, and not known by the balances.
    near : Fit, optional
        That keeps step already; the bounces are met from its values on.
    also : sequence of Record
        Reversals that are met as well.
    onward : bool
        Whether it goes on with whole logs, for as long as that meets them better.
    """
    start = rattled(records, start, declared, jobs)
    unknowns = (*start.unknowns, *beside)
    more = len(beside)
    loosely = loosened(start, more)
    best: Locked | Fit
    first = start.model if near is None else near.model
    reached = 0.0 if near is None else AGAIN * near.horizon
    best = locked = lock(
        records, first, unknowns, loosely, reached=reached, jobs=jobs, anew=near is None
    )
    met = (*records, *also)
    if also:
        other = lock(met, first, unknowns, loosely, reached=reached, jobs=jobs, anew=near is None)
        best = locked = min(
            (locked, other), key=lambda one: level(one.model, met, HORIZONS[-1], jobs)
        )
    if locked.horizon < FIRM_SECONDS and not onward:  # or whole logs come next
        misfit = Misfit(records, LEAD_HZ, jobs)
        misfit.weigh(start.model)
        known = widened(start.p, start.covariance, more)
        whole = fit(misfit, start.model, unknowns, iterations=ITERATIONS, known=known)
        kept = Fit(best.model, unknowns, best.p, best.covariance)
        best = whole if locked.horizon == 0.0 else nearest((kept, whole), records, jobs)[1]
    covariance = best.covariance
    if near is not None and near.unknowns == unknowns and best is locked and locked.horizon == 0.0:
        covariance = near.covariance  # a lock that holds nowhere knows no more than before
    done = Fit(best.model, unknowns, best.p, covariance, locked.horizon)
    tried = [done]
    if near is not None:  # a refit, or what it began with where that meets whole logs better
        tried.append(moved(done, position(near.model, unknowns)))
    if onward or near is not None:
        miss, done = nearest(tried, records, jobs)
        done = onto_whole(records, (miss, done), loosely, jobs) if onward else done
    return replace(done, covariance=honest(done, start))


def moved(done: Fit, p: Floats) -> Fit:
    """Return a fit at other values of its unknowns."""
    return replace(done, model=place(done.model, done.unknowns, p), p=p)


def nearest(tried: Sequence[Fit], records: Sequence[Record], jobs: int) -> tuple[float, Fit]:
    """Return the fit that meets whole logs best, behind how badly it does."""
    return min(((missed(one.model, records, jobs), one) for one in tried), key=lambda one: one[0])


def onto_whole(records: Sequence[Record], begun: tuple[float, Fit], known: Known, jobs: int) -> Fit:
    """Go on over whole logs, to where they are met best.

    Where a step comes out is partly chance, which the mean of the last has less of.
    """
    tried = smoothed(records, begun, known, lambda model: missed(model, records, jobs), jobs)
    done = begun[1]
    mean = moved(done, np.mean([one.p for _, one in tried[-LAST:]], axis=0))
    tried.append((missed(mean.model, records, jobs), mean))
    best = min(tried, key=lambda one: one[0])[1]
    return replace(done, model=best.model, p=best.p)


def missed(model: Model, records: Sequence[Record], jobs: int = 1) -> float:
    """How badly the expected motion meets the speed below 30 Hz: sum of the logs' logarithms."""

    def square(rec: Record) -> float:
        run = expected(model, rec.u, rec.x0, rec.dt, runs=RUNS, substeps=SUBSTEPS, columns=SPEED)
        return float(np.mean(low_pass(rec.omega - run[:, 0], rec.dt) ** 2))

    squares = in_threads(square, records, jobs, lambda rec: rec.omega.size)
    return float(np.sum(np.log(np.array(squares) + NOISE**2)))


def honest(done: Fit, start: BalanceFit) -> Floats:
    """Covariance of a refit, from the balances, and from how far the simulator moved it.

    The simulator sees the same logs once more, and times of landing and breaking away pin
    parameters far more firmly than its friction law is true: its own covariance is too small.
    """
    n = start.p.size
    covariance = NOT_NEWS * done.covariance
    covariance[:n, :n] = NOT_NEWS * start.covariance
    covariance[:n, n:] = covariance[n:, :n] = 0.0
    moved = np.concatenate([done.p[:n] - start.p, np.zeros(done.p.size - n)])
    return np.asarray(covariance + np.diag(moved**2))


def loosened(fit: BalanceFit, more: int = 0) -> Known:
    """Return what balances know before bounces sharpen it, and nothing of `more` unknowns.

    Where motors turn unmeasured, a ripple tells its order and little more: a large one opens the
    meshes, through which it would be seen, and one motor's is seen as the other's.
    """
    covariance = LOOSE * fit.covariance
    if "chain" not in map(role_of, fit.kinds):
        for i, unknown in enumerate(fit.unknowns):
            if unknown.effect in FAST:
                covariance[i], covariance[:, i] = 0.0, 0.0
                covariance[i, i] = unknown.prior**2
    return widened(fit.p, covariance, more)


def widened(p: Floats, covariance: Floats, more: int) -> Known:
    """Return what is known of some unknowns, and of `more` behind them nothing."""
    n = p.size
    precision = np.zeros((n + more, n + more))
    precision[:n, :n] = np.linalg.inv(covariance)
    return Known(np.concatenate([p, np.zeros(more)]), precision)
