"""Diagnose a rig of any shape: from logs and a rig file to the error budget."""

import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache
from math import inf
from os import PathLike

import numpy as np

from dmptm_ctrl.diagnosis.budget import EXPLAINED, NEGLIGIBLE, Errors, Squares, near
from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.confirmed import confirmed
from dmptm_ctrl.diagnosis.measure import HOLD_EVERY, of_each_kind
from dmptm_ctrl.diagnosis.negligible import without_negligible
from dmptm_ctrl.diagnosis.report import Diagnosis, provenance
from dmptm_ctrl.diagnosis.rig_ahead import Ahead
from dmptm_ctrl.diagnosis.rig_curves import (
    better_without_names,
    curves,
    mean_square,
    predicted,
)
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_objections import gone
from dmptm_ctrl.diagnosis.rig_report import declared_of, report_of
from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.diagnosis.rig_screen import (
    other_scale,
    refuse_no_gain,
    refuse_reversed,
    screen_rig,
)
from dmptm_ctrl.diagnosis.rig_state import RigState, beside_torques, rise, within_floor
from dmptm_ctrl.diagnosis.screen import READ_ROWS
from dmptm_ctrl.diagnosis.select import Selection, beyond_need, select_effects
from dmptm_ctrl.diagnosis.sensors import put_right, sensor_faults
from dmptm_ctrl.drive.rig import Rig, is_known
from dmptm_ctrl.identify.gap_search import at_start, gap_start
from dmptm_ctrl.identify.inverse_dynamics import Balance, balance_of
from dmptm_ctrl.identify.measured_motion import FEWEST_ROWS, STRETCHES
from dmptm_ctrl.identify.observer_driven import BANDWIDTH_HZ
from dmptm_ctrl.identify.pushing_teeth import in_contact
from dmptm_ctrl.identify.rig_fit import fit_rig, invisible_impacts
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.parallel import small_matrices
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.simulate.placed_effects import BACKLASH
from dmptm_ctrl.simulate.rig_model import RigModel, declared_effects

MANY_LOGS = 6  # from here on whole logs are held out; below, stretches of each
ROUNDS = 2  # fits of the declared model where hidden bodies follow the measured ones
SAMPLES = 150_000  # of the balance; fits cost as much, and pieces of long logs show as much


@small_matrices
def diagnose_rig(
    logs: str | PathLike[str] | Iterable[str | PathLike[str] | Log],
    declared: Rig,
    *,
    seed: int = 0,
    jobs: int = 2,
    say: Callable[[str], None] = lambda _: None,
) -> Diagnosis:
    """Find what the declared model of a rig lacks; see :func:`~.run.diagnose`."""
    started = time.perf_counter()
    _refuse_floating(declared)
    declared_effects(declared)  # what is wrong with them is said before logs are read
    left_out: list[str] = []
    read = declared.read(logs, max_rows=READ_ROWS, notes=left_out)
    loaded, warnings = screen_rig(declared, read)
    warnings = (*left_out, *warnings)
    say("comparing the sensors")
    faults = sensor_faults(declared, loaded)
    right = [put_right(declared, log, [f.placed for f in faults]) for log in loaded]
    balance, short = _long_enough(balance_of(declared, right))
    balance, pieces = _in_pieces(balance)
    warnings = (*warnings, *short, *pieces)
    refuse_no_gain(declared, balance)
    if turned := refuse_reversed(declared, balance):
        warnings = (*warnings, turned)
    strange = other_scale(declared, balance)
    if strange and all(link.rigid for link in declared.links):
        raise LogError(strange)
    say("fitting the declared model")
    model = RigModel(declared, closed=balance.closed, ranged=True)
    balance, evidence, base = _fitted(model, balance, right, jobs)
    _, held_logs, held_names, on = split(declared, balance)
    short_runs = Ahead.of(declared, right, base.logs, SAMPLES, jobs)
    ahead = cache(lambda state: beside_torques(state, short_runs.fitted(state)))
    explains = explaining(declared, right, held_logs, ahead, jobs)

    def grows(without: RigState, final: RigState) -> float:
        more = rise(without, final)
        return inf if more < NEGLIGIBLE and explains(without, final) else more

    selection = _selected(evidence, base, say)
    base, last = selection.base, selection.final
    if last.logs is not base.logs:  # other rows count by now
        base = evidence.refit(base, last.logs, last.held)
        selection = replace(selection, base=base)
    contact = last.fit.model
    as_read = _as_read(declared, loaded, balance, base, contact, jobs) if faults else None
    selection = without_negligible(evidence, selection, grows)
    selection = confirmed(evidence, selection)
    if not selection.entries:  # what was found on the way and went may have left another fit
        selection = replace(selection, final=base)
    say("fitting to short predictions")
    settled = selection.final
    selection = replace(
        selection,
        base=ahead(base),
        final=ahead(settled),
        entries=[replace(e, without=ahead(e.without)) for e in selection.entries],
    )
    say("looking for curves in what is left")
    found = curves(selection.final)
    floor = predicted(selection.final, found)
    at_floor = within_floor(selection, floor)
    plain = better_without_names(selection) if selection.entries else []
    if selection.entries and (at_floor or plain) and not explains(base, settled):
        bare = selection.base
        selection = replace(selection, final=bare, entries=[], rest=selection.first)
        found = plain or curves(bare)
    before = as_read or selection.base
    if not selection.entries and any(d["outside"] for d in declared_of(before.fit).values()):
        before = evidence.inside(before)  # "none" is said of the model as it is declared
    last = selection.final
    strained = any(d["outside"] for d in declared_of(last.fit).values())
    if strange and (strained or not near(mean_square(last.held_left[0], last.held), floor)):
        warnings = (*warnings, strange)  # else it was a resonance that looks like that
    noted = (f"{log.name}: {note}" for log in loaded for note in log.warnings)
    return report_of(
        declared,
        loaded,
        selection,
        evidence,
        as_read=before,
        faults=faults,
        found_curves=found,
        on=on,
        provenance=provenance(loaded, held_names, seed, time.perf_counter() - started),
        warnings=(*dict.fromkeys(noted), *warnings, *_no_gap(selection.final.fit.model)),
        jobs=jobs,
    )


def _selected(evidence: RigEvidence, base: RigState, say: Callable[[str], None]) -> Selection:
    """Select effects beside declared values in their ranges, or free where that is plainer.

    Values that leave their ranges take up what an effect does, and effects what a value does that
    is declared wrong. Where values explain more than the best effect, or still something beside all
    effects, both are looked at. Each value outside counts as one effect.
    """
    kept, loose = select_effects(evidence, base, say), evidence.free(base)
    start = evidence.free(kept.final) if kept.final.keys else loose
    best = max((c.evidence for c in kept.first if c.acceptable), default=0.0)
    inside = sum(evidence.gains(base, loose)) <= max(best, LEVEL)
    if inside and beyond_need(evidence, kept.final, start) <= 0.0:
        return kept
    if gone(loose.fit):
        return kept  # an unknown effect must not take a part of the drive away
    start = loose if gone(start.fit) else start
    say("declared values would leave their ranges: looking again with them free")
    free = select_effects(evidence, loose, say, begun=(kept, start))
    last = kept.final
    if last.logs is not free.final.logs:
        last = evidence.refit(last, free.final.logs, free.final.held)
    outside = sum(d["outside"] for d in declared_of(free.final.fit).values())
    more = len(free.final.keys) + outside - len(last.keys)
    return free if sum(evidence.gains(last, free.final)) > LEVEL * more else kept


def _no_gap(model: RigModel) -> Iterator[str]:
    """Say which unknown gaps the logs do not show."""
    found = {e.on for e in model.effects if e.name == BACKLASH.name}
    unknown = (k for k in model.rig.links if k.half_gap is not None and not is_known(k.half_gap))
    for link in (k for k in unknown if k.name not in found):
        yield (
            f"{link.name}: its backlash is declared unknown, and these logs show none; it counts "
            "as 0, and a small gap would make the stiffness look softer"
        )


def _fitted(
    model: RigModel, balance: Balance, read: Sequence[Log], jobs: int
) -> tuple[Balance, RigEvidence, RigState]:
    """Fit the declared model; each fit knows better when teeth touch."""
    logs, held, _, _ = split(model.rig, balance)
    start = rough_start(model, logs)
    if any(balance.bursts):
        for k in range(ROUNDS):
            if k > 0:
                start = fit_rig(State(start), logs, jobs=jobs).model
            balance = in_contact(balance, start, read)
            logs, held, _, _ = split(model.rig, balance)
    evidence = RigEvidence(logs, held, jobs, read)
    base = evidence.base(State(start))
    for link in (k.name for k in model.rig.links if is_known(k.half_gap)):
        base = _started_anew(evidence, base, link)
    return balance, evidence, base


def _started_anew(evidence: RigEvidence, base: RigState, link: str) -> RigState:
    """Fit again from the best start of a declared gap before bodies that nothing measures."""
    model, surprise = base.fit.model, base.tangent.surprise
    if link not in model.layout.links or not invisible_impacts(model, base.logs):
        return base
    start = gap_start(model, base.logs, link, surprise, jobs=evidence.jobs)
    if start is None:
        return base
    again = evidence.base(State(at_start(model, start), base.fit.state.logs))
    return min(base, again, key=lambda one: surprise(one.fit.model))


def explaining(
    rig: Rig,
    logs: Sequence[Log],
    held: Balance,
    ahead: Callable[[RigState], RigState],
    jobs: int,
) -> Callable[[RigState, RigState], bool]:
    """Return whether effects explain what predictions of held-out logs miss without them.

    Of a model without some effects, and the model with them; of free runs and short predictions.
    Noise of the balance may hide what builds up in a run.

    Parameters
    ----------
    ahead : callable
        Fits a model to short predictions of the fitted logs as well.
    """
    runs = [Runs.none_yet(rig, logs, held, jobs, lead) for lead in (0.0, BANDWIDTH_HZ)]
    missed = cache(lambda state: [one.missed(ahead(state).held_state) for one in runs])

    @cache
    def floor(state: RigState) -> list[float]:
        last = ahead(state)
        return [
            one.scatter(last.held_state, last.fit) if size < inf else inf
            for one, size in zip(runs, missed(state), strict=True)
        ]

    def explains(without: RigState, final: RigState) -> bool:
        pairs = [*zip(missed(without), missed(final), strict=True)]
        # a run that diverges says nothing, nor what a run without them misses by chance
        least = map(max, floor(final), floor(without))
        sizes = [
            Squares(*np.square([*pair, min(*pair, one)])) if max(pair) < inf else None
            for pair, one in zip(pairs, least, strict=True)
        ]
        far = any(m and not near(m.before, m.floor) for m in sizes)
        return far and Errors(1.0, 1.0, 1.0, *sizes).explained >= EXPLAINED

    return explains


def _as_read(
    rig: Rig, read: Sequence[Log], balance: Balance, base: RigState, contact: RigModel, jobs: int
) -> RigState:
    """Return the declared model fitted to the logs as the sensors read them."""
    whole = balance_of(rig, read, bandwidth=balance.bandwidth).only(balance.logs).at_most(SAMPLES)
    logs, held, _, _ = split(rig, in_contact(whole, contact, read))
    fitted = RigEvidence(logs, held, jobs).refit(base, logs, held)
    return Ahead.of(rig, read, logs, SAMPLES, jobs).fitted(fitted)


def split(rig: Rig, balance: Balance) -> tuple[Balance, Balance, Sequence[str], str]:
    """Part the logs into fitted and held-out ones.

    As the rig file says; else of many logs one of each kind of experiment, where these are a third
    at least, or every third log; of a few, three tenths of each. Then the names of logs that are
    held out whole, and in words what is held out.
    """
    names, held = balance.logs, list[str]()
    roles = rig.roles(names)
    if any(roles.values()):
        held = [n for n in names if roles[n] == "held-out"]
    elif len(names) >= MANY_LOGS:
        held = of_each_kind(names)
        if HOLD_EVERY * len(held) < len(names):
            held = [*names[HOLD_EVERY - 1 :: HOLD_EVERY]]
    if not held:
        return balance.part("fit"), balance.part("held-out"), (), "held-out parts of every log"
    fit = [n for n in names if n not in held]
    if not fit:
        raise LogError("every log is under [data] held_out; leave one to fit")
    return balance.only(fit), balance.only(held), held, "held-out logs"


def _long_enough(balance: Balance) -> tuple[Balance, tuple[str, ...]]:
    """Leave out logs without rows enough; say so."""
    kept = [m.name for m in balance.motions if m.rows.size >= FEWEST_ROWS]
    band = balance.bandwidth
    needs = f"{band:.3g} Hz of bandwidth need {FEWEST_ROWS / (2 * band):.3g} s"
    if not kept:
        raise LogError(f"logs are too short: {balance.longest:.3g} s at most, where {needs}")
    short = [m for m in balance.motions if m.name not in kept]
    if not short:
        return balance, ()
    return balance.only(kept), tuple(
        f"left out: {m.name} is too short: {float(m.time[-1]):.3g} s, where {needs}" for m in short
    )


def _in_pieces(balance: Balance) -> tuple[Balance, tuple[str, ...]]:
    """Take pieces of logs that are too long together; say so."""
    shorter = balance.at_most(SAMPLES)
    whole = {m.name: float(m.time[-1]) for m in balance.motions}
    pieces = {m.name: m.dt * m.time.size for m in shorter.motions if m.tenth is not None}
    return shorter, tuple(
        f"{name}: of {whole[name]:.6g} s, {STRETCHES} pieces of {seconds:.3g} s each are fitted, "
        "one in each tenth"
        for name, seconds in pieces.items()
    )


def _refuse_floating(rig: Rig) -> None:
    """Refuse a body of unknown inertia between springs that nothing measures or drives."""
    seen = {s.body for s in rig.sensors} | {i.body for i in rig.inputs}
    for body in rig.bodies:
        group = {*rig.turns(body.name, rigidly=True)}
        soft = [k.name for k in rig.links if not k.rigid and len({k.first, k.second} & group) == 1]
        if len(soft) > 1 and not group & seen and not is_known(body.inertia):
            key = "mass" if body.linear else "inertia"
            raise LogError(
                f"body {body.name} has an unknown {key} between {' and '.join(soft)}, and no "
                f"sensor: logs do not show it. Give its {key}, or leave it out and write one link "
                "with both stiffnesses in it"
            )
