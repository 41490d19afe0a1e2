"""Whether friction gives a little before it slides, told beside the effects that may be there.

What lets the drive leave rest early, as an offset does, is missed there as giving friction is.
"""

from collections.abc import Sequence
from dataclasses import replace

from dmptm_ctrl.diagnosis.at_rest import softened
from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.runners import Runner, entrant, shaped, together
from dmptm_ctrl.diagnosis.trace import Trial
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.lock import HORIZONS, cut
from dmptm_ctrl.identify.records import Record

FIRST = HORIZONS[:2]  # in which who has the right law of friction loses no step


def giving_or_not(
    records: Sequence[Record], start: BalanceFit, trials: Sequence[Trial], jobs: int
) -> tuple[BalanceFit, list[Trial], bool]:
    """Let friction give a little, unless one meets the first landings better where it sticks.

    Parameters
    ----------
    start : BalanceFit
        Of the model as it is, with friction that sticks.
    trials : sequence of Trial
        The effects that may be there.

    Returns
    -------
    start : BalanceFit
    trials : list of Trial
    sticks : bool
    """
    behind = len(start.unknowns)
    soft = [replace(trial, fit=softened(trial.fit, behind)) for trial in trials]
    of_soft = softened(start, behind)
    if at_first(records, start, trials, jobs) < at_first(records, of_soft, soft, jobs):
        return start, [*trials], True
    return of_soft, soft, False


def at_first(
    records: Sequence[Record], start: BalanceFit, trials: Sequence[Trial], jobs: int
) -> float:
    """Return what the nearest of all costs over the first hundredths of a second."""
    known = loosened(start)
    field = [entrant(None, start.model, start.unknowns, known, ())]
    for trial in trials:
        field += shaped(trial, start, known, records, jobs, scan=False)
    for seconds in FIRST:
        together(Runner.go, field, jobs, [cut(rec, seconds) for rec in records], jobs)
        for runner in field:
            runner.settle()
    return min(runner.cost for runner in field)
