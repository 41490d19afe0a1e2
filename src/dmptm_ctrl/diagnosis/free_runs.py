"""What free runs add to what the balances have told: names, one sign after another."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dmptm_ctrl.diagnosis import at_rest
from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.decide import (
    FAINT,
    MAX_EFFECTS,
    Decision,
    Found,
    adopt,
    faint_one,
    found_among,
    withdraw,
)
from dmptm_ctrl.diagnosis.finish import KEEPS_SECONDS, WINS_SECONDS
from dmptm_ctrl.diagnosis.giving import Giving, giving_or_not
from dmptm_ctrl.diagnosis.landings import BY_IMPACTS
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.race import Race
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.runoff import run_off
from dmptm_ctrl.diagnosis.tables import Tables
from dmptm_ctrl.diagnosis.trace import Trial, ringing, unknowns_of
from dmptm_ctrl.diagnosis.unknown import Unexplained
from dmptm_ctrl.diagnosis.unseen import AGEING, REVERSAL_SECONDS, Shown, unseen
from dmptm_ctrl.diagnosis.unseen import LEAST as LEAST_UNSEEN
from dmptm_ctrl.diagnosis.unseen import SUREST as UNSEEN_SURE
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit, Unknown
from dmptm_ctrl.identify.lock import DOUBTFUL, level
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.identify.segments import reversals
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Model

# A free run may be a little worse beside an effect of the twist; more is another sign.
WORSE = 1.2
# Of the error without them, up to which names stand beside what has none, and tables stand: a
# curve that hardly helps on these held-out logs does as much harm on others.
HELPS = 0.9
BESIDE_SECONDS = 0.2  # for which a model with an effect keeps step that need not race for more
WORTH_SECONDS = 0.1  # for which a model with a little pre-sliding keeps step, before a refit
LITTLE = 0.03  # deg/s; rattle of another course moves a small error by so much
BY_KEEPING_STEP = (at_rest.NAME, AGEING, *BY_IMPACTS)  # what balances may tell nothing of
LIKELY = 1.0  # steps of such an effect, by which another one beside it may change its size
RING_ENCODER = "encoder_eccentricity"
RINGING = {"u", "du_dt"}  # what a ringing reducer depends on


def traced(decision: Decision, before: Fit, without: float, jobs: int, seed: int) -> Fit:
    """Add what free runs tell to what the balances have told; return the fit with all of it.

    `without` is the error on held-out logs of the model as it is.
    """
    measured = decision.before.measured
    held = measured.held_logs
    after = before if decision.after is decision.before else refit(decision, jobs)
    after = of_little(decision, after, jobs)
    after = told_apart(decision, after, jobs, seed)
    after = sobered(decision, without, after, held, jobs)
    after = rested(decision, after, jobs)
    racing = later = None
    if may_race(decision, after):
        law = law_of_friction(decision, jobs)
        if law.told or measured.has_motor_encoders:
            racing = entered(decision, after, law, jobs, seed)
            after = in_step(decision, after, racing, jobs, pauses=not measured.has_motor_encoders)
        else:  # neither law meets the first landings: who races loses step there
            later = law
    after = uncovered(decision, without, after, held, jobs, seed)
    if may_race(decision, after):
        if met_by_landings(decision):  # beside it another one may show
            later = law_of_friction(decision, jobs)
        if later is not None:
            racing = entered(decision, after, later, jobs, seed)
        if racing is not None and not racing.ended:  # what takes longest, and is seldom won then
            after = in_step(decision, after, racing, jobs)
    if as_any_friction(decision, after):
        take_its_name(decision)
    return after


def as_any_friction(decision: Decision, *fits: Fit) -> bool:
    """Whether pre-sliding that was found is no more than any friction gives way."""
    return decision.is_found(at_rest.NAME) and not at_rest.matters(*fits)


def take_its_name(decision: Decision) -> None:
    """Leave pre-sliding in the model, as that of any friction."""
    decision.found = [found for found in decision.found if found.name != at_rest.NAME]


def of_little(decision: Decision, after: Fit, jobs: int) -> Fit:
    """Add an effect that little speaks for, if nothing else could: with it the model keeps step.

    Beside another one the model has to keep step without it, too.
    """
    measured, without = decision.before.measured, decision.after
    full = len(decision.found) == MAX_EFFECTS or decision.unexplained is not None
    winner = faint_one(decision.rest)
    if full or winner is None:
        return after
    if decision.found and not keeps_step(after, measured, jobs):
        return after
    decision.found.append(found_among(decision.rest, winner, FAINT))
    decision.after = adopt(measured, winner, jobs)
    beside = refit(decision, jobs)
    if beside.horizon >= after.horizon and keeps_step(beside, measured, jobs):
        return beside
    decision.found.pop()
    decision.after = without
    return after


def keeps_step(fit: Fit, measured: Measured, jobs: int) -> bool:
    """Whether a model meets every bounce for so long that its laws are the machine's."""
    meets = fit.horizon >= KEEPS_SECONDS
    return meets and level(fit.model, measured.fit, KEEPS_SECONDS, jobs) < DOUBTFUL


def told_apart(decision: Decision, after: Fit, jobs: int, seed: int) -> Fit:
    """Keep, of names that the balances take for one another, the one that keeps step."""
    measured = decision.before.measured
    if decision.tables is not None:
        return after
    for i, found in enumerate(decision.found):
        base, logs = decision.after.base, (measured.fit, measured.held)
        told = run_off(*logs, found.trial, base, after, found.rivals, jobs=jobs, seed=seed)
        if told is None:
            continue
        if told.better is not None:
            trial, rivals = told.better, (found.trial, *found.rivals)
            rivals = tuple(t for t in rivals if t is not trial)
            found = Found(trial.name, trial.evidence, found.threshold, trial, rivals)
            unknowns = trial.fit.unknowns
            decision.after = residual(measured, told.model, unknowns=unknowns, jobs=jobs)
        if told.better is not None or told.seconds > after.horizon:
            near = replace(after, model=told.model, horizon=told.seconds)
            after = refit(decision, jobs, near)
        decision.found[i] = replace(found, out_of_step=told.out)
    return after


def sobered(decision: Decision, without: float, after: Fit, held: Sequence[Log], jobs: int) -> Fit:
    """Withdraw what makes the free run of the held-out logs go astray.

    Where the model lacks what has no name, a name can stand in for a part of it: one that does
    not help is none.
    """
    tables = decision.tables
    if tables is not None and speed_error(after.model, held, jobs)["rmse"] > HELPS * without:
        decision.tables, decision.after = None, tables.beside
        after = refit(decision, jobs)
    most = WORSE * without + LITTLE
    if decision.unexplained is not None and decision.tables is None:
        most = HELPS * without
    while decision.found and speed_error(after.model, held, jobs)["rmse"] > most:
        withdraw(decision, jobs)
        after = refit(decision, jobs)
    return after


def may_race(decision: Decision, after: Fit) -> bool:
    """Whether free runs may tell of another effect."""
    if len(decision.found) == MAX_EFFECTS or decision.unexplained is not None:
        return False
    # beside another effect a law that is not quite the model's is not told from a faint one
    return not decision.found or after.horizon < BESIDE_SECONDS


def law_of_friction(decision: Decision, jobs: int) -> Giving:
    """Tell what those start from that race: as friction gives, where it may, or sticks."""
    measured, base = decision.before.measured, decision.after.base
    start, field = rattled(measured.fit, base, measured.drive, jobs), decision.rest
    resting = decision.at_rest
    if resting is None or not resting.gives:
        return Giving(start, [*field], True, True)
    law = giving_or_not(measured.fit, start, field, jobs)  # or delays and lags would do for it
    decision.at_rest = replace(resting, sticks=law.sticks, told=law.told)
    return law


def entered(decision: Decision, after: Fit, law: Giving, jobs: int, seed: int) -> Race:
    """Let those start that the balances do not see, but free runs from rest do.

    What has been found and the balances do not see either runs along, of any size.
    """
    measured, base = decision.before.measured, decision.after.base
    start, field = law.start, law.trials
    for found in met_by_landings(decision):
        others = (t for t in field if t.name != found.name)
        field = [replace(t, fit=with_found(t.fit, found, after.model, base)) for t in others]
        start = with_found(start, found, after.model, base)
    logs, scan = (measured.fit, measured.held), not decision.found
    enough = BESIDE_SECONDS if decision.found else np.inf
    return Race(*logs, start, field, scan=scan, enough=enough, jobs=jobs, seed=seed)


def in_step(
    decision: Decision, after: Fit, racing: Race, jobs: int, *, pauses: bool = False
) -> Fit:
    """Add who wins a race; `pauses` as of :meth:`Race.run`."""
    measured, base = decision.before.measured, decision.after.base
    shown = racing.run(pauses=pauses)
    if shown is None:
        return after
    unknowns = (*base.unknowns, *unknowns_of(shown.name))
    decision.after = residual(measured, shown.model, unknowns=unknowns, jobs=jobs)
    trial = Trial(shown.name, shown.evidence - shown.held_gain, shown.held_gain, base)
    found = Found(shown.name, shown.evidence, shown.threshold, trial, (), shown.seconds)
    decision.found.append(found)
    near = replace(after, model=shown.model, horizon=shown.seconds)
    return refit(decision, jobs, near)


def met_by_landings(decision: Decision) -> list[Found]:
    """Return what was found of which the balances tell nothing."""
    told = {unknown.effect for unknown in decision.after.base.unknowns}
    return [f for f in decision.found if f.name in BY_IMPACTS and f.name not in told]


def with_found(fit: BalanceFit, found: Found, model: Model, base: BalanceFit) -> BalanceFit:
    """Let what was found go along with a fit, from its values in a model."""
    there = fit.model.with_effect(found.name, **model.effects[found.name])
    return at_rest.extended(fit, there, unknowns_of(found.name), LIKELY, len(base.unknowns))


def refit(decision: Decision, jobs: int, near: Fit | None = None) -> Fit:
    """Refit what was found inside the simulator, from where a model keeps step already if so."""
    measured, base = decision.before.measured, decision.after.base
    beside, drive = beside_balances(base, measured), measured.drive
    also = () if near is None else turned(decision, measured.fit, near.model)
    return augment(measured.fit, base, drive, beside=beside, near=near, also=also, jobs=jobs)


def turned(decision: Decision, records: Sequence[Record], model: Model) -> tuple[Record, ...]:
    """Cut out the reversals, where they tell of an effect."""
    told = [found.name for found in decision.found if found.everywhere]
    # where the meshes open is told by a run without it, whose gaps do not vary
    return reversals(records, model.without(told), REVERSAL_SECONDS[-1]) if told else ()


def beside_balances(base: BalanceFit, measured: Measured) -> tuple[Unknown, ...]:
    """Unknowns in use that the balances do not tell."""
    fitted = {unknown.effect for unknown in base.unknowns}
    # the twist tells an error of the ring encoder far more finely than the speed does
    able = (*BY_KEEPING_STEP, *((RING_ENCODER,) if measured.has_motor_encoders else ()))
    used = [name for name in able if name in base.model.effects and name not in fitted]
    told = tuple(unknown for name in used for unknown in unknowns_of(name))
    return (*told, *ringing(base.model.effects))


def rested(decision: Decision, after: Fit, jobs: int) -> Fit:
    """Add the little pre-sliding of any friction, if the model keeps step by it.

    It is in the model without being named, unless it turns out to be more.
    """
    full = len(decision.found) == MAX_EFFECTS or decision.is_found(at_rest.NAME)
    if full or after.horizon >= WINS_SECONDS or decision.unexplained is not None:
        return after
    first = decision.at_rest
    if first is None or at_rest.NAME not in first.fit.model.effects:
        return after
    shown = at_rest.a_little(decision.after, after, first, jobs)
    if shown is None or not (shown.convincing or shown.in_step >= WORTH_SECONDS):
        return after
    measured, without = decision.before.measured, decision.after
    unknowns = without.base.unknowns
    decision.after = residual(measured, shown.fit.model, unknowns=unknowns, jobs=jobs)
    fit = refit(decision, jobs, shown.fit)
    if not shown.convincing and fit.horizon < WINS_SECONDS:
        decision.after = without
        return after
    if shown.convincing:
        decision.at_rest = shown
        trial = Trial(at_rest.NAME, shown.gain, shown.held_gain, decision.after.base)
        found = Found(at_rest.NAME, shown.evidence, at_rest.LEAST, trial, (), shown.in_step)
        decision.found.append(found)
    return fit


def uncovered(
    decision: Decision, without: float, after: Fit, held: Sequence[Log], jobs: int, seed: int
) -> Fit:
    """Add what the balances tell nothing of, if the model keeps step with it and all else fails."""
    full = len(decision.found) == MAX_EFFECTS or after.horizon >= WINS_SECONDS
    if (decision.found and full) or not may_ring(decision):
        return after
    alone = not decision.found and decision.unexplained is None
    before, beside = decision.after, decision.after
    if decision.tables is not None:
        beside = decision.tables.beside
    if not alone:
        without = speed_error(after.model, held, jobs)["rmse"]
    shown = unseen(beside, after, rested=decision.at_rest, alone=alone, jobs=jobs, seed=seed)
    if shown is None:
        return after
    if isinstance(shown, Fit):  # of the model without tables
        fit = after if decision.tables is not None else refit(decision, jobs, shown)
        return min(after, fit, key=lambda one: speed_error(one.model, held, jobs)["rmse"])
    # the balances tell nothing of it: what they leave stays as it was
    model = Model(beside.base.model.drive, shown.fit.model.effects)
    left = replace(beside, base=replace(beside.base, model=model))
    decision.after = left
    resting = decision.at_rest
    if shown.name != AGEING:
        decision.found.append(by_step(shown, left.base))
        if resting is not None and not resting.told:  # the law beside which it was found is
            sticks = at_rest.NAME not in shown.fit.model.effects
            decision.at_rest = replace(resting, sticks=sticks, told=True)
    fit = refit(decision, jobs, shown.fit)
    error = speed_error(fit.model, held, jobs)["rmse"]
    better = error <= without
    if shown.name != AGEING:
        # what all reversals tell, or what meets the landings, rattle of another course leaves
        lasting = shown.everywhere or shown.meets
        better |= lasting and error <= WORSE * without + LITTLE
        if not better:  # another one of its kind can meet the first landings too
            decision.after, decision.at_rest = before, resting
            decision.found.pop()
            return after
        decision.unexplained = decision.tables = None
        return fit
    variables = CATALOGUE[AGEING].depends_on
    decision.unexplained = Unexplained.without_curve(variables)
    if not better:  # known to be there, but not well enough
        decision.after = beside
        return after
    gains, errors = (shown.gain, shown.held_gain), errors_of(AGEING, fit)
    decision.tables = Tables(variables, (AGEING,), errors, *gains, beside, left)
    return fit


def may_ring(decision: Decision) -> bool:
    """Whether nothing is left without a name but what a soft reducer would leave.

    It rings after each step of the voltage, which come by the clock of the log, and only motor
    encoders would show it. Nor is it told without them which windows are bursts for a pinion has
    landed later than in the run that tells where the meshes are closed.
    """
    what = decision.unexplained
    if what is None:
        return True
    if decision.before.measured.has_motor_encoders:
        return False
    variables = set(what.variables)
    if decision.tables is None:
        if what.curve is None:
            return True
        if "du_dt" in variables:
            variables -= {"time"}
    return variables <= RINGING


def by_step(shown: Shown, base: BalanceFit) -> Found:
    """Describe an effect that keeping step has shown, and others that do nearly as well."""
    trials = [
        Trial(s.name, s.gain, s.held_gain, replace(base, model=s.fit.model))
        for s in (shown, *shown.rivals)
    ]
    seconds, rivals = shown.fit.horizon, tuple(trials[1:])
    found = Found(shown.name, shown.evidence, LEAST_UNSEEN, trials[0], rivals, seconds)
    sure = UNSEEN_SURE.get(shown.name, found.at_most)
    return replace(found, at_most=sure, everywhere=shown.everywhere)


def errors_of(name: str, fit: Fit) -> dict[tuple[str, str], float]:
    """Standard errors of an effect's parameters."""
    errors = np.sqrt(np.diag(fit.covariance))
    pairs = zip(fit.unknowns, errors, strict=True)
    return {(name, u.name): float(u.scale * e) for u, e in pairs if u.effect == name}
