"""Fifth step: the verdict as an object, as text, as JSON and as files."""

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from os import PathLike
from typing import Any

import numpy as np

from dmptm_ctrl.diagnosis import at_rest
from dmptm_ctrl.diagnosis.decide import Decision, Found
from dmptm_ctrl.diagnosis.experiment import EXPERIMENT_FILE, Experiment
from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.diagnosis.summary import correlated, correlation_lines, parameter_lines, versions
from dmptm_ctrl.diagnosis.tables import Tables
from dmptm_ctrl.diagnosis.trace import Trial
from dmptm_ctrl.diagnosis.verdict import verdict_dict
from dmptm_ctrl.effects import CATALOGUE, NO_CANDIDATES
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.signals import Log
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml

CLOCK = 1e-5  # s: a time is not known more finely than a hundredth of a usual sample
UNNAMED = "unknown"  # name of what lookup tables stand for, in the contract of diagnosis.json


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that was added to the model."""

    name: str
    location: str
    probability: float
    parameters: dict[str, dict[str, Any]]
    confusable_with: tuple[str, ...]
    evidence: str

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {
            "name": self.name,
            "location": self.location,
            "probability": self.probability,
            "parameters": self.parameters,
            "confusable_with": list(self.confusable_with),
            "evidence": self.evidence,
        }


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the declared model lacks.

    Attributes
    ----------
    verdict : "none", "explained" or "unknown"
    effects : tuple of NamedEffect
        In order of probability.
    ranking : list of dict
        Every catalogue entry: name, score, status, reveals, and the smallest amplitude
        that these logs could have shown.
    depends_on : tuple of str
    error : dict
        Held-out speed error below 30 Hz before and after [deg/s].
    declared, augmented : Model
        Fitted without and with the effects; `augmented.to_blocks()` gives python-control.
    measured : Measured
    decision : Decision
    fits : (Fit, Fit)
        Before and after, fitted on the fitted logs only: those that `error` is of.
    fitted : Fit
        Of `augmented`, on all logs.
    provenance : dict
    experiment : Experiment or None
        That would tell an effect from what it may be confused with.
    """

    verdict: str
    effects: tuple[NamedEffect, ...]
    ranking: list[dict[str, Any]]
    depends_on: tuple[str, ...]
    error: dict[str, Any]
    declared: Model
    augmented: Model
    measured: Measured
    decision: Decision
    fits: tuple[Fit, Fit]
    fitted: Fit
    provenance: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    experiment: Experiment | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the content of diagnosis.json: plain types, no NaN."""
        return verdict_dict(
            self.verdict,
            self.effects,
            ranking=self.ranking,
            depends_on=self.depends_on,
            error=self.error,
            provenance=self.provenance,
            warnings=self.warnings,
            next_experiment=self.experiment.to_dict() if self.experiment else None,
        )

    def summary(self) -> str:
        """Return the verdict as a text: sentence, errors, parameters with standard errors."""
        lines = [self.sentence(), ""]
        before, after = self.error["before"], self.error["after"]
        lines.append(
            f"speed error on {self.error['on']}, below {self.error['bandwidth_hz']} Hz: "
            f"{before['rmse']:.3f} → {after['rmse']:.3f} deg/s "
            f"(fit {before['fit_percent']:.1f} → {after['fit_percent']:.1f} %)"
        )
        for effect in self.effects:
            lines += [
                "",
                f"{effect.name} ({effect.location}), probability {effect.probability:.2f}",
            ]
            if effect.name != UNNAMED:  # a table is to be drawn, not read
                for name, p in effect.parameters.items():
                    line = f"  {name} = {p['value']:.4g} ± {p['se']:.2g} {p['unit']}"
                    lines.append(line.rstrip())
            lines.append(f"  {effect.evidence}")
            if effect.confusable_with:
                lines.append("  not told from: " + ", ".join(effect.confusable_with))
        if self.experiment is not None:
            lines += [
                "",
                f"to tell {' from '.join(self.experiment.against[:2])}: "
                f"{self.experiment.description}, {EXPERIMENT_FILE}",
            ]
        lines += ["", *parameter_lines(self.fitted, self.measured.drive)]
        lines += correlation_lines(correlated(self.fitted))
        bounds = self.fitted.at_bounds
        if bounds:
            lines += ["", "at the edge of the declared range: " + ", ".join(bounds)]
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    def sentence(self) -> str:
        """Return the verdict in one sentence."""
        if self.verdict == "none":
            return (
                "The declared model explains the logs within its uncertainty; nothing is missing."
            )
        names = " and ".join(
            effect.name.replace("_", " ") for effect in self.effects if effect.name != UNNAMED
        )
        if self.verdict == "explained":
            return f"The declared model lacks: {names}."
        on = ", ".join(self.depends_on) or "nothing that was measured"
        known = f" besides {names}" if names else ""
        return f"Something that is on no list is missing{known}; it depends on {on}."

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


# Where something no name stands for is left, a name may only stand in for it: of the ten effects
# of the catalogue that campaigns named on such rigs, five were right (one more of each: Laplace).
STANDS_IN = 6.0 / 12.0


def named(found: Found, after: Fit, *, all_explained: bool) -> NamedEffect:
    """Describe an accepted effect with the values of the final fit."""
    effect = CATALOGUE[found.name]
    parameters, absent = {}, effect.absent()
    for p in effect.parameters:
        try:
            value, se = after.value(found.name, p.name)
        except KeyError:  # found by search, not by fit: a whole-numbered order
            value, se = after.model.effects[found.name].get(p.name, absent[p.name]), 0.0
        parameters[p.name] = estimate(value, se, p.unit)
    trial = found.trial
    how = "It supplies the torque or twist that is missing"
    if found.in_step > 0.0:
        how = (
            f"With it the model meets every bounce of the first {found.in_step:g} s of each log, "
            "without it it loses step"
        )
    sentence = (
        f"{how}: log-likelihood ratio {trial.gain:.0f} "
        f"on the fitted logs and {trial.held_gain:.0f} on the held-out ones, together "
        f"{found.evidence:.0f} where {found.threshold:.0f} is needed"
    )
    if found.rivals:
        second = found.rivals[0]
        sentence += f"; the next best, {second.name}, reaches {second.evidence:.0f}"
    if found.out_of_step:
        several = ", ".join(found.out_of_step)
        sentence += f"; simulated in its place from the start of each log, {several} lost step"
    sentence += "."
    return NamedEffect(
        found.name,
        effect.location,
        found.probability * (1.0 if all_explained else STANDS_IN),
        parameters,
        found.confusable_with,
        sentence,
    )


def unnamed(tables: Tables) -> NamedEffect:
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
        f"A curve over {', '.join(tables.variables)}: log-likelihood ratio "
        f"{tables.gain:.0f} on the fitted logs and {tables.held_gain:.0f} on the held-out ones.",
    )


def detectable(trial: Trial) -> dict[str, dict[str, Any]]:
    """Smallest amplitudes that these logs could have shown: three standard errors."""
    effect = CATALOGUE[trial.name]
    sizes = {}
    errors = np.sqrt(np.diag(trial.fit.covariance))
    for unknown, error in zip(trial.fit.unknowns, errors, strict=True):
        if unknown.effect == trial.name and unknown.name in effect.amplitudes:
            unit = next(p.unit for p in effect.parameters if p.name == unknown.name)
            sizes[unknown.name] = {"value": float(3.0 * unknown.scale * error), "unit": unit}
    return sizes


def ranking(
    decision: Decision, untestable: Sequence[str], sensors: dict[str, dict[str, float]]
) -> list[dict[str, Any]]:
    """Status of every catalogue entry, best first."""
    chosen = {f.name: f for f in decision.found}
    rows = []
    for name, effect in CATALOGUE.items():
        if name in NO_CANDIDATES:
            continue
        trial = decision.trials.get(name)
        value = trial.evidence if trial is not None else 0.0
        if decision.at_rest is not None and name == at_rest.NAME:
            value = decision.at_rest.evidence
        if name in chosen:
            value = chosen[name].evidence
        status = "supported" if name in chosen else "rejected"
        simulated = decision.at_rest is not None and name == at_rest.NAME
        tried = trial is not None or name in sensors or simulated
        if status == "rejected" and (name in untestable or not tried):
            status = "not testable with these logs"
        row: dict[str, Any] = {
            "name": name,
            "score": float(np.nan_to_num(value)),
            "status": status,
            "reveals": effect.reveals,
        }
        if trial is not None:
            row["detectable"] = detectable(trial)
        if simulated:
            row["detectable"] = {"ring_distance": {"value": at_rest.MATTERS, "unit": "rad"}}
        if name in sensors:
            row["detectable"] = {
                key: {
                    "value": 3.0 * se,
                    "unit": next(p.unit for p in effect.parameters if p.name == key),
                }
                for key, se in sensors[name].items()
            }
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
