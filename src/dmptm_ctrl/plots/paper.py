"""Pictures of the paper's experiments and of what its equations leave out."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from dmptm_ctrl.plots.style import STYLES, Floats, axes
from dmptm_ctrl.simulate.mesh_path import MeshPath

FLOOR = 1e-5  # N·m, where the axis of a difference begins
DECADES = (0.1, 1.0, 10.0, 100.0)  # deg/s, ticks of a friction curve


def experiment_plot(
    time: Floats,
    measured: Floats,
    speeds: Mapping[str, Floats],
    *,
    scores: Mapping[str, tuple[float, float, float]] | None = None,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Draw a measured ring-gear speed and what models say, all [rad/s], in deg/s.

    "proposed" and "existing" have their own lines. Scores (r, FIT [%], RMSE [rad/s]) go to the
    legend, which stands beside the plot.
    """
    panel = axes(ax, 1, figsize=(6.5, 3.0), grid="major")[0, 0]
    panel.plot(time, np.degrees(measured), label="measured", **STYLES["measured"])
    for name, speed in speeds.items():
        label = name
        if scores is not None:
            _, fit, rmse = scores[name]
            label = f"{name}\nFIT {fit:.1f} %\nRMSE {np.degrees(rmse):.2f} deg/s"
        panel.plot(time, np.degrees(speed), label=label, **STYLES.get(name, STYLES["other"]))
    panel.set(xlabel="time [s]", ylabel="speed [deg/s]", title=title)
    panel.set_xlim(time[0], time[-1])
    panel.legend(fontsize=7, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    return panel


def amplitude_styles(labels: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Return line properties for labels such as "proposed, 0.6 V", two amplitudes per model.

    One colour and mark per model; the second amplitude has full lines and filled marks.
    """
    styles = {}
    for i, label in enumerate(labels):
        model, second = label.split(",")[0], i % 2 == 1
        colour = STYLES[model]["color"]
        styles[label] = {
            "color": colour,
            "linestyle": "-" if second else "--",
            "linewidth": 1.2,
            "marker": "o" if model == "proposed" else "s",
            "markersize": 3.5,
            "markerfacecolor": colour if second else "white",
        }
    return styles


def mesh_path_plot(
    paths: Sequence[tuple[str, MeshPath]], half_gap: float, *, ax: Any = None
) -> np.ndarray:
    """Draw motions through a gap, one column each: angle, torque of both laws, difference."""
    panels = axes(ax, 3, len(paths), figsize=(4.6 * len(paths), 6.6), grid="major", sharex="col")
    for (title, path), (top, middle, bottom) in zip(paths, panels.T, strict=True):
        ms = 1e3 * path.time
        top.plot(ms, 1e3 * path.z, label="relative angle z", **STYLES["measured"])
        top.plot(ms, 1e3 * path.position, label="position in the gap θb", **STYLES["proposed"])
        low, high = path.z.min(), path.z.max()
        for flank in (-half_gap, half_gap):
            if low <= flank <= high:
                top.axhline(1e3 * flank, color="0.4", linewidth=0.8, linestyle=":")
        top.set(title=title, ylabel="angle [mrad]")
        top.margins(y=0.3)
        middle.plot(ms, path.two_state, label="two-state original", **STYLES["proposed"])
        middle.plot(ms, path.memoryless, label="Eq. 21, exponent put right", **STYLES["existing"])
        middle.set(ylabel="mesh torque [N·m]")
        middle.margins(y=0.3)
        gap = np.abs(path.memoryless - path.two_state)
        bottom.semilogy(ms, np.maximum(gap, FLOOR), **{**STYLES["other"], "linestyle": "-"})
        bottom.set(xlabel="time [ms]", ylabel="|difference| [N·m]", ylim=(FLOOR, 10.0))
        for panel in (top, middle):
            panel.legend(fontsize=7, loc="upper center", ncols=2)
    return panels


def friction_plot(
    speed: Floats,
    torque: Floats,
    se: Floats,
    curve: tuple[Floats, Floats],
    *,
    ax: Axes | None = None,
    title: str = "",
) -> Axes:
    """Draw measured friction (n,) [N·m], signed like its speed [rad/s], over a fitted curve.

    `torque` is a magnitude; `curve` is (speed, torque), signed.
    """
    panel = axes(ax, 1, figsize=(5.5, 3.6), grid="major")[0, 0]
    for side in (curve[0] < 0.0, curve[0] > 0.0):
        label = "Eq. 25 fitted" if side[-1] else None
        x, y = curve[0][side], curve[1][side]
        panel.plot(np.degrees(x), y, label=label, **STYLES["proposed"])
    look = {"fmt": "o", "color": "0.35", "markersize": 3.5, "capsize": 2}
    label = "constant-speed runs ± 2 se"
    panel.errorbar(np.degrees(speed), np.sign(speed) * torque, 2.0 * se, label=label, **look)
    panel.axhline(0.0, color="0.7", linewidth=0.8)
    panel.set(xlabel="speed [deg/s]", ylabel="friction torque [N·m]", title=title)
    slowest = float(np.degrees(np.abs(speed).min()))
    panel.set_xscale("symlog", linthresh=slowest, linscale=0.3)
    ticks = [x for x in DECADES if slowest <= x <= np.degrees(np.abs(speed).max())]
    ticks = [-x for x in reversed(ticks)] + [0.0, *ticks]
    panel.set_xticks(ticks, [f"{x:g}" for x in ticks])
    panel.minorticks_off()
    panel.legend(fontsize=8)
    return panel


def convergence_plot(
    softness: ArrayLike, errors: Mapping[str, ArrayLike], *, ax: Axes | None = None, title: str = ""
) -> Axes:
    """Draw relative errors over the relative compliance they come from, with slope 1 beside."""
    panel = axes(ax, 1, figsize=(5.5, 4.0), grid="major")[0, 0]
    x = np.asarray(softness, float)
    styles = (STYLES["proposed"], STYLES["other"], STYLES["existing"], STYLES["measured"])
    for (label, values), style in zip(errors.items(), styles, strict=False):
        panel.loglog(x, values, marker="o", markersize=4, label=label, **style)
    first = np.asarray(next(iter(errors.values())), float)
    panel.loglog(x, 0.4 * first[0] * x / x[0], color="0.5", linestyle=":", label="slope 1")
    panel.set(
        xlabel="compliance of the reducer, relative to the default",
        ylabel="relative error of the frequency",
        title=title,
    )
    panel.legend(fontsize=8)
    return panel


def sensitivity_plot(
    values: Mapping[str, ArrayLike], titles: Sequence[str], *, ax: Axes | None = None
) -> Axes:
    """Draw relative sensitivities of the titled frequencies as bars, one group per parameter."""
    panel = axes(ax, 1, figsize=(6.5, 3.4))[0, 0]
    tones = ["#0b3c6f", "#d9a0a8", "#3a8f5c", "0.75"]
    table = pd.DataFrame.from_dict(values, "index", columns=list(titles), dtype=float)
    table.plot.bar(ax=panel, width=0.8, rot=0, color=tones, edgecolor="0.2")
    panel.axhline(0.0, color="0.3", linewidth=0.8)
    panel.set(ylabel="relative change of the frequency\nper relative change", xlabel="parameter")
    panel.grid(alpha=0.3, axis="y")
    panel.legend(fontsize=8)
    return panel
