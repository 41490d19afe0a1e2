"""Pages: one jinja environment for all of them, numbers for reading, figures inside the page."""

import base64
import io
import math
from typing import Any

import matplotlib as mpl
from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

LONG = 1e6  # from here on powers of ten read better


def environment(package: str) -> Environment:
    """Return the environment for a package's ``templates``, which may extend ``base.html.j2``.

    Text is escaped; a name that is not given is an error.
    """
    made = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("dmptm_ctrl.plots")]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters |= {"number": number, "words": words, "percent": percent}
    return made


def number(value: Any, digits: int = 3) -> str:
    """Format a number for reading; a dash where there is none."""
    if not math.isfinite(value):
        return "–"
    text = f"{float(value):.{digits}g}"
    if "e+" in text and abs(value) < LONG:
        text = f"{value:.0f}"
    return text.replace("-", "−")


def percent(value: float) -> str:
    """Format a percentage to a tenth."""
    return f"{value:.1f}".replace("-", "−") if math.isfinite(value) else "–"


def words(name: str) -> str:
    """Return the name of an effect as words."""
    return name.replace("_", " ")


def data_uri(figure: Figure) -> str:
    """Return a figure as an SVG image to put into a page: the same bytes every time."""
    text = io.BytesIO()
    with mpl.rc_context({"svg.hashsalt": "dmptm", "svg.fonttype": "path", "path.simplify": True}):
        figure.savefig(text, format="svg", metadata={"Date": None}, transparent=True)
    return "data:image/svg+xml;base64," + base64.b64encode(text.getvalue()).decode("ascii")
