"""Resonances as tables and pictures: ``dmptm resonances`` and a part of the reproduction."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table as Grid

from dmptm_ctrl.drive import (
    NINE_DOF_DEFAULTS,
    Drive,
    Modes,
    both_readings,
    nine_dof_parameters,
    nine_dof_train,
    paper_drive,
    pinion_inertia,
    sensitivities,
    solve_modes,
    three_dof_train,
)
from dmptm_ctrl.drive.modes import THREE_DOF_PARAMETERS
from dmptm_ctrl.plots.modes import mode_plot
from dmptm_ctrl.plots.paper import sensitivity_plot
from dmptm_ctrl.reproduce.items import Item, Picture, Table

OURS = "Depends on 9-DOF parameters that the paper does not print: these are ours."
READINGS = {"beside": "J_2 beside N1² J_m", "motor": "J_2 is N1² J_m"}
WIDTH = 120  # columns that the 9-DOF tables need
SMALL = 5e-4  # of the largest entry: below, a shape or a sensitivity is shown as 0


def overridden(values: Mapping[str, float]) -> tuple[Drive, dict[str, float]]:
    """Sort values by name into the paper's drive and the 9-DOF parameters.

    ValueError for a name that no resonance depends on, or a value that is no physical one.
    """
    drive, extra = paper_drive(), {}
    for name, value in values.items():
        if name in (*THREE_DOF_PARAMETERS, "c"):
            if not (value > 0.0 and np.isfinite(value)):
                raise ValueError(f"{name} is {value:g}, it must be more than zero")
            drive = drive.with_values(**{name: value})
        elif name in NINE_DOF_DEFAULTS:
            extra[name] = value
        else:
            known = ", ".join((*THREE_DOF_PARAMETERS, "c", *NINE_DOF_DEFAULTS))
            raise ValueError(f"no parameter {name!r}; there are {known}")
    nine_dof_parameters(drive, **extra)
    return drive, extra


def resonance_items(drive: Drive | None = None, **overrides: float) -> list[Item]:
    """Return tables of modes and sensitivities of both models, and their pictures.

    `overrides` are 9-DOF parameters, see :func:`~dmptm_ctrl.drive.nine_dof_parameters`.
    """
    drive = paper_drive() if drive is None else drive
    items: list[Item] = []
    for reading, read in both_readings(drive).items():
        modes = solve_modes(three_dof_train(read))
        title = f"3-DOF, {READINGS[reading]}: J̄3 = {pinion_inertia(read):g} kg·m²"
        caption = (
            "Table 1's J_2 equals N1² J_m exactly: it stays on the pinion's side beside N1² J_m "
            "(the default), or is that itself."
        )
        paper = "Eqs. 19, 20" if reading == "beside" else ""
        table = _modes_table(f"modes_3dof_{reading}", title, modes, caption, paper)
        items.append(table._replace(here=_frequencies(modes)))
    three = solve_modes(three_dof_train(drive))
    nine = solve_modes(nine_dof_train(drive, **overrides))
    title = "9-DOF, our defaults" if not overrides else "9-DOF"
    table = _modes_table("modes_9dof", title, nine, OURS, "")
    items.append(table._replace(here=_frequencies(nine)))
    every: dict[str, Any] = {"dof": 9, **overrides}
    changes = {3: sensitivities(drive), 9: sensitivities(drive, **every)}
    for dof, modes in ((3, three), (9, nine)):
        items.append(_change_table(dof, modes, changes[dof]))
    bars = sensitivity_plot(
        {name: values[1:] for name, values in changes[3].items()},
        [f"{k}, {f:.1f} Hz" for k, f in zip(three.kinds[1:], three.hz[1:], strict=True)],
    )
    items += [
        Picture(
            "modes_3dof",
            "Mode shapes, 3-DOF",
            mode_plot(three)[0],
            "Angles over those of the rigid turn.",
            "Eq. 19",
        ),
        Picture("modes_9dof", "Mode shapes, 9-DOF", mode_plot(nine)[0], OURS, "Fig. 9"),
        Picture(
            "sensitivities",
            "What each resonance depends on, 3-DOF",
            bars,
            "Relative change of a frequency per relative change of a parameter.",
        ),
    ]
    return items


def _frequencies(modes: Modes) -> str:
    return ", ".join(f"{hz:.1f}" for hz in modes.hz[1:]) + " Hz"


def _modes_table(name: str, title: str, modes: Modes, caption: str, paper: str) -> Table:
    bodies = modes.train.bodies
    rows = [
        (f"{hz:.2f}", kind, f"{ratio:.4f}", *(_short(x) for x in shape))
        for hz, kind, ratio, shape in zip(
            modes.hz, modes.kinds, modes.damping_ratios, modes.turns.T, strict=True
        )
    ]
    header = ("Hz", "class", "ζ", *(f"θ{b}" for b in bodies))
    shown = "Shapes: angles over those of the rigid turn, largest 1."
    return Table(name, title, header, rows, f"{caption} {shown}", paper)


def _change_table(dof: int, modes: Modes, changes: Mapping[str, np.ndarray]) -> Table:
    rows = [
        (name, *(_short(x) for x in values[1:]))
        for name, values in changes.items()
        if np.abs(values).max() > SMALL
    ]
    return Table(
        f"sensitivities_{dof}dof",
        f"Sensitivities, {dof}-DOF",
        ("parameter", *(f"{hz:.1f} Hz" for hz in modes.hz[1:])),
        rows,
        "Relative change of the frequency per relative change of the parameter.",
    )


def _short(value: float) -> str:
    return "0" if abs(value) < SMALL else f"{value:.3f}"


def show(items: Iterable[Item]) -> None:
    """Print the tables."""
    console = Console(highlight=False, soft_wrap=True)
    console.width = max(console.width, WIDTH)
    for item in items:
        if isinstance(item, Picture):
            continue
        console.print(f"[bold]{item.title}[/bold]")
        table = Grid(box=None, padding=(0, 1))
        for i, name in enumerate(item.header):
            table.add_column(name, justify="left" if i < 2 else "right", no_wrap=True)
        for row in item.rows:
            table.add_row(*row)
        console.print(table)
        console.print(f"{item.caption}\n")
