"""Pictures of controllers: what tuning gained, what an effect costs."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dmptm_ctrl.plots.style import axes

_LINES = (
    {"color": "0.65", "linestyle": "-", "linewidth": 2.5},
    {"color": "0.55", "linestyle": "--", "linewidth": 1.6},
    {"color": "#3a8f5c", "linestyle": "-.", "linewidth": 1.4},
    {"color": "#d1495b", "linestyle": "--", "linewidth": 1.4},
    {"color": "#0b3c6f", "linestyle": "-", "linewidth": 1.8},
)


def plot_tuning(tuned: Any, *, ax: Axes | None = None) -> Axes:
    """Draw the share of drawn plants below each tracking error, a line per stage.

    Parameters
    ----------
    tuned : Tuned
        Of :func:`~dmptm_ctrl.design.tune.tune_controller`.
    ax : Axes, optional
    """
    panel = axes(ax, 1, figsize=(7.0, 4.2))[0, 0]
    for row, style in zip(tuned.stages, _LINES, strict=False):
        errors = np.sort(row["errors"])
        share = 100.0 * (np.arange(errors.size) + 1.0) / errors.size
        panel.step(errors, share, where="post", label=row["stage"], **style)
    panel.set(
        xscale="log",
        ylim=(0.0, 101.0),
        xlabel="rms tracking error [deg/s]",
        ylabel=f"share of {errors.size} drawn plants below [%]",
    )
    panel.grid(alpha=0.3, which="both")
    panel.legend(loc="lower right", fontsize=9)
    return panel
