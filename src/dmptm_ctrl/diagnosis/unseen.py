"""What the balances tell nothing of: tried in the simulator, from the first bounces of the logs.

Without motor encoders the twist is not measured: an error of the teeth, a soft reducer or motors
that differ move only the times of the impacts. Within the first tenth of a second, before chance
has a say, the right one takes off most of what the model misses, on held-out logs too, under
most laws of contact and of friction; on others none does. Friction that grows with the time at
rest acts where no window is counted, and later: on a machine that obeys the model's laws
otherwise it alone lets the model keep step.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dmptm_ctrl.diagnosis.at_rest import AtRest, fitted, sized, softened
from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.finish import HELD_SHARE, OUT, SMALLEST, size
from dmptm_ctrl.diagnosis.landings import (
    BY_IMPACTS,
    FIRST_SECONDS,
    Landings,
    landings,
    looks,
    of_all_logs,
    within,
)
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.runners import Runner, beside, together
from dmptm_ctrl.diagnosis.runoff import KEEPS_SECONDS, Run, horizons, lost, run, starts
from dmptm_ctrl.diagnosis.trace import NEEDS_TWIST, WITHOUT_TWIST, unknowns_of
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.identify.lock import (
    DOUBTFUL,
    LOST,
    NEWS,
    NOISE_LEVEL,
    UNEASY,
    Locked,
    cut,
    level,
    lock,
)
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.identify.segments import reversals
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Model

AGEING = "unknown_breakaway"
SHARE = 0.5  # of what the model misses, that a winner takes off
# Where the law of the flanks is not quite the model's, none is near in the end; one alone that
# leaves so little, where each of the others leaves so much, is told all the same.
APART, OTHERS = 0.45, 0.75
# Of each reversal, from just before the meshes open; later a true model has lost step as well.
REVERSAL_SECONDS = (0.05, 0.07)
# Cost by which one of them is ahead of the model as it is at each: of what a winner has in the end
# a fifth. On rigs of benchmarks/rigs true ones had 38 to 129 at the first, others at most 13.
AHEAD = 20.0
MISSES = 1.6  # times the winner's loss, that the model as it is has there
LEAST_SECONDS = 0.1  # for which a winner among the rest keeps step; the first landings are before
# The same of what those landings, judged by themselves, have not told: it is to be seen in more.
LATER_SECONDS = 0.15
LEAST = 100.0  # evidence of a winner
# Of what the model misses beyond noise, that friction which grows with the time at rest leaves at
# most: of 18 rigs where it is large 17 have 0 to 0.65; of 110 that lack nothing, of all laws,
# those for which anything speaks have 0.86 and more.
LEAVES, LEAST_AGED = 0.7, 60.0  # and the evidence for it: those that leave less have 44 at most
# Errors of the teeth move the landings alike: of 13 such names on rigs of benchmarks/rigs 10 were
# right (seeds 97, 199, 401 to 406, 801).
SUREST = {**dict.fromkeys(WITHOUT_TWIST, 0.95), **dict.fromkeys(NEEDS_TWIST, 0.8)}
MARGIN = 40.0  # evidence by which another one is out of step
ONCE_MORE = 3  # of the nearest, that are tried where friction sticks as well


@dataclass(frozen=True, eq=False)
class Shown:
    """An effect with which alone the model keeps step.

    Attributes
    ----------
    name : str
    fit : Fit
        Of the model with it.
    gain, held_gain : float
        Fall of the loss on the starts of fitted and held-out logs.
    rivals : tuple of Shown
        Others that keep step as long.
    everywhere : bool
        Whether the reversals of whole logs tell it, not only their starts.
    meets : bool
        Whether it meets these starts well where the model as it is has lost step altogether.
    """

    name: str
    fit: Fit
    gain: float
    held_gain: float
    rivals: tuple["Shown", ...] = ()
    everywhere: bool = False
    meets: bool = False

    @property
    def evidence(self) -> float:
        """Fall of the loss on all logs."""
        return self.gain + self.held_gain


def names(left: Residual) -> tuple[str, ...]:
    """Effects of which the balances of these logs tell nothing."""
    return (AGEING,) if left.measured.has_motor_encoders else (AGEING, *BY_IMPACTS)


def unseen(
    left: Residual,
    before: Fit,
    *,
    rested: AtRest | None = None,
    alone: bool = True,
    jobs: int = 2,
    seed: int = 0,
) -> Shown | Fit | None:
    """Find what lets a model keep step that loses it.

    Parameters
    ----------
    left : Residual
        What the model leaves.
    before : Fit
        That model, refitted inside the simulator.
    rested : AtRest, optional
        What the first tenth of a second tells of friction that gives before it slides.
    alone : bool
        Whether nothing else was found: friction that grows with the time at rest shows alone only.

    Returns
    -------
    Shown or Fit or None
        A fit of the model as it is, where it keeps step for longer from values that another one
        has led to; None where nothing, or not one thing alone, lets the model keep step.
    """
    everything = (*left.measured.fit, *left.measured.held)
    if before.horizon >= KEEPS_SECONDS and keeps_all(before, everything, jobs):
        return None
    base = rattled(left.measured.fit, left.base, left.measured.drive, jobs)
    if alone and before.horizon < LEAST_SECONDS:  # soon tried, and where it is told none is left
        aged = ageing(left, base, before, jobs, seed, anew=False)
        if isinstance(aged, Shown):
            return aged
    if not left.measured.has_motor_encoders:
        gives = rested is not None and rested.gives
        start, other = (softened(base, len(base.unknowns)) if gives else base), base
        if rested is not None and gives and not rested.told:  # neither law: the declared one first
            start, other = other, start
        turns = start is base  # a friction law of another kind lets no model meet the reversals
        ahead = horizons(FIRST_SECONDS[-1], before.horizon)
        meets = any(level(before.model, left.measured.fit, h, jobs) < DOUBTFUL for h in ahead)
        if meets and start.model.effects.keys() == before.model.effects.keys():
            start = replace(start, model=before.model)  # from where the first ones are met
        landed = landings(left, start, jobs, seed, none_tells=meets)
        found: Shown | Fit | None = by_all_logs(landed, jobs, seed, turns=turns)
        if found is None:
            found = by_impacts(landed, jobs, seed, turns=turns)
        doubtful = rested is not None and rested.doubtful
        if doubtful and found is None and landed.alone.level > LOST:  # it may be the other law
            landed = landings(left, other, jobs, seed, among=landed.nearest(ONCE_MORE))
            found = by_impacts(landed, jobs, seed, turns=other is base)
        if isinstance(found, Fit) and found.horizon <= before.horizon:
            found = None
        if isinstance(found, Shown) and size(found.fit.model, found.name) < SMALLEST:
            found = None  # it mends a part of another law of friction or of the flanks
        if found is not None:
            return found
    return ageing(left, base, before, jobs, seed) if alone else None


def by_all_logs(landed: Landings, jobs: int, seed: int, *, turns: bool = True) -> Shown | None:
    """Find the effect that meets the first impacts of all logs where the model as it is does not.

    Those that do are told apart by how long they keep step with the fitted logs, else by the
    reversals; where neither tells, the nearest one has rivals.
    """
    whole = landed.whole
    near = [name for name in landed.nearest(ONCE_MORE) if landed.runs[name].level < LOST]
    if not near:
        return None
    alone, field = of_all_logs(landed, near, jobs)
    name, *others = sorted(field, key=lambda n: field[n].cost)
    best = field[name]
    if best.level > DOUBTFUL or alone.level < LOST or alone.cost < best.cost + LEAST:
        return None
    rivals = [n for n in others if field[n].cost < best.cost + MARGIN]
    kept = all_onward({n: field[n] for n in (name, *rivals)}, whole[0], jobs, seed)
    parts = starts(whole, FIRST_SECONDS[-1])
    bare = run(parts, alone.there, jobs)
    each = {
        n: shown(n, fit_of(field[n], kept[n]), bare, run(parts, field[n].there, jobs)) for n in kept
    }
    if rivals:
        first = outlasting(kept, whole, jobs)
        if first is None and turns:
            entrants = [(n, field[n]) for n in kept]
            met = by_reversals(whole, landed.base.model, alone, entrants, jobs, told=True)
            first = None if met is None or met.rivals else met.name
        if first is not None:
            name, rivals = first, []
    return replace(each[name], rivals=tuple(each[n] for n in rivals))


def keeps_all(before: Fit, records: Sequence[Record], jobs: int) -> bool:
    """Whether a model meets the first landings of all logs, of which it was fitted to some."""
    return level(before.model, records, FIRST_SECONDS[-1], jobs) < LOST


def by_impacts(landed: Landings, jobs: int, seed: int, *, turns: bool = True) -> Shown | Fit | None:
    """Find the effect that meets the first impacts where the model as it is does not."""
    whole, base, alone = landed.whole, landed.base, landed.alone
    entered, field, runs = landed.entered, landed.field, landed.runs
    if alone.level < LOST:  # reversals at other angles may tell
        return by_reversals(whole, base.model, alone, entered, jobs) if turns else None
    parts = starts(whole, FIRST_SECONDS[-1])
    going = {name: one for name, one in field.items() if runs[name].level < LOST}
    kept = all_onward(going, whole[0], jobs, seed)
    name = landed.nearest(1)[0]
    won = runs[name]
    alone.from_place_of(field[name])
    bare = run(parts, alone.there, jobs)
    share = max(won.fitted / bare.fitted, won.held / bare.held)
    told = share <= SHARE and bare.total - won.total > LEAST
    apart = stands_apart(won, bare, (r.total for n, r in runs.items() if n != name))
    near = [n for n in runs if n != name and runs[n].total < won.total + MARGIN]
    told = apart or (told and won.level < LOST)
    if turns and (near or not told):  # other reversals may tell, or a longer run
        entrants = [(n, one) for n, one in entered if not told or n in (name, *near)]
        met = by_reversals(whole, base.model, alone, entrants, jobs, told=told)
        if told and met is not None and met.name in kept:
            return replace(met, fit=fit_of(field[met.name], kept[met.name]))
        if met is not None:
            return met
        if told:  # one of several that no reversal tells from the others: a longer run may
            first = outlasting({n: kept[n] for n in (name, *near) if n in kept}, whole, jobs)
            if first is None:
                return None
            return shown(first, fit_of(field[first], kept[first]), bare, runs[first])
    if not told:
        name = max(going, key=lambda n: kept[n].lasts(), default="")
        if not name:
            return None
        between = LATER_SECONDS, kept[name].horizon
        bare_too = without(kept[name], base, whole[0], jobs, seed)
        longer = max(onward(alone, whole[0], jobs, seed), bare_too, key=Locked.lasts)
        ahead = lost(whole, longer.model, kept[name].model, between, jobs)
        if ahead is None:
            return longer.as_fit(base.unknowns) if longer is bare_too else None
        seconds, bare, won = ahead
        parts = starts(whole, seconds)
        runs = {n: run(parts, kept[n].model, jobs) for n in going}
        near = [n for n in runs if n != name and runs[n].total < won.total + MARGIN]
    fits = {n: fit_of(field[n], kept.get(n)) for n in (name, *near)}
    rivals = tuple(shown(n, fits[n], bare, runs[n]) for n in near)
    best = shown(name, fits[name], bare, won, rivals)
    return best if best.evidence > LEAST else None


def by_reversals(
    whole: Sequence[Sequence[Record]],
    model: Model,
    alone: Runner,
    entered: Sequence[tuple[str, Runner]],
    jobs: int,
    *,
    told: bool = False,
) -> Shown | None:
    """Find the effect that meets the reversals of whole logs, each at its own angle.

    Where the starts of the logs have told already that one of them is there, it is to be told from
    the others only. The last horizon tells at which the nearest one keeps step.
    """
    longest = REVERSAL_SECONDS[-1]
    turned = [reversals(records, model, longest) for records in whole]
    share = HELD_SHARE * len(turned[1]) / max(1, len(turned[0]))
    field = [one for _, one in entered]
    found = None
    for seconds in REVERSAL_SECONDS:
        begun = starts(whole, seconds)
        parts = [[*a, *(cut(r, seconds) for r in b)] for a, b in zip(begun, turned, strict=True)]
        together(Runner.go, (alone, *field), jobs, parts[0], jobs)
        nearest, *others = sorted((alone, *field), key=lambda one: one.level)
        for some in ([nearest], others):
            together(looks, some, jobs, within((alone, *field)))
        for one in (alone, *field):
            one.settle()
        if not told and min(one.cost for one in field) > alone.cost - AHEAD:
            break
        runs = [(name, one, run(parts, one.there, jobs)) for name, one in entered]
        runs.sort(key=lambda entry: entry[2].total)
        name, first, won = runs[0]
        alone.from_place_of(first)
        bare = run(parts, alone.there, jobs)
        behind = (own.total for n, _, own in runs if n != name)
        if won.level > LOST and not stands_apart(won, bare, behind):
            break
        near: dict[str, Shown] = {}  # the best pattern of each name
        for name, one, own in runs:
            if name not in near and own.total < won.total + MARGIN:
                near[name] = shown(name, fitted(one, seconds), bare, own)
        best, *rivals = near.values()
        missed = bare.level > max(LOST, MISSES * won.level) and best.evidence > LEAST
        agree = best.held_gain > share * best.gain
        clear = agree and (told or missed)
        found = replace(best, rivals=tuple(rivals), everywhere=True) if clear else None
    return found


def outlasting(
    kept: Mapping[str, Locked], whole: Sequence[Sequence[Record]], jobs: int
) -> str | None:
    """Return the effect that keeps step for so long that each of the others has lost it."""
    if not kept:
        return None
    first, *others = sorted(kept, key=lambda name: kept[name].lasts(), reverse=True)
    between = LATER_SECONDS, kept[first].horizon
    behind = (lost(whole, kept[n].model, kept[first].model, between, jobs) for n in others)
    return first if all(one is not None for one in behind) else None


def stands_apart(won: Run, bare: Run, others: Iterable[float]) -> bool:
    """Whether one leaves so little, and each of the others so much, that it is told out of step."""
    second = min(others, default=np.inf)
    return won.total <= APART * bare.total and second > OTHERS * bare.total


def onward(one: Runner, records: Sequence[Record], jobs: int, seed: int) -> Locked:
    """Go on from the first tenth of a second for as long as it keeps step."""
    start, reached = one.there, FIRST_SECONDS[-1]
    return lock(
        records, start, one.unknowns, one.known, reached=reached, jobs=jobs, seed=seed, anew=False
    )


def all_onward(
    field: Mapping[str, Runner], records: Sequence[Record], jobs: int, seed: int
) -> dict[str, Locked]:
    """The same of several, each on a thread of its own."""
    kept = in_threads(lambda one: onward(one, records, jobs, seed), field.values(), jobs)
    return dict(zip(field, kept, strict=True))


def fit_of(one: Runner, kept: Locked | None) -> Fit:
    """Where a runner is, or how far it went on."""
    if kept is None or kept.horizon == 0.0:
        return fitted(one, FIRST_SECONDS[-1])
    return kept.as_fit(one.unknowns)


def without(
    kept: Locked, base: BalanceFit, records: Sequence[Record], jobs: int, seed: int
) -> Locked:
    """Lock the model as it is from where it keeps step with an effect.

    That may be all that the effect had ahead: a lock misses a way that one with more freedom
    finds.
    """
    start = Model(kept.model.drive, base.model.effects)
    between = horizons(LEAST_SECONDS, kept.horizon)
    reached = max((h for h in between if level(start, records, h, jobs) < LOST), default=0.0)
    unknowns, known = base.unknowns, loosened(base)
    return lock(records, start, unknowns, known, reached=reached, jobs=jobs, seed=seed, anew=False)


def ageing(
    left: Residual, base: BalanceFit, before: Fit, jobs: int, seed: int, *, anew: bool = True
) -> Shown | Fit | None:
    """Try friction that grows with the time at rest."""
    if AGEING in base.model.effects:
        return None
    whole = left.measured.fit, left.measured.held
    own = unknowns_of(AGEING)
    model = sized(AGEING, base.model, 1.0)
    known = beside(loosened(base), model, own)
    unknowns = (*base.unknowns, *own)
    kept = lock(whole[0], model, unknowns, known, jobs=jobs, seed=seed, anew=anew)
    if kept.horizon < max(before.horizon, LEAST_SECONDS):
        return aged_at_landings(left, base, jobs, seed) if anew else None
    bare_too = without(kept, base, whole[0], jobs, seed)
    between = LEAST_SECONDS, kept.horizon
    ahead = lost(whole, before.model, kept.model, between, jobs)
    if ahead is not None and bare_too.horizon > 0.0:
        ahead = lost(whole, bare_too.model, kept.model, between, jobs)
    if ahead is None:
        return bare_too.as_fit(base.unknowns) if bare_too.horizon > before.horizon else None
    _, bare, with_it = ahead
    best = shown(AGEING, kept.as_fit(unknowns), bare, with_it)
    return best if best.evidence > LEAST else None


def aged_at_landings(left: Residual, base: BalanceFit, jobs: int, seed: int) -> Shown | None:
    """Find friction that grows with the time at rest where it takes off most of what is missed.

    A large one throws the drive from rest to rest: no model keeps step for long.
    """
    landed = landings(left, base, jobs, seed, among=(AGEING,))
    one, won = landed.field[AGEING], landed.runs[AGEING]
    parts = starts(landed.whole, FIRST_SECONDS[-1])
    bare = run(parts, landed.alone.there, jobs)
    noise = [by_noise(part) for part in parts]
    fitted = won.fitted - noise[0] < LEAVES * (bare.fitted - noise[0])
    held = won.held - noise[1] < LEAVES * (bare.held - noise[1])
    best = shown(AGEING, fit_of(one, None), bare, won)
    told = fitted and held and best.evidence > LEAST_AGED
    return best if told and size(one.there, AGEING) > SMALLEST else None


def by_noise(records: Sequence[Record]) -> float:
    """Return the loss that noise alone leaves."""
    return NEWS * NOISE_LEVEL * sum(rec.omega.size - rec.led for rec in records)


def shown(name: str, fit: Fit, bare: Run, own: Run, rivals: tuple[Shown, ...] = ()) -> Shown:
    """Describe one that keeps step where the model as it is does not."""
    meets = own.level < UNEASY and bare.level > max(LOST, OUT * own.level)
    return Shown(name, fit, bare.fitted - own.fitted, bare.held - own.held, rivals, meets=meets)
