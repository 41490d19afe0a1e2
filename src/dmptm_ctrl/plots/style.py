"""Colours and lines that stay apart in grey, and axes where none are given."""

from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

Floats = NDArray[np.float64]

# colour, line style, width: dark against light, so that a grey print separates them
STYLES: dict[str, dict[str, Any]] = {
    "measured": {"color": "0.65", "linestyle": "-", "linewidth": 2.5},
    "proposed": {"color": "#0b3c6f", "linestyle": "-", "linewidth": 1.2},
    "existing": {"color": "#d1495b", "linestyle": "--", "linewidth": 1.2},
    "other": {"color": "#3a8f5c", "linestyle": "-.", "linewidth": 1.2},
}
SEQUENCE = (STYLES["proposed"], STYLES["existing"], STYLES["other"], STYLES["measured"])


def axes(
    ax: Any,
    rows: int,
    columns: int = 1,
    *,
    figsize: tuple[float, float],
    grid: str = "",
    **options: Any,
) -> np.ndarray:
    """Return an array (rows, columns) of axes: those given, which must be as many, or new ones.

    `grid` is "major" or "both" for lines in the background.
    """
    if ax is None:
        figure = plt.figure(figsize=figsize, layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False, **options)
    else:
        panels = np.array([ax] if isinstance(ax, Axes) else ax, dtype=object)
        if not all(isinstance(panel, Axes) for panel in panels.ravel()):
            raise TypeError("ax must be matplotlib's Axes, or an array of them")
        if panels.size != rows * columns:
            raise ValueError(f"{panels.size} axes given, {rows * columns} are needed")
        panels = panels.reshape(rows, columns)
    for panel in panels.ravel() if grid else ():
        panel.grid(alpha=0.3, which=grid)
    return panels
