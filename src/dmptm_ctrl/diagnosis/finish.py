"""Who has won a race, if anyone: the model as it is has lost step, and held-out logs agree."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import Unknown
from dmptm_ctrl.identify.lock import DOUBTFUL, HORIZONS, LOST, NEWS, Steps, cut, level, loss
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Floats, Model

WINS_SECONDS = 0.15  # for which a winner keeps step
# A model that keeps step for so long, as well as noise lets it, need not race.
KEEPS_SECONDS = 0.6
MARGIN = 40.0  # cost beyond the best one's at which a candidate drops out
# The same for the last lap, where the best one leaves no more than noise: costs are what they
# claim to be then, logarithms of likelihoods.
CLEARLY = 20.0
LEAST = 150.0  # evidence of a winner
# Times the winner's loss per sample: so far out of step is the model as it is. Where friction is
# only a little other than the model's, an effect that mends it in part leaves more of it.
OUT = 2.7
WELL = 0.4  # mean loss per sample that leaves nothing to mend
# Of a clearly visible offset, by which the motors' offsets differ at least: what is common to both
# acts as a friction that is not the same both ways, and mends a part of another law of friction.
APART = 0.2
SLIDING = ("T3c_plus", "T3c_minus")  # friction of a pinion, each way
# Of a clearly visible effect, a winner at least: less moves the landings by a digit that any drive
# may find. In campaigns wrong winners had 0.04 to 0.18, right ones 0.67 and more.
SMALLEST = 0.3
# Where the model as it is keeps step itself, its laws are the machine's: cost by which one is ahead
# of it and of every other name there, and gain of the held-out logs.
FAINT_LEAD, FAINT_HELD = 12.0, 8.0
# Share of that lead that one fitted log makes at most. A bounce that one model misses in one log is
# a way that was not found: 31 of a lead of 36 on a rig where three names gained it alike.
FAINT_SHARE = 0.5
# The same where it has kept step for `LAWFUL_SECONDS` and loses it then, which may be a way through
# the bounces that was not found: another one would find more or less of it. Share of the winner's
# lead that any other name has.
LAWFUL_SECONDS, LAWFUL_LEAD, LAWFUL_SHARE = 0.3, 60.0, 0.3
HELD_SHARE = 0.3  # of what a fitted log commonly gains, that a held-out log gains at least
CHANCE = 0.05  # share of what one log alone gains, by which all held-out logs may miss more


@dataclass(frozen=True, eq=False)
class Raced:
    """The winner.

    Attributes
    ----------
    name : str
    model : Model
        With the effect, at its values.
    seconds : float
        For which it keeps step.
    evidence : float
        By how much the model as it is misses more, on fitted and held-out logs.
    held_gain : float
        The held-out logs' share of it.
    threshold : float
        Evidence that is asked for.
    """

    name: str
    model: Model
    seconds: float
    evidence: float
    held_gain: float
    threshold: float = LEAST


class Place(NamedTuple):
    """Where a runner is after a lap."""

    name: str | None
    steps: Steps
    p: Floats
    cost: float
    level: float

    @property
    def model(self) -> Model:
        """The model there."""
        return self.steps.placed(self.p)

    def missed(self, records: Sequence[Record], jobs: int) -> Floats:
        """Loss on each of some records."""
        each = [replace(self.steps, records=[rec], jobs=jobs) for rec in records]
        return np.array([NEWS * loss(steps.residuals([self.p])).sum() for steps in each])


class Lap(NamedTuple):
    """The model as it is and those in the field, the best first, after a horizon."""

    seconds: float
    bare: Place
    field: tuple[Place, ...]

    @property
    def lead(self) -> float:
        """Cost by which the winner is ahead of the model as it is."""
        return self.bare.cost - self.field[0].cost

    @property
    def proven(self) -> set[str | None]:
        """Who meets all bounces here where the model as it is does not.

        Who never does may mend a part of what other laws of friction or contact make.
        """
        out = self.bare.level
        met = [place for place in self.field if place.level < DOUBTFUL]
        return {place.name for place in met if out >= min(LOST, OUT * place.level)}


def judged(lap: Lap, held: Sequence[Record], jobs: int) -> Raced | None:
    """Return the winner, if the model as it is has lost step and the held-out logs agree."""
    winner, bare = lap.field[0], lap.bare
    if lap.seconds < WINS_SECONDS or winner.name is None:
        return None
    if not behind(bare.level, winner.level):
        return None
    margin = CLEARLY if winner.level < DOUBTFUL else MARGIN
    if not ahead_of_others(lap, margin):
        return None  # several mend a law that is not quite the model's
    won = agreed(lap, held, LEAST, -np.inf, jobs)
    return won if won and won.evidence >= LEAST else None


def faintly(lap: Lap, held: Sequence[Record], jobs: int) -> Raced | None:
    """Return who is clearly ahead where the model as it is keeps step too, if held-out logs agree.

    What is too little to lose step is then worth as much as the likelihoods say.
    """
    if lap.lead < FAINT_LEAD or not ahead_of_others(lap, FAINT_LEAD):
        return None
    return agreed(lap, held, FAINT_LEAD + FAINT_HELD, FAINT_HELD, jobs, most=FAINT_SHARE)


def lawfully(lap: Lap, held: Sequence[Record], jobs: int) -> Raced | None:
    """Return who alone goes on where the model as it is, and all others, lose step late.

    What begins then, a limit that is reached, held-out logs need not show.
    """
    others = (p.cost for p in lap.field if p.name not in (None, lap.field[0].name))
    nearest = min(others, default=np.inf) - lap.field[0].cost
    if lap.lead < LAWFUL_LEAD or nearest < (1.0 - LAWFUL_SHARE) * lap.lead:
        return None
    return agreed(lap, held, LAWFUL_LEAD, -np.inf, jobs)


def agreed(
    lap: Lap,
    held: Sequence[Record],
    threshold: float,
    least: float,
    jobs: int,
    most: float = np.inf,
) -> Raced | None:
    """Return the winner of a lap, if held-out logs agree and gain no less than so much.

    Nor does one fitted log alone make more than a share of the lead, if there is a limit to it.
    """
    gains, held_gains = gained(lap, held, jobs)
    held_gain = float(held_gains.sum())
    if held_gain < least or gains.max() > most * lap.lead:
        return None
    if not (agree(gains, held_gains) and large_enough(lap)):
        return None
    won = lap.field[0]
    assert won.name is not None
    return Raced(won.name, won.model, lap.seconds, lap.lead + held_gain, held_gain, threshold)


def gained(lap: Lap, held: Sequence[Record], jobs: int) -> tuple[Floats, Floats]:
    """What each fitted and held-out log gains for as long as held-out logs tell."""
    winner, bare = lap.field[0], lap.bare
    seconds = tells_for((bare, winner), held, lap.seconds, jobs)
    parts = [[cut(rec, seconds) for rec in some] for some in (winner.steps.records, held)]
    gains, held_gains = (bare.missed(some, jobs) - winner.missed(some, jobs) for some in parts)
    return gains, held_gains


def ahead_of_others(lap: Lap, margin: float) -> bool:
    """Whether no other name, nor the model as it is, comes near the winner."""
    winner = lap.field[0]
    near = [place for place in lap.field if place.cost < winner.cost + margin]
    return all(place.name == winner.name for place in near)


def large_enough(lap: Lap) -> bool:
    """Whether the winner is no digit that any drive may find, and no friction."""
    winner = lap.field[0]
    assert winner.name is not None
    if size(winner.model, winner.name) < SMALLEST:
        return False
    lasting = lap.seconds >= KEEPS_SECONDS and winner.level < DOUBTFUL
    return told_from_friction(winner.model, winner.name) or (
        lasting and beyond_friction(winner.model, winner.steps.unknowns)
    )


def tells_for(places: Sequence[Place], held: Sequence[Record], longest: float, jobs: int) -> float:
    """Return for how long held-out logs tell: where no one keeps step any more, chance does.

    They were not fitted, and a value moved by a hair for a fitted log's sake meets their later
    bounces a little better or worse. If no one ever does, the whole run tells.
    """
    models = [place.steps.placed(place.p) for place in places]
    ahead = (h for h in reversed(HORIZONS) if h <= longest)
    kept = (h for h in ahead if any(level(one, held, h, jobs) < LOST for one in models))
    return next(kept, longest)


def behind(bare: float, winner: float) -> bool:
    """Whether the model as it is, by its level, has lost step where the winner of a lap keeps it.

    One that meets all bounces is known to have been ahead before, see :attr:`Lap.proven`: who lost
    step at an early reversal may meet most of a long run again.
    """
    return winner < DOUBTFUL or bare >= max(LOST, winner * (1.0 if winner < WELL else OUT))


def agree(gains: Floats, held_gains: Floats) -> bool:
    """Whether held-out logs gain what is common to the fitted ones.

    What shows in one log only, a limit that no other reaches, need not show there; values that
    have moved for its sake then meet the others a little better or worse, by chance.
    """
    common = max(float(np.median(gains)), 0.0)
    one_s_own = max(float(gains.sum()) - common * gains.size, 0.0)
    return bool(held_gains.sum() >= HELD_SHARE * common * held_gains.size - CHANCE * one_s_own)


def size(model: Model, name: str) -> float:
    """Largest amplitude of an effect, as a share of a clearly visible one."""
    effect, values = CATALOGUE[name], model.effects[name]
    return max(
        abs(values.get(p.name, 0.0)) / p.step
        for p in effect.parameters
        if p.name in effect.amplitudes
    )


def told_from_friction(model: Model, name: str) -> bool:
    """Whether an effect is more than friction that is not the same both ways."""
    if name != "drive_offset":
        return True
    steps = {p.name: p.step for p in CATALOGUE[name].parameters}
    values = model.effects[name]
    return abs(values["left"] - values["right"]) > APART * steps["left"]


def beyond_friction(model: Model, unknowns: Sequence[Unknown]) -> bool:
    """Whether a common offset is more than friction inside its ranges can differ both ways."""
    drive, values = model.drive, model.effects["drive_offset"]
    common = 0.5 * (values["left"] + values["right"])
    torque = abs(drive["N_1"] * drive["K_d"] * drive["K_M"] * common)
    ranges = [k.scale for k in unknowns if k.effect is None and k.name in SLIDING]
    return bool(ranges) and torque > min(ranges)
