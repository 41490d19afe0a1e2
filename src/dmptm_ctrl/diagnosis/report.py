"""The result of a diagnosis: as an object, as text, as JSON and as files."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis.budget import MATERIAL, Errors, Row, table_lines
from dmptm_ctrl.diagnosis.dual import key_of, name_of
from dmptm_ctrl.diagnosis.experiment import EXPERIMENT_FILE, Experiment
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.select import Candidate, Entry, Selection
from dmptm_ctrl.diagnosis.summary import correlated, correlation_lines, parameter_lines, versions
from dmptm_ctrl.diagnosis.tables import Tables
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects import CATALOGUE, NO_CANDIDATES
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.signals import Log
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml

SCHEMA = 2
CLOCK = 1e-5  # s: a time is not known more finely than a hundredth of a usual sample
UNNAMED = "unknown"  # name of what lookup tables stand for
HEADLINE = 0.5  # probability from which a name stands in the sentence
OUTSIDE = 2.0  # standard errors from which a fitted value left its declared range
DIGITS = 3


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that was added to the model.

    Attributes
    ----------
    share : float
        Of the error budget; 2 % and more is material.
    """

    name: str
    location: str
    probability: float
    parameters: dict[str, dict[str, Any]]
    confusable_with: tuple[str, ...]
    evidence: str
    share: float = 0.0

    @property
    def material(self) -> bool:
        """Whether it moves the budget."""
        return self.share >= MATERIAL

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {
            "name": self.name,
            "location": self.location,
            "probability": self.probability,
            "material": self.material,
            "parameters": self.parameters,
            "confusable_with": list(self.confusable_with),
            "evidence": self.evidence,
        }


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the declared model lacks, and what each part of it is worth.

    Attributes
    ----------
    verdict : "none", "explained" or "unknown"
    effects : tuple of NamedEffect
        In order of their share of the budget.
    budget : tuple of Row
        Contribution of each effect, what is not explained, and the floor, on held-out logs.
    ranking : list of dict
        Every catalogue entry: name, location, score, status, reveals.
    depends_on : tuple of str
        Variables of what is not explained.
    error : dict
        Held-out errors before, after and floor: speed, torque, horizon.
    errors : Errors
    declared, augmented : Model
        Fitted without and with the effects; `augmented.to_blocks()` gives python-control.
    measured : Measured
    selection : Selection
    fits : (Fit, Fit)
        Before and after, fitted on the fitted logs only: those that `error` is of.
    fitted : Fit
        Of `augmented`, on all logs.
    declared_values : dict
        Declared and fitted value of each parameter of the drive.
    provenance : dict
    experiment : Experiment or None
        That would separate an effect from what it may be confused with.
    """

    verdict: str
    effects: tuple[NamedEffect, ...]
    budget: tuple[Row, ...]
    ranking: list[dict[str, Any]]
    depends_on: tuple[str, ...]
    error: dict[str, Any]
    errors: Errors
    declared: Model
    augmented: Model
    measured: Measured
    selection: Selection
    fits: tuple[Fit, Fit]
    fitted: Fit
    declared_values: dict[str, dict[str, Any]]
    provenance: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    experiment: Experiment | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the content of diagnosis.json: plain types, no NaN."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "effects": [effect.to_dict() for effect in self.effects],
            "budget": [row.to_dict() for row in self.budget],
            "ranking": self.ranking,
            "depends_on": list(self.depends_on),
            "error": self.error,
            "declared": self.declared_values,
            "next_experiment": self.experiment.to_dict() if self.experiment else None,
            "provenance": self.provenance,
            "warnings": list(self.warnings),
        }

    @property
    def outside(self) -> tuple[str, ...]:
        """Parameters whose fitted values sit on or beyond a bound of the declared range."""
        return tuple(k for k, v in self.declared_values.items() if v["outside"])

    def sentence(self) -> str:
        """Return the result in one sentence that says no more than the budget."""
        speed = {k: self.error[k]["speed"]["rmse"] for k in ("before", "after", "floor")}
        left = f"{speed['after']:.{DIGITS}g} deg/s are left on held-out logs"
        sure = [
            e.name.replace("_", " ")
            for e in self.effects
            if e.name != UNNAMED and e.material and e.probability >= HEADLINE
        ]
        either = [
            " or ".join(name.replace("_", " ") for name in (e.name, *e.confusable_with))
            for e in self.effects
            if e.name != UNNAMED and e.material and e.probability < HEADLINE and e.confusable_with
        ]
        names = ", ".join([*sure, *either])
        if self.verdict == "none":
            return (
                "The declared model is as good as these logs can show: its error on held-out logs, "
                f"{speed['before']:.{DIGITS}g} deg/s, is near the floor."
            )
        if self.verdict == "explained":
            share = f"{100.0 * self.errors.explained:.0f} % of the removable error"
            return f"The declared model lacks {names or 'small effects'}: {share}; {left}."
        on = f"; it depends on {', '.join(self.depends_on)}" if self.depends_on else ""
        if names:
            share = f"{100.0 * self.errors.explained:.0f} % of the removable error"
            return f"Found {names}: {share}. The rest is unknown{on}; {left}."
        return f"The declared model lacks something unknown{on}; {left}."

    def summary(self) -> str:
        """Return the result as text: sentence, budget, effects, parameters."""
        lines = [
            self.sentence(),
            "",
            "error budget (share of the mean square of the balances, all logs)",
        ]
        lines += table_lines(self.budget, ("deg/s", "N·m"))
        before, after = (self.error[k]["speed"] for k in ("before", "after"))
        lines += [
            "",
            f"speed error on held-out logs, below {before['bandwidth_hz']:g} Hz: "
            f"{before['rmse']:.3f} → {after['rmse']:.3f} deg/s "
            f"(fit {before['fit_percent']:.1f} → {after['fit_percent']:.1f} %)",
        ]
        if self.outside:
            lines.append("at or outside the declared range: " + ", ".join(self.outside))
        for effect in self.effects:
            kind = "" if effect.material else ", immaterial"
            lines += [
                "",
                f"{effect.name} ({effect.location}), probability {effect.probability:.2f}{kind}",
            ]
            if effect.name != UNNAMED:  # a table is to be drawn, not read
                for name, p in effect.parameters.items():
                    line = f"  {name} = {p['value']:.4g} ± {p['se']:.2g} {p['unit']}"
                    lines.append(line.rstrip())
            lines.append(f"  {effect.evidence}")
            if effect.confusable_with:
                lines.append("  cannot be told from: " + ", ".join(effect.confusable_with))
        if self.experiment is not None:
            lines += [
                "",
                f"next experiment, to separate {' from '.join(self.experiment.against[:2])}: "
                f"{self.experiment.description}, {EXPERIMENT_FILE}",
            ]
        lines += ["", *parameter_lines(self.fitted, self.measured.drive)]
        lines += correlation_lines(correlated(self.fitted))
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    def plot(self, **options: Any) -> Any:
        """Draw measured, before and after on each held-out log; see `plots.diagnosis`."""
        from dmptm_ctrl.plots.diagnosis import plot_diagnosis

        return plot_diagnosis(self, **options)

    def overlays(self) -> tuple[Any, ...]:
        """Speeds per held-out log, measured, before and after: `plots.diagnosis.Overlay`."""
        from dmptm_ctrl.diagnosis.figures import overlays

        return overlays(self)

    def evidence(self) -> Any:
        """Residual folded over what explains it: `plots.diagnosis.Evidence`."""
        from dmptm_ctrl.diagnosis.figures import folded

        return folded(self)

    def plot_evidence(self, **options: Any) -> Any:
        """Draw the residual against what explains it; see `plots.diagnosis`."""
        from dmptm_ctrl.plots.diagnosis import plot_evidence

        return plot_evidence(self, **options)

    def _repr_html_(self) -> str:
        from html import escape

        return f"<pre>{escape(self.summary())}</pre>"

    def save(self, folder: str | PathLike[str]) -> None:
        """Write diagnosis.json, model.toml and report.html, together or not at all."""
        from dmptm_ctrl.diagnosis.html import render

        with output_folder(folder) as out:
            text = json.dumps(self.to_dict(), indent=2, ensure_ascii=False, allow_nan=False)
            (out / "diagnosis.json").write_text(text + "\n", encoding="utf-8")
            (out / "model.toml").write_text(to_toml(self.augmented), encoding="utf-8")
            if self.experiment is not None:
                table = self.experiment.table()
                table.to_csv(out / EXPERIMENT_FILE, index=False, float_format="%.6g")
            (out / "report.html").write_text(render(self), encoding="utf-8")


def estimate(value: float, se: float, unit: str) -> dict[str, Any]:
    """Return a parameter as in diagnosis.json; a time is not known to less than :data:`CLOCK`."""
    floor = CLOCK if unit == "s" else 0.0
    return {"value": float(value), "se": float(np.hypot(se, floor)), "unit": unit}


def named(entry: Entry, after: Fit, share: float) -> NamedEffect:
    """Describe a selected effect with the values of the final fit."""
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
        f"{entry.held_gain:.0f} on the held-out ones, the rest refitted"
    )
    if entry.rivals:
        second = entry.rivals[0]
        sentence += f"; in its place {name_of(second.keys[0])} would give {second.evidence:.0f}"
    return NamedEffect(
        effect.name,
        effect.location,
        entry.probability,
        parameters,
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
    evidence = tables.gain + tables.held_gain
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
            unit = next(p.unit for p in effect.parameters if p.name == unknown.name)
            sizes[unknown.name] = {"value": float(3.0 * unknown.scale * error), "unit": unit}
    return sizes


def ranking(
    selection: Selection,
    untestable: Sequence[str],
    sensors: dict[str, dict[str, float]],
    found: Sequence[str],
) -> list[dict[str, Any]]:
    """Status of every catalogue entry, best first.

    Parameters
    ----------
    untestable : sequence of str
        Effects that these logs cannot show.
    sensors : mapping
        Effect of a sensor → standard errors of its amplitudes.
    found : sequence of str
        Effects of sensors that are in the model.
    """
    entries = {e.key: e for e in selection.entries}
    beside = {c.keys[0]: c for c in selection.rest}
    alone = {c.keys[0]: c for c in selection.first}
    rivals = {key for e in selection.entries for key in e.confusable_with}
    rows = []
    for name, effect in CATALOGUE.items():
        if name in NO_CANDIDATES:
            continue
        key = key_of(name)
        row: dict[str, Any] = {"name": name, "location": effect.location, "reveals": effect.reveals}
        if key in entries or name in found:
            row["status"] = "supported"
            row["score"] = entries[key].evidence if key in entries else float("inf")
        elif key in beside or key in alone:
            candidate = beside.get(key, alone.get(key))
            assert candidate is not None
            row["status"], row["score"] = "rejected", candidate.evidence
            row["reason"] = candidate.objection or (
                "other effects explain the same as well"
                if key in rivals or alone.get(key, candidate).acceptable
                else "too little evidence beside what was found"
            )
        elif name in sensors:
            row["status"], row["score"] = "rejected", 0.0
        else:
            row["status"], row["score"] = "not testable with these logs", 0.0
        if name in untestable and row["status"] == "rejected" and key not in beside:
            row["status"] = "not testable with these logs"
        if key in alone:
            row["detectable"] = detectable(beside.get(key, alone[key]))
        if name in sensors:
            row["detectable"] = {
                k: {
                    "value": 3.0 * se,
                    "unit": next(p.unit for p in effect.parameters if p.name == k),
                }
                for k, se in sensors[name].items()
            }
        row["score"] = float(np.clip(row["score"], -1e9, 1e9))
        rows.append(row)
    return sorted(rows, key=lambda row: (row["status"] != "supported", -row["score"]))


def provenance(
    measured: Measured, logs: Sequence[Log], seed: int, seconds: float
) -> dict[str, Any]:
    """Versions, seed, hashes and roles of the logs."""
    from dmptm_ctrl import __version__

    held = {rec.name for rec in measured.held}
    return {
        "version": __version__,
        "seed": seed,
        "logs": [
            {
                "name": log.name,
                "sha256": log.sha256 or "",
                "role": "held-out" if log.name in held else "fit",
            }
            for log in logs
        ],
        "seconds": round(seconds, 3),
        "versions": versions(),
    }
