"""The report: one HTML file without scripts, network or paths, that any browser opens."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from dmptm_ctrl.diagnosis.code import rebuilding_code
from dmptm_ctrl.diagnosis.figures import folded, overlays
from dmptm_ctrl.diagnosis.quality import correlations, orders
from dmptm_ctrl.diagnosis.summary import correlated
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.plots.diagnosis import (
    Evidence,
    Overlay,
    plot_budget,
    plot_evidence,
    plot_overlay,
)
from dmptm_ctrl.plots.gaps import animated_uri, busiest, gap_motion
from dmptm_ctrl.plots.page import data_uri, environment, number, words
from dmptm_ctrl.plots.quality import Correlation, Orders, plot_correlation, plot_orders

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.report import Diagnosis

VERDICTS = {
    "none": "as good as these logs show",
    "explained": "effects found",
    "unknown": "something is not explained",
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
READ_ORDERS = (
    "A line at order 1 repeats with every turn of a motor (cogging, an eccentric motor encoder), "
    "one below with the pinion or the ring gear, one at the tooth mesh with each tooth. Lines that "
    "stand before and are gone after are explained; lines that stay are not."
)
READ_CORRELATION = (
    "What a true model leaves is noise: 99 of a hundred lags lie inside the grey band. A residual "
    "that correlates with itself lacks dynamics or an effect; one that follows the input (positive "
    "lags) lacks a path from the voltage. At negative lags only a closed loop's feedback shows."
)
NORMAL_95 = 1.96  # standard errors on either side that hold 95 %
TOLD = 3  # values of an effect that the verdict's sentence tells
CORRELATED = 0.9  # from here on two parameters are told apart badly


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
    logs = overlays(diagnosis)
    evidence = folded(diagnosis)
    tests = {which: correlations(diagnosis, which) for which in ("before", "after")}
    along = orders(diagnosis)
    return (
        environment("dmptm_ctrl.diagnosis")
        .get_template("report.html.j2")
        .render(
            d=diagnosis,
            tone=diagnosis.verdict,
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
            budget_figure=budget_figure(diagnosis),
            evidence=evidence,
            evidence_figure=evidence_figure(evidence),
            read=READ_EVIDENCE if evidence.effect else READ_NOTHING,
            declared=declared_rows(diagnosis),
            at_bounds=diagnosis.fitted.at_bounds,
            catalogue=CATALOGUE,
            detectable=detectable,
            rivals={name for effect in diagnosis.effects for name in effect.confusable_with},
            quality=quality_rows(diagnosis, tests),
            quality_figure=quality_figure(tests),
            read_correlation=READ_CORRELATION,
            orders=along,
            orders_figure=orders_figure(along),
            read_orders=READ_ORDERS,
            gaps_figure=gaps_figure(diagnosis),
            pairs=correlated(diagnosis.fitted, CORRELATED),
            code=rebuilding_code(diagnosis.augmented),
        )
    )


def action(diagnosis: "Diagnosis") -> str:
    """Return what to do about the result, in one or two sentences."""
    before, after = diagnosis.error["before"]["rmse"], diagnosis.error["after"]["rmse"]
    if diagnosis.verdict == "none":
        return (
            f"Keep the declared model: refitted inside its declared ranges it leaves "
            f"{number(after)} deg/s on logs that it was not fitted to."
        )
    fall = f"the error on logs that it was not fitted to goes from {number(before)} to "
    fall += f"{number(after)} deg/s"
    material = [e for e in diagnosis.effects if e.material]
    rivals = [name for e in material for name in e.confusable_with]
    if diagnosis.verdict == "unknown":
        first = f"Use model.toml for prediction ({fall}), but look for the cause on the rig."
    else:
        where = "; ".join(f"{e.location} ({sizes(e.parameters)})" for e in material[:TOLD])
        first = f"Look at: {where}. Use model.toml for control design: {fall}."
    if rivals:
        first += f" Before a repair, rule out {', '.join(map(words, dict.fromkeys(rivals)))}."
    return first


def sizes(parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the first values of an effect, with their units."""
    told = [f"{words(k)} {number(p['value'])} {p['unit']}".rstrip() for k, p in parameters.items()]
    return ", ".join(told[:TOLD]) + (", …" if len(told) > TOLD else "")


def detectable(row: dict[str, Any]) -> str:
    """Return the smallest amplitudes that the logs would have shown."""
    parts = []
    sizes = {p.name: max(abs(p.low), abs(p.high)) for p in CATALOGUE[row["name"]].parameters}
    for name, p in row.get("detectable", {}).items():
        if p["value"] < sizes[name]:  # beyond it: not with these logs
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
                    "interval": np.clip(
                        (value - NORMAL_95 * se, value + NORMAL_95 * se), low, high
                    ),
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


def budget_figure(diagnosis: "Diagnosis") -> str:
    """Return the picture of the error budget as a data URI."""
    figure = Figure(figsize=(8.6, 0.8 + 0.36 * len(diagnosis.budget)), layout="constrained")
    plot_budget(diagnosis, ax=figure.subplots())
    return data_uri(figure)


def evidence_figure(evidence: Evidence) -> str:
    """Return the picture of the evidence as a data URI."""
    figure = Figure(figsize=(8.6, 3.5), layout="constrained")
    plot_evidence(evidence, ax=figure.subplots(1, 2, sharex=True, sharey=True))
    return data_uri(figure)


def gaps_figure(diagnosis: "Diagnosis") -> str:
    """Return the moving picture of the gaps in the first held-out log as a data URI."""
    log = diagnosis.measured.held_logs[0]
    return animated_uri(busiest(gap_motion(log, diagnosis.augmented)))


def quality_figure(tests: Mapping[str, tuple[Correlation, Correlation]]) -> str:
    """Return the picture of the correlations as a data URI."""
    figure = Figure(figsize=(8.6, 3.1), layout="constrained")
    panels = figure.subplots(1, 2, sharey=True)
    titles = ("residual with itself", "residual with the input, mean voltage")
    for k, (panel, title) in enumerate(zip(panels, titles, strict=True)):
        plot_correlation(tests["before"][k], tests["after"][k], ax=panel, title=title)
    panels[1].set_ylabel("")
    return data_uri(figure)


def orders_figure(along: Orders) -> str:
    """Return the picture of the orders as a data URI."""
    figure = Figure(figsize=(8.6, 2.9), layout="constrained")
    plot_orders(along, ax=figure.subplots())
    return data_uri(figure)


def quality_rows(
    diagnosis: "Diagnosis", tests: Mapping[str, tuple[Correlation, Correlation]]
) -> list[dict[str, Any]]:
    """Return tests of the fit on held-out logs: name, before, after, what is good."""
    error = diagnosis.error
    rows = [
        ("RMSE [deg/s]", "rmse", "0"),
        ("FIT = 100 (1 − NRMSE) [%]", "fit_percent", "100"),
        ("correlation of model and measurement [1]", "pearson_r", "1"),
    ]
    made: list[dict[str, Any]] = [
        {"name": name, "before": error["before"][key], "after": error["after"][key], "good": good}
        for name, key, good in rows
    ]
    for k, what in enumerate(("residual with itself", "residual with the input")):
        made.append(
            {
                "name": f"{what}: lags outside the 99 % band [%]",
                "before": tests["before"][k].outside_percent,
                "after": tests["after"][k].outside_percent,
                "good": "about 1",
            }
        )
    return made
