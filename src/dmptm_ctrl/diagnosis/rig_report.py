"""The error budget of a rig of any shape: as an object, as text, as JSON and as files."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from math import isfinite, pi, sqrt
from os import PathLike
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.budget import EXPLAINED, MATERIAL, NONE
from dmptm_ctrl.diagnosis.report import NamedEffect
from dmptm_ctrl.diagnosis.rig_curves import Curve, mean_square
from dmptm_ctrl.diagnosis.rig_evidence import RigState
from dmptm_ctrl.diagnosis.rig_files import rig_model_to_toml
from dmptm_ctrl.diagnosis.rig_sensors import SensorFault
from dmptm_ctrl.diagnosis.select import LEVEL, Candidate, Selection
from dmptm_ctrl.diagnosis.sensors import SENSOR_PROBABILITY
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.identify.free_parameters import on_slide
from dmptm_ctrl.identify.rig_fit import RigFit
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

SCHEMA = 2
LIKELY = 0.5  # probability from which a name is in the headline


@dataclass(frozen=True, eq=False)
class RigDiagnosis:
    """What the declared model of a rig lacks.

    Attributes
    ----------
    verdict : "none", "explained" or "unknown"
    effects : tuple of NamedEffect
        In order of their share of the budget.
    material : tuple of bool
        Of each effect.
    budget, ranking : list of dict
    depends_on : tuple of str
    error : dict
        Of the balance of torques on held-out logs or stretches: before, after, floor.
    parameters : dict
        Declared quantities: declared, range, fitted, standard error.
    selection : Selection
    declared, augmented : RigModel
    """

    rig: Rig
    verdict: str
    effects: tuple[NamedEffect, ...]
    material: tuple[bool, ...]
    budget: list[dict[str, Any]]
    ranking: list[dict[str, Any]]
    depends_on: tuple[str, ...]
    error: dict[str, Any]
    parameters: dict[str, dict[str, Any]]
    selection: Selection
    declared: RigModel
    augmented: RigModel
    provenance: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the content of diagnosis.json: plain types, no NaN."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "effects": [
                {**e.to_dict(), "material": m}
                for e, m in zip(self.effects, self.material, strict=True)
            ],
            "budget": self.budget,
            "ranking": self.ranking,
            "depends_on": list(self.depends_on),
            "error": self.error,
            "declared": self.parameters,
            "provenance": self.provenance,
            "warnings": list(self.warnings),
        }

    def sentence(self) -> str:
        """Return the verdict in one sentence; it says no more than the budget."""
        likely = [
            e.name.replace("_", " ") for e, m in zip(self.effects, self.material, strict=True)
            if m and e.probability >= LIKELY
        ]  # fmt: skip
        names = ", ".join(likely)
        before, after, floor = (self.error[k]["rmse"] for k in ("before", "after", "floor"))
        figures = f"{before:.3g} to {after:.3g} {self.error['unit']}, floor {floor:.3g}"
        if self.verdict == "none":
            return "The error of the declared model is near its floor; no effect was found."
        if self.verdict == "explained" and names:
            return f"The declared model lacks: {names} (error {figures})."
        on = ", ".join(self.depends_on)
        more = f", which depends on {on}" if on else ""
        if names:
            return f"Found: {names}; part of the error is not explained{more} ({figures})."
        return f"Something is missing that no effect explains{more} ({figures})."

    def summary(self) -> str:
        """Return the verdict as text: sentence, budget, effects with standard errors."""
        unit = self.error["unit"]
        lines = [self.sentence(), "", f"torque error on {self.error['on']} [{unit}]"]
        for row in self.budget:
            place = f" @ {row['location']}" if row["location"] else ""
            on = f"  depends on {', '.join(row['depends_on'])}" if row["depends_on"] else ""
            lines.append(f"  {row['name'] + place:36s} {row['torque_rms']:10.4g} "
                         f"{100 * row['share']:6.1f} %{on}")  # fmt: skip
        for effect, material in zip(self.effects, self.material, strict=True):
            head = f"{effect.name} ({effect.location}), probability {effect.probability:.2f}"
            lines += ["", head + ("" if material else ", immaterial")]
            for name, p in effect.parameters.items():
                lines.append(f"  {name} = {p['value']:.4g} ± {p['se']:.2g} {p['unit']}".rstrip())
            lines.append(f"  {effect.evidence}")
            if effect.confusable_with:
                lines.append("  not told from: " + ", ".join(effect.confusable_with))
        for key, p in self.parameters.items():
            if p["outside"]:
                low, high = p["range"]
                lines.append(f"warning: {key} = {p['fitted']:.4g} ± {p['se']:.2g} is outside its "
                             f"declared range {low:.4g} to {high:.4g}")  # fmt: skip
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    def plot(self, **options: Any) -> Any:
        """Draw the error budget; see `rig_html.plot_budget_of`."""
        from dmptm_ctrl.diagnosis.rig_html import plot_budget_of

        return plot_budget_of(self, **options)

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.summary())}</pre>"

    def model_toml(self) -> str:
        """Return the augmented model as the text of a file."""
        logs = self.selection.final.held_state.logs
        zeros = {log: dict(n.zero) for log, n in logs.items()}
        return rig_model_to_toml(self.augmented, self.rig.text, zeros)

    def save(self, folder: str | PathLike[str]) -> None:
        """Write diagnosis.json, model.toml and report.html, together or not at all."""
        from dmptm_ctrl.diagnosis.rig_html import render_html

        with output_folder(folder) as out:
            text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
            (out / "diagnosis.json").write_text(text + "\n", encoding="utf-8")
            (out / "model.toml").write_text(self.model_toml(), encoding="utf-8")
            (out / "report.html").write_text(render_html(self), encoding="utf-8")


def report_of(
    rig: Rig,
    selection: Selection,
    *,
    as_read: RigState,
    faults: Sequence[SensorFault],
    curves: Sequence[Curve],
    floor: float,
    share_of_curves: float,
    nearest: tuple[str, ...],
    on: str,
    provenance: dict[str, Any],
    warnings: Sequence[str],
) -> RigDiagnosis:
    """Put a selection into words and figures.

    Parameters
    ----------
    as_read : RigState
        The declared model on the logs as the sensors read them.
    curves : sequence of Curve
        Those that the logs demand, beside the effects.
    floor : float
        Mean square that no model predicts.
    share_of_curves : float
        Share of the held-out mean square that the best curve takes.
    nearest : tuple of str
        Variable of the best curve, demanded or not.
    """
    final: RigState = selection.final
    base: RigState = selection.base
    before = mean_square(as_read.held_left[0], as_read.held)
    after = mean_square(final.held_left[0], final.held)
    removable = max(before - floor, 0.0)
    found = [_sensor_effect(f, rig) for f in faults]
    costs = [max(before - mean_square(base.held_left[0], base.held), 0.0) / len(faults)
             for _ in faults]  # fmt: skip
    errors = final.fit.errors
    for entry in selection.entries:
        placed = next(e for e in final.fit.model.effects if e.key == entry.key)
        without = mean_square(entry.without.held_left[0], final.held)
        found.append(
            NamedEffect(
                placed.name,
                placed.on,
                entry.probability,
                effect_parameters(placed, final.fit, errors),
                tuple(dict.fromkeys(k.partition("@")[0] for k in entry.confusable_with)),
                f"Without it, −2 log-likelihood rises by {entry.gain:.0f} on the fitted and "
                f"{entry.held_gain:.0f} on the held-out logs ({LEVEL:.0f} are needed), and the "
                f"error from {sqrt(after):.3g} to {sqrt(without):.3g}.",
            )
        )
        costs.append(max(without - after, 0.0))
    order = sorted(range(len(found)), key=lambda k: -costs[k])
    effects = tuple(found[k] for k in order)
    costs = [costs[k] for k in order]
    explained = (before - after) / removable if removable > 0 else 1.0
    strong = (c.variable for c in curves if c.evidence > 0.5 * curves[0].evidence)
    variables = tuple(dict.fromkeys(strong))[:2]
    verdict = "unknown"
    if effects and (explained >= EXPLAINED or before <= NONE**2 * floor):
        verdict = "explained"
    elif not effects and share_of_curves < 1.0 - EXPLAINED and before <= NONE**2 * floor:
        verdict = "none"
    depends_on = (variables or nearest) if verdict == "unknown" else ()
    augmented = final.fit.model
    for fault in faults:
        augmented = augmented.with_effect(fault.placed)
    drive = float(np.sqrt(np.mean(np.concatenate(base.held_left[1]) ** 2))) or 1.0
    figures = {
        key: {"rmse": sqrt(v), "percent": 100 * sqrt(v) / drive, "unit": torque_unit(rig)}
        for key, v in (("before", before), ("after", after), ("floor", floor))
    }
    return RigDiagnosis(
        rig,
        verdict,
        effects,
        tuple(c >= MATERIAL * removable for c in costs),
        budget_of(effects, costs, before, after, floor, variables),
        ranking_of(selection, final, faults),
        depends_on,
        {
            "on": on,
            "unit": torque_unit(rig),
            "bandwidth_hz": final.fit.likelihood.balance.bandwidth,
            **{k: {**v, "torque": v} for k, v in figures.items()},
        },
        declared_of(final.fit),
        selection,
        base.fit.model,
        augmented,
        provenance,
        tuple(warnings),
    )


def budget_of(
    effects: Sequence[NamedEffect],
    costs: Sequence[float],
    before: float,
    after: float,
    floor: float,
    variables: Sequence[str],
) -> list[dict[str, Any]]:
    """Return the rows of the error budget: mean squares as rms, and shares of that before."""
    whole = max(before, after, 1e-300)
    went, each = max(before - after, 0.0), sum(costs)
    part = min(1.0, went / each) if each > 0 else 0.0  # effects that hide each other

    def row(name: str, on: str, square: float, depends: Sequence[str] = ()) -> dict[str, Any]:
        return {
            "name": name, "location": on, "speed_rms": None, "torque_rms": sqrt(max(square, 0.0)),
            "share": max(square, 0.0) / whole, "depends_on": list(depends),
        }  # fmt: skip

    rows = [row(e.name, e.location, part * c) for e, c in zip(effects, costs, strict=True)]
    if effects and went > each:
        rows.append(row("shared", "", went - each))
    rows.append(row("not explained", "", after - floor, variables))
    rows.append(row("floor", "", floor))
    return rows


def ranking_of(
    selection: Selection, final: RigState, faults: Sequence[SensorFault]
) -> list[dict[str, Any]]:
    """Status of every effect of the chain catalogue, most evidence first."""
    kept = {k.partition("@")[0] for k in final.keys}
    kept |= {f.placed.name for f in faults}
    best: dict[str, Candidate] = {}
    for seen in (*selection.rest, *selection.first):  # what it is worth beside the final model
        best.setdefault(seen.keys[0].partition("@")[0], seen)
    rows = []
    for name, chain in PLACED_CATALOGUE.items():
        entry = next((e for e in selection.entries if e.key.startswith(f"{name}@")), None)
        one = best.get(name)
        score = entry.evidence if entry else one.evidence if one else 0.0
        status, reason = "rejected", ""
        if name in kept:
            status = "supported"
        elif one is None:
            status = "not testable with these logs"
        elif one.objection:
            reason = one.objection
        elif one.evidence > LEVEL:
            reason = "held-out logs speak against it, or an effect that was added explains it"
        rows.append({
            "name": name, "location": one.keys[0].partition("@")[2] if one else "",
            "score": max(score, 0.0) if isfinite(score) else 0.0, "status": status,
            "reason": reason, "reveals": chain.reveals,
        })  # fmt: skip
    return sorted(rows, key=lambda row: (row["status"] != "supported", -row["score"]))


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


def _sensor_effect(fault: SensorFault, rig: Rig) -> NamedEffect:
    """Describe what a sensor does."""
    values, errors = fault.placed.values, fault.errors
    units = {p.name: p.unit for p in PLACED_CATALOGUE[fault.placed.name].keep}
    sure = max(abs(v) / max(errors[k], 1e-300) for k, v in values.items())
    return NamedEffect(
        fault.placed.name,
        fault.placed.on,
        SENSOR_PROBABILITY,
        {k: {"value": v, "se": errors[k], "unit": units[k]} for k, v in values.items()},
        (),
        f"Sensors of one motion disagree by it by {sure:.0f} standard errors, whatever the "
        "drive does.",
    )


def effect_parameters(
    effect: Placed, fit: RigFit, errors: dict[str, float]
) -> dict[str, dict[str, Any]]:
    """Return the parameters of an effect in units that people read."""
    model = fit.model
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
        if effect.name == "drive_offset":
            unit = input_symbol(model.rig, effect.on)
        error = se.get(p.name, 0.0)
        unit = counted_unit(model.rig, unit)
        found[p.name] = {"value": value * scale, "se": error * scale, "unit": unit}
    if "cosine" in found and "sine" in found:
        c, s = found["cosine"], found["sine"]
        size = sqrt(c["value"] ** 2 + s["value"] ** 2)
        error = sqrt((c["value"] * c["se"]) ** 2 + (s["value"] * s["se"]) ** 2) / (size or 1.0)
        found["amplitude"] = {"value": size, "se": error, "unit": c["unit"]}
    if effect.name == "shaft_compliance":
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


def input_symbol(rig: Rig, name: str) -> str:
    """SI unit of an input's signal."""
    from dmptm_ctrl.signals.units import parse_unit

    return parse_unit(next(i for i in rig.inputs if i.name == name).unit).symbol


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
    return input_symbol(rig, source.name) or "of the input"
