"""Linear models in one picture: ``dmptm bode`` and ``dmptm step``."""

import warnings
from pathlib import Path
from typing import Any

import control as ct
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from dmptm_ctrl.control import common_mode
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.drive import Drive, baseline_drive, nine_dof_ss, paper_drive, three_dof_ss
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.drive.rig_units import input_symbol
from dmptm_ctrl.drive.state_space import step_info
from dmptm_ctrl.plots.linear import bode_compare, step_compare
from dmptm_ctrl.plots.style import axes
from dmptm_ctrl.reproduce.items import figure_of
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.any_model import inputs_of
from dmptm_ctrl.simulate.linear import linearize
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import read_model

UNDAMPED = 1e-9  # damping ratio that is rounding
MOTORS, SPEED = "one voltage on both motors", "speed of the ring gear"
# column -> what python-control calls it
STEP = {
    "steady [SI]": "SteadyStateValue",
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
    build = {
        "9-DOF": lambda: nine_dof_ss(drive),
        "3-DOF": lambda: three_dof_ss(drive),
        "baseline": lambda: three_dof_ss(baseline_drive(drive)),
    }
    for label, make in build.items():
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
        if input or output:
            raise LogError(
                f"{file.name}: a dual-motor drive is drawn from {MOTORS} to the {SPEED}; "
                "leave --input, --output out"
            )
        return model.drive, {f"{file.stem}, linearised": common_mode(linear_plant(model))}
    rig, inputs = model.rig, inputs_of(model)
    source, seen = input or inputs[0], output or rig.speed_sensor.name
    if source not in inputs:
        raise LogError(f"{file.name}: no input {source!r}; it has {', '.join(inputs)}")
    plant = linearize(model, outputs=[seen])
    units = f"{_unit(rig, seen)} per {input_symbol(rig, source)}"
    return paper_drive(), {f"{rig.name}: {seen} over {source} [{units}]": plant[seen, source]}


def _unit(rig: Rig, output: str) -> str:
    """SI unit of a sensor, or of a body's position or speed; of another output it is left open."""
    rate = {"position": "", "speed": "/s"}
    units = {f"q_{body.name}": body.angle_unit for body in rig.bodies}
    units |= {f"v_{body.name}": f"{body.angle_unit}/s" for body in rig.bodies}
    units |= {s.name: rig.body(s.body).angle_unit + rate[s.measures] for s in rig.sensors}
    return units.get(output, "SI")


def bode(models: dict[str, ct.StateSpace], low: float, high: float) -> tuple[Figure, str]:
    """Return a Bode plot over a band [Hz], and python-control's numbers of each model."""
    title = f"{MOTORS}, {SPEED} [rad/s per V]"
    if _of_another_shape(models):
        title = f"{SPEED} [rad/s per V], and a drive of your own"
    plot = bode_compare(models, omega_limits=(low, high), title=title)
    rows = {}
    for label, system in models.items():
        gain, phase, _, _ = ct.margin(system)
        poles = system.poles()  # at one without damping the gain is infinite, whatever the loop's
        undamped = bool((np.abs(poles.real) < UNDAMPED * np.abs(poles)).any())
        rows[label] = {
            "states": str(system.nstates),
            "gain at rest [SI]": _said(ct.dcgain(system)),
            "-3 dB [Hz]": _said(ct.bandwidth(system) / (2.0 * np.pi)),
            "gain margin [dB]": "undamped" if undamped else f"{20.0 * np.log10(gain):.1f}",
            "phase margin [deg]": "undamped" if undamped else f"{phase:.1f}",
        }
    note = "Margins: with a controller of gain 1 in SI units. inf: no crossing."
    return figure_of(plot.axes[0, 0]), _table(rows, note)


def step(models: dict[str, ct.StateSpace], seconds: float) -> tuple[Figure, str]:
    """Return steps of height 1, and python-control's numbers of each model.

    A drive of another shape has axes of its own, below.
    """
    other = _of_another_shape(models)
    panels = axes(None, 1 + len(other), figsize=(6.5, 3.4 + 3.2 * len(other))).ravel()
    alike = {label: system for label, system in models.items() if label not in other}
    unit, title = f"{SPEED} [rad/s]", f"Step of 1 V: {MOTORS}"
    step_compare(alike, seconds, ax=panels[0], unit=unit, title=title)
    for panel, label in zip(panels[1:], other, strict=True):
        what, _, units = label[:-1].rpartition(" [")
        output, _, input = units.partition(" per ")
        unit, title = f"{models[label].output_labels[0]} [{output}]", f"Step of 1 {input}"
        step_compare({what: models[label]}, seconds, ax=panel, unit=unit, title=title)
    rows = {}
    for label, system in models.items():
        settles = np.isfinite(ct.dcgain(system)) and system.poles().real.max() < 0.0
        info = step_info(system) if settles else {}
        rows[label] = {column: _said(info.get(key, np.nan)) for column, key in STEP.items()}
    open_ended = any("–" in row.values() for row in rows.values())
    return figure_of(panels[0]), _table(rows, "–: no steady value." * open_ended)


def _of_another_shape(models: dict[str, ct.StateSpace]) -> list[str]:
    """Labels of rigs with other inputs and outputs."""
    return [label for label in models if label.endswith("]")]


def _said(value: Any) -> str:
    number = float(value)
    return f"{number:.4g}" if np.isfinite(number) else "–"


def _table(rows: dict[str, dict[str, str]], note: str) -> str:
    """Return rows of text in columns, two blanks between them, and a note below."""
    table = pd.DataFrame.from_dict(rows, "index").rename_axis("model", axis=1)
    widths = {c: 1 + max(len(c), *map(len, table[c])) for c in table}
    return f"{table.to_string(col_space=widths)}\n{note}".rstrip()
