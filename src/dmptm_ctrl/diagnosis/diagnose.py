"""The diagnosis of the dual-motor drive: screen → sensors → balance → selection → budget."""

import time
from collections.abc import Callable
from dataclasses import replace

from dmptm_ctrl.contract import MOTOR_ENCODERS
from dmptm_ctrl.diagnosis.budget import verdict_of
from dmptm_ctrl.diagnosis.confirmed import confirmed, size_text
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState
from dmptm_ctrl.diagnosis.dual_budget import assess, rise
from dmptm_ctrl.diagnosis.dual_report import (
    DualSource,
    declared_dict,
    named,
    ranking,
    unnamed,
)
from dmptm_ctrl.diagnosis.experiment import next_experiment
from dmptm_ctrl.diagnosis.impact_chatter import with_chatter
from dmptm_ctrl.diagnosis.measure import Measured, measure
from dmptm_ctrl.diagnosis.negligible import without_negligible
from dmptm_ctrl.diagnosis.report import Diagnosis, provenance
from dmptm_ctrl.diagnosis.residual import Residual, balances, of_windows, predicting_fit, residual
from dmptm_ctrl.diagnosis.screen import screen
from dmptm_ctrl.diagnosis.select import select_effects
from dmptm_ctrl.diagnosis.sensors import cross_check, sensor_effect, with_sensors
from dmptm_ctrl.diagnosis.short_predictions import with_short_predictions
from dmptm_ctrl.diagnosis.summary import correlated
from dmptm_ctrl.diagnosis.tables import in_tables
from dmptm_ctrl.diagnosis.unknown import unexplained
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.parallel import small_matrices, thread_pool
from dmptm_ctrl.signals import Campaign, LogError
from dmptm_ctrl.simulate.model import Model


@small_matrices
def diagnose_dual(
    logs: Campaign, declared: Drive, jobs: int, seed: int, say: Callable[[str], None]
) -> Diagnosis:
    """Find what the declared model of a dual-motor drive lacks; see :func:`~.run.diagnose`.

    `logs` have channels u_left, u_right [V], theta_L [rad], omega_L [rad/s]; theta_ml, theta_mr
    [rad] where there are motor encoders.
    """
    start = time.perf_counter()
    with thread_pool(jobs):
        campaign, notes = screen(logs, declared)
        measured = measure(tuple(campaign), declared)
        sensors = cross_check((*measured.fit, *measured.held))
        model = with_sensors(Model(declared), sensors)
        if model.effects:
            measured = measured.started(model)
        base = DualState(residual(measured, model, jobs=jobs))
        evidence = DualEvidence(measured, tuple(sensors.values), jobs)
        selection = without_negligible(evidence, select_effects(evidence, base, say), rise)
        selection = with_short_predictions(evidence, selection, say)
        selection = confirmed(evidence, selection)
        left = of_windows(selection.final.left)
        rest = unexplained(base.left, left, sum(e.evidence for e in selection.entries))
        rest, tables = in_tables(left, rest, jobs) if rest is not None else (None, None)
        before = with_chatter(measured.fit, base.left.base, declared, jobs)
        best = tables.left if tables else selection.final.left
        after = with_chatter(measured.fit, best.base, declared, jobs)
        assessed = assess(measured, evidence, selection, (before, after), tables, rest, jobs)
        final = on_all_logs(measured, best, after, declared, jobs)
        last = selection.final
        effects = [
            replace(
                named(e, final, assessed.share_of(e.key), size_text(evidence, e.without, last)),
                together=e.key in assessed.together,
            )
            for e in selection.entries
        ]
        effects += [
            sensor_effect(name, sensors, final, assessed.share_of(name)) for name in model.effects
        ]
        curve = [] if tables is None else [unnamed(tables, assessed.unexplained_share)]
        material = any(e.material for e in effects)
        experiment = next_experiment(selection, measured, jobs)
    by_encoders = tuple(n for n, e in CATALOGUE.items() if e.seen_by == MOTOR_ENCODERS)
    return Diagnosis(
        verdict=verdict_of(assessed.errors, material, rest is not None),
        effects=(*sorted(effects, key=lambda e: -e.share), *curve),
        budget=assessed.rows,
        ranking=ranking(
            selection,
            () if measured.has_motor_encoders else by_encoders,
            sensors.errors,
            tuple(model.effects),
        ),
        depends_on=rest.variables if rest is not None else (),
        error=assessed.error,
        errors=assessed.errors,
        declared=before.model,
        augmented=final.model,
        declared_values=declared_dict(final, declared),
        selection=selection,
        source=DualSource(measured, selection, (before, after), final.model),
        correlations=correlated([k.label for k in final.unknowns], final.covariance),
        provenance=provenance(
            measured.logs, [rec.name for rec in measured.held], seed, time.perf_counter() - start
        ),
        warnings=tuple(dict.fromkeys((*notes, *measured.warnings))),
        experiment=experiment,
    )


def on_all_logs(measured: Measured, left: Residual, after: Fit, declared: Drive, jobs: int) -> Fit:
    """Refit the selected model on all logs: its held-out error is known, now it predicts best."""
    everything = (*measured.fit, *(r for r in measured.held if r not in measured.fit))
    try:
        balance = balances(everything, left.base.model, Model(measured.drive), jobs)
    except LogError:  # no window may be left where the fitted model decides which pinions touch
        return after
    done = predicting_fit(replace(balance, observer_driven=True), left.base)
    return with_chatter(everything, done, declared, jobs)
