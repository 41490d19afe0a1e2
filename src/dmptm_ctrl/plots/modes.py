"""Pictures of mode shapes."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from dmptm_ctrl.drive.modes import Modes
from dmptm_ctrl.plots.style import STYLES, axes

NAMES = {"m": "motor", "1": "wheel 1", "2": "wheel 2", "3": "pinion", "L": "ring gear"}
COLUMNS = 3
HAND = np.pi / 3  # turn of a wheel's hand at the largest amplitude; upright is at rest


def mode_plot(modes: Modes, *, ax: Any = None, Hz: bool = True) -> np.ndarray:
    """Draw each mode: left side, ring gear, right side, from outside to the middle.

    Above the amplitudes stands each body as a wheel, its hand turned as the mode turns it.
    Amplitudes are angles divided by those of the rigid turn, so that rigid motion is a horizontal
    line; the largest is 1.
    """
    train = modes.train
    order = _along(train.bodies)
    count = modes.omega.size
    rows = -(-count // COLUMNS)
    if ax is None:
        size = (3.2 * COLUMNS, 2.5 * rows)
        grid = axes(None, rows, COLUMNS, figsize=size, sharex=True, sharey=True).ravel()
        for spare in grid[count:]:
            spare.set_visible(False)
        ax = grid[:count]
    panels = axes(ax, count, figsize=(4, 3)).ravel()
    labels = [_label(train.bodies[i], "\n" if len(order) <= 3 else " ") for i in order]
    x = np.arange(len(order))
    each = zip(panels, modes.omega, modes.turns.T, modes.kinds, strict=True)
    for panel, omega, turn, kind in each:
        panel.axhline(0.0, color="0.7", linewidth=0.8)
        panel.vlines(x, 0.0, turn[order], color="0.6", linewidth=1.0)
        _wheels(panel, x, turn[order])
        panel.plot(x, turn[order], marker="o", markersize=4, **STYLES["proposed"])
        value = f"{omega / (2 * np.pi):.4g} Hz" if Hz else f"{omega:.4g} rad/s"
        panel.set_title(f"{kind}, {value}", fontsize=9)
        panel.set_xticks(x, labels, fontsize=7, rotation=90 if len(order) > 3 else 0)
        panel.set_ylim(-1.15, 2.0)
        panel.set_yticks((-1, 0, 1))
        panel.tick_params(labelbottom=True)
    for panel in panels[::COLUMNS]:
        panel.set_ylabel("angle over that of\nthe rigid turn", fontsize=8)
    return panels


def _wheels(panel: Axes, x: np.ndarray, turn: np.ndarray) -> None:
    height = np.full(x.size, 1.55)
    panel.plot(x, height, "o", markersize=13, markerfacecolor="white", markeredgecolor="0.5")
    angle = HAND * turn
    panel.quiver(
        x, height, np.sin(angle), np.cos(angle), angles="uv", scale_units="inches",
        scale=1.0 / 0.085, width=0.012, headwidth=1, headlength=0,
        headaxislength=0, color=STYLES["existing"]["color"], zorder=3,
    )  # fmt: skip


def _along(bodies: tuple[str, ...]) -> list[int]:
    """Indices of the bodies from the left motor over the ring gear to the right motor."""
    left, right = (
        [i for i, b in enumerate(bodies) if b[:-1] in NAMES and b[-1] == side] for side in "lr"
    )
    middle = [i for i in range(len(bodies)) if i not in left and i not in right]
    return left + middle + right[::-1]


def _label(body: str, between: str) -> str:
    if body[:-1] not in NAMES:
        return NAMES.get(body, body).replace(" ", between)
    return f"{'left' if body[-1] == 'l' else 'right'}{between}{NAMES[body[:-1]]}"
