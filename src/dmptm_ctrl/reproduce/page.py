"""Items as files and on a page."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

import matplotlib.pyplot as plt

from dmptm_ctrl import __version__
from dmptm_ctrl.plots.page import environment
from dmptm_ctrl.reproduce.items import Item, Picture

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
