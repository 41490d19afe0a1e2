"""Make all items and a page that lists them beside what the paper prints."""

from collections.abc import Callable
from os import PathLike
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from dmptm_ctrl.reproduce import experiments, linear, nonlinear, parts
from dmptm_ctrl.reproduce.items import Context, Item, render, save_items
from dmptm_ctrl.reproduce.resonances import resonance_items
from dmptm_ctrl.signals.atomic import output_folder

# in the order of the page
SECTIONS: tuple[tuple[str, Callable[[Context], list[Item]]], ...] = (
    ("Parameters", parts.declared),
    ("Resonances", lambda context: resonance_items(context.drive)),
    ("From 9 to 3 degrees of freedom", linear.convergence),
    ("What the simplification costs", linear.simplification),
    ("Time responses", experiments.eight),
    ("Bode plots and steps", linear.bode_and_step),
    ("Frequency responses, open loop", experiments.open_responses),
    ("Frequency responses, closed loop", experiments.closed_responses),
    ("Block diagram", parts.blocks),
    ("Mesh", parts.mesh),
    ("Backlash", nonlinear.two_laws),
    ("Tooth stiffness and mesh damping", linear.tooth),
    ("Parameters from experiments", nonlinear.parameters),
    ("PI tuning", nonlinear.tuning),
    ("Errata", linear.errata),
)


def reproduce(
    out: str | PathLike[str], *, quiet: bool = False, context: Context | None = None
) -> Path:
    """Write every figure and table to a folder, and ``index.html`` that shows them.

    Parameters
    ----------
    out : path
        Appears whole at the end, or not at all.
    quiet : bool
        No progress bar.
    context : Context, optional
        Shared results, to look at afterwards.

    Returns
    -------
    Path
        Of ``index.html``.

    Examples
    --------
    >>> page = dm.reproduce("paper")
    """
    columns = (
        TextColumn("{task.description:<48}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
    )
    console = Console(stderr=True, quiet=quiet)
    with output_folder(out) as folder, Progress(*columns, console=console) as progress:
        bar = progress.add_task("", total=len(SECTIONS))
        current = ""

        def say(text: str) -> None:
            progress.update(bar, description=f"{current}: {text}")

        context = Context() if context is None else context
        context.say = say
        made: list[tuple[str, list[Item]]] = []
        for current, build in SECTIONS:
            progress.update(bar, description=current)
            items = build(context)
            save_items(folder, items)
            made.append((current, items))
            progress.advance(bar)
        (folder / "index.html").write_text(render(made), encoding="utf-8")
    return Path(out) / "index.html"
