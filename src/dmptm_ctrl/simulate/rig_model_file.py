"""The model of a rig of any shape as a file: the rig file's text, its fitted values, effects."""

import tomlkit

from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.numbers import finite_numbers
from dmptm_ctrl.signals.toml_text import parse_toml
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

KIND = "chain"
SCHEMA = 1


def with_unit(value: float, unit: str) -> tomlkit.items.Item:
    """Return a number for a document, its unit in a comment beside it."""
    item = tomlkit.item(float(value))
    item.comment(unit or "1")
    return item


def unit_at(effect: Placed, rig: Rig, unit: str) -> str:
    """Unit of an effect's parameter where it stands: an input's signal need not be a voltage."""
    if all(source.name != effect.on for source in rig.inputs):
        return unit
    symbol = input_symbol(rig, effect.on)
    return unit.replace("V", f"({symbol})" if unit == "1/V" and "·" in symbol else symbol)


def input_symbol(rig: Rig, name: str) -> str:
    """SI unit of an input's signal."""
    return parse_unit(next(i for i in rig.inputs if i.name == name).unit).symbol


def rig_model_to_toml(model: RigModel) -> str:
    """Return the text of a model file, complete in itself: the rig file's text is in it."""
    document = tomlkit.document()
    document.add(tomlkit.comment("Drive model of dmptm-ctrl. SI units; angles in radians."))
    document["schema"] = SCHEMA
    document["kind"] = KIND
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
            table[key] = with_unit(value, unit_at(effect, model.rig, units[key]))
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
    """Read the text of a model file.

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
    zeros = {log: finite_numbers(name, f"zero.{log}", shifts) for log, shifts in shifted.items()}
    try:
        model = RigModel(rig, tuple(effects), values, zeros)
        model.plant()
    except (KeyError, ValueError) as error:
        raise LogError(f"{name}: {error.args[0]}") from None
    return model
