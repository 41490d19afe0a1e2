"""Bring models to the first landings of the logs: as they are, or with one effect or another.

From the starts of the logs over a horizon that grows, each from several places: first impacts are
met in many ways, of which the next leave few.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import product

import numpy as np

from dmptm_ctrl.diagnosis.at_rest import sized
from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.local_gaps import VARYING, waves_of_gaps
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.runners import Runner, beside, entrant, together
from dmptm_ctrl.diagnosis.runoff import Run, run, starts
from dmptm_ctrl.diagnosis.trace import FIXED_SHAPES, WITHOUT_TWIST, unknowns_of
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Unknown, position
from dmptm_ctrl.identify.lock import LOST, SCATTERED, UNEASY, cut
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Floats, Model

BY_IMPACTS = (*WITHOUT_TWIST, "torque_constant_mismatch")
FIRST_SECONDS = (0.03, 0.05, 0.07, 0.1)  # of each log, one after another
# Places that go on from each: first impacts alone are met in many ways, of which the next leave
# few; the one that leaves least there is seldom right.
PLACES = (8, 4, 3, 2)
PLACES_OF_ALL = (4, 3, 2, 2)  # where all logs are met together, from places that are known
# The amplitudes of a wave that the next impacts tell, drawn anew about each of these places: how
# many draws, and how far in steps.
REDRAWN, RESIZED = 3072, (2.0, 4.0, 8.0)
SIZES = (1.0, -1.0, 4.0, -4.0)  # of each amplitude, in its step, to start from
QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))  # cosine and sine
WAVES = (3.0, 10.0, 30.0)  # of one over an angle
SEARCHES = 2  # at a horizon where no start is near
BEHIND = 2.0  # times the nearest one's loss, from where none looks for another start


@dataclass(frozen=True, eq=False)
class Landings:
    """Where models are that were fitted to the first landings of the logs.

    Attributes
    ----------
    whole : two sequences of Record
        Fitted and held-out logs.
    base : BalanceFit
        What they start from.
    alone : Runner
        The model as it is.
    entered : sequence of (str, Runner)
        With an effect, of each of its patterns.
    field : dict
        The best pattern of each effect.
    runs : dict
        What it misses.
    """

    whole: tuple[Sequence[Record], Sequence[Record]]
    base: BalanceFit
    alone: Runner
    entered: Sequence[tuple[str, Runner]]
    field: Mapping[str, Runner]
    runs: Mapping[str, Run]

    def nearest(self, count: int) -> list[str]:
        """Return the effects with which least is missed."""
        return sorted(self.runs, key=lambda name: self.runs[name].level)[:count]


def landings(
    left: Residual,
    base: BalanceFit,
    jobs: int,
    seed: int,
    among: Sequence[str] = BY_IMPACTS,
    *,
    none_tells: bool = False,
) -> Landings:
    """Fit a model as it is, and with one effect or another, to the first landings.

    Where it is known that the model as it is, as `base` has it, meets them, none tells anything:
    all are only brought there.
    """
    whole = left.measured.fit, left.measured.held
    alone = enter([base.model], base, (), seed)
    new = [name for name in among if name not in base.model.effects]
    seen: dict[str, list[Model]] = {}  # where the reversals see an effect
    if VARYING in new and not none_tells:
        seen[VARYING] = waves_of_gaps(whole[0], base.model, left.measured.drive, jobs, seed)
    entered = [
        (name, enter([*models, *seen.get(name, ())], base, unknowns_of(name), seed))
        for name in new
        for models in variants(name, base.model)
    ]
    field = [one for _, one in entered]
    if none_tells:
        brought(alone, field, whole[0], jobs)
    else:
        race_first(alone, field, whole[0], jobs)
    parts = starts(whole, FIRST_SECONDS[-1])
    best: dict[str, Runner] = {}
    runs: dict[str, Run] = {}
    for name, one in entered:
        own = run(parts, one.there, jobs)
        if name not in best or own.level < runs[name].level:
            best[name], runs[name] = one, own
    return Landings(whole, base, alone, entered, best, runs)


def variants(name: str, model: Model) -> list[list[Model]]:
    """Models with an effect of each pattern, of several sizes and phases to start from."""
    effect = CATALOGUE[name]
    fixed = FIXED_SHAPES.get(name, ())
    banks = [(p.name, value) for p in effect.parameters if p.name in fixed for value in p.bank]
    patterns: list[Mapping[str, float]] = [{key: value} for key, value in banks] or [{}]
    models = waves(name, model)
    if not models:
        signed = any(p.low < 0.0 for p in effect.parameters if p.name in effect.amplitudes)
        models = [sized(name, model, size) for size in SIZES if signed or size > 0.0]
    return [
        [one.with_effect(name, **{**one.effects[name], **pattern}) for one in models]
        for pattern in patterns
    ]


def waves(name: str, model: Model) -> list[Model]:
    """Models with one wave of an effect over an angle, a quarter of a turn apart; none if flat."""
    effect = CATALOGUE[name]
    steps = {p.name: p.step for p in effect.parameters}
    none = dict.fromkeys(effect.amplitudes, 0.0)
    started = []
    for cosine in effect.amplitudes:
        sine = cosine.replace("cosine", "sine")
        if sine == cosine or sine not in none or cosine.startswith("apart"):
            continue
        for size, (c, s) in product(WAVES, QUARTERS):
            wave = {cosine: size * c * steps[cosine], sine: size * s * steps[sine]}
            started.append(model.with_effect(name, **{**none, **wave}))
    return started


def enter(models: Sequence[Model], base: BalanceFit, own: tuple[Unknown, ...], seed: int) -> Runner:
    """Enter a model that starts from several sizes of an effect."""
    unknowns = (*base.unknowns, *own)
    known = beside(loosened(base), models[0], own)
    others = [position(model, unknowns) for model in models[1:]]
    one = entrant(None, models[0], unknowns, known, others)
    one.rng = np.random.default_rng(seed)
    one.wave = len(own) if own and waves(str(own[0].effect), models[0]) else 0
    return one


def race_first(
    alone: Runner,
    field: Sequence[Runner],
    records: Sequence[Record],
    jobs: int,
    places: Sequence[int] = PLACES,
    *,
    afresh: bool = True,
    hopeless: float = np.inf,
) -> None:
    """Fit all to the first hundredths of a second, then to the next, from several places each.

    Who is not near looks for other starts, unless another one leaves much less. The second impact
    is the other pinion's: every wave is drawn anew there, or one of them would win by chance. Not
    so where they do not begin afresh, but from places that are known. Where the nearest one leaves
    more than what is hopeless by the second lap, no later one is run.
    """
    entered = (alone, *field)
    for lap, (seconds, kept) in enumerate(zip(FIRST_SECONDS, places, strict=True)):
        came = {one: one.places for one in entered}
        together(Runner.go, entered, jobs, [cut(rec, seconds) for rec in records], jobs)
        if afresh and lap == 0:
            together(lambda one: one.spread(one.draw(SCATTERED)), entered, jobs)
        far = within(entered)
        redraws = (0.0, np.inf if afresh else far, far, far)[lap]
        some = [one for one in entered if UNEASY < one.level <= max(redraws, far)]
        together(looks_on, some, jobs, came, redraws, far)
        for one in entered:
            one.settle()
            one.places = one.different(kept)
        if lap > 0 and min(one.level for one in entered) > hopeless:
            break


def of_all_logs(
    landed: Landings, names: Sequence[str], jobs: int
) -> tuple[Runner, dict[str, Runner]]:
    """Bring the model as it is, and some effects, to the first landings of all logs together.

    Half a dozen logs leave open by how much a landing at another angle is early: so finely does
    it depend on what is fitted that the right effect misses it, too, until it is told of it.
    """
    alone, field = copy(landed.alone), {name: copy(landed.field[name]) for name in names}
    records = [rec for part in landed.whole for rec in part]
    some = [*field.values()]
    race_first(alone, some, records, jobs, PLACES_OF_ALL, afresh=False, hopeless=LOST)
    alone.from_place_of(min(field.values(), key=lambda one: one.cost))
    return alone, field


def brought(alone: Runner, field: Sequence[Runner], records: Sequence[Record], jobs: int) -> None:
    """Fit all to the first landings at once, from where the model as it is meets them."""
    parts = [cut(rec, FIRST_SECONDS[-1]) for rec in records]
    together(Runner.go, (alone, *field), jobs, parts, jobs)
    together(from_none, field, jobs, alone)
    for one in (alone, *field):
        one.settle()
        one.places = one.different(PLACES[-1])


def from_none(one: Runner, alone: Runner) -> None:
    """Go on from where the model as it is is, with nothing of the effect yet."""
    own = one.unknowns[len(alone.unknowns) :]
    there = position(one.model, own)
    there[[k.name in CATALOGUE[str(k.effect)].amplitudes for k in own]] = 0.0
    one.pursue(np.concatenate([alone.places[0], there]))


def looks_on(one: Runner, came: Mapping[Runner, list[Floats]], redraws: float, far: float) -> None:
    """Draw a wave anew about the places it came from, look for other starts."""
    if one.wave and UNEASY < one.level <= redraws:
        one.places = came[one]
        one.spread(one.anew(one.wave, REDRAWN, RESIZED))
    for _ in range(SEARCHES):
        looks(one, far)


def looks(one: Runner, far: float) -> None:
    """Look for another start where all is not well, unless the nearest one leaves much less."""
    if UNEASY < one.level <= far:
        one.search()


def within(entered: Sequence[Runner]) -> float:
    """Return the loss up to which one looks for other starts, as the nearest leaves no less."""
    return max(UNEASY, BEHIND * min(one.level for one in entered))
