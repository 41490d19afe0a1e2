"""Pictures of what a model leaves: correlations with bands, orders per turn."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import LogLocator

from dmptm_ctrl.plots.style import STYLES, Floats, axes

ROOM = 0.45  # above a correlation of 1, for the legend
DECADES = 3.5  # of amplitude that are drawn
KINDS = {"measured": "measured", "before": "existing", "after": "proposed"}  # of line


@dataclass(frozen=True, eq=False)
class Correlation:
    """Correlation over lags, (n,) arrays: lag [s], value, half-width of the 99 % band."""

    lag: Floats
    value: Floats
    band: Floats

    @property
    def outside_percent(self) -> float:
        """Share of lags outside the band [%]; about 1 for noise."""
        return 100.0 * float(np.mean(np.abs(self.value) > self.band))

    @property
    def largest(self) -> float:
        """Largest correlation over its band; up to about 1 for noise."""
        return float(np.max(np.abs(self.value) / self.band))


@dataclass(frozen=True, eq=False)
class Orders:
    """Amplitudes per order of the motor's turn, (k,) arrays, and named orders."""

    order: Floats
    before: Floats
    after: Floats
    quantity: str
    marks: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Gains over frequency: (Hz, gain) of each curve, the quantity, and marked frequencies [Hz]."""

    curves: Mapping[str, tuple[Floats, Floats]]
    quantity: str
    marks: Mapping[str, float]


def plot_correlation(
    before: Correlation, after: Correlation, *, ax: Any = None, title: str = ""
) -> Any:
    """Draw a correlation before and after over its 99 % band."""
    panel = axes(ax, 1, figsize=(4.6, 3.0), grid="major")[0, 0]
    panel.fill_between(after.lag, -after.band, after.band, color="0.85", label="99 % band")
    for label, found in (("before", before), ("after", after)):
        text = f"{label}: {found.outside_percent:.0f} % outside"
        panel.plot(found.lag, found.value, label=text, **STYLES[KINDS[label]])
    panel.axhline(0.0, color="0.5", linewidth=0.8)
    panel.set(xlabel="lag [s]", ylabel="correlation [1]", xlim=(after.lag[0], after.lag[-1]))
    panel.set_title(title, fontsize=10)
    panel.set_ylim(-1.0, 1.0 + ROOM)
    panel.legend(fontsize=7.5, loc="upper right", ncols=3, handlelength=1.4, columnspacing=1.0)
    return panel


def plot_orders(orders: Orders, *, ax: Any = None) -> Any:
    """Draw amplitudes per order before and after, with the orders that a drive makes."""
    panel = axes(ax, 1, figsize=(7.4, 3.0), grid="major")[0, 0]
    top = 2.0 * max(float(orders.before.max()), float(orders.after.max()), 1e-12)
    least = top * 10.0**-DECADES
    for label, values in (("before", orders.before), ("after", orders.after)):
        seen = np.maximum(values, 0.5 * least)
        panel.plot(orders.order, seen, label=label, **STYLES[KINDS[label]])
    last = orders.order[-1]
    _mark(panel, {name: o for name, o in orders.marks.items() if o <= last})
    panel.set_yscale("log")
    panel.set(
        xlabel="order per motor turn [1]",
        ylabel=f"amplitude of the\n{orders.quantity}",
        xlim=(0.0, float(orders.order[-1])),
        ylim=(least, top),
    )
    panel.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0), frameon=False)
    return panel


def _mark(panel: Any, marks: Mapping[str, float]) -> None:
    """Draw named places of the abscissa."""
    for k, (at, name) in enumerate(sorted((at, name) for name, at in marks.items())):
        panel.axvline(at, color="0.5", linewidth=0.8, linestyle=":")
        panel.text(  # above the panel, where no line crosses
            at, 1.01, name, transform=panel.get_xaxis_transform(),
            ha="left" if k else "right", va="bottom", fontsize=7.5,
        )  # fmt: skip


def plot_spectrum(spectrum: Spectrum, *, ax: Any = None) -> Any:
    """Draw gains over frequency, measured, before and after, with resonances marked."""
    panel = axes(ax, 1, figsize=(7.4, 3.4), grid="major")[0, 0]
    for label, (hz, gain) in spectrum.curves.items():
        size = 6.0 if label == "measured" else 2.5  # seen beneath a model that agrees
        style = STYLES[KINDS[label]]
        panel.loglog(hz, gain, label=label, marker="o", markersize=size, **style)
    _mark(panel, spectrum.marks)
    for axis in (panel.xaxis, panel.yaxis):  # within a decade powers of ten say nothing
        axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    panel.set(xlabel="frequency [Hz]", ylabel=spectrum.quantity)
    panel.figure.legend(fontsize=7.5, loc="outside right upper")
    return panel
