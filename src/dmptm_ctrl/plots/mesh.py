"""Pictures of a mesh: torque over the gap, the tooth's shape, stiffness by mesh phase."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from dmptm_ctrl.drive.tooth import Tooth
from dmptm_ctrl.effects.backlash import Backlash, mesh_torque
from dmptm_ctrl.plots.style import SEQUENCE, STYLES, axes

REACH = 1.15  # of the half-gap, how far a torque is drawn
NEAR = 0.03  # of the half-gap, about a flank
MARGIN = 1.9  # of the tooth's half width


def dead_zone_plot(
    law: Backlash, rates: Sequence[float], *, ax: Sequence[Axes] | None = None, title: str = ""
) -> np.ndarray:
    """Draw the torque of Eq. 21 over the relative angle, a line per rate [rad/s].

    The whole gap, and one flank; at rate 0 it is the classical dead zone.
    """
    panels = axes(ax, 1, 2, figsize=(9.0, 3.6), grid="major")[0]
    gap, near = law.half_gap, NEAR * law.half_gap
    spans = ((-REACH * gap, REACH * gap), (gap - near, gap + near))
    for panel, (low, high), name in zip(panels, spans, (title, "the flank at Δ"), strict=True):
        z = np.linspace(low, high, 4001)
        for rate, style in zip(rates, SEQUENCE, strict=False):
            torque = [mesh_torque(x, rate, law) for x in z]
            panel.plot(1e3 * z, torque, label=f"ż = {rate:g} rad/s", **style)
        for flank, symbol in ((-gap, "−Δ"), (gap, "Δ")):
            if low <= flank <= high:
                panel.axvline(1e3 * flank, color="0.4", linewidth=0.8, linestyle=":")
                where = {"xytext": (-4, 5), "textcoords": "offset points", "ha": "right"}
                panel.annotate(symbol, (1e3 * flank, 0.0), **where)
        panel.set(xlabel="relative angle z [mrad]", ylabel="mesh torque [N·m]", title=name)
        panel.legend(fontsize=8, loc="upper left")
    return panels


def tooth_plot(tooth: Tooth, *, ax: Axes | None = None, title: str = "") -> Axes:
    """Draw the tooth from root to tip, with the load on the pitch circle, to scale in mm."""
    panel = axes(ax, 1, figsize=(4.2, 4.2))[0, 0]
    tip = tooth.pitch_radius + tooth.module
    radii = np.linspace(tooth.root_radius, tip, 100)
    height, width = np.array([tooth.section(r) for r in radii]).T
    base, pitch = (tooth.section(r) for r in (tooth.root_radius, tooth.pitch_radius))
    x, y = 0.5e3 * width, 1e3 * (height - base[0])
    panel.fill_betweenx(y, -x, x, facecolor="0.88", edgecolor="0.2")
    level = 1e3 * (pitch[0] - base[0])
    panel.axhline(level, linestyle=":", color="0.4", linewidth=0.8)
    panel.annotate("pitch circle", (-MARGIN * x[0] + 0.05, level), va="bottom", fontsize=8)
    panel.axhline(0.0, color="0.2", linewidth=1.2)
    panel.annotate("base", (-MARGIN * x[0] + 0.05, 0.0), va="bottom", fontsize=8)
    side = 0.5e3 * pitch[1]
    arrow = {"arrowstyle": "-|>", "color": STYLES["existing"]["color"]}
    panel.annotate("", (side, level), xytext=(side + 0.8, level), arrowprops=arrow)
    panel.annotate("F", (side + 0.85, level), va="center")
    both_ways = {"arrowstyle": "<->", "color": "0.2"}
    panel.annotate("", (0.0, 0.0), xytext=(0.0, level), arrowprops=both_ways)
    panel.annotate("h1", (0.06, 0.5 * level))
    panel.set(xlabel="width [mm]", ylabel="height above the base [mm]", title=title)
    panel.set_xlim(-MARGIN * x[0], MARGIN * x[0])
    panel.set_aspect("equal")
    return panel


def mesh_phase_plot(
    time: ArrayLike,
    theta_3: ArrayLike,
    stiffness: Mapping[str, ArrayLike],
    *,
    ax: Sequence[Axes] | None = None,
    title: str = "",
) -> np.ndarray:
    """Draw a pinion's angle [rad] and its mesh stiffness [N·m/rad] by several laws over time."""
    top, bottom = axes(ax, 2, figsize=(6.5, 4.4), grid="major", sharex=True)[:, 0]
    top.plot(time, np.degrees(np.asarray(theta_3)), **STYLES["measured"])
    top.set(ylabel="pinion angle [deg]", title=title)
    for (label, values), style in zip(stiffness.items(), SEQUENCE, strict=False):
        bottom.plot(time, 1e-3 * np.asarray(values), label=label, **style)
    bottom.set(xlabel="time [s]", ylabel="k [kN·m/rad]")
    bottom.margins(y=0.25)
    bottom.legend(fontsize=8, ncols=2, loc="upper center")
    return np.array([top, bottom])
