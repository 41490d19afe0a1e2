"""The result of a rig file: its effects, errors, budget and ranking; its runs and pictures."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite, pi, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.diagnosis.budget import (
    EXPLAINED,
    Errors,
    Row,
    closed_rows,
    error_entry,
    verdict_of,
)
from dmptm_ctrl.diagnosis.candidate import FIRM, LEVEL, members, name_of
from dmptm_ctrl.diagnosis.confirmed import size_text
from dmptm_ctrl.diagnosis.experiment import rig_experiment
from dmptm_ctrl.diagnosis.negligible import material_together
from dmptm_ctrl.diagnosis.ranking import ranking_of
from dmptm_ctrl.diagnosis.report import Diagnosis, NamedEffect, Picture
from dmptm_ctrl.diagnosis.rig_curves import Curve, accepted, curve_share, mean_square, predicted
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_runs import Runs, variable_of
from dmptm_ctrl.diagnosis.rig_state import RigState, of_teeth
from dmptm_ctrl.diagnosis.select import Entry, Selection
from dmptm_ctrl.diagnosis.sensors import SENSOR_PROBABILITY, SensorFault
from dmptm_ctrl.diagnosis.summary import correlated, with_amplitudes
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.drive.rig_units import input_symbol, unit_at
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.free_parameters import on_slide
from dmptm_ctrl.identify.observer_driven import BANDWIDTH_HZ
from dmptm_ctrl.identify.rig_fit import RigFit
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel, link_inertias

if TYPE_CHECKING:
    from dmptm_ctrl.plots.diagnosis import Evidence, Overlay

SIDES = "before", "after", "floor"
READ_SPECTRUM = (
    "The response of the sensor to the input on a held-out log, only where the log excites it. "
    "Of the models it is that of free runs on the same input, read in the same way."
)


@dataclass(frozen=True, eq=False)
class RigSource:
    """Logs and models of a rig file's drive, for the report.

    Attributes
    ----------
    on : str
        What the errors are measured on.
    selection : Selection
    augmented : RigModel
    runs : Runs
    curve : Curve, optional
        Over the first variable of what is unknown.
    """

    rig: Rig
    on: str
    selection: Selection
    augmented: RigModel
    runs: Runs
    curve: Curve | None = None

    @property
    def title(self) -> str:
        """Name of the rig."""
        return self.rig.name

    @property
    def shares(self) -> str:
        """What the budget's shares are of."""
        return f"the mean square of the balance on {self.on}"

    def overlays(self) -> "list[Overlay]":
        """A reading per held-out log: measured, and free runs before and after."""
        return self.runs.overlays()

    def evidence(self, effect: NamedEffect | None, depends_on: Sequence[str]) -> "Evidence | None":
        """What the drive gave more than the model, over what an effect depends on.

        None for an error of a sensor, which the balance does not show.
        """
        from dmptm_ctrl.diagnosis.rig_figures import folded

        key = "" if effect is None else f"{effect.name}@{effect.location}"
        entry = next((e for e in self.selection.entries if e.key == key), None)
        if effect and entry is None:
            return None
        return folded(
            entry.without if entry else self.selection.base,
            self.selection.final,
            variable_of(self.augmented, key) if effect else next(iter(depends_on), ""),
            key,
            torque_unit(self.rig),
            self.curve if depends_on and not effect else None,
        )

    def pictures(self) -> Iterator[Picture]:
        """The gain over frequency, where a compliance was found."""
        from dmptm_ctrl.diagnosis.rig_spectrum import spectrum, spectrum_uri

        fit = self.selection.final.fit
        for placed in (e for e in fit.model.effects if e.name == SHAFT_COMPLIANCE.name):
            read = effect_parameters(placed, fit)
            marks = {n: read[f"{n}_hz"]["value"] for n in ("antiresonance", "resonance")}
            if found := spectrum(self, marks):
                alt = "Gain over frequency: measured, and free runs of the models before and after."
                yield Picture("spectrum", "Resonance", spectrum_uri(found), alt, READ_SPECTRUM)
                return


def report_of(
    rig: Rig,
    logs: Sequence[Log],
    selection: Selection,
    evidence: RigEvidence,
    *,
    as_read: RigState,
    faults: Sequence[SensorFault],
    found_curves: Sequence[Curve],
    on: str,
    provenance: dict[str, Any],
    warnings: Sequence[str],
    jobs: int,
) -> Diagnosis:
    """Put a selection into words and figures.

    Parameters
    ----------
    logs : sequence of Log
        As the sensors read them.
    as_read : RigState
        The declared model on these.
    found_curves : sequence of Curve
        Beside the effects, most evidence first, demanded by the logs or not.
    """
    final: RigState = selection.final
    curves, floor = accepted(found_curves), predicted(final, found_curves)
    best = next(iter([*curves, *found_curves]), None)
    base: RigState = selection.base
    beside = of_teeth(final)

    def whole(left: Sequence[Floats]) -> float:
        return mean_square(left, final.held) + beside(left)

    after_left = final.held_left[0]
    errors = Errors(whole(as_read.held_left[0]), whole(after_left), floor + beside(after_left))
    augmented = final.fit.model.opened
    for fault in faults:
        augmented = augmented.with_effect(fault.placed)
    zeros = {log: dict(n.zero) for log, n in final.held_state.logs.items()}
    augmented = replace(augmented, zeros=zeros)
    after = State(augmented, final.held_state.logs)
    given = rig, logs, final.held, as_read.held_state, after, final.fit, jobs
    runs, short = Runs.of(*given), Runs.of(*given, lead_hz=BANDWIDTH_HZ)
    errors = replace(errors, runs=runs.squares, short=short.squares)
    found = [_sensor_effect(f) for f in faults]
    healed = max(errors.before - whole(base.held_left[0]), 0.0)
    costs = [healed / len(faults) for _ in faults]
    slower = [runs.rise(after.without({f.placed.key})) for f in faults]
    removable = max(errors.removable, 1e-300)

    def lacks(state: RigState) -> float:
        return (whole(state.held_left[0]) - errors.after) / removable

    together = material_together(evidence, selection, lacks)
    for entry in selection.entries:
        without = whole(entry.without.held_left[0])
        size = size_text(evidence, entry.without, final)
        named = _named(entry, final.fit, errors.after, without, size)
        found.append(replace(named, together=entry.key in together))
        costs.append(max(without - errors.after, 0.0))
        bare = entry.without.held_state
        for fault in faults:
            bare = State(bare.model.with_effect(fault.placed), bare.logs)
        slower.append(runs.rise(bare))
    order = sorted(range(len(found)), key=lambda k: -costs[k])
    effects = tuple(replace(found[k], share=min(costs[k] / removable, 1.0)) for k in order)
    strong = (c.variable for c in curves if c.evidence > 0.5 * curves[0].evidence)
    variables = tuple(dict.fromkeys(strong))[:2]
    nearest = (best.variable,) if best else ()
    # after a few impacts a free run is chance; balance and short predictions decide "none"
    counted = errors if effects else replace(errors, runs=short.usual)
    loose = _parted(final.fit)
    more = bool(loose) or curve_share(final, curves) >= 1.0 - EXPLAINED
    verdict = verdict_of(counted, bool(effects), more)
    torn = (f"{link}: no stiffness fits these logs; the fit leaves hardly any" for link in loose)
    rows = [
        Row(e.name, e.location, slower[k], sqrt(costs[k]), e.share,
            (variable_of(augmented, f"{e.name}@{e.location}"),))
        for e, k in zip(effects, order, strict=True)
    ]  # fmt: skip
    drive = float(np.sqrt(np.mean(np.concatenate(base.held_left[1]) ** 2))) or 1.0
    roots = {k: sqrt(getattr(errors, k)) for k in SIDES}
    torque = {
        k: {"rmse": v, "percent": 100 * v / drive, "unit": torque_unit(rig),
            "bandwidth_hz": final.fit.likelihood.balance.bandwidth}
        for k, v in roots.items()
    }  # fmt: skip
    (left, floored), rest = runs.left(), sqrt(max(errors.after - floor, 0.0))
    return Diagnosis(
        verdict=verdict,
        effects=effects,
        budget=tuple(closed_rows(rows, errors, (left, rest), (floored, sqrt(floor)), variables)),
        ranking=ranking_of(
            selection,
            ((name, "", one.reveals) for name, one in PLACED_CATALOGUE.items()),
            sensors={f.placed.name for f in faults},
        ),
        depends_on=(variables or nearest) if verdict == "unknown" else (),
        error=error_entry(on, runs.error(), torque, short.error()),
        errors=errors,
        declared=base.fit.model.opened,
        augmented=augmented,
        declared_values=declared_of(final.fit),
        selection=selection,
        source=RigSource(rig, on, selection, augmented, runs, best),
        correlations=correlations_of(final.fit),
        provenance=provenance,
        warnings=(*warnings, *torn, *runs.warnings),
        experiment=rig_experiment(selection, runs, jobs),
        off_balance=final.fit.off_balance,
    )


def _named(entry: Entry, fit: RigFit, after: float, without: float, size: str) -> NamedEffect:
    """Describe a selected effect with the values of the final fit; `size` is of held-out logs."""
    name, _, places = entry.key.partition("@")
    parameters: dict[str, Any] = {}
    for key in members(entry.key):
        placed = fit.model.effect(key)
        read = effect_parameters(placed, fit)
        if placed.like:  # what it shares is listed already
            read = {f"{placed.on}.{k}": v for k, v in read.items() if v != parameters.get(k)}
        parameters |= read
    return NamedEffect(
        name,
        places,
        entry.probability,
        parameters,
        tuple(dict.fromkeys(name_of(k) for k in entry.confusable_with)),
        f"Without it, −2 log-likelihood rises by {entry.gain:.0f} on the fitted and "
        f"{entry.held_gain:.0f} on the held-out logs (at least {LEVEL:.0f} are needed), and the "
        f"error of the balance from {sqrt(after):.3g} to {sqrt(without):.3g} "
        f"{torque_unit(fit.model.rig)}; {size}.",
    )


def correlations_of(fit: RigFit) -> list[tuple[str, str, float]]:
    """Pairs of fitted numbers of the drive and its effects whose estimates go together."""
    own = [j for j, f in enumerate(fit.frees) if f.kind in ("value", "effect")]
    return correlated([fit.frees[j].label for j in own], fit.covariance[np.ix_(own, own)])


def declared_of(fit: RigFit) -> dict[str, dict[str, Any]]:
    """Return declared quantities: declared, range, fitted value, standard error, unit."""
    errors, found = fit.errors, {}
    for free in (f for f in fit.frees if f.kind == "value"):
        quantity = fit.model.quantities[free.owner]
        low, high = quantity.range
        known = isfinite(quantity.value) and isfinite(high - low)
        value, se = fit.model.value(free.owner), errors.get(free.label, 0.0)
        found[free.owner] = {
            "declared": quantity.value if known else None,
            "range": [low, high] if known else None,
            "fitted": value,
            "se": se,
            "unit": counted_unit(fit.model.rig, quantity.unit),
            "outside": bool(known and (value < low - 2 * se or value > high + 2 * se)),
        }
    return found


def _sensor_effect(fault: SensorFault) -> NamedEffect:
    """Describe what a sensor does."""
    values, errors = fault.placed.values, fault.errors
    units = {p.name: p.unit for p in PLACED_CATALOGUE[fault.placed.name].keep}
    sure = max(abs(v) / max(errors[k], 1e-300) for k, v in values.items())
    return NamedEffect(
        fault.placed.name,
        fault.placed.on,
        SENSOR_PROBABILITY,
        with_amplitudes(
            {k: {"value": v, "se": errors[k], "unit": units[k]} for k, v in values.items()}
        ),
        (),
        f"Sensors of one motion disagree by it by {sure:.0f} standard errors, whatever the "
        "drive does.",
    )


def effect_parameters(effect: Placed, fit: RigFit) -> dict[str, dict[str, Any]]:
    """Return the parameters of an effect in units that people read."""
    model, errors = fit.model, fit.errors
    se = {k: errors.get(f"{effect.key}.{k}", 0.0) for k in effect.values}
    slide = on_slide(model, effect.on)
    found: dict[str, dict[str, Any]] = {}
    for p in PLACED_CATALOGUE[effect.name].keep:
        value = effect.values.get(p.name)
        if value is None:
            continue
        unit, scale = p.unit, 1.0
        if slide:
            unit = unit.replace("N·m", "N").replace("rad", "m")
        if p.name == "order":
            unit, scale = ("1/m", 1 / (2 * pi)) if slide else ("1/turn", 1.0)
        unit = unit_at(effect.on, model.rig, unit)
        error = se.get(p.name, 0.0)
        unit = counted_unit(model.rig, unit)
        found[p.name] = {"value": value * scale, "se": error * scale, "unit": unit}
    found = with_amplitudes(found)
    if effect.name == SHAFT_COMPLIANCE.name:
        found |= _spring(effect, model, se, slide)
    return found


def _spring(
    effect: Placed, model: RigModel, se: dict[str, float], slide: bool
) -> dict[str, dict[str, Any]]:
    """Stiffness, inertias and frequencies of a compliance."""
    w, dw = effect.values["antiresonance"], se.get("antiresonance", 0.0)
    plant, layout = model.plant(), model.layout
    k = layout.links.index(effect.key if effect.key in layout.links else effect.on)
    stiffness = float(plant.link_values[k, 1])
    near, far = (
        float(plant.inertia[plant.body_coordinate[plant.link_body[k, side]]]) for side in (0, 1)
    )
    share = effect.values["share"]
    if effect.key in layout.links:
        resonance = w / sqrt(1 - share)
        error = sqrt((dw / sqrt(1 - share)) ** 2
                     + (0.5 * resonance / (1 - share) * se.get("share", 0.0)) ** 2)  # fmt: skip
    else:
        far /= plant.link_values[k, 0] ** 2
        resonance, error = w * sqrt(1 + far / near), dw * sqrt(1 + far / near)
    unit = counted_unit(model.rig, "N/m" if slide else "N·m/rad")
    return {
        "antiresonance_hz": {"value": w / (2 * pi), "se": dw / (2 * pi), "unit": "Hz"},
        "resonance_hz": {"value": resonance / (2 * pi), "se": error / (2 * pi), "unit": "Hz"},
        "stiffness": {"value": stiffness, "se": 2 * stiffness * dw / w, "unit": unit},
        "far_inertia": {
            "value": far, "se": 0.0 if share == 0 else far * se.get("share", 0.0) / share,
            "unit": counted_unit(model.rig, "kg" if slide else "kg·m²"),
        },
    }  # fmt: skip


def _parted(fit: RigFit) -> list[str]:
    """Links of unknown stiffness that a fit leaves hardly any: not different from 0 by its errors.

    A link that is too stiff to be identified is none: its mode lies above the band.
    """
    model, found = fit.model, []
    for link in (k for k in model.rig.links if k.stiffness and not isfinite(k.stiffness.value)):
        key = f"link.{link.name}.stiffness"
        stiffness = model.value(key)
        square = stiffness * sum(1.0 / inertia for inertia in link_inertias(model, link.name))
        in_band = square < (2.0 * np.pi * fit.likelihood.balance.bandwidth) ** 2
        if in_band and stiffness < FIRM * fit.errors.get(key, 0.0):
            found.append(link.name)
    return found


def counted_unit(rig: Rig, unit: str) -> str:
    """Unit of a torque, friction or inertia; counted in the input's where its gain is unknown."""
    source = rig.inputs[0]
    if isfinite(source.gain.value):
        return unit
    symbol = input_symbol(rig, source.name)
    if unit in ("kg·m²", "kg"):
        return f"{symbol}·s²/{'rad' if unit == 'kg·m²' else 'm'}"
    return unit.replace("N·m", symbol) if "N·m" in unit else unit.replace("N", symbol)


def torque_unit(rig: Rig) -> str:
    """Unit in which the balance of a rig counts torque or force."""
    source = rig.inputs[0]
    if isfinite(source.gain.value):
        return rig.body(source.body).force_unit
    return input_symbol(rig, source.name)
