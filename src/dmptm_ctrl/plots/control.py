"""Pictures of controllers: what tuning gained, what an effect costs."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import ArrayLike

from dmptm_ctrl.plots.page import words
from dmptm_ctrl.plots.style import STYLES, axes

_LINES = (
    STYLES["measured"],
    {"color": "0.55", "linestyle": "--", "linewidth": 1.6},
    {"color": "#c77f1a", "linestyle": ":", "linewidth": 1.8},
    STYLES["other"],
    STYLES["existing"],
    {**STYLES["proposed"], "linewidth": 1.8},
)
_MARKERS = ("o", "s", "^", "v", "D", "x")
_PAIR = (STYLES["proposed"], STYLES["existing"])


def plot_tuning(tuned: Any, *, ax: Axes | None = None) -> Axes:
    """Draw the share of drawn plants below each tracking error, a line per stage."""
    panel = axes(ax, 1, figsize=(7.0, 4.2), grid="both")[0, 0]
    for row, style in zip(tuned.stages, _LINES, strict=False):
        errors = np.sort(row["errors"])
        share = 100.0 * (np.arange(errors.size) + 1.0) / errors.size
        panel.step(errors, share, where="post", label=row["stage"], **style)
    panel.set(
        xscale="log",
        ylim=(0.0, 101.0),
        xlabel=f"rms tracking error [{tuned.unit}]",
        ylabel=f"share of {errors.size} drawn plants below [%]",
    )
    low, high = panel.get_xlim()
    few, many = (1.0, 2.0, 5.0), (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    panel.xaxis.set_major_locator(LogLocator(subs=few if high > 10.0 * low else many))
    panel.xaxis.set_major_formatter("{x:g}")
    panel.xaxis.set_minor_formatter(NullFormatter())
    panel.legend(loc="best", fontsize=9)
    return panel


def plot_impact(found: Any, *, ax: Any = None) -> np.ndarray:
    """Draw speeds along the duty, tracking errors, and closed-loop gains of both drives."""
    panels = axes(ax, 3, figsize=(8.0, 8.5), grid="both").ravel()
    unit, factor = found.unit
    time, ref = found.duty.time, found.duty.reference / factor
    panels[0].plot(time, ref, color="0.65", linewidth=2.5, label="setpoint")
    speeds = {name: speed / factor for name, speed in found.speeds.items()}
    for (name, speed), style in zip(speeds.items(), _PAIR, strict=True):
        panels[0].plot(time, speed, label=name, **style)
        panels[1].plot(time, speed - ref, label=name, **style)
    settled = time >= found.duty.settling
    worst = max(np.abs((v - ref)[settled]).max() for v in speeds.values())
    panels[1].set(ylim=(-1.15 * worst, 1.15 * worst))
    for (name, rows), style in zip(found.gains.items(), _PAIR, strict=True):
        fills = {"small": "white", "large": style["color"]}
        for row, (size, fill) in zip(rows, fills.items(), strict=True):
            decibels = 20.0 * np.log10(np.where(row > 0.0, row, np.nan))  # what rests has no gain
            look = {**style, "marker": "o", "markersize": 4, "markerfacecolor": fill}
            panels[2].semilogx(found.sweep_hz, decibels, label=f"{name}, {size}", **look)
    panels[2].axhline(-3.01, color="0.4", linewidth=0.8, linestyle=":")
    panels[0].set(ylabel=f"speed [{unit}]")
    panels[0].set_title(", ".join(map(words, found.effects)), loc="left")
    panels[1].set(ylabel=f"speed − setpoint [{unit}]", xlabel="time [s]")
    panels[2].set(ylabel="closed-loop gain [dB]", xlabel="frequency [Hz]")
    above = {"loc": "lower right", "bbox_to_anchor": (1.0, 1.0), "frameon": False}
    for panel in panels:  # the curves fill them
        panel.legend(fontsize=8, ncols=4, borderaxespad=0.2, **above)
    return panels


def plot_preload(
    accelerations: ArrayLike, balance: ArrayLike, simulated: ArrayLike, *, ax: Axes | None = None
) -> Axes:
    """Draw the least preload [V] of `boundary` over the peak acceleration [rad/s²]."""
    panel = axes(ax, 1, figsize=(6.4, 4.0), grid="major")[0, 0]
    peak = np.asarray(accelerations, float)
    panel.plot(peak, simulated, marker="o", label="simulated loop", **_PAIR[0])
    panel.plot(peak, balance, marker="s", label="balance of torques", **_PAIR[1])
    panel.fill_between(peak, simulated, 0.0, color="0.9")
    panel.annotate("a mesh opens", (0.6, 0.15), xycoords="axes fraction", color="0.3")
    panel.set(
        xlabel="peak acceleration of the setpoint [rad/s²]",
        ylabel="preload ±u_b [V]",
        ylim=(0.0, None),
    )
    panel.legend(loc="upper left")
    return panel


def plot_schedules(preloads: ArrayLike, found: Any, *, ax: Any = None) -> np.ndarray:
    """Draw error at reversals and torque over the preload (n,) [V], a line per schedule."""
    panels = axes(ax, 2, figsize=(6.8, 6.2), grid="both").ravel()
    volts = np.asarray(preloads, float)
    for i, (name, rows) in enumerate(found.items()):
        style = _LINES[::-1][i % len(_LINES)]
        options = {**style, "marker": _MARKERS[i % len(_MARKERS)], "label": name}
        panels[0].plot(volts, [row.reversal_error for row in rows], **options)
        panels[1].plot(volts, [row.torque for row in rows], **options)
    panels[0].set(ylabel="rms error at reversals [deg/s]", yscale="log")
    panels[1].set(ylabel="rms torque of a motor [N·m]", xlabel="preload at rest ±u_b [V]")
    panels[1].legend(fontsize=9, ncols=2)
    return panels


def plot_gains(hz: ArrayLike, gains: Mapping[str, ArrayLike], *, ax: Axes | None = None) -> Axes:
    """Draw closed-loop gains (n,) of named variants of a drive, a line each."""
    panel = axes(ax, 1, figsize=(6.4, 4.0), grid="both")[0, 0]
    for (name, gain), style in zip(gains.items(), _LINES, strict=False):
        panel.plot(hz, gain, label=name, **style)
    panel.set(xscale="log", xlabel="frequency [Hz]", ylabel="closed-loop gain, speed / setpoint")
    for axis in (panel.xaxis.set_major_formatter, panel.xaxis.set_minor_formatter):
        axis("{x:g}")  # within a decade powers of ten say nothing
    panel.legend()
    return panel
