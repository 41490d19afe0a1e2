"""The result of a diagnosis, whatever the drive: as an object, as text, as JSON and as files."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import sqrt
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis.budget import MATERIAL, NONE, Errors, Row, near, table_lines
from dmptm_ctrl.diagnosis.experiment import EXPERIMENT_FILE, Experiment
from dmptm_ctrl.diagnosis.select import Selection
from dmptm_ctrl.diagnosis.summary import correlation_lines, parameter_lines, shown_names, versions
from dmptm_ctrl.signals import Log
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import model_text
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import RigModel

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.dual_report import DualSource
    from dmptm_ctrl.diagnosis.rig_report import RigSource
    from dmptm_ctrl.plots.diagnosis import Evidence, Overlay

SCHEMA = 2
CLOCK = 1e-5  # s: a time is not known more finely than a hundredth of a usual sample
UNNAMED = "unknown"  # name of what lookup tables stand for
HEADLINE = 0.5  # probability from which a name stands in the sentence
DIGITS = 3


@dataclass(frozen=True, eq=False)
class NamedEffect:
    """An effect that was added to the model.

    Attributes
    ----------
    share : float
        Of the error budget; 2 % and more is material.
    together : bool
        Whether it takes as much together with weaker ones.
    """

    name: str
    location: str
    probability: float
    parameters: dict[str, dict[str, Any]]
    confusable_with: tuple[str, ...]
    evidence: str
    share: float = 0.0
    together: bool = False

    @property
    def named(self) -> bool:
        """Whether it has a name; lookup tables stand for what has none."""
        return self.name != UNNAMED

    @property
    def material(self) -> bool:
        """Whether it moves the budget."""
        return self.share >= MATERIAL or self.together

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


class Picture(NamedTuple):
    """A picture that only one kind of drive has: its anchor, title, source, words."""

    anchor: str
    title: str
    uri: str
    alt: str
    caption: str
    plain: bool = False  # kept as it is on a dark page


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the declared model lacks, and what each part of it is worth.

    Attributes
    ----------
    verdict : "none", "explained" or "unknown"
    effects : tuple of NamedEffect
        In order of their share of the budget.
    budget : tuple of Row
        Contribution of each effect, what is not explained, and the floor.
    ranking : list of dict
        Every catalogue entry: name, location, score, status, reason, reveals.
    depends_on : tuple of str
        Variables of what is not explained.
    error : dict
        Held-out errors before, after and floor: speed, torque, horizon.
    errors : Errors
        Mean squares that the verdict compares.
    declared, augmented : Model or RigModel
        Fitted without and with the effects.
    declared_values : dict
        Declared and fitted value of each declared parameter.
    selection : Selection
    source : DualSource or RigSource
        Logs, runs and pictures of this kind of drive.
    correlations : list of (str, str, float)
        Pairs of fitted parameters whose estimates go together.
    provenance : dict
    experiment : Experiment or None
        That would separate an effect from what it may be confused with.
    off_balance : dict of str to float
        How far fitted numbers are from what the balance of torques alone gives [SI].

    Examples
    --------
    >>> found = dm.diagnose("logs")
    >>> for row in found.budget:
    ...     print(row.name, row.location, row.share)
    >>> plant = found.augmented.to_blocks()
    """

    verdict: str
    effects: tuple[NamedEffect, ...]
    budget: tuple[Row, ...]
    ranking: list[dict[str, Any]]
    depends_on: tuple[str, ...]
    error: dict[str, Any]
    errors: Errors
    declared: Model | RigModel
    augmented: Model | RigModel
    declared_values: dict[str, dict[str, Any]]
    selection: Selection
    source: "DualSource | RigSource"
    correlations: list[tuple[str, str, float]] = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    experiment: Experiment | None = None
    off_balance: dict[str, float] = field(default_factory=dict)

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
            "apart_from_balance": self.off_balance,
            "next_experiment": self.experiment.to_dict() if self.experiment else None,
            "provenance": self.provenance,
            "warnings": list(self.warnings),
        }

    @property
    def outside(self) -> tuple[str, ...]:
        """Parameters whose fitted values sit on or beyond a bound of the declared range."""
        return tuple(k for k, v in self.declared_values.items() if v["outside"])

    @property
    def shown(self) -> dict[str, str]:
        """Names of the declared parameters for reading, by their keys."""
        return shown_names(self.declared_values)

    @property
    def outside_shown(self) -> str:
        """Names of :attr:`outside` for reading, separated by commas."""
        return ", ".join(self.shown[key] for key in self.outside)

    @property
    def units(self) -> tuple[str, str]:
        """Units of the budget's speeds and torques; empty where there are none."""
        speed, torque = (self.error["after"].get(k) or {} for k in ("speed", "torque"))
        return speed.get("unit", ""), torque.get("unit", "")

    def sentence(self) -> str:
        """Return the result in one sentence that says no more than the budget."""
        before, after = (f"{self.error[k]['rmse']:.{DIGITS}g}" for k in ("before", "after"))
        left = f"{after} {self.error['unit']}"
        runs, times = self.errors.runs, 1.0
        if "speed" in self.error["after"]:
            left = f"free runs miss {self.error['on']} by {left}"
            times = sqrt(runs.after / max(runs.floor, 1e-300)) if runs else times
            if times > NONE:
                left += f", {times:.1f} times their floor"
            if float(after) > float(before):  # as shown, so that no last bit decides
                left += f", those of the declared model by {before}"
        else:
            left += f" are left on {self.error['on']}"
        beyond = ""
        if self.outside and not self.effects:
            beyond = f"; fitted values leave their declared ranges: {self.outside_shown}"
        if self.verdict == "none":
            balance = sqrt(self.errors.before / max(self.errors.floor, 1e-300))
            said = f"is {balance:.2f} times the floor; {left}{beyond}."
            if times > NONE:
                return f"The balance shows no lack of the declared model: its error {said}"
            return (
                "The declared model is as good as these logs can show: the error of its "
                f"balance {said}"
            )
        where = f"depends on {', '.join(self.depends_on)}" if self.depends_on else ""
        on = f"; it {where}" if where else ""
        names = self._headline()
        rest = ". The rest is unknown" * (times > NONE)
        if not names and (apart := self._sensors_apart()):
            return f"Sensors of one motion disagree: {apart}{rest}; {left}."
        if not names:
            why = "The declared model lacks something unknown"
            short = self.errors.short
            if self.errors.balanced and short and not near(short.before, short.floor):
                times = sqrt(short.before / max(short.floor, 1e-300))
                why = "The balance shows no lack of the declared model, but short predictions do: "
                why += f"they miss by {times:.1f} times their floor"
                on = f"; what they miss {where}" if where else ""
            return f"{why}{on}; {left}{beyond}."
        share = f"{100.0 * self.errors.explained:.0f} % of the removable error"
        if self.verdict == "explained":
            return f"The declared model lacks {names}: {share}{rest}; {left}."
        return f"Found {names}: {share}. The rest is unknown{on}; {left}."

    def _sensors_apart(self) -> str:
        """Errors of sensors, which a balance of mended readings does not show."""
        return ", ".join(
            f"{e.name.replace('_', ' ')} of {e.location}"
            for e in self.effects
            if e.named and e.probability >= HEADLINE and _of_sensor(e.name)
        )

    def _headline(self) -> str:
        """Effects that matter: names that are likelier than not, and how many others."""
        named = [e for e in self.effects if e.named and not _of_sensor(e.name)]
        material = [e for e in self.effects if e.material and e.named]
        if self.verdict == "explained":
            material = material or named  # what they explain, they share
        names = [e.name.replace("_", " ") for e in material]
        sure = [
            f"{name} of {e.location}" if names.count(name) > 1 else name
            for name, e in zip(names, material, strict=True)
            if e.probability >= HEADLINE
        ]
        doubtful = len(material) - len(sure)
        if doubtful:
            sure.append(f"{doubtful} effect{'s'[: doubtful > 1]} of uncertain name")
        return ", ".join(sure)

    def summary(self) -> str:
        """Return the result as text: sentence, budget, effects, parameters."""
        lines = [self.sentence(), "", f"error budget (share of {self.source.shares})"]
        lines += table_lines(self.budget, self.units)
        before, after = self.error["before"], self.error["after"]
        lines.append("")
        for kind in ("speed", "torque", "horizon"):
            if kind in after:
                one, two = before[kind], after[kind]
                said = "short-prediction" if kind == "horizon" else kind
                text = f"{said} error on {self.error['on']}: {one['rmse']:.3g} → {two['rmse']:.3g} "
                text += two["unit"] + (f" of {two['sensor']}" if "sensor" in two else "")
                if "fit_percent" in two:
                    text += f" (fit {one['fit_percent']:.1f} → {two['fit_percent']:.1f} %"
                    text += f", below {two['bandwidth_hz']:g} Hz)"
                lines.append(text)
        if self.outside:
            lines.append(f"at or outside the declared range: {self.outside_shown}")
        for effect in self.effects:
            kind = "" if effect.material else ", immaterial"
            head = f"{effect.name} ({effect.location}), probability {effect.probability:.2f}{kind}"
            lines += ["", head]
            if effect.named:  # a table is to be drawn, not read
                for name, p in effect.parameters.items():
                    line = f"  {name} = {p['value']:.4g} ± {p['se']:.2g} {p['unit']}"
                    lines.append(line.rstrip())
            lines.append(f"  {effect.evidence}")
            if effect.confusable_with:
                lines.append("  cannot be distinguished from: " + ", ".join(effect.confusable_with))
        if self.experiment is not None:
            lines += [
                "",
                f"next experiment, to separate {' from '.join(self.experiment.against[:2])}: "
                f"{self.experiment.description}, {EXPERIMENT_FILE}",
            ]
        lines += ["", *parameter_lines(self.declared_values)]
        pairs = [(self.shown.get(a, a), self.shown.get(b, b), c) for a, b, c in self.correlations]
        lines += correlation_lines(pairs)
        lines += [f"warning: {text}" for text in self.warnings]
        return "\n".join(lines)

    __str__ = summary

    def overlays(self) -> "Sequence[Overlay]":
        """Measured, before and after on each held-out log: `plots.diagnosis.Overlay`."""
        return self.source.overlays()

    def evidence(self, name: str | None = None) -> "Evidence | None":
        """Residual without and with an effect, over what it depends on.

        Parameters
        ----------
        name : str, optional
            Of an effect that was found; by default the first, else what is not explained.

        Returns
        -------
        Evidence or None
            See `plots.diagnosis`; None where there is nothing to fold.

        Raises
        ------
        KeyError
            No such effect was found.
        """
        found = next((e for e in self.effects if name in (None, e.name)), None)
        if found is None and name is not None:
            raise KeyError(f"no effect {name!r} in this diagnosis")
        return self.source.evidence(found, self.depends_on)

    def plot(self, **options: Any) -> Any:
        """Draw measured, before and after on each held-out log; see `plots.diagnosis`."""
        from dmptm_ctrl.plots.diagnosis import plot_diagnosis

        return plot_diagnosis(self, **options)

    def plot_budget(self, **options: Any) -> Any:
        """Draw the error budget as bars; see `plots.diagnosis`."""
        from dmptm_ctrl.plots.diagnosis import plot_budget

        return plot_budget(self, **options)

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
            (out / "model.toml").write_text(model_text(self.augmented), encoding="utf-8")
            if self.experiment is not None:
                table = self.experiment.table()
                table.to_csv(out / EXPERIMENT_FILE, index=False, float_format="%.6g")
            (out / "report.html").write_text(render(self), encoding="utf-8")


def estimate(value: float, se: float, unit: str) -> dict[str, Any]:
    """Return a parameter as in diagnosis.json; a time is not known to less than :data:`CLOCK`."""
    floor = CLOCK if unit == "s" else 0.0
    return {"value": float(value), "se": float(np.hypot(se, floor)), "unit": unit}


def provenance(
    logs: Sequence[Log], held: Iterable[str], seed: int, seconds: float
) -> dict[str, Any]:
    """Versions, seed, hashes and roles of the logs; `held` are names of those held out whole."""
    from dmptm_ctrl import __version__

    names = set(held)
    roles = ["held-out" if log.name in names else "fit" for log in logs]
    return {
        "version": __version__,
        "seed": seed,
        "logs": [
            {"name": log.name, "sha256": log.sha256 or "", "role": role}
            for log, role in zip(logs, roles, strict=True)
        ],
        "seconds": round(seconds, 3),
        "versions": versions(),
    }


def _of_sensor(name: str) -> bool:
    """Whether an effect is an error of a sensor."""
    return name in PLACED_CATALOGUE and PLACED_CATALOGUE[name].place == "sensor"
