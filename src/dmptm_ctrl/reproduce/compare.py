"""Linear models in one picture: ``dmptm bode`` and ``dmptm step``."""

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dmptm_ctrl.control import common_mode
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.drive import Drive, baseline_drive, nine_dof_ss, paper_drive, three_dof_ss
from dmptm_ctrl.drive.space import step_info
from dmptm_ctrl.plots.linear import bode_compare, step_compare
from dmptm_ctrl.reproduce.items import figure_of
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.any_model import inputs_of
from dmptm_ctrl.simulate.linear import linearize
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import read_model

UNDAMPED = 1e-9  # damping ratio that is rounding
OVER = " over "  # between output and input of another rig
MOTORS = "one voltage on both motors"
# column -> what python-control calls it
STEP = {
    "steady": "SteadyStateValue",
    "rise [s]": "RiseTime",
    "settling [s]": "SettlingTime",
    "overshoot [%]": "Overshoot",
}


def linear_models(
    file: Path | None = None, *, input: str | None = None, output: str | None = None
) -> dict[str, ct.StateSpace]:
    """Return linear models by label, one input and one output each.

    9-DOF, 3-DOF and baseline model from one voltage [V] on both motors to the ring gear's speed
    [rad/s]; and what `file`, a rig.toml or a model.toml of a diagnosis, describes, linearised. If
    it is of a dual-motor drive, all models are of that drive; else it stands beside the paper's.
    `input` and `output` are those of a rig of another shape, by default its first input and its
    first speed sensor, or first sensor. LogError for a file or a name that is no good.
    """
    drive, own = paper_drive(), None
    if file is not None:
        try:
            drive, own = _own(file, input, output)
        except LogError:
            raise
        except (KeyError, ValueError) as error:
            raise LogError(f"{file.name}: {error.args[0]}") from None
    models: dict[str, ct.StateSpace] = {}
    build: list[tuple[str, Callable[[], ct.StateSpace]]] = [
        ("9-DOF", lambda: nine_dof_ss(drive)),
        ("3-DOF", lambda: three_dof_ss(drive)),
        ("baseline", lambda: three_dof_ss(baseline_drive(drive))),
    ]
    for label, make in build:
        try:
            models[label] = common_mode(make())
        except ValueError as error:  # our 9-DOF defaults do not fit every drive
            warnings.warn(f"no {label} model: {error}", UserWarning, stacklevel=2)
    return models if own is None else {**models, **own}


def _own(
    file: Path, input: str | None, output: str | None
) -> tuple[Drive, dict[str, ct.StateSpace]]:
    """Return the dual-motor drive of a file, or the paper's; and its own linear model."""
    model = read_model(file)
    if isinstance(model, Model):
        return model.drive, {f"{file.stem}, linearised": common_mode(linear_plant(model))}
    inputs = inputs_of(model)
    source, seen = input or inputs[0], output or model.rig.speed_sensor.name
    if source not in inputs:
        raise LogError(f"{file.name}: no input {source!r}; it has {', '.join(inputs)}")
    plant = linearize(model, outputs=[seen])
    return paper_drive(), {f"{model.rig.name}: {seen}{OVER}{source}": plant[seen, source]}


def bode(models: dict[str, ct.StateSpace], low: float, high: float) -> tuple[Figure, pd.DataFrame]:
    """Return a Bode plot over a band [Hz], and python-control's numbers of each model."""
    title = (
        "Linear models [SI]" if _mixed(models) else f"{MOTORS}, speed of the ring gear [(rad/s)/V]"
    )
    plot = bode_compare(models, omega_limits=(low, high), title=title)
    rows = {}
    for label, system in models.items():
        gain, phase, _, _ = ct.margin(system)
        poles = system.poles()  # at one without damping the gain is infinite, whatever the loop's
        undamped = bool((np.abs(poles.real) < UNDAMPED * np.abs(poles)).any())
        rows[label] = {
            "states": str(system.nstates),
            "gain at rest": _said(ct.dcgain(system)),
            "-3 dB [Hz]": _said(ct.bandwidth(system) / (2.0 * np.pi)),
            "gain margin [dB]": "undamped" if undamped else f"{20.0 * np.log10(gain):.1f}",
            "phase margin [deg]": "undamped" if undamped else f"{phase:.1f}",
        }
    return figure_of(plot.axes[0, 0]), pd.DataFrame.from_dict(rows, "index")


def step(models: dict[str, ct.StateSpace], seconds: float) -> tuple[Figure, pd.DataFrame]:
    """Return steps of height 1, and python-control's numbers of each model."""
    if _mixed(models):
        unit, title = "output [SI]", "Step of 1 in the input's SI unit"
    else:
        unit, title = "speed of the ring gear [rad/s]", f"Step of 1 V: {MOTORS}"
    plot = step_compare(models, seconds, unit=unit, title=title)
    rows = {}
    for label, system in models.items():
        settles = np.isfinite(ct.dcgain(system)) and system.poles().real.max() < 0.0
        info = step_info(system) if settles else {}
        rows[label] = {column: _said(info.get(key, np.nan)) for column, key in STEP.items()}
    return figure_of(plot.axes[0, 0]), pd.DataFrame.from_dict(rows, "index")


def _mixed(models: dict[str, ct.StateSpace]) -> bool:
    """Whether one of the models is of a rig with other inputs and outputs."""
    return any(OVER in label for label in models)


def _said(value: Any) -> str:
    number = float(value)
    return f"{number:.4g}" if np.isfinite(number) else "–"


def table(rows: pd.DataFrame) -> str:
    """Return rows of text in columns, two blanks between them."""
    widths = {c: 1 + max(len(c), *map(len, rows[c])) for c in rows}
    return str(rows.rename_axis("model", axis=1).to_string(col_space=widths))
