"""Second step: what the declared model, fitted inside its declared ranges, leaves."""

from dataclasses import dataclass, replace

import numpy as np

from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.fit import Fit, Misfit, drive_unknowns, fit, prior_cost
from dmptm_ctrl.simulate.model import Floats, Model

STIFF = 0.3  # of the prior's width, for the start that stays near the declaration
LEAD_HZ = 0.05  # slow lead by the measured angle: bounds drift, leaves everything faster


@dataclass(eq=False)
class Residual:
    """A fitted model and what it leaves on the logs that it was fitted to.

    Attributes
    ----------
    base : Fit
    misfit : Misfit
        Its weights are those of `base`, and stay for every comparison.
    held : Misfit
        The logs that judge, weighted the same way.
    runs : list of (n, 8) arrays
    vector : (m,) array
        Weighted; its square counts independent news.
    jacobian : (m, k) array
        What refitted parameters of the drive could explain.
    """

    base: Fit
    misfit: Misfit
    held: Misfit
    runs: list[Floats]
    vector: Floats
    jacobian: Floats

    @property
    def prior(self) -> Floats:
        """Inverse prior standard deviations of the unknowns."""
        return np.array([1.0 / k.prior for k in self.base.unknowns])


def residual(measured: Measured, *, jobs: int = 2, start: Model | None = None) -> Residual:
    """Fit the declared model and return what is left."""
    model = start or Model(measured.drive)
    misfit = Misfit(measured.fit, LEAD_HZ, jobs)
    unknowns = drive_unknowns(model)
    # Robust weights follow the iterate until it is near, then stay for the comparisons.
    base = fit(misfit, model, unknowns, iterations=3, reweigh=True)
    misfit.weigh(base.model)
    # Then the reference must be the best of the declared model under those very weights.
    base = fit(misfit, base.model, unknowns, iterations=12, tolerance=3e-3)
    held = Misfit(measured.held, LEAD_HZ, jobs)
    held.weigh(base.model)
    return linearised(base, misfit, held)


def linearised(base: Fit, misfit: Misfit, held: Misfit) -> Residual:
    """Gather residual and sensitivities at a fitted model."""
    vector = misfit.vector(base.model)
    cost = float(vector @ vector) + prior_cost(base.unknowns, base.p)
    base = replace(base, cost=cost, residual=vector)
    jacobian = misfit.columns(base.model, base.unknowns, vector)
    return Residual(base, misfit, held, misfit.runs(base.model), vector, jacobian)


def near_declared(left: Residual, drive: Drive) -> Residual:
    """Return a second start: the drive held near its declaration, weighted as `left`.

    A fit that bent its parameters to absorb an effect is a trap; this one could not.
    """
    unknowns = left.base.unknowns
    model = Model(drive, left.base.model.effects)
    stiff = tuple(replace(k, prior=STIFF * k.prior) for k in unknowns)
    held_back = fit(left.misfit, model, stiff, iterations=5)
    start = replace(held_back, unknowns=unknowns)
    return linearised(start, left.misfit, left.held)
