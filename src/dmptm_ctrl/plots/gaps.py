"""A picture that moves: the two pinions in their tooth gaps along a log."""

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.animation import FuncAnimation
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.text import Text
from numpy.typing import NDArray
from PIL import Image

Floats = NDArray[np.float64]

SIDES = ("left", "right")
PUSHES = {1: "#0b3c6f", 0: "#e0a030", -1: "#b3262e"}  # dark, light, middle: also in grey
NAMES = {1: "pushes forward", 0: "in flight", -1: "pushes backward"}
REACH = 1.6  # half-gaps that are drawn
FRAMES = 24
PER_SECOND = 8


@dataclass(frozen=True, eq=False)
class GapMotion:
    """Where each pinion is in its gap along a log."""

    name: str
    time: Floats  # (n,) [s]
    place: Floats  # (2, n), left and right, in half-gaps: ±1 at the flanks
    speed: Floats  # (n,), of the ring gear [deg/s]
    source: str  # "measured" or "simulated"

    @property
    def contact(self) -> NDArray[np.int64]:
        """1 where a tooth pushes forward, −1 backward, 0 in flight, (2, n)."""
        return (np.sign(self.place) * (np.abs(self.place) >= 1.0)).astype(np.int64)


def busiest(motion: GapMotion, seconds: float = 1.5) -> GapMotion:
    """Return the part of a motion in which the pinions change flank most often."""
    dt = float(np.median(np.diff(motion.time)))
    count = min(round(seconds / dt), motion.time.size)
    changes = np.abs(np.diff(motion.contact, axis=1)).sum(0).astype(float)
    sums = np.convolve(changes, np.ones(max(count - 1, 1)), "valid")
    start = int(np.argmax(sums)) if sums.size else 0
    part = slice(start, start + count)
    time, place, speed = motion.time[part], motion.place[:, part], motion.speed[part]
    return replace(motion, time=time, place=place, speed=speed)


@dataclass(frozen=True, eq=False)
class Scene:
    """Figure of a motion, and what moves in it."""

    motion: GapMotion
    figure: Figure
    teeth: Sequence[Rectangle]
    cursor: Line2D
    title: Text
    shown: NDArray[np.int64]  # sample of each frame

    def draw(self, frame: int) -> list[Artist]:
        """Move what moves to where it is in a frame, and return it."""
        motion, i = self.motion, self.shown[frame]
        for side, tooth in enumerate(self.teeth):
            place = float(np.clip(motion.place[side, i], -REACH, REACH))
            tooth.set_x(place - 0.5)
            tooth.set_facecolor(PUSHES[int(motion.contact[side, i])])
        self.cursor.set_xdata([motion.time[i]] * 2)
        self.title.set_text(
            f"{motion.name}, {motion.source}: t = {motion.time[i]:6.3f} s, ring gear "
            f"{motion.speed[i]:+6.2f} deg/s"
        )
        return [*self.teeth, self.cursor, self.title]


def scene(motion: GapMotion, frames: int) -> Scene:
    """Draw what stands still in all frames."""
    figure = Figure(figsize=(7.2, 3.0), dpi=100)
    panels = figure.subplots(1, 2, gridspec_kw={"width_ratios": [2, 3]})
    figure.subplots_adjust(left=0.02, right=0.985, bottom=0.17, top=0.86, wspace=0.3)
    teeth, cursor = _teeth(panels[0]), _traces(panels[1], motion)
    shown = np.linspace(0, motion.time.size - 1, frames).round().astype(np.int64)
    return Scene(motion, figure, teeth, cursor, figure.suptitle("", fontsize=10), shown)


def animate_gaps(motion: GapMotion, *, frames: int = FRAMES) -> FuncAnimation:
    """Draw the pinions in their gaps, frame by frame; ``.to_jshtml()`` shows it in a notebook."""
    drawn = scene(motion, frames)
    drawn.draw(0)
    interval = 1000 / PER_SECOND
    return FuncAnimation(drawn.figure, drawn.draw, frames=frames, interval=interval, blit=False)


def animated_uri(motion: GapMotion) -> str:
    """Return the animation as an animated image to put into a page without scripts.

    What stands still is drawn once, as interactive backends do.
    """
    drawn = scene(motion, FRAMES)
    for artist in drawn.draw(0):
        artist.set_animated(True)
    canvas = FigureCanvasAgg(drawn.figure)
    canvas.draw()
    still = canvas.copy_from_bbox(drawn.figure.bbox)
    images = []
    for frame in range(FRAMES):
        canvas.restore_region(still)
        for artist in drawn.draw(frame):
            drawn.figure.draw_artist(artist)
        images.append(Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()))
    file = io.BytesIO()
    first, *rest = images
    first.save(file, "gif", save_all=True, append_images=rest, duration=1000 // PER_SECOND, loop=0)
    return "data:image/gif;base64," + base64.b64encode(file.getvalue()).decode("ascii")


def _teeth(panel: Any) -> list[Rectangle]:
    """Gaps between two teeth of the ring gear, and a tooth of each pinion that moves in them."""
    moving = []
    for side, name in enumerate(SIDES):
        base = 1.4 * (1 - side)
        for edge in (-REACH - 1.0, 1.5):
            panel.add_patch(
                Rectangle((edge, base), REACH - 0.5, 0.8, facecolor="0.82", edgecolor="0.4")
            )
        tooth = Rectangle((-0.5, base + 0.1), 1.0, 0.6, edgecolor="0.2")
        panel.add_patch(tooth)
        moving.append(tooth)
        panel.text(-REACH - 0.95, base + 0.86, f"{name} pinion in its gap", fontsize=8)
    panel.set(xlim=(-REACH - 1.0, REACH + 1.0), ylim=(-0.1, 2.6))
    panel.set_axis_off()
    return moving


def _traces(panel: Any, motion: GapMotion) -> Any:
    """Places over time, coloured by contact, and a cursor."""
    panel.axhspan(-1.0, 1.0, color="0.93")
    for side, line in enumerate(("-", "--")):
        panel.plot(motion.time, motion.place[side], line, color="0.45", linewidth=0.9,
                   label=SIDES[side])  # fmt: skip
        for sign, colour in PUSHES.items():
            here = np.where(motion.contact[side] == sign, motion.place[side], np.nan)
            label = NAMES[sign] if side == 0 else None
            panel.plot(motion.time, here, line, color=colour, linewidth=1.8, label=label)
    panel.set(
        xlabel="time [s]",
        ylabel="place in the gap [half-gaps]",
        xlim=(motion.time[0], motion.time[-1]),
        ylim=(-REACH - 0.1, REACH + 1.0),
    )
    panel.legend(fontsize=6.5, ncols=3, loc="upper center")
    return panel.axvline(motion.time[0], color="k", linewidth=1.0)


def gap_motion(log: Any, model: Any) -> GapMotion:
    """Where the pinions are: measured where the log has motor encoders, else simulated.

    The model's gaps scale the picture; without motor encoders it is run on the log's voltages.
    """
    from dmptm_ctrl.simulate.compiled import march, rest

    drive = model.drive
    gaps = np.array([drive["gap_l"], drive["gap_r"]])
    if log.has("theta_ml", "theta_mr"):
        motors = np.array([log["theta_ml"], log["theta_mr"]])
        place = motors / drive["N_1"] - drive["N_2"] * log["theta_L"]
        source = "measured"
    else:
        voltage = np.array([log["u_left"], log["u_right"]])
        start = rest(model, float(log["theta_L"][0]))
        timed = model.over(log.time.size * log.sample_time)
        place = march(timed, voltage, start, log.sample_time)[:, 6:8].T
        source = "simulated"
    return GapMotion(log.name, log.time, place / gaps[:, None], np.rad2deg(log["omega_L"]), source)
