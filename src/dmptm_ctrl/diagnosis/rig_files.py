"""The model of a rig of any shape as a file: the rig file's text, its fitted values, effects."""

from collections.abc import Mapping
from os import PathLike
from pathlib import Path

import tomlkit

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.numbers import finite_numbers
from dmptm_ctrl.signals.toml_text import parse_toml
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

KIND = "chain"
SCHEMA = 1


def rig_model_to_toml(
    model: RigModel, rig_text: str, zeros: Mapping[str, Mapping[str, float]] | None = None
) -> str:
    """Return the text of a model file.

    Parameters
    ----------
    model : RigModel
    rig_text : str
        The rig file that it was declared in; a model file is complete in itself.
    zeros : mapping of log to mapping of effect to float, optional
        Shift of the encoder's zero in each log [rad or m].
    """
    document = tomlkit.document()
    document.add(tomlkit.comment("Drive model of dmptm-ctrl. SI units; angles in radians."))
    document["schema"] = SCHEMA
    document["kind"] = KIND
    document["rig"] = tomlkit.string(rig_text, multiline=True)
    values = tomlkit.table()
    for key, value in model.values.items():
        item = tomlkit.item(float(value))
        item.comment(model.quantities[key].unit or "1")
        values[key] = item
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
            item = tomlkit.item(float(value))
            item.comment(units[key] or "1")
            table[key] = item
        effects.append(table)
    document["effect"] = effects
    if zeros:
        logs = tomlkit.table()
        for log, shifts in zeros.items():
            if shifts:
                logs[log] = {key: float(shift) for key, shift in shifts.items()}
        document["zero"] = logs
    return tomlkit.dumps(document)


def rig_model_from_toml(
    text: str, name: str = "model.toml"
) -> tuple[RigModel, dict[str, dict[str, float]]]:
    """Read the text of a model file.

    Returns
    -------
    model : RigModel
    zeros : dict of log to dict of effect key to float

    Raises
    ------
    LogError
        Not TOML, another kind, a name that does not exist, a value that is no finite number.
    """
    data = parse_toml(text, name)
    if data.get("kind") != KIND or data.get("schema") != SCHEMA:
        raise LogError(f'{name}: needs kind = "{KIND}" and schema = {SCHEMA}, as diagnose writes')
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
    try:
        model = RigModel(rig, tuple(effects), values)
        model.plant()
    except (KeyError, ValueError) as error:
        raise LogError(f"{name}: {error.args[0]}") from None
    zeros = {log: finite_numbers(name, f"zero.{log}", shifts) for log, shifts in shifted.items()}
    return model, zeros


def read_rig_model(path: str | PathLike[str]) -> tuple[RigModel, dict[str, dict[str, float]]]:
    """Read a model file; see `rig_model_from_toml`."""
    file = Path(path)
    try:
        text = file.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise LogError(f"{file.name}: no readable model file there") from None
    return rig_model_from_toml(text, file.name)


def is_rig_model(path: str | PathLike[str]) -> bool:
    """Whether a model file is of a drive of any shape; False for what cannot be read."""
    try:
        return parse_toml(Path(path).read_text(encoding="utf-8"), "").get("kind") == KIND
    except (OSError, UnicodeDecodeError, LogError):
        return False
