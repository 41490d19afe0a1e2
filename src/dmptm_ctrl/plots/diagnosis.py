"""Pictures of a diagnosis: measured, before and after; and what speaks for the effect."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dmptm_ctrl.plots.page import words
from dmptm_ctrl.plots.style import STYLES, Floats, axes

MEASURED = {**STYLES["measured"], "linewidth": 3.5}  # shows beside what covers it
BEFORE = {**STYLES["existing"], "linewidth": 1.0}
AFTER = {**STYLES["proposed"], "linewidth": 1.0}
AHEAD = {**STYLES["other"], "linewidth": 0.6, "zorder": 1.0}  # it has the ringing: behind
LEGEND: dict[str, Any] = {
    "fontsize": 7.5, "handlelength": 1.8, "columnspacing": 1.2, "frameon": False,
}  # fmt: skip
DIRECTIONS: dict[str, dict[str, Any]] = {  # filled against hollow: distinct in grey
    "forward": {"color": "#0b3c6f", "linestyle": "-", "marker": "o", "markersize": 3.5},
    "backward": {
        "color": "#c0641a", "linestyle": "--", "marker": "s", "markersize": 4,
        "markerfacecolor": "white",
    },
}  # fmt: skip
BUDGET: dict[str, dict[str, Any]] = {
    "": {"color": "#0b3c6f"},
    "shared": {"color": "#8fb0d3", "hatch": "///"},
    "not explained": {"color": "#c0641a", "hatch": "xx"},
    "floor": {"color": "0.8"},
}


@dataclass(frozen=True, eq=False)
class Overlay:
    """A reading on one log and free runs of two models, (n,) arrays, all of one bandwidth."""

    name: str
    time: Floats  # s
    measured: Floats
    before: Floats
    after: Floats
    held: NDArray[np.bool_]  # samples that nothing was fitted to: they count
    push: Floats  # signal of the inputs together
    quantity: str = "speed"
    unit: str = "deg/s"
    ahead: Floats | None = None  # short predictions of the model after; NaN: none

    def rmse(self, which: str) -> float:
        """Root-mean-square error of "before" or "after" where nothing was fitted."""
        return float(np.sqrt(np.mean((self.measured - getattr(self, which))[self.held] ** 2)))

    def fit_percent(self, which: str) -> float:
        """100 (1 − NRMSE) of "before" or "after"; 0 where the reading is constant."""
        spread = float(np.std(self.measured[self.held]))
        return 100.0 * (1.0 - self.rmse(which) / spread) if spread > 0.0 else 0.0

    def stretches(self) -> list[slice]:
        """Parts of the log that nothing was fitted to."""
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.held.astype(np.int8), [0]])))
        return [slice(*pair) for pair in edges.reshape(-1, 2)]


@dataclass(frozen=True, eq=False)
class Curve:
    """Binned residual, (bins,) arrays: centre of the bin, mean, standard error of the mean."""

    x: Floats
    mean: Floats
    se: Floats


@dataclass(frozen=True, eq=False)
class Evidence:
    """A residual against the variable that explains it; curves "forward" and "backward"."""

    variable: str  # label with unit
    quantity: str  # label with unit
    before: Mapping[str, Curve]  # without
    after: Mapping[str, Curve]  # with it
    effect: str = ""  # the one in question; empty where there is none
    ways: tuple[str, str] = ("forward", "backward")  # what the two curves are called


def plot_overlay(overlay: Overlay, *, ax: Any = None, title: str | None = None) -> np.ndarray:
    """Draw one log: measured, before and after; below it what is left where nothing was fitted."""
    panels = axes(
        ax, 2, figsize=(7.0, 3.9), grid="major", sharex=True, gridspec_kw={"height_ratios": [3, 2]}
    ).ravel()
    reading, left = panels
    t = overlay.time
    reading.plot(t, overlay.measured, label="measured", **MEASURED)
    left.axhline(0.0, color="0.65", linewidth=0.8)
    for which, style in (("before", BEFORE), ("after", AFTER)):
        values = getattr(overlay, which)
        label = f"{which}: RMSE {overlay.rmse(which):.3g} {overlay.unit}, "
        label += f"FIT {overlay.fit_percent(which):.1f} %"
        reading.plot(t, values, label=label, **style)
        left.plot(t, np.where(overlay.held, overlay.measured - values, np.nan), **style)
    shown = list(reading.get_lines())
    if overlay.ahead is not None:
        label = "after, short predictions"
        shown += left.plot(t, overlay.measured - overlay.ahead, label=label, **AHEAD)
    title = overlay.name if title is None else title
    reading.set_title(title, fontsize=10, pad=32.0 if title else None)
    reading.set_ylabel(f"{overlay.quantity} [{overlay.unit}]")
    # Above the axes, where it cannot cover a line.
    reading.legend(handles=shown, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, **LEGEND)
    ylabel = f"measured −\nmodel [{overlay.unit}]"
    left.set(xlabel="time [s]", ylabel=ylabel, xlim=(t[0], t[-1]))
    return panels


def plot_diagnosis(diagnosis: Any, *, ax: Any = None) -> np.ndarray:
    """Draw every held-out log of a diagnosis, or Overlays; what is left below."""
    overlays: Sequence[Overlay]
    overlays = diagnosis.overlays() if hasattr(diagnosis, "overlays") else tuple(diagnosis)
    count = len(overlays)
    size, ratios = (6.2 * count, 4.0), {"height_ratios": [3, 2]}
    panels = axes(ax, 2, count, figsize=size, sharex="col", gridspec_kw=ratios)
    for i, overlay in enumerate(overlays):
        plot_overlay(overlay, ax=panels[:, i])
    return panels


def plot_budget(diagnosis: Any, *, ax: Any = None) -> Axes:
    """Draw the error budget: a bar per effect, then what is not explained, and the floor."""
    rows: Any = list(getattr(diagnosis, "budget", diagnosis))
    panel: Axes = axes(ax, 1, figsize=(7.0, 0.7 + 0.34 * len(rows)))[0, 0]
    for i, row in enumerate(rows):
        share, style = 100.0 * row.share, BUDGET.get(row.name, BUDGET[""])
        panel.barh(i, share, height=0.65, edgecolor="0.2", linewidth=0.6, **style)
        panel.text(share + 1.0, i, f"{share:.1f} %", va="center", fontsize=9)
    labels = [f"{r.name} @ {r.location}".rstrip(" @").replace("_", " ") for r in rows]
    panel.set_yticks(range(len(rows)), labels, fontsize=9)
    panel.invert_yaxis()
    most = max((100.0 * r.share for r in rows), default=100.0)
    panel.set(xlim=(0.0, 1.15 * max(most, 1.0)), xlabel="share of the mean square error [%]")
    panel.grid(axis="x", alpha=0.3)
    panel.set_axisbelow(True)
    return panel


def plot_evidence(diagnosis: Any, *, ax: Any = None) -> np.ndarray:
    """Draw the residual without and with an effect against the variable that explains it.

    Points are means over bins, by direction of motion; bars are ± 2 standard errors.
    """
    evidence: Evidence
    evidence = diagnosis if isinstance(diagnosis, Evidence) else diagnosis.evidence()
    panels = axes(ax, 1, 2, figsize=(7.4, 3.2), grid="major", sharex=True, sharey=True).ravel()
    what = words(evidence.effect) or "the effects"
    titles = (f"without {what}", "with all that was found")
    for panel, title, curves in zip(panels, titles, (evidence.before, evidence.after), strict=True):
        panel.axhline(0.0, color="0.65", linewidth=0.8)
        names = dict(zip(DIRECTIONS, evidence.ways, strict=True))
        for direction, curve in curves.items():
            x, mean, se = with_breaks(curve)
            look = {"linewidth": 1.0, "elinewidth": 0.8, "capsize": 1.5, **DIRECTIONS[direction]}
            panel.errorbar(x, mean, 2.0 * se, label=names[direction], **look)
        panel.set_title(title, fontsize=10)
        panel.set_xlabel(evidence.variable)
    panels[0].set_ylabel(evidence.quantity)
    if evidence.before or evidence.after:
        side = panels[0 if evidence.before else 1]
        panels[1].legend(
            *side.get_legend_handles_labels(), loc="upper left", bbox_to_anchor=(1.0, 1.0), **LEGEND
        )
    return panels


def with_breaks(curve: Curve) -> tuple[Floats, Floats, Floats]:
    """Points of a curve with NaN where bins between two of them are empty: no line is drawn."""
    steps = np.diff(curve.x)
    if steps.size == 0:
        return curve.x, curve.mean, curve.se
    empty = np.flatnonzero(steps > 1.5 * steps.min()) + 1
    x, mean, se = (np.insert(part, empty, np.nan) for part in (curve.x, curve.mean, curve.se))
    return x, mean, se
