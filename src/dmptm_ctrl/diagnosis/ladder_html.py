"""The report on a drive of any shape: one HTML file without scripts, network or paths."""

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure

from dmptm_ctrl.diagnosis.html import VERDICTS
from dmptm_ctrl.identify.chain_fit import State, residuals
from dmptm_ctrl.plots.ladder import TorqueTrace, plot_rungs, plot_torque
from dmptm_ctrl.plots.page import data_uri, environment, words

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis.ladder_report import ChainDiagnosis

MOST_LOGS = 6  # that are drawn
SHOWN = 3000  # points of a curve; more are not seen


def plot_ladder(diagnosis: "ChainDiagnosis", *, ax: Any = None) -> Any:
    """Draw the error after each rung of a diagnosis, fitted and held out."""
    rungs = diagnosis.ladder.rungs
    if rungs:
        first = rungs[0]
        fitted = [first.fit_before.percent, *(r.fit_after.percent for r in rungs)]
        held = [first.held_before.percent, *(r.held_after.percent for r in rungs)]
    else:
        fitted = held = [float(diagnosis.error["before"]["relative_percent"])]
    labels = ["as declared", *(f"+ {words(r.key.partition('@')[0])}" for r in rungs)]
    return plot_rungs(labels, fitted, held, ax=ax)


def torque_traces(diagnosis: "ChainDiagnosis") -> list[TorqueTrace]:
    """Return drive and residuals of held-out logs, before and after."""
    ladder = diagnosis.ladder
    held = ladder.held_logs
    after, drive = residuals(ladder.held_state, held)
    before, _ = residuals(State(ladder.base.model, ladder.held_state.logs), held)
    traces = []
    for k, motion in enumerate(held.motions[:MOST_LOGS]):
        thin = slice(None, None, max(motion.rows.size // SHOWN, 1))
        rest = ~motion.moving
        one, two, three = (
            np.where(rest, np.nan, p)[thin] for p in (drive[k], before[k][0], after[k][0])
        )
        unit = str(diagnosis.error["unit"])
        traces.append(TorqueTrace(motion.name, motion.rows[thin], one, two, three, unit))
    return traces


def render_html(diagnosis: "ChainDiagnosis") -> str:
    """Return the report of a diagnosis as a whole HTML document."""
    content = diagnosis.to_dict()
    figure = Figure(figsize=(7.6, 0.9 + 0.5 * (1 + len(content["ladder"]))), layout="constrained")
    plot_ladder(diagnosis, ax=figure.subplots())
    return (
        environment("dmptm_ctrl.diagnosis")
        .get_template("ladder.html.j2")
        .render(
            d=content,
            tone=diagnosis.verdict,
            title=VERDICTS[diagnosis.verdict],
            sentence=diagnosis.sentence(),
            ladder_figure=data_uri(figure),
            traces=[(t.name, _trace_figure(t)) for t in torque_traces(diagnosis)],
            rig=diagnosis.rig.name,
            rig_text=diagnosis.rig.text,
        )
    )


def _trace_figure(trace: TorqueTrace) -> str:
    figure = Figure(figsize=(8.6, 4.0), layout="constrained")
    plot_torque(trace, ax=figure.subplots(2, 1, sharex=True))
    return data_uri(figure)
