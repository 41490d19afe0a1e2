"""Whether friction gives a little before it slides, told beside the effects that may be there.

What lets the drive leave rest early, as an offset does, is missed there as giving friction is.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

from dmptm_ctrl.diagnosis.at_rest import softened
from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.runners import Runner, entrant, shaped, together
from dmptm_ctrl.diagnosis.trace import Trial
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.lock import HORIZONS, LOST, cut
from dmptm_ctrl.identify.records import Record

FIRST = HORIZONS[:2]  # in which who has the right law of friction loses no step


class Giving(NamedTuple):
    """What a model starts from, as friction gives or sticks.

    Attributes
    ----------
    start : BalanceFit
        The model as it is.
    trials : list of Trial
        The effects that may be there.
    sticks : bool
        Whether friction sticks.
    told : bool
        Whether anyone meets the first landings; else neither law does.
    """

    start: BalanceFit
    trials: list[Trial]
    sticks: bool
    told: bool


def giving_or_not(
    records: Sequence[Record], start: BalanceFit, trials: Sequence[Trial], jobs: int
) -> Giving:
    """Let friction give a little, unless one meets the first landings better where it sticks.

    Parameters
    ----------
    start : BalanceFit
        Of the model as it is, with friction that sticks.
    trials : sequence of Trial
        The effects that may be there.
    """
    behind = len(start.unknowns)
    soft = [replace(trial, fit=softened(trial.fit, behind)) for trial in trials]
    of_soft = softened(start, behind)
    stuck, gave = (at_first(records, *law, jobs) for law in ((start, trials), (of_soft, soft)))
    sticks, told = stuck.cost < gave.cost, min(stuck.level, gave.level) < LOST
    return Giving(start, [*trials], True, told) if sticks else Giving(of_soft, soft, False, told)


def at_first(
    records: Sequence[Record], start: BalanceFit, trials: Sequence[Trial], jobs: int
) -> Runner:
    """Return the nearest of all over the first hundredths of a second."""
    known = loosened(start)
    field = [entrant(None, start.model, start.unknowns, known, ())]
    for trial in trials:
        field += shaped(trial, start, known, records, jobs, scan=False)
    for seconds in FIRST:
        together(Runner.go, field, jobs, [cut(rec, seconds) for rec in records], jobs)
        for runner in field:
            runner.settle()
    return min(field, key=lambda runner: runner.cost)
