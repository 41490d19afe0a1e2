"""The sentence: measure → residual → trace → augment → report."""

import time
from collections.abc import Iterable
from os import PathLike

from dmptm_ctrl.diagnosis.augment import augment
from dmptm_ctrl.diagnosis.decide import Decision, decide
from dmptm_ctrl.diagnosis.experiment import next_experiment
from dmptm_ctrl.diagnosis.flanks import damp_by_depth
from dmptm_ctrl.diagnosis.free_runs import (
    LITTLE,
    as_any_friction,
    beside_balances,
    take_its_name,
    traced,
    turned,
)
from dmptm_ctrl.diagnosis.measure import Measured, measure
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.remarks import remarks
from dmptm_ctrl.diagnosis.report import (
    Diagnosis,
    NamedEffect,
    named,
    provenance,
    ranking,
    unnamed,
)
from dmptm_ctrl.diagnosis.residual import Residual, closed, residual
from dmptm_ctrl.diagnosis.screen import READ_ROWS, screen
from dmptm_ctrl.diagnosis.sensors import cross_check, sensor_effect, with_sensors
from dmptm_ctrl.diagnosis.unknown import Unexplained, astray
from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.effects import CATALOGUE, LAWS
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.parallel import at_once, crew, small_matrices
from dmptm_ctrl.signals import Log, LogError, load_logs
from dmptm_ctrl.simulate.damping import damping_by_depth
from dmptm_ctrl.simulate.model import Model

# deg/s on held-out logs; the worst of 39 rigs that lack nothing has 0.17. No balance may
# close so well that a model which predicts no better is right.
ASTRAY = 0.45
# Evidence of a name that free runs speak against, by which something is there all the same: ten
# times what balances find on rigs that lack nothing.
CERTAIN = 300.0
NEEDS_MOTOR_ENCODERS = ("pinion_runout", "ring_gear_eccentricity")


@small_matrices
def diagnose(
    logs: str | PathLike[str] | Iterable[Log],
    drive: Drive | None = None,
    *,
    jobs: int = 2,
    seed: int = 0,
) -> Diagnosis:
    """Find the physical effect that the declared model lacks.

    Parameters
    ----------
    logs : folder, or Logs of one rig
        Channels u_left, u_right [V], theta_L [rad], omega_L [rad/s]; theta_ml, theta_mr
        [rad] where there are motor encoders.
    drive : Drive, optional
        The declared model with its tolerances; the paper's rig by default.
    jobs : int
        Threads. The result does not depend on it.
    seed : int
        Of the starts that are tried where the model loses step; kept in the provenance.

    Returns
    -------
    Diagnosis
        `.summary()`, `.to_dict()`, `.augmented`, `.plot()`, `.save(folder)`.

    Raises
    ------
    LogError
        Logs that cannot be read, lack a channel or are not of one rig.
    """
    with crew(jobs):
        return diagnosed(logs, drive or paper_drive(), jobs, seed)


def diagnosed(
    logs: str | PathLike[str] | Iterable[Log], declared: Drive, jobs: int, seed: int
) -> Diagnosis:
    """Diagnose on threads that are kept."""
    start = time.perf_counter()
    if isinstance(logs, str | PathLike):
        logs = load_logs(logs, max_rows=READ_ROWS)
    campaign, notes = screen(logs, declared)
    measured = measure(tuple(campaign), declared)
    sensors = cross_check((*measured.fit, *measured.held))
    model = with_sensors(Model(declared), sensors)
    if model.effects:
        measured = measured.started(model)
    left = residual(measured, model, jobs=jobs)

    def begun(left: Residual) -> tuple[Decision, Fit]:
        own = beside_balances(left.base, measured)
        return at_once(
            lambda: decide(left, skip=tuple(sensors.values), jobs=jobs),
            lambda: augment(measured.fit, left.base, declared, beside=own, jobs=jobs),
            jobs,
        )

    decision, before = begun(left)
    held = measured.held_logs
    as_declared = without = speed_error(before.model.without(model.effects), held, jobs)
    if decision.unexplained is None and damp_by_depth(decision.after, jobs):
        decision, before = begun(residual(measured, damping_by_depth(left.base.model), jobs=jobs))
        without = speed_error(before.model.without(model.effects), held, jobs)
    after = traced(decision, before, without["rmse"], jobs, seed)
    without_a_name(decision, before.model, without["rmse"])
    predicted = speed_error(after.model, held, jobs)
    final = refined(measured, decision, after, predicted["rmse"], jobs)
    if as_any_friction(decision, after, final):
        take_its_name(decision)
        if not decision.found and predicted["rmse"] > without["rmse"]:
            after, final, predicted = before, before, without  # what has no name has to help
    error = {
        "unit": "deg/s",
        "bandwidth_hz": 30,
        "on": "held-out logs",
        "before": as_declared,
        "after": predicted,
    }
    effects = effects_of(decision, final)
    effects += [sensor_effect(name, sensors, final) for name in model.effects]
    verdict = "explained" if effects else "none"
    if decision.unexplained is not None:
        verdict = "unknown"
    untestable = () if measured.has_motor_encoders else NEEDS_MOTOR_ENCODERS
    return Diagnosis(
        verdict=verdict,
        effects=tuple(sorted(effects, key=lambda e: -e.probability)),
        ranking=ranking(decision, untestable, sensors.errors),
        depends_on=decision.unexplained.variables if decision.unexplained else (),
        error=error,
        declared=before.model,
        augmented=final.model,
        measured=measured,
        decision=decision,
        fits=(before, after),
        fitted=final,
        provenance=provenance(measured, measured.logs, seed, time.perf_counter() - start),
        warnings=tuple(dict.fromkeys((*notes, *measured.warnings, *remarks(decision, final)))),
        experiment=next_experiment(decision, measured.has_motor_encoders, jobs),
    )


def without_a_name(decision: Decision, model: Model, without: float) -> None:
    """Say what is there and has no name, where nothing was found in a model that goes astray."""
    measured = decision.before.measured
    if decision.found or of_sensors(decision) or decision.unexplained is not None:
        return
    certain = [found for found in decision.withdrawn if found.evidence > CERTAIN]
    if certain:  # something is there that acts as they do, and is none of them
        effect = CATALOGUE[max(certain, key=lambda found: found.evidence).name]
        decision.unexplained = Unexplained.without_curve(effect.depends_on)
    elif without > ASTRAY:
        variables = astray(model, measured.held_logs)
        decision.unexplained = Unexplained.without_curve(variables)


def of_sensors(decision: Decision) -> tuple[str, ...]:
    """Return the errors of sensors that the model had from the start."""
    return tuple(decision.before.base.model.without(LAWS).effects)


def effects_of(decision: Decision, fit: Fit) -> list[NamedEffect]:
    """Describe what was found, with a name and without."""
    explained = decision.unexplained is None
    effects = [named(found, fit, all_explained=explained) for found in decision.found]
    return effects + ([] if decision.tables is None else [unnamed(decision.tables)])


def refined(measured: Measured, decision: Decision, after: Fit, error: float, jobs: int) -> Fit:
    """Refit the verdict's model on all logs: its honest `error` is known, now predict best.

    Not where the model is known to lack something: more logs would lead it as far astray.
    """
    if decision.unexplained is not None and decision.tables is None:
        return after
    everything = (*measured.fit, *(rec for rec in measured.held if rec not in measured.fit))
    base = decision.after.base
    declared = Model(measured.drive)
    try:
        _, start = closed(everything, base.model, declared, base.unknowns, jobs)
    except LogError:  # with what keeping step has added no window may be left
        return after
    also = turned(decision, everything, after.model)
    beside, drive = beside_balances(base, measured), measured.drive
    # a drive that lacks nothing has told all there is by its first bounces
    onward = bool(decision.found or decision.tables or of_sensors(decision))
    final = augment(
        everything, start, drive, beside=beside, near=after, also=also, onward=onward, jobs=jobs
    )
    # it has seen these logs, the other one has not: where it misses more it went astray
    worse = speed_error(final.model, measured.held_logs, jobs)["rmse"] > error + LITTLE
    return after if worse else final
