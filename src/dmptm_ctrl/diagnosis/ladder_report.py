"""The verdict on a rig of any shape: as an object, as text, as JSON and as files."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from math import isfinite, pi, sqrt
from os import PathLike
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.ladder import Ladder, Rung
from dmptm_ctrl.diagnosis.ladder_files import chain_to_toml
from dmptm_ctrl.diagnosis.ladder_judge import Errors
from dmptm_ctrl.diagnosis.ladder_score import Tangent
from dmptm_ctrl.diagnosis.ladder_standing import Standing
from dmptm_ctrl.diagnosis.report import NamedEffect
from dmptm_ctrl.diagnosis.sensors import SENSOR_PROBABILITY
from dmptm_ctrl.diagnosis.verdict import verdict_dict
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.identify.chain_fit import ChainFit
from dmptm_ctrl.identify.chain_free import on_slide
from dmptm_ctrl.identify.chain_sensors import Lateness
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE
from dmptm_ctrl.simulate.chain_model import ChainModel, Placed

MIN_SURVIVAL = 0.25  # of a candidate's size; less, and refitted parameters stand in for it


@dataclass(frozen=True, eq=False)
class ChainDiagnosis:
    """What the declared model of a rig lacks.

    Attributes
    ----------
    verdict : "none", "explained" or "unknown"
    effects : tuple of NamedEffect
        In order of probability.
    ladder : Ladder
        Every rung with its errors before and after.
    ranking : list of dict
    depends_on : tuple of str
    error : dict
        Of the balance of torques on held-out logs or stretches, before and after.
    declared, augmented : ChainModel
    provenance : dict
    """

    rig: Rig
    verdict: str
    effects: tuple[NamedEffect, ...]
    ladder: Ladder
    ranking: list[dict[str, Any]]
    depends_on: tuple[str, ...]
    error: dict[str, Any]
    declared: ChainModel
    augmented: ChainModel
    provenance: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the content of diagnosis.json: plain types, no NaN."""
        return verdict_dict(
            self.verdict,
            self.effects,
            ranking=self.ranking,
            depends_on=self.depends_on,
            error=self.error,
            ladder=[rung_dict(r, self.ladder.deleted) for r in self.ladder.rungs],
            declared_parameters=parameters_of(self.ladder.base, self.ladder.fit_logs),
            parameters=parameters_of(self.ladder.final, self.ladder.fit_logs),
            provenance=self.provenance,
            warnings=self.warnings,
        )

    def sentence(self) -> str:
        """Return the verdict in one sentence."""
        names = " and ".join(e.name.replace("_", " ") for e in self.effects)
        if self.verdict == "none":
            return "The declared model explains the logs; nothing is missing."
        if self.verdict == "explained":
            return f"The declared model lacks: {names}."
        on = ", ".join(self.depends_on) or "nothing that was measured"
        besides = f" besides {names}" if names else ""
        return f"Something that is on no list is missing{besides}; it depends on {on}."

    def summary(self) -> str:
        """Return the verdict as text: sentence, ladder, parameters with standard errors."""
        unit = self.error["unit"]
        before, after = self.error["before"], self.error["after"]
        lines = [
            self.sentence(),
            "",
            f"torque error on {self.error['on']}, below {self.error['bandwidth_hz']:.4g} Hz: "
            f"{before['rmse']:.4g} → {after['rmse']:.4g} {unit} "
            f"({before['relative_percent']:.2f} → {after['relative_percent']:.2f} %)",
        ]
        if self.ladder.rungs:
            lines += ["", "ladder (error in % of the torque, fitted | held out)"]
            first = self.ladder.rungs[0]
            lines.append(
                f"  {'as declared':34s} {first.fit_before.percent:8.3f} | "
                f"{first.held_before.percent:8.3f}"
            )
            for rung in self.ladder.rungs:
                gone = "  given up again" if rung.key in self.ladder.deleted else ""
                lines.append(
                    f"  + {rung.key:32s} {rung.fit_after.percent:8.3f} | "
                    f"{rung.held_after.percent:8.3f}{gone}"
                )
        for effect in self.effects:
            head = f"{effect.name} ({effect.location}), probability {effect.probability:.2f}"
            lines += ["", head]
            for name, p in effect.parameters.items():
                lines.append(f"  {name} = {p['value']:.4g} ± {p['se']:.2g} {p['unit']}".rstrip())
            lines.append(f"  {effect.evidence}")
            if effect.confusable_with:
                lines.append("  not told from: " + ", ".join(effect.confusable_with))
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    def plot(self, **options: Any) -> Any:
        """Draw the ladder and the residual before and after; see `ladder_html.plot_ladder`."""
        from dmptm_ctrl.diagnosis.ladder_html import plot_ladder

        return plot_ladder(self, **options)

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.summary())}</pre>"

    def model_toml(self) -> str:
        """Return the augmented model as the text of a file."""
        zeros = {log: dict(n.zero) for log, n in self.ladder.held_state.logs.items()}
        return chain_to_toml(self.augmented, self.rig.text, zeros)

    def save(self, folder: str | PathLike[str]) -> None:
        """Write diagnosis.json, model.toml and report.html, together or not at all."""
        from dmptm_ctrl.diagnosis.ladder_html import render_html

        with output_folder(folder) as out:
            text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
            (out / "diagnosis.json").write_text(text + "\n", encoding="utf-8")
            (out / "model.toml").write_text(self.model_toml(), encoding="utf-8")
            (out / "report.html").write_text(render_html(self), encoding="utf-8")


def error_dict(errors: Errors) -> dict[str, float]:
    """Return errors as JSON has them."""
    return {
        "rmse": errors.rmse,
        "fit_percent": errors.fit_percent,
        "pearson_r": errors.pearson_r,
        "relative_percent": errors.percent,
    }


def rung_dict(rung: Rung, deleted: tuple[str, ...]) -> dict[str, Any]:
    """Return a rung as JSON has it."""
    name, _, on = rung.key.partition("@")
    return {
        "name": name,
        "location": on,
        "kept": rung.key not in deleted,
        "fitted": {"before": error_dict(rung.fit_before), "after": error_dict(rung.fit_after)},
        "held_out": {"before": error_dict(rung.held_before), "after": error_dict(rung.held_after)},
        "p_value": rung.p_value,
    }


def standard_errors(fit: ChainFit, logs: Balance) -> dict[str, float]:
    """Standard errors of the fitted numbers by label, robust against correlated residuals.

    Sandwich (JᵀJ)⁻¹ (Σ_blocks s sᵀ) (JᵀJ)⁻¹ with s the score of a block.
    """
    if not fit.frees:
        return {}
    tangent = Tangent(fit, logs)
    slopes, left = tangent.stack(fit.slopes), tangent.stack(fit.left)
    count = int(tangent.blocks.max()) + 1
    products = slopes * left[:, None]
    sums = np.array(
        [np.bincount(tangent.blocks, products[:, j], count) for j in range(products.shape[1])]
    )
    inverse = np.linalg.pinv(slopes.T @ slopes, rcond=1e-12)
    spread = inverse @ (sums @ sums.T) @ inverse * count / max(count - 1, 1)
    se = np.sqrt(np.maximum(np.diag(spread), 0.0))
    return {f.label: float(s * f.scale) for f, s in zip(fit.frees, se, strict=True)}


def parameters_of(fit: ChainFit, logs: Balance) -> dict[str, dict[str, Any]]:
    """Return fitted values of declared quantities, with standard error, unit and range."""
    errors = standard_errors(fit, logs)
    found = {}
    for free in fit.frees:
        if free.kind != "value":
            continue
        quantity = fit.model.quantities[free.owner]
        low, high = quantity.range
        entry: dict[str, Any] = {
            "value": fit.model.value(free.owner),
            "se": errors.get(free.label, 0.0),
            "unit": counted_unit(fit.model.rig, quantity.unit),
        }
        if isfinite(quantity.value) and isfinite(high - low):
            entry["declared"] = [low, high]
        found[free.owner] = entry
    return found


def out_of_range(fit: ChainFit, logs: Balance) -> list[str]:
    """Warnings for declared quantities that the logs put outside their range."""
    notes = []
    for key, entry in parameters_of(fit, logs).items():
        if "declared" not in entry:
            continue
        low, high = entry["declared"]
        value, se = entry["value"], entry["se"]
        if value < low - 2 * se or value > high + 2 * se:
            notes.append(
                f"{key} = {value:.4g} ± {se:.2g} {entry['unit']} is outside its declared "
                f"range {low:.4g} to {high:.4g}"
            )
    return notes


def named_effect(
    effect: Placed, ladder: Ladder, stands: Mapping[str, Standing], errors: Mapping[str, float]
) -> NamedEffect:
    """Describe an effect of the final model."""
    model = ladder.final.model
    rung = next(r for r in ladder.rungs if r.key == effect.key)
    stand = stands.get(effect.key, Standing(rung.gain, (), 0.99))
    se = {k: errors.get(f"{effect.key}.{k}", 0.0) for k in effect.values}
    sentence = (
        f"Error on held-out data {rung.held_before.percent:.2f} → {rung.held_after.percent:.2f} % "
        f"when it was added ({rung.fit_before.percent:.2f} → {rung.fit_after.percent:.2f} % "
        f"fitted); without it {100 * stand.gain:.0f} % of the final residual's square returns"
    )
    if effect.name == "drive_offset":
        sentence += "; an offset and a difference of Coulomb friction by direction are one constant"
    return NamedEffect(
        effect.name,
        effect.on,
        stand.probability,
        effect_parameters(effect, model, se),
        stand.rivals,
        sentence + ".",
    )


def effect_parameters(
    effect: Placed, model: ChainModel, se: Mapping[str, float]
) -> dict[str, dict[str, Any]]:
    """Return the parameters of an effect in units that people read."""
    slide = on_slide(model, effect.on)
    found: dict[str, dict[str, Any]] = {}
    for p in CHAIN_CATALOGUE[effect.name].keep:
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
    effect: Placed, model: ChainModel, se: Mapping[str, float], slide: bool
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


def late_effect(item: Lateness) -> NamedEffect:
    """Describe a late speed sensor."""
    return NamedEffect(
        "sensor_delay",
        item.sensor,
        SENSOR_PROBABILITY,
        {"delay": {"value": item.delay, "se": item.se, "unit": "s"}},
        (),
        f"The speed reading follows the derivative of the position on the same body "
        f"{1e3 * item.delay:.2f} ms late, by {item.delay / item.se:.0f} standard errors.",
    )


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


def ranking_of(ladder: Ladder, late: Mapping[str, Lateness]) -> list[dict[str, Any]]:
    """Status of every effect of the chain catalogue, best first."""
    kept = {e.name for e in ladder.final.model.effects}
    rows = []
    for name, chain in CHAIN_CATALOGUE.items():
        best = ladder.best.get(name)
        if name in kept or (name == "sensor_delay" and late):
            status = "supported"
        elif best is None or best.score.survival < MIN_SURVIVAL:
            status = "not testable with these logs"
        else:
            status = "rejected"
        score = float(best.score.gain) if best is not None else float(status == "supported")
        rows.append(
            {
                "name": name,
                "score": max(score, 0.0) if isfinite(score) else 0.0,
                "status": status,
                "reveals": chain.reveals,
            }
        )
    return sorted(rows, key=lambda row: (row["status"] != "supported", -row["score"]))
