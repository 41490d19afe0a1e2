"""Models as files: `model.toml`, written by the diagnosis and read by `dmptm predict`.

That of a rig is complete in itself: the rig file's text, its fitted values, effects.
"""

from os import PathLike
from pathlib import Path
from typing import Any

import tomlkit

from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.drive.rig_dual import dual_motor
from dmptm_ctrl.drive.rig_units import unit_at
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.numbers import finite_numbers
from dmptm_ctrl.signals.toml_text import parse_toml, read_toml
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

DUAL, RIG = "dual-motor", "chain"  # kinds
SCHEMA = 1


def begun(what: str, kind: str, schema: int) -> tomlkit.TOMLDocument:
    """Return the beginning of a file: what it is, schema and kind."""
    document = tomlkit.document()
    document.add(tomlkit.comment(f"{what} of dmptm-ctrl. SI units; angles in radians."))
    document["schema"] = schema
    document["kind"] = kind
    return document


def _parsed(text: str, name: str, kind: str) -> dict[str, Any]:
    data = parse_toml(text, name)
    if data.get("kind") != kind or data.get("schema") != SCHEMA:
        raise LogError(f'{name}: needs kind = "{kind}" and schema = {SCHEMA}, as diagnose writes')
    return data


def with_unit(value: float, unit: str) -> tomlkit.items.Item:
    """Return a number for a document, its unit in a comment beside it."""
    item = tomlkit.item(float(value))
    item.comment(unit or "1")
    return item


def rig_model_to_toml(model: RigModel) -> str:
    """Return the text of a model file, complete in itself: the rig file's text is in it."""
    document = begun("Drive model", RIG, SCHEMA)
    document["rig"] = tomlkit.string(model.rig.text, multiline=True)
    values = tomlkit.table()
    for key, value in model.values.items():
        values[key] = with_unit(value, model.quantities[key].unit)
    document["values"] = values
    effects = tomlkit.aot()
    for effect in model.effects:
        table = tomlkit.table()
        table["name"] = effect.name
        table["on"] = effect.on
        if effect.far:
            table["far"] = list(effect.far)
        units = {p.name: p.unit for p in PLACED_CATALOGUE[effect.name].keep}
        for key, value in effect.values.items():
            table[key] = with_unit(value, unit_at(effect.on, model.rig, units[key]))
        effects.append(table)
    document["effect"] = effects
    logs = tomlkit.table()
    for log, shifts in model.zeros.items():
        if shifts:
            logs[log] = {key: float(shift) for key, shift in shifts.items()}
    if logs:
        document["zero"] = logs
    return tomlkit.dumps(document)


def rig_model_from_toml(text: str, name: str = "model.toml") -> RigModel:
    """Read the text of a model file; LogError as of :func:`from_toml`."""
    data = _parsed(text, name, RIG)
    if not isinstance(data.get("rig"), str):
        raise LogError(f"{name}: no rig in it; the diagnosis writes the rig file's text there")
    rig = parse_rig(data["rig"], f"rig in {name}")
    values = finite_numbers(name, "values", data.get("values", {}))
    listed, shifted = data.get("effect", []), data.get("zero", {})
    if not isinstance(listed, list) or not isinstance(shifted, dict):
        raise LogError(f"{name}: effects are tables [[effect]], zeros are under [zero]")
    effects = []
    for table in listed:
        known = isinstance(table, dict) and isinstance(table.get("name"), str)
        if not known or not isinstance(table.get("on"), str):
            raise LogError(f"{name}: each [[effect]] needs a name and what it is on")
        numbers = {k: v for k, v in table.items() if k not in ("name", "on", "far")}
        far = table.get("far", [])
        if not isinstance(far, list):
            raise LogError(f"{name}: far of an effect is a list of names")
        values_of = finite_numbers(name, f"effect {table['name']}", numbers)
        effects.append(Placed(table["name"], table["on"], values_of, tuple(map(str, far))))
    zeros = {log: finite_numbers(name, f"zero.{log}", shifts) for log, shifts in shifted.items()}
    try:
        model = RigModel(rig, tuple(effects), values, zeros)
        model.plant()
    except (KeyError, ValueError) as error:
        raise LogError(f"{name}: {error.args[0]}") from None
    return model


def to_toml(model: Model) -> str:
    """Return the text of a model file: values in SI, the unit beside each."""
    document = begun("Drive model", DUAL, SCHEMA)
    drive = tomlkit.table()
    for name in model.drive:
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


def from_toml(text: str, *, name: str = "model.toml") -> Model:
    """Read the text of a model file.

    LogError where it is no TOML, or of another kind or schema; for an unknown or missing name, a
    value that is no finite number.
    """
    data = _parsed(text, name, DUAL)
    values = finite_numbers(name, "drive", data.get("drive"))
    paper = paper_drive()
    unknown = sorted(set(values) - set(paper))
    missing = [n for n in paper if n not in values]
    if unknown or missing:
        what = f"unknown {unknown[0]!r}" if unknown else f"no {missing[0]!r}"
        raise LogError(f"{name}: {what} in [drive]; it needs {', '.join(paper)}")
    speeds = ("W3_plus", "W3_minus", "WL_plus", "WL_minus")
    for key in ("J_m", "J_L", "N_1", "N_2", "k_m", *speeds):
        if values[key] <= 0:
            raise LogError(f"{name}: {key} is {values[key]} in [drive]; it must be positive")
    effects = data.get("effects", {})
    if not isinstance(effects, dict):
        raise LogError(f"{name}: [effects] must hold one table per effect")
    tables = {key: finite_numbers(name, f"effects.{key}", table) for key, table in effects.items()}
    try:
        return Model(paper.with_values(**values), tables)
    except (KeyError, ValueError) as error:
        raise LogError(f"{name}: {error.args[0]}") from None


def read_model(path: str | PathLike[str]) -> Model | RigModel:
    """Read a model from a model.toml, as `diagnose` writes it for any drive, or from a rig file.

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
        No such file, no TOML, an effect or a parameter that does not exist, a value that no
        drive has.

    Examples
    --------
    >>> dm.read_model("model.toml").effects["unbalance"]["cosine"]
    8.0
    """
    file = Path(path)
    text, data = read_toml(file, "model")
    if "kind" not in data and "body" in data:
        rig = parse_rig(text, file.name)
        drive = dual_motor(rig)
        return RigModel(rig) if drive is None else Model(drive)
    return model_of(text, file.name)


def model_of(text: str, name: str) -> Model | RigModel:
    """Read the text of a model file of any drive; LogError as `read_model`."""
    of_rig = parse_toml(text, name).get("kind") == RIG
    return rig_model_from_toml(text, name) if of_rig else from_toml(text, name=name)


def model_text(model: Model | RigModel) -> str:
    """Return the text of a model file of any drive."""
    return rig_model_to_toml(model) if isinstance(model, RigModel) else to_toml(model)
