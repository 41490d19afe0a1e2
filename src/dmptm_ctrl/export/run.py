"""What the command line calls: a model or controller file in, files to run elsewhere out."""

import re
from os import PathLike
from pathlib import Path
from typing import Any

from dmptm_ctrl.design.controller import KIND as CONTROLLER
from dmptm_ctrl.design.controller import Controller, read_controller
from dmptm_ctrl.export.c_source import c_header, c_source
from dmptm_ctrl.export.controller import controller_program, provenance
from dmptm_ctrl.export.experiment import Limits, experiment_program, read_signals, within
from dmptm_ctrl.export.fmu import write_fmu
from dmptm_ctrl.export.mujoco import mujoco_joint, mujoco_text
from dmptm_ctrl.export.plant import plant_program
from dmptm_ctrl.export.printer import REALS
from dmptm_ctrl.export.program import Program
from dmptm_ctrl.export.python_program import python_program
from dmptm_ctrl.export.reserved import RESERVED
from dmptm_ctrl.export.st_source import st_source
from dmptm_ctrl.export.stepping import origin
from dmptm_ctrl.export.tables import write_tables
from dmptm_ctrl.export.tracer import NotScalar
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.atomic import output_folder
from dmptm_ctrl.signals.toml_text import read_toml
from dmptm_ctrl.simulate.model_file import read_model

OF_EXPERIMENT = ("csv", "c", "st")
OF_CONTROLLER = ("c", "st", "python")
TARGETS = ("c", "st", "fmu", "python", "table", "mujoco")
_WORD = re.compile(r"(?=.{1,31}$)[A-Za-z](_?[A-Za-z0-9])*")
SAMPLE_TIME = 1e-3  # s, of a plant's program where none is given


def export_file(
    source: str | PathLike[str],
    target: str,
    out: str | PathLike[str],
    *,
    real: str = "double",
    sample_time: float | None = None,
    name: str | None = None,
) -> list[str]:
    """Write a model or a controller as a program.

    Parameters
    ----------
    source : path
        model.toml of `dmptm diagnose`, a rig.toml, or controller.toml of `dmptm tune`.
    target : {"c", "st", "fmu", "python", "table", "mujoco"}
    out : path
        Folder; files of other names in it stay.
    real : {"double", "float"}
        Of C and Structured Text.
    sample_time : float, optional
        Of a plant's program [s]; by default 1 ms. A controller has its own.
    name : str, optional
        Of the program in C, Structured Text or FMU; by default "controller" or "plant". Two
        programs of one project need two.

    Returns
    -------
    list of str
        Names of the files.

    Raises
    ------
    LogError
        No such file, target or number type; nothing is written.

    Examples
    --------
    >>> files = dm.export("controller.toml", "c", "code")
    """
    source, out = Path(source), Path(out)
    if target not in TARGETS:
        raise LogError(f"no target {target!r}; there are {', '.join(TARGETS)}")
    _check_numbers(real, sample_time)
    if name is not None and (not _WORD.fullmatch(name) or name.lower() in RESERVED):
        raise LogError(f"name {name!r}: must be a new word of at most 31 letters, digits, single _")
    model = _read(source)
    if isinstance(model, Controller):
        if sample_time is not None:
            raise LogError(f"{source.name}: a controller has its own sample time; leave it out")
        if target not in OF_CONTROLLER:
            kinds = ", ".join(OF_CONTROLLER)
            raise LogError(f"{source.name}: a controller goes to {kinds}; {target} is of a plant")
    step = sample_time or SAMPLE_TIME
    with output_folder(out) as folder:
        try:
            _write(target, model, source, step, real, folder, name)
        except NotScalar as error:  # a user's own effect
            raise LogError(f"{source.name}: an effect has no program: {error}") from None
        except LogError:
            raise
        except ValueError as error:  # a value that the rig file leaves open
            raise LogError(f"{source.name}: {error}") from None
        return sorted(p.name for p in folder.iterdir())


def export_experiment(
    source: Path,
    target: str,
    out: Path,
    *,
    limits: Limits,
    model: Path | None = None,
    real: str = "double",
    sample_time: float | None = None,
) -> list[str]:
    """Write a planned experiment, as next_experiment.csv, ready to run; return the files' names.

    `model` is the file that gives speed and travel. LogError, and nothing is written, for
    files that cannot be used, or limits that cannot be kept.
    """
    if target not in OF_EXPERIMENT:
        raise LogError(f"no target {target!r}; an experiment goes to {', '.join(OF_EXPERIMENT)}")
    _check_numbers(real, sample_time)
    plant = None if model is None else _read(model)
    if isinstance(plant, Controller):
        raise LogError(f"--model {source.name}: that is a controller; give a model.toml")
    table = within(read_signals(source), limits, model=plant, sample_time=sample_time)
    program = experiment_program(table, source)
    with output_folder(out) as folder:
        if target == "csv":
            text = table.to_csv(index=False, lineterminator="\n")
            (folder / f"{program.name}.csv").write_text(text, encoding="utf-8")
        else:
            _write_program(target, program, real, folder)
        return sorted(p.name for p in folder.iterdir())


def _check_numbers(real: str, sample_time: float | None) -> None:
    if real not in REALS:
        raise LogError(f"no number type {real!r}; there are {', '.join(REALS)}")
    if sample_time is not None and not 0.0 < sample_time < 1.0:
        raise LogError(f"sample time {sample_time:g} s: must lie between 0 and 1 s")


def _read(source: Path) -> Any:
    _, written = read_toml(source, "model or controller")
    if written.get("kind") == CONTROLLER:
        return read_controller(source)
    return read_model(source)


def _program(model: Any, source: Path, step: float, name: str | None) -> Program:
    if isinstance(model, Controller):
        return controller_program(model, name or "controller", provenance(model, source))
    notes = [
        "Model of a drive.",
        f"Sample time: {step!r} s. Call the step once per sample; inputs are held until the next.",
        "Units: SI, angles in rad.",
        *origin(source),
    ]
    return plant_program(model, step, name=name or "plant", notes=notes)


def _write(
    target: str, model: Any, source: Path, step: float, real: str, folder: Path, name: str | None
) -> None:
    if target == "python":
        file = "controller.py" if isinstance(model, Controller) else "plant.py"
        (folder / file).write_text(python_program(model, source), encoding="utf-8")
    elif target == "table":
        write_tables(model, source, folder)
    elif target == "mujoco":
        text = mujoco_text(mujoco_joint(model), source)
        (folder / "joint.xml").write_text(text, encoding="utf-8")
    elif target == "fmu":
        program = _program(model, source, step, name)
        write_fmu(program, step, folder / f"{program.name}.fmu")
    else:
        _write_program(target, _program(model, source, step, name), real, folder)


def _write_program(target: str, program: Program, real: str, folder: Path) -> None:
    texts = {"st": st_source} if target == "st" else {"h": c_header, "c": c_source}
    for ending, text in texts.items():
        (folder / f"{program.name}.{ending}").write_text(text(program, real), encoding="ascii")
