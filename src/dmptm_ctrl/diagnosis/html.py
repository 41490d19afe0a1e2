"""The report: one HTML file without scripts, network or paths, that any browser opens."""

import base64
import io
import math
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from dmptm_ctrl.diagnosis.figures import folded, overlays
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.plots.diagnosis import Evidence, Overlay, plot_evidence, plot_overlay

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.report import Diagnosis

DETECTABLE_MAX = 1e6  # steps beyond which an amplitude means: not with these logs
VERDICTS = {
    "none": "nothing is missing",
    "explained": "an effect is missing",
    "unknown": "something unlisted is missing",
}
READ_EVIDENCE = (
    "Points are means over bins, bars ± 2 standard errors; samples at rest are left out. A curve "
    "before that stands off zero by many bars, and lies on zero after, speaks for the effect. "
    "The same sign in both directions of motion is a torque of place or drive; opposite signs "
    "are friction."
)
READ_NOTHING = (
    "Points are means over bins, bars ± 2 standard errors; samples at rest are left out. Small "
    "offsets that differ by direction are friction inside its declared range; a wave that both "
    "directions share would be an effect that the declared model lacks."
)
CODE = """\
from dmptm_ctrl.simulate.model_file import read_model

model = read_model("model.toml")  # written beside this report
plant = model.to_blocks()  # python-control: InterconnectedSystem
print(plant.input_labels, plant.output_labels)
"""


def render(diagnosis: "Diagnosis") -> str:
    """Return the report of a diagnosis.

    Parameters
    ----------
    diagnosis : Diagnosis

    Returns
    -------
    str
        A whole HTML document; figures are inline SVG images, style is inline, names from
        files are escaped.
    """
    environment = Environment(
        loader=PackageLoader("dmptm_ctrl.diagnosis"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"number": number, "words": words, "percent": percent}
    logs = overlays(diagnosis)
    evidence = folded(diagnosis)
    return environment.get_template("report.html.j2").render(
        d=diagnosis,
        title=VERDICTS[diagnosis.verdict],
        action=action(diagnosis),
        logs=[
            {
                "name": log.name,
                "before": {"rmse": log.rmse("before"), "fit": log.fit_percent("before")},
                "after": {"rmse": log.rmse("after"), "fit": log.fit_percent("after")},
                "figure": overlay_figure(log),
            }
            for log in logs
        ],
        evidence=evidence,
        evidence_figure=evidence_figure(evidence),
        read=READ_EVIDENCE if evidence.effect else READ_NOTHING,
        declared=declared_rows(diagnosis),
        at_bounds=diagnosis.fitted.at_bounds,
        catalogue=CATALOGUE,
        detectable=detectable,
        code=CODE,
    )


def action(diagnosis: "Diagnosis") -> str:
    """Return what to do about the verdict, in one or two sentences."""
    before, after = diagnosis.error["before"]["rmse"], diagnosis.error["after"]["rmse"]
    if diagnosis.verdict == "none":
        return (
            f"Keep the declared model: refitted inside its declared ranges it leaves "
            f"{number(after)} deg/s on logs that it was not fitted to."
        )
    fall = f"the error on logs that it was not fitted to goes from {number(before)} to "
    fall += f"{number(after)} deg/s"
    rivals = [name for effect in diagnosis.effects for name in effect.confusable_with]
    if diagnosis.verdict == "unknown":
        first = f"Use model.toml for prediction ({fall}), but look for the cause on the rig."
    else:
        where = " and ".join(dict.fromkeys(effect.location for effect in diagnosis.effects))
        first = f"Look at: {where}. Use model.toml for control design: {fall}."
    if rivals:
        first += f" Before a repair, rule out {', '.join(map(words, dict.fromkeys(rivals)))}."
    return first


def number(value: float, digits: int = 3) -> str:
    """Format a number for reading; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    return f"{float(value):.{digits}g}".replace("-", "−")


def percent(value: float) -> str:
    """Format a percentage to a tenth."""
    return f"{value:.1f}".replace("-", "−") if math.isfinite(value) else "–"


def words(name: str) -> str:
    """Return the name of an effect as words."""
    return name.replace("_", " ")


def detectable(row: dict[str, Any]) -> str:
    """Return the smallest amplitudes that the logs would have shown."""
    parts = []
    steps = {p.name: p.step for p in CATALOGUE[row["name"]].parameters}
    for name, p in row.get("detectable", {}).items():
        if p["value"] < DETECTABLE_MAX * steps[name]:
            parts.append(f"{words(name)} {number(p['value'], 2)} {p['unit']}".rstrip())
    return ", ".join(parts) or "–"


def declared_rows(diagnosis: "Diagnosis") -> list[dict[str, Any]]:
    """Return fitted parameters of the drive beside their declared ranges."""
    after = diagnosis.fitted
    rows = []
    for k, p in zip(after.unknowns, after.p, strict=True):
        if k.effect is None:
            value, se = after.value(None, k.name)
            quantity = diagnosis.measured.drive.quantities[k.name]
            low, high = quantity.range
            rows.append(
                {
                    "name": k.name,
                    "value": value,
                    "se": se,
                    "declared": quantity.value,
                    "low": low,
                    "high": high,
                    "unit": quantity.unit,
                    "place": float(np.clip(p, -1.0, 1.0)),
                    "edge": k.name in after.at_bounds,
                }
            )
    return rows


def overlay_figure(overlay: Overlay) -> str:
    """Return the picture of one log as a data URI."""
    figure = Figure(figsize=(8.6, 4.0), layout="constrained")
    panels = figure.subplots(2, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    plot_overlay(overlay, ax=panels, title="")
    return data_uri(figure)


def evidence_figure(evidence: Evidence) -> str:
    """Return the picture of the evidence as a data URI."""
    figure = Figure(figsize=(8.6, 3.5), layout="constrained")
    plot_evidence(evidence, ax=figure.subplots(1, 2, sharex=True, sharey=True))
    return data_uri(figure)


def data_uri(figure: Figure) -> str:
    """Return a figure as an SVG image to put into a page: the same bytes every time."""
    text = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "dmptm", "svg.fonttype": "path", "path.simplify": True}):
        figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True)
    return "data:image/svg+xml;base64," + base64.b64encode(text.getvalue()).decode("ascii")
