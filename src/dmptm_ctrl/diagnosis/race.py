"""Which effect lets the model keep step: for what is too little for the balances to see.

A model that obeys the machine's laws meets the first bounces one by one, see
:mod:`dmptm_ctrl.identify.lock`. Where the fitted model loses step within the first tenths of a
second, each catalogue effect runs beside it over the same growing horizon; those that miss more
than the best drop out. An effect that keeps step alone, for long, is there, however small its
torque. On a machine with other laws of friction or contact none does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.finish import (
    KEEPS_SECONDS,
    LAWFUL_SECONDS,
    MARGIN,
    Lap,
    Raced,
    faintly,
    judged,
    lawfully,
)
from dmptm_ctrl.diagnosis.runners import Runner, entrant, shaped, together
from dmptm_ctrl.diagnosis.trace import Trial, bent
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.lock import DOUBTFUL, HORIZONS, LOST, UNEASY, cut
from dmptm_ctrl.identify.records import Record

# Where all lose step after so long, it may be the way that was wrong: how many begin anew.
WAY_SECONDS, ONCE_MORE = 0.1, 3
TRIED = 4  # best candidates, for which other starts are tried
BEHIND = 8.0  # cost beyond the best one's, at which it may only have missed a way
# Seconds for which the model as it is keeps step too, from where only so many go on: those that
# balances and bounces together speak for.
EVEN_SECONDS, MANY = 0.15, 8
# Seconds by which landings tell so much that a first way into them may be wrong; how many of the
# best, by balances and by cost, begin anew from places drawn at random then.
SCATTER_SECONDS, SCATTERED = 0.05, 3


@dataclass
class Field:
    """Who still runs, and what the laps so far have told.

    Attributes
    ----------
    bare : Runner
        The model as it is; it goes on after it has dropped out.
    runners : list of Runner
        Those in the field.
    waiting : list of Runner
        Those that join when the model as it is loses step.
    last, even_so, outrun : Lap or None
        The last that someone has met; the one by which the model as it is keeps step for good;
        the one in which it has lost it late.
    proven : set of str
        Names that have met a lap that the model as it is has not.
    kept : float
        Seconds for which the model as it is keeps step.
    """

    bare: Runner
    runners: list[Runner]
    waiting: list[Runner]
    jobs: int
    last: Lap | None = None
    even_so: Lap | None = None
    outrun: Lap | None = None
    proven: set[str | None] = field(default_factory=set)
    kept: float = 0.0

    @property
    def all(self) -> list[Runner]:
        """The field, and the model as it is beside it."""
        return self.with_bare(self.runners)

    def with_bare(self, some: Sequence[Runner]) -> list[Runner]:
        """Return some runners, and the model as it is beside them."""
        return [*some, *([] if self.bare in some else [self.bare])]

    def sort(self) -> None:
        """Let the best come first."""
        self.runners.sort(key=lambda runner: runner.cost)

    @property
    def level(self) -> float:
        """Lowest of the field's."""
        return min(runner.level for runner in self.runners)

    def set_off(self, records: Sequence[Record]) -> None:
        """Begin a lap: all go, and those that wait where they are needed."""
        together(Runner.go, self.all, self.jobs, records, self.jobs)
        self.late_ones_join(records)

    def stuck(self, horizon: float) -> bool:
        """Whether no one meets the first landings well: some begin anew then."""
        return self.level > DOUBTFUL and SCATTER_SECONDS <= horizon <= WAY_SECONDS

    def lap(
        self, horizon: float, records: Sequence[Record], fitted: Sequence[Record], enough: float
    ) -> bool:
        """Run a lap of so many seconds to its end; whether there is another one to run."""
        self.begin_anew(horizon, records)
        self.cross()
        even = horizon >= EVEN_SECONDS
        late = self.look_around(even)
        if even and not self.proven and self.level > UNEASY:
            return False  # who has never met all bounces does not win, and none is near
        self.start_again(horizon, fitted, late)
        self.sort()
        if self.runners[0].level > LOST:
            return False
        self.kept = horizon if self.bare.level < DOUBTFUL else self.kept
        if self.kept == horizon and horizon >= KEEPS_SECONDS:
            self.even_so = self.after(horizon)
            return False
        if self.bare.level < UNEASY and horizon >= enough:
            self.last = self.outrun = None
            return False
        self.drop_out(horizon)
        if self.runners[0].level < UNEASY:
            self.last = self.after(horizon)
            self.proven |= self.last.proven
            if LAWFUL_SECONDS <= self.kept < horizon and self.runners[0].level < DOUBTFUL:
                self.outrun = self.last
        return True

    def late_ones_join(self, records: Sequence[Record]) -> None:
        """Let those that wait join where the model as it is loses step."""
        if not self.waiting or self.bare.level <= UNEASY:
            return
        joined = [one for one in self.waiting if one.joins(self.bare, records, self.jobs)]
        together(Runner.go, joined, self.jobs, records, self.jobs)
        self.runners, self.waiting = [*dict.fromkeys((*self.runners, *joined))], []

    def begin_anew(self, horizon: float, records: Sequence[Record]) -> None:
        """Draw places at random for some, where no one meets the first landings well."""
        if not self.stuck(horizon):
            return
        told = sorted(self.runners, key=lambda runner: -runner.told)[:SCATTERED]
        ahead = sorted(self.runners, key=lambda runner: runner.cost)[:SCATTERED]
        some = self.with_bare([*dict.fromkeys((*told, *ahead))])
        if horizon == SCATTER_SECONDS:
            together(Runner.scatters, some, self.jobs, records, self.jobs)
        else:
            together(Runner.closer, some, self.jobs, 1)

    def cross(self) -> None:
        """Let who is behind try the way of who is ahead."""
        self.sort()
        # the model as it is may be ahead after it has dropped out
        first = min(self.all, key=lambda runner: runner.cost)
        behind = [one for one in self.all if one.cost > first.cost + BEHIND]
        common = len(self.bare.unknowns)
        others = [runner for runner in behind if runner is not self.bare]
        together(Runner.crosses, others, self.jobs, [first], common)
        if self.bare in behind:
            # each of the others may have found the way that is right for the model as it is
            self.bare.crosses([r for r in self.runners if r is not self.bare], common)
        self.sort()

    def look_around(self, even: bool) -> list[Runner]:
        """Let the best that are not well try other starts; return those that may begin again."""
        best = self.with_bare(self.runners[:TRIED])
        late = [one for one in best if even and self.is_behind(one)]
        uneasy = [one for one in best if one.level > UNEASY or one in late]
        together(Runner.search, uneasy, self.jobs)
        return late

    def is_behind(self, one: Runner) -> bool:
        """Whether one is so far behind the first of the field that it may have missed a way."""
        return one.cost > self.runners[0].cost + BEHIND

    def start_again(self, horizon: float, fitted: Sequence[Record], late: Sequence[Runner]) -> None:
        """Let who is late go alone from the start; where all lose step, the most hopeful too."""
        late = [one for one in late if self.is_behind(one) and one.alone]
        together(Runner.from_the_start, late, self.jobs, fitted, horizon, self.jobs)
        if self.level > LOST and self.last is not None and self.last.seconds >= WAY_SECONDS:
            hopeful = self.hopeful(ONCE_MORE)
            together(Runner.from_the_start, hopeful, self.jobs, fitted, horizon, self.jobs)

    def hopeful(self, count: int) -> list[Runner]:
        """Those that bounces and balances together speak for."""
        return sorted(self.runners, key=lambda runner: runner.cost - runner.told)[:count]

    def drop_out(self, horizon: float) -> None:
        """Let go who misses more than the best, and make the others ready for the next lap."""
        bare, most = self.bare, self.runners[0].cost + MARGIN
        self.runners = [runner for runner in self.runners if runner.cost <= most]
        if bare.level < UNEASY and horizon >= EVEN_SECONDS:
            hopeful = self.hopeful(MANY)
            stay = (bare, *hopeful, *self.waiting)
            self.waiting += [one for one in self.runners if one not in stay]
            self.runners = [runner for runner in self.runners if runner in hopeful]
        if bare.cost > self.runners[0].cost + MARGIN:
            bare.from_place_of(self.runners[0])
        for runner in self.all:
            runner.settle()

    def after(self, seconds: float) -> Lap:
        """Return where all are after a horizon."""
        places = tuple(runner.place() for runner in self.runners)
        return Lap(seconds, self.bare.place(), places)

    def winner(self, held: Sequence[Record]) -> Raced | None:
        """Return who has won, if anyone."""
        won, last = None, self.last
        if last is not None and last.field[0].name in self.proven:
            won = judged(last, held, self.jobs)
        if won is None and self.even_so is not None:
            return faintly(self.even_so, held, self.jobs)
        if won is None and self.outrun is not None:
            return lawfully(self.outrun, held, self.jobs)
        return won


class Race:
    """Effects that run against the model as it is.

    Parameters
    ----------
    start : BalanceFit
        Of the model as it is, with the damping that its rattle tells.
    trials : sequence of Trial
        The effects, with the shapes that the balances like best.
    scan : bool
        Whether other orders are tried, which takes seconds.
    enough : float
        Seconds for which the model as it is keeps step if it lacks nothing that is looked for.

    Attributes
    ----------
    ended : bool
    """

    def __init__(
        self,
        fitted: Sequence[Record],
        held: Sequence[Record],
        start: BalanceFit,
        trials: Sequence[Trial],
        *,
        scan: bool = True,
        enough: float = np.inf,
        jobs: int = 2,
        seed: int = 0,
    ) -> None:
        self.fitted, self.held, self.enough = fitted, held, enough
        known = loosened(start)
        bare = entrant(None, start.model, start.unknowns, known, ())
        runners = [bare]
        for trial in trials:
            runners += shaped(trial, start, known, fitted, jobs, scan=scan)
        for i, runner in enumerate(runners):
            runner.rng = np.random.default_rng([seed, i])
        # no step from nothing finds those
        waiting = [one for one in runners if one.name is not None and bent(one.name)]
        self.running = Field(bare, runners, waiting, jobs)
        self._ahead = [*HORIZONS]
        self._begun: Sequence[Record] | None = None  # records of a lap that some have begun

    @property
    def ended(self) -> bool:
        """Whether there is no lap left to run."""
        return not self._ahead

    def run(self, *, pauses: bool = False) -> Raced | None:
        """Run to the end, or until some would begin anew; return who has won, if anyone."""
        while self._ahead:
            horizon, running = self._ahead[0], self.running
            if self._begun is None:
                self._begun = [cut(rec, horizon) for rec in self.fitted]
                running.set_off(self._begun)
            if pauses and running.stuck(horizon):
                return None
            goes_on = running.lap(horizon, self._begun, self.fitted, self.enough)
            self._begun, self._ahead = None, self._ahead[1:] if goes_on else []
        return self.running.winner(self.held)
