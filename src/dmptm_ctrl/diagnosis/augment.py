"""Fourth step: the effects that were found go into the simulator, and everything is refitted."""

from collections.abc import Sequence

import numpy as np

from dmptm_ctrl.diagnosis.residual import LEAD_HZ
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit, Known, Misfit, fit
from dmptm_ctrl.identify.records import Record

ITERATIONS = 5  # from the balance's values, which are near


def augment(records: Sequence[Record], start: BalanceFit, *, jobs: int = 2) -> Fit:
    """Refit a model inside the simulator, from what the balances know.

    The balances know nothing of what happens inside a gap or at rest; the simulation does,
    and from values this near it does not lose its way among the rattle.
    """
    misfit = Misfit(records, LEAD_HZ, jobs)
    misfit.weigh(start.model)
    known = Known(start.p, np.asarray(np.linalg.inv(start.covariance), np.float64))
    return fit(misfit, start.model, start.unknowns, iterations=ITERATIONS, known=known)
