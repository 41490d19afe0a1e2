"""The result of a dual-motor drive: its effects, declared values and ranking; its pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.diagnosis.candidate import Candidate, name_of
from dmptm_ctrl.diagnosis.dual import DualState
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.predict import speeds
from dmptm_ctrl.diagnosis.ranking import best_of, ranking_of
from dmptm_ctrl.diagnosis.report import UNNAMED, NamedEffect, Picture, estimate
from dmptm_ctrl.diagnosis.select import Entry, Selection
from dmptm_ctrl.diagnosis.summary import with_amplitudes
from dmptm_ctrl.diagnosis.tables import Tables
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects import CATALOGUE, TABLES
from dmptm_ctrl.identify.compared_signals import low_pass
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.identify.observer_driven import ObserverRun
from dmptm_ctrl.simulate.model import Model

if TYPE_CHECKING:
    from dmptm_ctrl.plots.diagnosis import Evidence, Overlay

READ_ORDERS = (
    "A line at order 1 repeats with every turn of a motor: cogging, or an eccentric motor encoder. "
    "Lower orders are of the pinion or the ring gear; the tooth mesh has its own. Lines that stand "
    "before and are gone after are explained; lines that stay are not."
)
READ_GAPS = (
    "A tooth of each pinion between two of the ring gear, to the scale of the gap. Dark blue "
    "pushes the ring gear forward, red backward, yellow flies through the gap and carries nothing. "
    "Under preload each stays on a flank of its own."
)


@dataclass(frozen=True, eq=False)
class DualSource:
    """Logs and models of a dual-motor drive, for the report.

    Attributes
    ----------
    measured : Measured
    selection : Selection
    fits : (Fit, Fit)
        Before and after, fitted on the fitted logs only: those that `error` is of.
    augmented : Model
        Fitted on all logs.
    """

    measured: Measured
    selection: Selection
    fits: tuple[Fit, Fit]
    augmented: Model

    title = "dual-motor drive"
    shares = "the mean square of the balances, all logs"

    @property
    def models(self) -> tuple[Model, Model]:
        """The models that `error` judges: neither has seen the held-out logs."""
        before, after = self.fits
        return Model(before.model.drive), after.model

    def without(self, name: str) -> Model:
        """The model that an effect is left out of, the rest refitted.

        Of what has no name it is that with all named effects.
        """
        after = self.fits[1].model
        entry = next((e for e in self.selection.entries if name_of(e.key) == name), None)
        state = self.selection.final if name in ("", UNNAMED) else entry and entry.without
        if isinstance(state, DualState):
            damping = {k: after.drive[k] for k in ("c", "c_f")}
            return state.left.base.model.with_values(**damping)
        return after.without([name]) if name in after.effects else self.models[0]

    def overlays(self) -> "list[Overlay]":
        """Speeds on each held-out log below 30 Hz [deg/s], before and after."""
        from dmptm_ctrl.plots.diagnosis import Overlay

        before, after = self.models
        records = {rec.name: rec for rec in self.measured.held}
        done = []
        for log in self.measured.held_logs:
            seen, old = np.rad2deg(speeds(before, log))
            new = np.rad2deg(speeds(after, log)[1])
            push = low_pass(0.5 * (log["u_left"] + log["u_right"]), log.sample_time)
            held = np.ones(seen.size, bool)
            one = ObserverRun(records[log.name])
            ahead = np.full(seen.size, np.nan)
            missing = np.repeat(np.rad2deg(one.missing(after)), one.block)
            ahead[: missing.size] = seen[: missing.size] - missing
            done.append(Overlay(log.name, log.time, seen, old, new, held, push, ahead=ahead))
        return done

    def evidence(self, effect: NamedEffect | None, depends_on: Sequence[str]) -> "Evidence":
        """Residual over what an effect, or what is not explained, depends on."""
        from dmptm_ctrl.diagnosis.dual_figures import folded

        return folded(self, effect.name if effect else "", tuple(depends_on))

    def pictures(self) -> Iterator[Picture]:
        """Orders per turn, and the pinions in their gaps."""
        from dmptm_ctrl.diagnosis.dual_figures import gaps_uri, orders, orders_uri

        along = orders(self)
        alt = f"Amplitude of the {along.quantity} per order of the motor's turn, before and after."
        title = "By order of the motor's turn"
        yield Picture("orders", title, orders_uri(along), alt, READ_ORDERS)
        if gaps := gaps_uri(self):
            alt = "Moving picture: the teeth of both pinions between those of the ring gear."
            title = "The pinions in their gaps"
            yield Picture("gaps", title, gaps, alt, READ_GAPS, plain=True)


def named(entry: Entry, after: Fit, share: float, size: str) -> NamedEffect:
    """Describe a selected effect with the values of the final fit; `size` is of held-out logs."""
    effect = CATALOGUE[name_of(entry.key)]
    parameters, absent = {}, effect.absent()
    for p in effect.parameters:
        try:
            value, se = after.value(effect.name, p.name)
        except KeyError:  # a whole number, found by search
            value, se = after.model.effects[effect.name].get(p.name, absent[p.name]), 0.0
        parameters[p.name] = estimate(value, se, p.unit)
    sentence = (
        f"Without it −2 log-likelihood rises by {entry.gain:.0f} on the fitted logs and "
        f"{entry.held_gain:.0f} on the held-out ones, the rest refitted; {size}"
    )
    if entry.rivals:
        second = entry.rivals[0]
        sentence += (
            f"; the best rival in its place, {name_of(second.keys[0])}, makes it fall by "
            f"{second.evidence:.0f} on both together"
        )
    return NamedEffect(
        effect.name,
        effect.location,
        entry.probability,
        with_amplitudes(parameters),
        tuple(name_of(key) for key in entry.confusable_with),
        sentence + ".",
        share,
    )


def unnamed(tables: Tables, share: float) -> NamedEffect:
    """Describe the curves of an effect that is on no list."""
    parameters = {}
    for name in tables.names:
        kind = name.removeprefix("unknown_")
        values = tables.left.base.model.effects[name]
        for p in CATALOGUE[name].parameters:
            se = tables.errors.get((name, p.name), 0.0)
            parameters[f"{kind}_{p.name}"] = {"value": values[p.name], "se": se, "unit": p.unit}
    sides = {CATALOGUE[name].location for name in tables.names}
    evidence = tables.evidence
    return NamedEffect(
        UNNAMED,
        ", ".join(sorted(sides)),
        float(min(0.99, evidence / (evidence + 10.0 * len(tables.errors) ** 0.5))),
        parameters,
        (),
        f"A curve over {', '.join(tables.variables)}: −2 log-likelihood falls by "
        f"{tables.gain:.0f} on the fitted logs and by {tables.held_gain:.0f} on the held-out ones.",
        share,
    )


def declared_dict(fit: Fit, drive: Drive) -> dict[str, dict[str, Any]]:
    """Return declared value and range beside the fitted value of each parameter of the drive."""
    rows = {}
    for k, p in zip(fit.unknowns, fit.p, strict=True):
        if k.effect is not None:
            continue
        value, se = fit.value(None, k.name)
        quantity = drive.quantities[k.name]
        rows[k.name] = {
            "declared": quantity.value,
            "range": [float(x) for x in quantity.range],
            "fitted": value,
            "se": se,
            "unit": quantity.unit,
            "outside": bool(min(p - k.low, k.high - p) < 1e-6),
        }
    return rows


def detectable(candidate: Candidate) -> dict[str, dict[str, Any]]:
    """Smallest amplitudes that these logs could have shown: three standard errors."""
    (trial,) = candidate.fitted
    effect = CATALOGUE[trial.name]
    sizes = {}
    errors = np.sqrt(np.diag(trial.fit.covariance))
    for unknown, error in zip(trial.fit.unknowns, errors, strict=True):
        if unknown.effect == trial.name and unknown.name in effect.amplitudes:
            p = next(p for p in effect.parameters if p.name == unknown.name)
            size = float(3.0 * unknown.scale * error)
            if size < max(abs(p.low), abs(p.high)):  # beyond it: not with these logs
                sizes[unknown.name] = {"value": size, "unit": p.unit}
    return sizes


def ranking(
    selection: Selection,
    invisible: Sequence[str],
    sensors: dict[str, dict[str, float]],
    found: Sequence[str],
) -> list[dict[str, Any]]:
    """Status of every catalogue entry, best first, and what size the logs would have shown.

    Parameters
    ----------
    invisible : sequence of str
        Effects that these logs cannot show, unless they are large.
    sensors : mapping
        Effect of a sensor → standard errors of its amplitudes.
    found : sequence of str
        Effects of sensors that are in the model.
    """
    catalogue = [(n, e.location, e.reveals) for n, e in CATALOGUE.items() if n not in TABLES]
    rows = ranking_of(selection, catalogue, sensors=found, compared=sensors, invisible=invisible)
    tried = {**best_of(selection.first), **best_of(selection.rest)}
    for row in rows:
        name = row["name"]
        if name in sensors:
            units = {p.name: p.unit for p in CATALOGUE[name].parameters}
            row["detectable"] = {
                k: {"value": 3.0 * se, "unit": units[k]} for k, se in sensors[name].items()
            }
        elif name in tried:
            row["detectable"] = detectable(tried[name])
    return rows
