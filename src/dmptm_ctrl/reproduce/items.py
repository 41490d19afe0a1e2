"""What a reproduction is made of: figures and tables, each beside what the paper prints."""

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dmptm_ctrl import __version__
from dmptm_ctrl.data import path
from dmptm_ctrl.drive import Drive, baseline_drive, paper_drive
from dmptm_ctrl.identify.compared_signals import low_pass
from dmptm_ctrl.identify.experiments_validation import (
    EXPERIMENTS,
    Score,
    Trial,
    fit_to_logs,
    score,
    speed_on,
    validate,
)
from dmptm_ctrl.identify.loop_resonance import ResonantGains, resonant_gains
from dmptm_ctrl.plots.page import environment
from dmptm_ctrl.signals import Campaign, load_logs
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
RIG_LOOP = Loop(0.08 / DEG, 1.5 / DEG, 10.0)  # of the bundled logs; README of null_rig's source
PAPER_RESONANCE_HZ = 5.5  # section 4.3.4
PAPER_AMPLITUDES = (10.0 * DEG, 15.0 * DEG)  # rad/s, Fig. 18 and 19
PAPER_VOLTS = (0.6, 0.75)  # V, Fig. 16 and 17


class Picture(NamedTuple):
    """A figure, how to read it, and what the paper has in its place."""

    name: str
    title: str
    panel: Axes | Figure  # of the figure, or the whole
    caption: str
    paper: str = ""  # its item
    printed: str = ""  # its number, if it prints one
    here: str = ""  # ours beside it

    @property
    def figure(self) -> Figure:
        """The whole figure."""
        return figure_of(self.panel)


class Table(NamedTuple):
    """A table of text, how to read it, and what the paper has in its place."""

    name: str
    title: str
    header: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]
    caption: str
    paper: str = ""
    printed: str = ""
    here: str = ""


Item = Picture | Table


def figure_of(panel: Axes | Figure) -> Figure:
    """Return the figure that a panel is in."""
    figure = panel.get_figure(root=True)
    if figure is None:
        raise ValueError("the panel is in no figure")
    return figure


@dataclass
class Context:
    """What several items share, computed once; `say` gets what is being done."""

    say: Callable[[str], None] = field(default=lambda text: None)

    @cached_property
    def drive(self) -> Drive:
        """The paper's drive, corrected."""
        return paper_drive()

    @cached_property
    def campaign(self) -> Campaign:
        """Logs of an independent rig without undeclared effects."""
        return load_logs(path("null_rig"))

    @cached_property
    def validation(self) -> tuple[list[Trial], dict[str, list[Drive]]]:
        """The eight experiments, with both models fitted on the other half."""
        drives = {"proposed": self.drive, "existing": baseline_drive(self.drive)}
        return validate(self.campaign, drives, RIG_LOOP, progress=self.say)

    @cached_property
    def favoured(self) -> dict[str, Score]:
        """The existing model fitted to each experiment that it is then judged on."""
        result = {}
        for experiment, (name, *_) in EXPERIMENTS.items():
            self.say(f"existing model, fitted on {experiment} itself")
            log = self.campaign[name]
            model = Model(fit_to_logs(baseline_drive(self.drive), [log], RIG_LOOP))
            speeds = (log["omega_L"], speed_on(model, log, RIG_LOOP))
            result[experiment] = score(*(low_pass(x, log.sample_time) for x in speeds))
        return result

    @cached_property
    def fitted(self) -> dict[str, Model]:
        """Both models as fitted on the first half of the experiments."""
        return {name: Model(drives[0]) for name, drives in self.validation[1].items()}

    @cached_property
    def resonance(self) -> ResonantGains:
        """Gains with the paper's closed-loop resonance, kp as on the rig."""
        kp, speed = RIG_LOOP.kp, PAPER_AMPLITUDES[0]
        return resonant_gains(Model(self.drive), PAPER_RESONANCE_HZ, kp, speed)


DPI = 110


def save_items(folder: Path, items: Iterable[Item]) -> None:
    """Write pictures as PNG and close them, tables as CSV."""
    for item in items:
        if isinstance(item, Picture):
            item.figure.savefig(folder / f"{item.name}.png", dpi=DPI)
            plt.close(item.figure)
        else:
            with (folder / f"{item.name}.csv").open("w", newline="", encoding="utf-8") as stream:
                csv.writer(stream).writerows([item.header, *item.rows])


def render(sections: Sequence[tuple[str, list[Item]]]) -> str:
    """Return the page as HTML; pictures are expected beside it."""
    pages = environment("dmptm_ctrl.reproduce")
    pages.tests["picture"] = lambda item: isinstance(item, Picture)
    page = pages.get_template("page.html")
    return page.render(sections=sections, version=__version__)
