"""A declared drive drawn: as text for a terminal, and as a picture."""

from collections.abc import Iterator
from math import isfinite
from typing import Any

from matplotlib.axes import Axes
from matplotlib.patches import FancyBboxPatch

from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import Body, Link, Rig
from dmptm_ctrl.plots.style import axes

WIDTH, HEIGHT = 2.4, 1.1  # of a body's box
STEP = 4.4, 1.9  # from body to body, along the chain and between branches


def rig_text(rig: Rig) -> str:
    """Return a rig as a tree of text: bodies, what joins, drives and measures them."""
    lines = [rig.name]
    for depth, link, body in _walk(rig):
        stem = "    " * depth
        if link is not None:
            lines.append(f"{stem[4:]}└── {_link_text(link)}")
        lines.append(f"{stem}[{body.name}] {_body_text(body)}")
        for source in (i for i in rig.inputs if i.body == body.name):
            gain = show(source.gain)
            lines.append(f"{stem}  ← {source.name}: column {source.column}, gain {gain}")
        for sensor in (s for s in rig.sensors if s.body == body.name):
            lines.append(f"{stem}  → {sensor.name}: {sensor.measures}, column {sensor.column}")
    for effect in rig.effects:
        lines.append(f"declared effect: {effect.name} on {effect.on}")
    if rig.controller is not None:
        loop = rig.controller
        lines.append(f"controller: {loop.kind} from {loop.sensor} to {loop.input}")
    return "\n".join(lines)


def plot_rig(rig: Rig, *, ax: Any = None) -> Axes:
    """Draw a rig: a box per body, a line per shaft or mesh, arrows for inputs and sensors."""
    place: dict[str, tuple[float, float]] = {}
    rows: dict[int, int] = {}
    order = list(_walk(rig))
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
        inertia = show(body.inertia).partition(" ±")[0]
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
    panel.set_title(rig.name)
    return panel


def show(quantity: Quantity | None) -> str:
    """Value, unit and tolerance as people write them."""
    if quantity is None or not isfinite(quantity.value):
        return "unknown"
    low, high = quantity.range
    text = f"{quantity.value:.4g} {quantity.unit}".strip()
    if quantity.low is not None:
        return f"{text} ({low:.4g} to {high:.4g})"
    return f"{text} ± {100 * quantity.tolerance:.3g} %" if quantity.tolerance else text


def _walk(rig: Rig) -> Iterator[tuple[int, Link | None, Body]]:
    """Bodies from the first driven one outwards, with the link that leads to each."""
    done = set()
    waiting: list[tuple[int, Link | None, str]] = [(0, None, rig.inputs[0].body)]
    while waiting:
        depth, link, name = waiting.pop()
        done.add(name)
        yield depth, link, rig.body(name)
        for k in reversed(rig.links):
            if name in (k.first, k.second):
                other = k.second if k.first == name else k.first
                if other not in done:
                    waiting.append((depth + 1, k, other))


def _body_text(body: Body) -> str:
    friction = ", ".join(f"{key} {show(value)}" for key, value in body.friction.items())
    kind = "mass" if body.linear else "inertia"
    return f"{kind} {show(body.inertia)}" + (f"; friction: {friction}" if friction else "")


def _link_text(link: Link) -> str:
    parts = [f"{'mesh' if link.mesh else 'shaft'} {link.name}"]
    if link.ratio.value != 1:
        parts.append(f"ratio {link.ratio.value:.6g} ({link.first} per {link.second})")
    parts.append("rigid" if link.rigid else f"stiffness {show(link.stiffness)}")
    if link.damping is not None:
        parts.append(f"damping {show(link.damping)}")
    if link.half_gap is not None:
        parts.append(f"half-gap {show(link.half_gap)}")
    return ", ".join(parts)
