"""Models as files: `model.toml`, written by the diagnosis and read by `dmptm predict`."""

from os import PathLike
from pathlib import Path

import tomlkit

from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.numbers import finite_numbers
from dmptm_ctrl.signals.toml_text import parse_toml
from dmptm_ctrl.simulate.damping import DAMPING, FLANKS, undamped
from dmptm_ctrl.simulate.model import BASE, Model
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_model_file import KIND as RIG
from dmptm_ctrl.simulate.rig_model_file import rig_model_from_toml, with_unit

KIND = "dual-motor"
SCHEMA = 1


def to_toml(model: Model) -> str:
    """Return the text of a model file: values in SI, the unit beside each."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Drive model of dmptm-ctrl. SI units; angles in radians."))
    document["schema"] = SCHEMA
    document["kind"] = KIND
    drive = tomlkit.table()
    for name in BASE:
        drive[name] = with_unit(model.drive[name], model.drive.quantities[name].unit)
    document["drive"] = drive
    effects = tomlkit.table()
    for name, values in model.effects.items():
        table = tomlkit.table()
        for p in CATALOGUE[name].parameters:
            if p.name in values:
                table[p.name] = with_unit(values[p.name], p.unit)
        effects[name] = table
    document["effects"] = effects
    return tomlkit.dumps(document)


def from_toml(text: str, *, name: str = "model.toml", drive: Drive | None = None) -> Model:
    """Read the text of a model file.

    Raises
    ------
    LogError
        Not TOML, another kind or schema, an unknown or missing name, a value that is not a
        finite number.
    """
    data = parse_toml(text, name)
    if data.get("kind") != KIND or data.get("schema") != SCHEMA:
        raise LogError(f'{name}: needs kind = "{KIND}" and schema = {SCHEMA}, as diagnose writes')
    declared = drive or paper_drive()
    values = finite_numbers(name, "drive", data.get("drive"))
    unknown = sorted(set(values) - set(BASE))
    missing = [n for n in BASE if n not in values]
    if unknown or missing:
        what = f"unknown {unknown[0]!r}" if unknown else f"no {missing[0]!r}"
        raise LogError(f"{name}: {what} in [drive]; it needs {', '.join(BASE)}")
    for key in (
        "J_m",
        "J_2",
        "J_L",
        "N_1",
        "N_2",
        "k_m",
        "W3_plus",
        "W3_minus",
        "WL_plus",
        "WL_minus",
    ):
        if values[key] <= 0:
            raise LogError(f"{name}: {key} is {values[key]} in [drive]; it must be positive")
    effects = data.get("effects", {})
    if not isinstance(effects, dict):
        raise LogError(f"{name}: [effects] must hold one table per effect")
    tables = {key: finite_numbers(name, f"effects.{key}", table) for key, table in effects.items()}
    try:
        found = declared.with_values(**values)
        if FLANKS in tables and found[DAMPING] == 0.0:
            found = undamped(found)
        return Model(found, tables)
    except (KeyError, ValueError) as error:
        raise LogError(f"{name}: {error.args[0]}") from None


def read_model(path: str | PathLike[str]) -> Model | RigModel:
    """Read a model from a model.toml, as `diagnose` writes it for any drive.

    Parameters
    ----------
    path : path

    Returns
    -------
    Model or RigModel
        Of the dual-motor drive; of a rig file.

    Raises
    ------
    LogError
        See :func:`from_toml`; also a file that cannot be read.
    """
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise LogError(f"{file.name}: no readable model file there") from None
    if parse_toml(text, file.name).get("kind") == RIG:
        return rig_model_from_toml(text, file.name)
    return from_toml(text, name=file.name)


def read_dual_model(path: str | PathLike[str]) -> Model:
    """Read the model of a dual-motor drive; one of a rig file is refused in one sentence."""
    model = read_model(path)
    if isinstance(model, RigModel):
        raise LogError(f"{Path(path).name}: a model of rig {model.rig.name!r}; this is only for "
                       "dual-motor drives")  # fmt: skip
    return model
