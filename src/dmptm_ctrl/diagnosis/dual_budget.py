"""What the models of a diagnosis are worth on held-out logs: free runs, balance, short horizons."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.budget import Errors, Row, Squares, closed_rows, error_entry
from dmptm_ctrl.diagnosis.candidate import name_of
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.negligible import material_together
from dmptm_ctrl.diagnosis.predict import free_run, rms_excess, speed_error, twin_steps
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.diagnosis.tables import Tables
from dmptm_ctrl.diagnosis.unknown import Unexplained
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.balance import scatter
from dmptm_ctrl.identify.compared_signals import BANDWIDTH_HZ, low_pass, noise_below
from dmptm_ctrl.identify.fit import Fit, place
from dmptm_ctrl.identify.heavy_tails import bent
from dmptm_ctrl.identify.observer_driven import BLOCK_SECONDS, MEMORY_SECONDS, ObserverRun
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

HORIZON = round(MEMORY_SECONDS, 3)  # s, of a short prediction
UNIT = "deg/s"
TORQUE = "N·m"


@dataclass(frozen=True, eq=False)
class Assessed:
    """Errors and budget of a diagnosis.

    Attributes
    ----------
    error : dict
        The entry of diagnosis.json.
    together : frozenset of str
        Keys of effects that only look immaterial, since others stand for them.
    """

    errors: Errors
    rows: tuple[Row, ...]
    error: dict[str, Any]
    together: frozenset[str]

    def share_of(self, key: str) -> float:
        """Share of an effect in the budget."""
        name = name_of(key)
        return next((r.share for r in self.rows if r.name == name), 0.0)

    @property
    def unexplained_share(self) -> float:
        """Share of what no effect explains."""
        return next(r.share for r in self.rows if r.name == "not explained")


def rise(without: DualState, final: DualState) -> float:
    """What is left rises by without an effect, over what is left that is no noise."""
    scale = Scale.of(final.left)
    after = mean_square(final.left, scale)
    still = after * systematic(final.left, scale)
    more = mean_square(on_rows_of(final.left, without.left), scale) - after
    return more / max(still, 1e-300)


def systematic(left: Residual, scale: "Scale") -> float:
    """Share of the mean square that rows have in common with the next but one.

    Noise has nothing in common; neighbouring windows overlap.
    """
    rows = [
        np.sqrt(w) * part / s
        for part, s, w in zip(all_parts(left)[0], scale.sizes, scale.weights, strict=True)
    ]
    shared = sum(float(x[2:] @ x[:-2]) for x in rows)
    return max(shared, 0.0) / sum(float(x @ x) for x in rows)


def assess(
    measured: Measured,
    evidence: DualEvidence,
    selection: Selection,
    fits: tuple[Fit, Fit],
    tables: Tables | None,
    rest: Unexplained | None,
    jobs: int,
) -> Assessed:
    """Compare the models before and after, and leave out each effect."""
    base: DualState = selection.base
    final: DualState = selection.final
    first = on_rows_of(final.left, base.left)
    best = final.left if tables is None else on_rows_of(final.left, tables.left)
    scale = Scale.of(best)
    before, after, floor = (mean_square(one, scale) for one in (first, final.left, best))
    declared, augmented = fits
    fixed = tuple(base.left.base.model.effects)  # of the sensors
    logs = measured.held_logs
    bare = declared.model.without(fixed)
    speed = {
        "before": speed_error(bare, logs, jobs),
        "after": speed_error(augmented.model, logs, jobs),
    }
    freely, shortly = scatters(twins_of(augmented), measured, jobs)
    speed["floor"] = {"rmse": min(freely, *(one["rmse"] for one in speed.values()))}
    names = ("before", "after", "floor")
    torque = dict(zip(names, map(torque_error, (first, final.left, best)), strict=True))
    horizons = dict(
        zip(names[:2], (horizon(m, measured.held, jobs) for m in (bare, augmented.model)),
            strict=True)
    )  # fmt: skip
    horizons["floor"] = min(shortly, *horizons.values())
    errors = Errors(
        before,
        after,
        min(floor, after),
        runs=Squares(*(speed[name]["rmse"] ** 2 for name in names)),
        short=Squares(*(horizons[name] ** 2 for name in names)),
    )
    rows = [
        effect_row(e.key, e.without, final, errors, scale, augmented, measured, speed, jobs)
        for e in selection.entries
    ]
    rows += [sensor_row(name, augmented.model, speed, logs, jobs) for name in fixed]
    left = (
        rms_excess(speed["after"]["rmse"], speed["floor"]["rmse"]),
        rms_excess(torque["after"]["rmse"], torque["floor"]["rmse"]),
    )
    depends_on = rest.variables if rest is not None else ()
    closed = closed_rows(
        rows, errors, left, (speed["floor"]["rmse"], torque["floor"]["rmse"]), depends_on
    )
    error = error_entry(
        "held-out logs",
        {k: {**speed[k], "unit": UNIT, "bandwidth_hz": BANDWIDTH_HZ} for k in names},
        {k: {**torque[k], "unit": TORQUE} for k in names},
        {k: {"rmse": horizons[k], "unit": UNIT, "seconds": HORIZON} for k in names},
    )
    together = material_together(
        evidence, selection, lambda state: lacked(state, final, errors, scale)
    )
    return Assessed(errors, tuple(closed), error, together)


@dataclass(frozen=True, eq=False)
class Scale:
    """Scatter of each equation under the final model, and what each row counts.

    What no model predicts, such as the windows of impacts, counts little: by the weights of
    Student's t under the final model, the same for every model that is compared.
    """

    sizes: Sequence[float]
    weights: Sequence[Floats]

    @classmethod
    def of(cls, left: Residual) -> "Scale":
        """Scale of the model that leaves least."""
        parts, kinds = all_parts(left)
        sizes = scatter(parts, kinds)
        return cls(sizes, [*map(bent, parts, sizes)])


def all_parts(left: Residual) -> tuple[list[Floats], list[str]]:
    """What a model leaves of every equation of the fitted and the held-out logs.

    Some experiments have no twin and are fitted; what only they excite counts as well.
    """
    parts = [*left.base.parts, *left.held.missing(left.base.model)]
    return parts, [*left.base.kinds, *left.held.kinds]


def on_rows_of(final: Residual, other: Residual) -> Residual:
    """Another model on the rows of the final one.

    Where no encoder shows it, the model decides which pinions touch and so which rows count.
    """
    model = other.base.model
    base = replace(other.base, parts=final.balance.missing(model), kinds=final.balance.kinds)
    return replace(other, balance=final.balance, held=final.held, base=base)


def mean_square(left: Residual, scale: Scale) -> float:
    """Weighted mean square of all balances, each in units of its scale."""
    rows = zip(all_parts(left)[0], scale.sizes, scale.weights, strict=True)
    total = sum(float(w @ np.square(part / s)) for part, s, w in rows)
    return total / float(sum(w.sum() for w in scale.weights))


def torque_error(left: Residual) -> dict[str, float]:
    """Root mean square of what the balance at the ring gear misses, and over the drive's torque."""
    parts = left.held.missing(left.base.model)
    pairs = list(zip(left.held.equations, parts, strict=True))
    missing = np.concatenate([part for e, part in pairs if e.kind == "total"])
    drive = left.base.model.drive
    gain = drive["N_1"] * drive["N_2"] * drive["K_d"] * drive["K_M"]
    pushes = [
        gain * np.sum(mo.mean(mo.rec.u), axis=0)[e.used]
        for e, mo in ((e, left.held.motions[e.motion]) for e, _ in pairs if e.kind == "total")
    ]
    size = float(np.sqrt(np.mean(np.concatenate(pushes) ** 2)))
    rmse = float(np.sqrt(np.mean(missing**2)))
    return {"rmse": rmse, "percent": 100.0 * rmse / max(size, 1e-300)}


def horizon(model: Model, records: Sequence[Record], jobs: int) -> float:
    """Root mean square of what short predictions miss of the speed, in blocks [deg/s]."""
    rows = in_threads(
        lambda rec: ObserverRun(rec).missing(model), records, jobs, lambda r: r.omega.size
    )
    return float(np.rad2deg(np.sqrt(np.mean(np.square(np.concatenate(rows))))))


def noise_floor(records: Sequence[Record], bandwidth_hz: float = BANDWIDTH_HZ) -> float:
    """Noise of the speed below a bandwidth [deg/s], from its fastest part."""
    squares = [noise_below(r.omega, r.dt, bandwidth_hz) ** 2 for r in records]
    return float(np.rad2deg(np.sqrt(np.mean(squares))))


def twins_of(fit: Fit) -> list[Model]:
    """Drives within the standard errors of a fit."""
    low, high = (np.array([getattr(k, end) for k in fit.unknowns]) for end in ("low", "high"))
    draws = (np.clip(fit.p + step, low, high) for step in twin_steps(fit.covariance))
    return [place(fit.model, fit.unknowns, p) for p in draws]


def scatters(twins: Sequence[Model], measured: Measured, jobs: int) -> tuple[float, float]:
    """Scatter of free runs and of short predictions of twins, and noise [deg/s]."""

    def free(log: Any) -> tuple[float, int]:
        runs = [free_run(m, log, runs=1, columns=(1,))[:, 0] for m in twins]
        return spread([low_pass(run, log.sample_time) for run in runs])

    def short(rec: Record) -> tuple[float, int]:
        return spread(ObserverRun(rec).missing_of(twins))

    def spread(runs: Any) -> tuple[float, int]:
        return float(np.sum(np.var(runs, axis=0, ddof=1))), len(runs[0])

    def root(done: Sequence[tuple[float, int]], noise: float) -> float:
        variance = sum(d[0] for d in done) / max(sum(d[1] for d in done), 1)
        return float(np.hypot(np.rad2deg(np.sqrt(variance)), noise))

    return (
        root(
            in_threads(free, measured.held_logs, jobs, lambda log: log.time.size),
            noise_floor(measured.held),
        ),
        root(
            in_threads(short, measured.held, jobs, lambda rec: rec.omega.size),
            noise_floor(measured.held, 0.5 / BLOCK_SECONDS),
        ),
    )


def lacked(state: DualState, final: DualState, errors: Errors, scale: Scale) -> float:
    """Share of the removable mean square that a model with fewer effects leaves."""
    more = mean_square(on_rows_of(final.left, state.left), scale) - errors.after
    return more / max(errors.removable, 1e-300)


def effect_row(
    key: str,
    without: DualState,
    final: DualState,
    errors: Errors,
    scale: Scale,
    augmented: Fit,
    measured: Measured,
    speed: Mapping[str, Mapping[str, float]],
    jobs: int,
) -> Row:
    """What the held-out errors rise by when one effect is left out and the rest refitted."""
    name = name_of(key)
    effect = CATALOGUE[name]
    left = on_rows_of(final.left, without.left)
    torque = rms_excess(torque_error(left)["rmse"], torque_error(final.left)["rmse"])
    damping = {k: augmented.model.drive[k] for k in ("c", "c_f")}
    model = left.base.model.with_values(**damping)
    slower = speed_error(model, measured.held_logs, jobs)["rmse"]
    return Row(
        name,
        effect.location,
        rms_excess(slower, speed["after"]["rmse"]),
        torque,
        min(max(lacked(without, final, errors, scale), 0.0), 1.0),
        effect.depends_on,
    )


def sensor_row(
    name: str, model: Model, speed: Mapping[str, Mapping[str, float]], logs: Any, jobs: int
) -> Row:
    """What the error of the readings rises by without an error of a sensor."""
    lost = rms_excess(
        speed_error(model.without([name]), logs, jobs)["rmse"], speed["after"]["rmse"]
    )
    span = speed["before"]["rmse"] ** 2 - speed["floor"]["rmse"] ** 2
    share = min(lost**2 / span, 1.0) if span > 0.0 else 0.0
    return Row(name, CATALOGUE[name].location, lost, None, share, CATALOGUE[name].depends_on)
