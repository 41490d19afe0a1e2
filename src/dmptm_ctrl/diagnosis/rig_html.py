"""The report on a drive of any shape: one HTML file without scripts, network or paths."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from dmptm_ctrl.diagnosis.html import VERDICTS
from dmptm_ctrl.plots.budget import TorqueTrace, plot_budget, plot_torque
from dmptm_ctrl.plots.page import data_uri, environment, words

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.rig_report import RigDiagnosis

MOST_LOGS = 6  # that are drawn
SHOWN = 3000  # points of a curve; more are not seen


def plot_budget_of(diagnosis: "RigDiagnosis", *, ax: Any = None) -> Any:
    """Draw the error budget of a diagnosis."""
    labels = [
        words(row["name"]) + (f" @ {row['location']}" if row["location"] else "")
        for row in diagnosis.budget
    ]
    return plot_budget(labels, [100 * row["share"] for row in diagnosis.budget], ax=ax)


def torque_traces(diagnosis: "RigDiagnosis") -> list[TorqueTrace]:
    """Return drive and residuals of held-out logs, before and after."""
    base, final = diagnosis.selection.base, diagnosis.selection.final
    after, drive = final.held_left
    before, _ = base.held_left
    traces = []
    for k, motion in enumerate(final.held.motions[:MOST_LOGS]):
        thin = slice(None, None, max(motion.rows.size // SHOWN, 1))
        rest = ~motion.moving
        one, two, three = (
            np.where(rest, np.nan, p)[thin] for p in (drive[k], before[k][0], after[k][0])
        )
        unit = str(diagnosis.error["unit"])
        traces.append(TorqueTrace(motion.name, motion.rows[thin], one, two, three, unit))
    return traces


def render_html(diagnosis: "RigDiagnosis") -> str:
    """Return the report of a diagnosis as a whole HTML document."""
    content = diagnosis.to_dict()
    figure = Figure(figsize=(7.6, 0.9 + 0.35 * len(content["budget"])), layout="constrained")
    plot_budget_of(diagnosis, ax=figure.subplots())
    return (
        environment("dmptm_ctrl.diagnosis")
        .get_template("rig.html.j2")
        .render(
            d=content,
            tone=diagnosis.verdict,
            title=VERDICTS[diagnosis.verdict],
            sentence=diagnosis.sentence(),
            budget_figure=data_uri(figure),
            traces=[(t.name, _trace_figure(t)) for t in torque_traces(diagnosis)],
            rig=diagnosis.rig.name,
            rig_text=diagnosis.rig.text,
        )
    )


def _trace_figure(trace: TorqueTrace) -> str:
    figure = Figure(figsize=(8.6, 4.0), layout="constrained")
    plot_torque(trace, ax=figure.subplots(2, 1, sharex=True))
    return data_uri(figure)
