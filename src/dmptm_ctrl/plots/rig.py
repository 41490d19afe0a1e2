"""A declared drive as a picture."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.plots.style import axes

WIDTH, HEIGHT = 2.4, 1.1  # of a body's box
STEP = 4.4, 1.9  # from body to body, along the train and between branches


def plot_rig(rig: Rig, *, ax: Any = None) -> Axes:
    """Draw a rig: a box per body, a line per shaft or mesh, arrows for inputs and sensors."""
    place: dict[str, tuple[float, float]] = {}
    rows: dict[int, int] = {}
    order = list(rig.walk())
    for depth, _, body in order:
        row = max(rows.get(depth, 0), max((r for d, r in rows.items() if d > depth), default=1) - 1)
        place[body.name] = (depth * STEP[0], -row * STEP[1])
        rows[depth] = row + 1
    wide = max(x for x, _ in place.values()) + WIDTH
    high = max(-y for _, y in place.values()) + STEP[1]
    panel = axes(ax, 1, figsize=(1.0 + 0.9 * (wide + 2), 0.6 + 0.9 * high))[0, 0]
    for _, link, body in order:
        x, y = place[body.name]
        panel.add_patch(
            FancyBboxPatch(
                (x, y), WIDTH, HEIGHT, boxstyle="round,pad=0.05", facecolor="#eef2f7",
                edgecolor="#0b3c6f",
            )
        )  # fmt: skip
        panel.text(x + WIDTH / 2, y + 0.7, body.name, ha="center", va="center", weight="bold")
        inertia = str(body.inertia).partition(" ±")[0]
        panel.text(x + WIDTH / 2, y + 0.3, inertia, ha="center", va="center", fontsize=8)
        if link is not None:
            other = link.first if link.second == body.name else link.second
            x0, y0 = place[other]
            panel.plot(
                [x0 + WIDTH + 0.06, x - 0.06], [y0 + HEIGHT / 2, y + HEIGHT / 2],
                color="0.2", linewidth=3.0 if link.rigid else 1.5,
                linestyle="-" if link.half_gap is None else "--",
            )  # fmt: skip
            label = link.name if abs(link.ratio.value) == 1 else (
                f"{link.name}, {link.ratio.value:.4g}:1"
            )  # fmt: skip
            panel.text(
                (x0 + WIDTH + x) / 2, (y0 + y + HEIGHT) / 2 + 0.12, label, ha="center",
                va="bottom", fontsize=8,
            )  # fmt: skip
        driven = [f"← {i.name}" for i in rig.inputs if i.body == body.name]
        seen = [f"→ {s.name}" for s in rig.sensors if s.body == body.name]
        note = "   ".join([*driven, *seen])
        panel.text(x + WIDTH / 2, y - 0.15, note, ha="center", va="top", fontsize=8, color="0.3")
    panel.set_xlim(-0.8, wide + 0.8)
    panel.set_ylim(-high + STEP[1] - 0.8, HEIGHT + 0.7)
    panel.set_aspect("equal")
    panel.set_axis_off()
    legend = "thick line: rigid; dashed: with a gap; ← input; → sensor"
    panel.set_title(f"{rig.name}\n{legend}", fontsize=9)
    return panel
