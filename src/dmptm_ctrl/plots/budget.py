"""Pictures of an error budget, and of the torque on one log."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dmptm_ctrl.plots.style import STYLES, axes

Floats = NDArray[np.float64]

FITTED = {"color": "#9db4d0", "edgecolor": "#0b3c6f"}
BAR = 0.6  # height


@dataclass(frozen=True, eq=False)
class TorqueTrace:
    """Torque or force of the drive on one log, and what two models leave of it, (n,) arrays."""

    name: str
    time: Floats  # s
    drive: Floats
    before: Floats
    after: Floats
    unit: str


def plot_budget(labels: Sequence[str], shares: Sequence[float], *, ax: Any = None) -> Axes:
    """Draw an error budget as bars.

    Parameters
    ----------
    labels : sequence of str
    shares : sequence of float
        Of the mean square before [%].
    ax : Axes, optional
    """
    panel = axes(ax, 1, figsize=(7.0, 0.8 + 0.35 * len(labels)))[0, 0]
    place = np.arange(len(labels))
    panel.barh(place, shares, BAR, **FITTED)
    for x, y in zip(shares, place, strict=True):
        panel.annotate(
            f"{x:.3g}", (x, y), xytext=(3, 0), textcoords="offset points", va="center", fontsize=8
        )
    panel.set_yticks(place, labels)
    panel.invert_yaxis()
    panel.set_xlim(0, 1.15 * max([*shares, 1e-9]))
    panel.set_xlabel("share of the mean square before [%]")
    panel.spines[["top", "right"]].set_visible(False)
    return panel


def plot_torque(trace: TorqueTrace, *, ax: Any = None) -> np.ndarray:
    """Draw the driving torque of a log, and below it what the models leave.

    Parameters
    ----------
    trace : TorqueTrace
    ax : two Axes, optional
    """
    panels = axes(ax, 2, figsize=(8.6, 4.0), sharex=True)[:, 0]
    panels[0].plot(trace.time, trace.drive, label="drive", **STYLES["measured"])
    panels[0].plot(trace.time, trace.drive - trace.after, label="model", **STYLES["proposed"])
    panels[1].plot(trace.time, trace.before, label="left by the declared", **STYLES["existing"])
    panels[1].plot(trace.time, trace.after, label="left in the end", **STYLES["proposed"])
    panels[0].set_ylabel(f"drive [{trace.unit}]")
    panels[1].set_ylabel(f"residual [{trace.unit}]")
    panels[1].set_xlabel("time [s]")
    for panel in panels:
        panel.grid(True, linewidth=0.4, color="0.85")
        panel.legend(loc="upper right", fontsize=8, ncols=2)
        panel.margins(x=0.01)
    return panels
