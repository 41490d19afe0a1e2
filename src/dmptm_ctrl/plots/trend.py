"""How the entries of a model drift from date to date."""

from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dmptm_ctrl.plots.style import SEQUENCE, axes

SHOWN = 6  # entries: those that move most, in their standard errors
MARKERS = "osD^v<"


def plot_trend(
    dates: Sequence[datetime],
    series: Mapping[str, Sequence[tuple[float, float]]],
    *,
    ax: Any = None,
) -> Axes:
    """Draw entries of a model over dates, one (change, standard error) [%] per date."""
    (panel,) = axes(ax, 1, figsize=(8.0, 4.5)).ravel()

    def clearness(name: str) -> float:
        return max(abs(change) / se for change, se in series[name])

    shown = sorted(series, key=clearness, reverse=True)[:SHOWN]
    for k, name in enumerate(shown):
        change, se = np.transpose(series[name])
        style = SEQUENCE[k % len(SEQUENCE)]
        panel.errorbar(
            list(dates), change, se, label=name, marker=MARKERS[k % len(MARKERS)], capsize=3,
            color=style["color"], linestyle=style["linestyle"], linewidth=1.2,
        )  # fmt: skip
    panel.axhline(0.0, color="0.3", linewidth=0.8)
    panel.set_ylabel("change against the model [%]")
    panel.tick_params(axis="x", rotation=20)
    if shown:
        panel.legend(fontsize="small", loc="center left", bbox_to_anchor=(1.0, 0.5))
    return panel
