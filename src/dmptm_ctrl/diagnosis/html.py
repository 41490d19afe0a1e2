"""The report: one HTML file without scripts, network or paths, that any browser opens."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from dmptm_ctrl.diagnosis.quality import correlations
from dmptm_ctrl.plots.diagnosis import Evidence, Overlay, plot_budget, plot_evidence, plot_overlay
from dmptm_ctrl.plots.page import data_uri, environment, number, words
from dmptm_ctrl.plots.quality import Correlation, plot_correlation

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.report import Diagnosis, NamedEffect

VERDICTS = {
    "none": "as good as these logs show",
    "explained": "effects found",
    "unknown": "something is not explained",
}
BALANCED = "the balance shows no lack"  # runs are far above their floor all the same
READ_EVIDENCE = (
    "Points are means over bins, bars ± 2 standard errors; what stands still is left out. A curve "
    "that stands off zero by many bars without the effect, and lies on zero with it, speaks for "
    "the effect. Without it the rest is refitted, so the level of a curve may be shifted; its "
    "shape counts. The same sign in both directions of motion is a torque of place or drive; "
    "opposite signs are friction."
)
READ_NOTHING = (
    "Points are means over bins, bars ± 2 standard errors; what stands still is left out. Small "
    "offsets that differ by direction are friction inside its declared range; a wave that both "
    "directions share is not in the model."
)
READ_HYSTERESIS = (
    "Points are means over bins, bars ± 2 standard errors; what stands still is left out. Where "
    "rising and falling stand apart, the torque depends on where the variable came from, as "
    "behind a play or in a hysteresis."
)
READ_CORRELATION = (
    "What a true model leaves is noise: 99 of a hundred lags lie inside the grey band. A residual "
    "that correlates with itself lacks dynamics or an effect; one that follows the input (positive "
    "lags) lacks a path from the input. At negative lags only a closed loop's feedback shows."
)
CODE = """\
import numpy as np

import dmptm_ctrl as dm

model = dm.read_model("model.toml")  # beside this report
plant = model.to_blocks()  # ct.InterconnectedSystem, the effects included
linear = dm.linearize(model)  # ct.StateSpace

time = np.arange(0.0, 0.05, 1e-3)  # s
signals = np.full((plant.ninputs, time.size), 0.6)  # of the inputs, SI
response = dm.simulate(model, time, signals)  # ct.TimeResponseData
"""
NORMAL_95 = 1.96  # standard errors on either side that hold 95 %
SHOWN = 3  # effects, and values of each, that the action names
CORRELATED = 0.9  # from here on two parameters are hard to separate
MOST_LOGS = 6  # that are drawn


def _title(diagnosis: "Diagnosis") -> str:
    if diagnosis.verdict == "none" and not diagnosis.errors.within_floor:
        return BALANCED
    return VERDICTS[diagnosis.verdict]


def render(diagnosis: "Diagnosis") -> str:
    """Return the report of a diagnosis, a whole HTML document with its figures and style inside."""
    logs = diagnosis.overlays()
    tests = correlations(logs)
    return (
        environment("dmptm_ctrl.diagnosis")
        .get_template("report.html.j2")
        .render(
            d=diagnosis,
            tone=diagnosis.verdict,
            title=_title(diagnosis),
            action=action(diagnosis),
            units=diagnosis.units,
            logs=[
                {
                    "name": log.name,
                    "unit": log.unit,
                    "quantity": log.quantity,
                    "before": {"rmse": log.rmse("before"), "fit": log.fit_percent("before")},
                    "after": {"rmse": log.rmse("after"), "fit": log.fit_percent("after")},
                    "figure": overlay_figure(log) if k < MOST_LOGS else "",
                }
                for k, log in enumerate(logs)
            ],
            errors=error_rows(diagnosis.error),
            budget_figure=budget_figure(diagnosis),
            evidence=list(evidence(diagnosis)),
            pictures=list(diagnosis.source.pictures()),
            declared=declared_rows(diagnosis.declared_values),
            reveals={row["name"]: row["reveals"] for row in diagnosis.ranking},
            detectable=detectable,
            rivals={name for effect in diagnosis.effects for name in effect.confusable_with},
            quality=tests,
            quality_figure=quality_figure(tests),
            read_correlation=READ_CORRELATION,
            pairs=[p for p in diagnosis.correlations if abs(p[2]) >= CORRELATED],
            code=CODE,
        )
    )


def action(diagnosis: "Diagnosis") -> str:
    """Return what to do about the result, in one or two sentences."""
    unit, on = diagnosis.error["unit"], diagnosis.error["on"]
    before, after = (diagnosis.error[k]["rmse"] for k in ("before", "after"))
    if diagnosis.verdict == "none":
        return (
            f"Keep the declared model: refitted inside its declared ranges it leaves "
            f"{number(after)} {unit} on {on}."
        )
    fall = f"the error on {on} goes from {number(before)} to {number(after)} {unit}"
    material = [e for e in diagnosis.effects if e.material and e.named]
    rivals = [name for e in material for name in e.confusable_with]
    if diagnosis.verdict == "unknown":
        first = f"Look for the cause on the rig. With model.toml {fall}."
    else:
        where = "; ".join(f"{e.location} ({sizes(e.parameters)})" for e in material[:SHOWN])
        first = f"Look at: {where}. " if where else ""
        first += f"Use model.toml for control design: {fall}."
    if rivals:
        first += f" Before a repair, rule out {', '.join(map(words, dict.fromkeys(rivals)))}."
    return first


def sizes(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the first values of an effect, with their units; of a wave its amplitude."""
    texts = [
        f"{words(k)} {number(p['value'])} {p['unit']}".rstrip()
        for k, p in parameters.items()
        if not k.endswith("sine")  # a wave's cosine and sine
    ]
    return ", ".join(texts[:SHOWN]) + (", …" if len(texts) > SHOWN else "")


def detectable(row: Mapping[str, Any]) -> str:
    """Return the smallest amplitudes that the logs would have shown."""
    parts = [
        f"{words(name)} {number(p['value'], 2)} {p['unit']}".rstrip()
        for name, p in row["detectable"].items()
    ]
    return ", ".join(parts) or "–"


def error_rows(error: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the errors of each kind: name, unit, before, after, floor."""
    names = {"speed": "free run", "torque": "balance", "horizon": "short predictions"}
    rows = []
    for kind, name in names.items():
        if kind in error["after"]:
            entry = error["after"][kind]
            if "sensor" in entry:
                name += f" of {entry['sensor']}"
            if "seconds" in entry:
                name += f", {entry['seconds']:g} s"
            if "bandwidth_hz" in entry:
                name += f", below {entry['bandwidth_hz']:.3g} Hz"
            sides = {side: error[side][kind]["rmse"] for side in ("before", "after", "floor")}
            rows.append({"name": name, "unit": entry["unit"], **sides})
    return rows


def evidence(diagnosis: "Diagnosis") -> Iterable[dict[str, Any]]:
    """Each effect with the picture of its evidence; then that of what is not explained."""
    shown: list[NamedEffect | None] = list(diagnosis.effects)
    if not shown or (diagnosis.depends_on and all(e.named for e in diagnosis.effects)):
        shown.append(None)
    for effect in shown:
        found = diagnosis.source.evidence(effect, diagnosis.depends_on)
        read = READ_EVIDENCE if found and found.effect else READ_NOTHING
        yield {
            "effect": effect,
            "variable": found.variable if found else "",
            "figure": evidence_figure(found) if found else "",
            "read": READ_HYSTERESIS if found and "rising" in found.ways else read,
        }


def declared_rows(declared: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return fitted parameters beside their declared ranges, and their place in these."""
    rows = []
    for name, p in declared.items():
        half = NORMAL_95 * p["se"]
        interval, place = np.array([p["fitted"] - half, p["fitted"] + half]), None
        if p["range"]:
            low, high = p["range"]
            if not p["outside"]:
                interval = np.clip(interval, low, high)
            place = float(np.clip((p["fitted"] - low) / max(high - low, 1e-300), 0.0, 1.0))
        rows.append({**p, "name": name, "interval": interval, "place": place})
    return rows


def overlay_figure(overlay: Overlay) -> str:
    """Return the picture of one log as a data URI."""
    figure = Figure(figsize=(8.6, 4.0), layout="constrained")
    panels = figure.subplots(2, sharex=True, gridspec_kw={"height_ratios": [3, 2]})
    plot_overlay(overlay, ax=panels, title="")
    return data_uri(figure)


def budget_figure(diagnosis: "Diagnosis") -> str:
    """Return the picture of the error budget as a data URI."""
    figure = Figure(figsize=(8.6, 0.8 + 0.36 * len(diagnosis.budget)), layout="constrained")
    plot_budget(diagnosis, ax=figure.subplots())
    return data_uri(figure)


def evidence_figure(evidence: Evidence) -> str:
    """Return the picture of the evidence as a data URI."""
    figure = Figure(figsize=(8.6, 3.3), layout="constrained")
    plot_evidence(evidence, ax=figure.subplots(1, 2, sharex=True, sharey=True))
    return data_uri(figure)


def quality_figure(tests: Sequence[tuple[str, Correlation, Correlation]]) -> str:
    """Return the picture of the correlations as a data URI; empty where there are none."""
    if not tests:
        return ""
    figure = Figure(figsize=(8.6, 3.1), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    for panel, (title, before, after) in zip(panels, tests, strict=True):
        plot_correlation(before, after, ax=panel, title=title)
    panels[1].set_ylabel("")
    return data_uri(figure)
