"""Read and check a rig file; what may stand in it is in docs/rig_toml.md."""

import re
from collections.abc import Mapping
from math import inf, isfinite, pi
from os import PathLike
from pathlib import Path
from typing import Any, NoReturn

from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import (
    CONTACTS,
    FRICTION,
    Body,
    Controller,
    DeclaredEffect,
    Input,
    Link,
    Rig,
    Sensor,
    is_known,
    unknown,
)
from dmptm_ctrl.drive.rig_tables import RigError, Table, TableReader, suffix_unit
from dmptm_ctrl.drive.rig_units import UnitError, counted_per, counts, factor, in_counts, lead
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.signals.errors import repeated
from dmptm_ctrl.signals.toml_text import parse_toml
from dmptm_ctrl.signals.units import parse_unit

_NAMED = ("body", "shaft", "mesh", "input", "sensor", "effect")
_TOP = ("name", "body", "shaft", "mesh", "input", "sensor", "controller", "effect", "data")
_BODY = (
    *("inertia", "mass", "viscous", "coulomb", "static", "stribeck_speed", "stribeck_exponent"),
    *FRICTION,
)
_LINK = (
    *("between", "ratio", "lead", "stiffness", "damping", "half_gap", "backlash", "gap_damping"),
    "contact",
)
_INPUT = (
    *("column", "unit", "sign", "scale", "body", "gain", "amplifier", "torque_constant"),
    *("resistance", "inductance", "back_emf_constant", "delay", "time_constant", "limit"),
)
_SENSOR = (
    *("column", "unit", "sign", "scale", "body", "measures", "resolution", "counts_per_rev"),
    *("noise", "absolute"),
)
_CONTROLLER = ("kind", "input", "sensor", "kp", "ki", "kv", "reference", "unit", "limit")
_MEASURES = {
    "position": "position", "angle": "position", "speed": "speed", "velocity": "speed",
}  # fmt: skip


def load_rig(path: str | PathLike[str]) -> Rig:
    """Read a rig file.

    Parameters
    ----------
    path : path of a TOML file, see docs/rig_toml.md

    Returns
    -------
    Rig

    Raises
    ------
    RigError
        No such file, no TOML, a key that does not exist or is missing, a value that cannot
        be read; with line, key, and what would be right.

    Examples
    --------
    >>> dm.load_rig("rig.toml")
    <Rig 'paper': 5 bodies, 4 links, 2 inputs, 2 sensors>
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise RigError(f"no such rig file: {path}") from None
    except IsADirectoryError:
        raise RigError(f"{path.name} is a folder, not a rig file") from None
    except (OSError, UnicodeDecodeError) as error:
        raise RigError(f"{path.name} cannot be read as UTF-8 text; save it so") from error
    return parse_rig(text, path.name)


def parse_rig(text: str, source: str = "rig.toml") -> Rig:
    """Read a rig from the text of a file; see `load_rig`."""
    try:
        raw = parse_toml(text, source)
    except LogError as error:
        raise RigError(str(error)) from None
    return _Reader(text, source).rig(raw)


class _Reader(TableReader):
    """What each table of a rig stands for."""

    def rig(self, raw: dict[str, Any]) -> Rig:
        Table(self, "", raw, _TOP)
        tables = {kind: self.tables(raw, kind) for kind in _TOP if kind in _NAMED}
        ties: dict[str, str] = {}
        for kind in ("body", "shaft", "mesh"):
            tables[kind] = {n: self._like(kind, n, tables[kind], ties) for n in tables[kind]}
        if not tables["body"]:
            self.fail("", "", "no [body.NAME]: a rig has at least one body")
        bodies = tuple(self._body(name, t) for name, t in tables["body"].items())
        by_name = {b.name: b for b in bodies}
        links = tuple(
            self._link(kind, name, t, by_name)
            for kind in ("shaft", "mesh")
            for name, t in tables[kind].items()
        )
        self._tree(bodies, links)
        if not tables["input"]:
            self.fail("", "", "no [input.NAME]: without what drives it there is no diagnosis")
        if not tables["sensor"]:
            self.fail("", "", "no [sensor.NAME]: without a measurement there is no diagnosis")
        inputs = tuple(self._input(n, t, by_name) for n, t in tables["input"].items())
        sensors = tuple(self._sensor(n, t, by_name) for n, t in tables["sensor"].items())
        if twice := repeated([*(i.column for i in inputs), *(s.column for s in sensors)]):
            self.fail("", "", f"column {twice!r} is used twice; each input and sensor has its own")
        places = {*by_name, *(link.name for link in links)}
        places |= {*(i.name for i in inputs), *(s.name for s in sensors)}
        effects = tuple(self._effect(n, t, places) for n, t in tables["effect"].items())
        name = raw.get("name", "rig")
        return Rig(
            str(name) if isinstance(name, str) else self.fail("", "name", "name is no text"),
            bodies,
            links,
            inputs,
            sensors,
            effects,
            self._controller(raw.get("controller"), inputs, sensors),
            self.data(raw.get("data", {})),
            self._source,
            "\n".join(self._lines) + "\n",
            ties,
        )

    def _like(
        self, kind: str, name: str, tables: Mapping[str, Any], ties: dict[str, str]
    ) -> dict[str, Any]:
        """Return a table with what it does not say itself taken from the one that it is like."""
        t = Table(self, f"{kind}.{name}", tables[name])
        if (other := t.pop("like", None)) is None:
            return t
        t.known("like", other, {k: v for k, v in tables.items() if k != name}, kind)
        if "like" in tables[other]:
            t.fail("like", f"{other} is like another itself; name that one")
        begin = kind if kind == "body" else "link"
        taken = {k: v for k, v in tables[other].items() if k not in t}
        for key in taken:
            same = {"mass": "inertia", "backlash": "half_gap"}.get(key, key)
            ties[f"{begin}.{name}.{same}"] = f"{begin}.{other}.{same}"
        return taken | t

    # -- tables ------------------------------------------------------------------------------

    def _body(self, name: str, raw: dict[str, Any]) -> Body:
        t = Table(self, f"body.{name}", raw, _BODY)
        linear = "mass" in t
        if linear == ("inertia" in t):
            t.fail("", "give either inertia (it turns) or mass (it slides); 'unknown' will do")
        key, unit = ("mass", "kg") if linear else ("inertia", "kg·m²")
        force, speed = ("N", "m/s") if linear else ("N·m", "rad/s")
        units = {
            "static": force, "coulomb": force, "stribeck_speed": speed,
            "viscous": "N·s/m" if linear else "N·m·s/rad",
        }  # fmt: skip
        friction: dict[str, Quantity] = {}
        for kind, si in units.items():
            both = t.number(kind, si)
            sides = {s: t.number(f"{kind}_{s}", si) for s in ("plus", "minus")}
            given = [s for s, value in sides.items() if value is not None]
            if both is not None:
                friction[kind] = both
                if given:
                    t.fail(f"{kind}_{given[0]}", f"{kind} is given for both directions")
            elif len(given) == 1:
                missing = "minus" if given[0] == "plus" else "plus"
                t.fail(f"{kind}_{given[0]}", f"{kind}_{missing} is missing beside it")
            friction |= {f"{kind}_{s}": v for s, v in sides.items() if v is not None}
        if "stribeck_exponent" in t:
            friction["stribeck_exponent"] = t.need("stribeck_exponent", "")
        for key_ in ("static", "static_plus"):
            for other in ("stribeck_speed", "coulomb"):
                if key_ in friction and not {other, f"{other}_plus"} & set(friction):
                    t.fail(key_, f"a static friction needs a {other} beside it")
        inertia = t.need(key, unit)
        if is_known(inertia) and inertia.value == 0:
            of = f"{'an' if key[0] in 'aeiou' else 'a'} {key} of 0"
            t.fail(key, f"{of} cannot be; write 'unknown' if it is not known")
        return Body(name, inertia, linear, friction)

    def _link(self, kind: str, name: str, raw: dict[str, Any], bodies: Mapping[str, Body]) -> Link:
        t = Table(self, f"{kind}.{name}", raw, _LINK)
        ends = t.get("between")
        if not isinstance(ends, list) or len(ends) != 2:
            t.fail("between", 'between = ["first body", "second body"] is needed')
        for end in ends:
            t.known("between", end, bodies, "body")
        first, second = bodies[ends[0]], bodies[ends[1]]
        ratio_unit = f"{first.angle_unit}/{second.angle_unit}"
        if first.angle_unit == second.angle_unit:
            ratio_unit = ""
        if "lead" in t:
            if first.linear or not second.linear:
                t.fail("lead", "a lead is from a turning first body to a sliding second")
            try:
                travel = lead(t["lead"])
            except UnitError as error:
                t.fail("lead", f"lead: {error}")
            ratio = Quantity(2 * pi / travel.value, "rad/m", travel.tolerance, travel.source)
        elif "ratio" in t:
            ratio = t.need("ratio", ratio_unit, exact=True, positive=False)
        elif ratio_unit:
            t.fail("", f"a ratio in {ratio_unit}, or a lead per turn, is needed")
        else:
            ratio = Quantity(1.0, "", 0.0, "default")
        if not is_known(ratio) or ratio.value == 0:
            t.fail("ratio", "the ratio must be a number other than 0")
        unit, force = first.angle_unit, first.force_unit
        gap = t.number("half_gap", unit)
        if "backlash" in t:
            if gap is not None:
                t.fail("backlash", "give half_gap or backlash, which is twice that")
            full = t.need("backlash", unit)
            gap = Quantity(full.value / 2, unit, full.tolerance, full.source)
        stiff_raw = t.get("stiffness", "rigid" if kind == "shaft" and gap is None else "unknown")
        rigid = isinstance(stiff_raw, str) and stiff_raw.strip().lower() == "rigid"
        stiffness = None if rigid else t.read("stiffness", stiff_raw, f"{force}/{unit}")
        if rigid and gap is not None:
            t.fail("stiffness", "a gap needs a stiffness of the teeth; write 'unknown'")
        per_speed = "N·s/m" if first.linear else "N·m·s/rad"
        contact = t.get("contact", CONTACTS[0])
        if contact not in CONTACTS or (gap is None and "contact" in t):
            t.fail("contact", f"contact of a gap is one of {', '.join(CONTACTS)}")
        damps = f"s/{unit}" if contact == "impact" else per_speed
        damping = t.number("damping", damps)
        return Link(
            name,
            ends[0],
            ends[1],
            ratio,
            stiffness,
            None if rigid else damping or unknown(damps),
            gap,
            t.number("gap_damping", per_speed),
            kind == "mesh",
            contact,
        )

    def _input(self, name: str, raw: dict[str, Any], bodies: Mapping[str, Body]) -> Input:
        t = Table(self, f"input.{name}", raw, _INPUT)
        body = _one_body(t, bodies)
        column = t.text("column")
        t.either("gain", "torque_constant", "amplifier", "resistance")
        t.either("amplifier", "resistance")
        t.either("time_constant", "inductance")
        for key in ("inductance", "back_emf_constant"):
            if key in t and "resistance" not in t:
                t.fail(key, f"{key} needs a resistance beside it")
        unit, symbol = t.column_unit(column, implied=_gain_unit(t))
        per = f"{body.force_unit}/{symbol}" if symbol else body.force_unit
        factors = {}
        back_emf = 0.0
        if "resistance" in t:
            if symbol != "V":
                t.fail("resistance", f"the column is in {symbol}; a resistance needs V")
            constant = t.need("torque_constant", "N·m/A", exact=True)
            ohms = t.need("resistance", "ohm", exact=True)
            if ohms.value == 0:
                t.fail("resistance", "a resistance of 0 cannot be")
            emf = t.number("back_emf_constant", "V*s/rad") or constant
            gain = Quantity(constant.value / ohms.value, per, ohms.tolerance, "torque_constant/R")
            back_emf = constant.value * emf.value / ohms.value
            factors = {"torque_constant": constant, "resistance": ohms}
            if "inductance" in t:
                factors["inductance"] = henry = t.need("inductance", "henry", exact=True)
                t["time_constant"] = henry.value / ohms.value
        elif "amplifier" in t or "torque_constant" in t:
            constant = t.need("torque_constant", f"{body.force_unit}/A", exact=True)
            factors = {"torque_constant": constant}
            value, tolerance = constant.value, constant.tolerance
            if "amplifier" in t:
                amp = t.need("amplifier", f"A/{symbol}", exact=True)
                factors["amplifier"] = amp
                value, tolerance = value * amp.value, tolerance + amp.tolerance
            elif symbol != "A":
                t.fail(
                    "torque_constant",
                    f"the column is in {symbol}; give an amplifier (A/{symbol}) or resistance",
                )  # fmt: skip
            gain = Quantity(value, per, tolerance, constant.source)
        elif "gain" in t:
            gain = t.read("gain", t["gain"], per, exact=True, positive=False)
            text = _gain_text(t)
            if symbol == "%" and is_known(gain) and "N" in text and "/" not in text:
                t.fail("gain", f"gain {text.strip()!r} is per what? Write it per percent: … {per}")
        elif symbol == body.force_unit:
            gain = Quantity(1.0, "", 0.0, "the column is the torque or force itself")
        else:
            gain = unknown(per)
        if is_known(gain) and gain.value == 0:
            t.fail("gain", "a gain of 0 drives nothing; write 'unknown' if so")
        return Input(
            name, column, unit, body.name, gain, t.sign(), back_emf,
            t.number("delay", "s"),
            t.number("time_constant", "s"),
            t.number("limit", symbol), factors,
        )  # fmt: skip

    def _sensor(self, name: str, raw: dict[str, Any], bodies: Mapping[str, Body]) -> Sensor:
        t = Table(self, f"sensor.{name}", raw, _SENSOR)
        body = _one_body(t, bodies)
        column = t.text("column")
        given = t.get("measures")
        if given is not None and given not in _MEASURES:
            t.fail("measures", 'measures = "position" or "speed"')
        step = _count(t, body)
        counted = counted_per(str(t.get("unit", "")))
        if step is not None and counted is not None:
            unit = symbol = body.angle_unit + ("" if counted == "" else "/s")
            scale = step / (factor(counted, "s") if counted else 1.0)
        else:
            unit, symbol = t.column_unit(column)
            scale = 1.0
        by_unit = {body.angle_unit: "position", f"{body.angle_unit}/s": "speed"}
        measures = _MEASURES.get(str(given)) or by_unit.get(symbol)
        si = body.angle_unit + ("/s" if measures == "speed" else "")
        if symbol != si or measures is None:
            if symbol in by_unit:
                t.fail("measures", f"column {column!r} is in {symbol}, no {measures}")
            _wrong_unit(t, column, symbol, body)
        absolute = t.get("absolute", False)
        if not isinstance(absolute, bool):
            t.fail("absolute", "absolute is true or false")
        resolution = None
        if step is not None and measures == "position":
            t.either("counts_per_rev", "resolution")
            resolution = Quantity(step, si, 0.0, "counts")
        elif step is None or "counts_per_rev" in t:
            resolution = _in_counts(t, "resolution", step, si)
        return Sensor(
            name, column, unit, body.name, measures, scale * t.sign(),
            resolution, _in_counts(t, "noise", step, si), absolute,
        )  # fmt: skip

    def _controller(
        self, raw: Any, inputs: tuple[Input, ...], sensors: tuple[Sensor, ...]
    ) -> Controller | None:
        if raw is None:
            return None
        t = Table(self, "controller", raw, _CONTROLLER)
        kind = t.get("kind")
        if kind not in ("pi_speed", "cascade"):
            t.fail("kind", 'kind = "pi_speed" or "cascade"')
        source = {i.name: i for i in inputs}
        sensor = {s.name: s for s in sensors}
        to = t.get("input", inputs[0].name)
        of = t.get("sensor", sensors[0].name)
        t.known("input", to, source, "input")
        t.known("sensor", of, sensor, "sensor")
        gains = {}
        for key in ("kp", "ki", "kv"):
            value = t.get(key)
            if isinstance(value, str):
                value = re.split(r"\s", value.strip())[0]
            try:
                gains[key] = float(value or 0.0)
                if not isfinite(gains[key]):
                    raise ValueError
            except (TypeError, ValueError):
                t.fail(key, f"{key} = {value!r} is no number (SI)")
        reference = t.text("reference")
        unit, _ = t.column_unit(reference, implied=sensor[of].unit)
        limit = t.number("limit", parse_unit(source[to].unit).symbol)
        return Controller(kind, to, of, gains, reference, unit, limit.value if limit else inf)

    def _effect(self, name: str, raw: dict[str, Any], places: set[str]) -> DeclaredEffect:
        t = Table(self, f"effect.{name}", raw)
        on = t.pop("on", "")
        if not isinstance(on, str) or (on and on not in places):
            t.fail("on", f"no {on!r} in the rig; it has {', '.join(sorted(places))}")
        values = {}
        for key, value in t.items():
            if not isinstance(value, int | float) or isinstance(value, bool):
                t.fail(key, f"{key} = {value!r}: parameters of an effect are SI numbers")
            if not isfinite(value) or (key == "stiffness" and value < 0):
                wanted = "zero or more" if key == "stiffness" else "a finite number"
                t.fail(key, f"{key} is {value:g}; it must be {wanted}")
            values[key] = Quantity(float(value), "", 0.0, "rig file")
        return DeclaredEffect(name, on, values)

    # -- parts -------------------------------------------------------------------------------

    def _tree(self, bodies: tuple[Body, ...], links: tuple[Link, ...]) -> None:
        group = {b.name: b.name for b in bodies}
        for link in links:
            one, other = group[link.first], group[link.second]
            kind = "mesh" if link.mesh else "shaft"
            if one == other:
                self.fail(
                    f"{kind}.{link.name}", "between",
                    f"this closes a ring of bodies: {link.first} and {link.second} are joined "
                    "already. For a shaft and a gear one after the other write one [mesh], with "
                    "the shaft's stiffness in it, or a body between them",
                )  # fmt: skip
            group = {k: one if g == other else g for k, g in group.items()}
        if len(set(group.values())) > 1:
            odd = next(b.name for b in bodies if group[b.name] != group[bodies[0].name])
            self.fail(
                f"body.{odd}", "", f"nothing joins {odd} to {bodies[0].name}; add a [shaft.NAME]"
            )


def _count(t: Table, body: Body) -> float | None:
    """Size of one count of an encoder [rad or m]; None where the file does not say."""
    turn = f"counts/{'m' if body.linear else 'rev'}"
    given = t.get("counts_per_rev")
    if isinstance(given, int | float) and not isinstance(given, bool):
        given = f"{given!r} counts/rev"
    try:
        step = counts(given if given is not None else t.get("resolution"), body.angle_unit)
    except UnitError as error:
        key = "resolution" if given is None else "counts_per_rev"
        t.fail(key, f"{error}; write '8192 {turn}'")
    if step is None and given is not None:
        t.fail("counts_per_rev", "counts_per_rev is a number above 0, such as 8192")
    if step is None and counted_per(str(t.get("unit", ""))) is not None:
        t.fail(
            "unit", f"counts of what size? Add resolution = '8192 {turn}' (a quadrature "
            "encoder counts four times its lines)",
        )  # fmt: skip
    return step


def _in_counts(t: Table, key: str, step: float | None, si: str) -> Quantity | None:
    """Number of a sensor, also in counts of this size; None if it is not there."""
    if key not in t:
        return None
    try:
        return t.read(key, in_counts(t[key], step, si.removesuffix("/s")), si)
    except UnitError as error:
        t.fail(key, f"{key}: {error}")


def _wrong_unit(t: Table, column: str, symbol: str, body: Body) -> NoReturn:
    how = f"{'slides' if body.linear else 'turns'}: {body.angle_unit} or {body.angle_unit}/s"
    how += '; of an encoder unit = "counts", with counts_per_rev' * (not symbol)
    if "unit" in t:
        t.fail("unit", f"column {column!r} is in {symbol or 'no unit'}, but {body.name} {how}")
    t.fail(
        "column", f"column {column!r} has no unit of its own (its ending "
        f"{suffix_unit(column)!r} would be in {symbol}), and {body.name} {how}; add unit = "
        f'"{body.angle_unit}" or its like',
    )  # fmt: skip


def _one_body(t: Table, bodies: Mapping[str, Body]) -> Body:
    name = t.get("body", next(iter(bodies)) if len(bodies) == 1 else None)
    if name is None:
        t.fail("", f"body = … is missing; bodies are {', '.join(bodies)}")
    t.known("body", name, bodies, "body")
    return bodies[name]


def _gain_text(t: Mapping[str, Any]) -> str:
    """Value and unit of an amplifier or a gain, as written."""
    gain: Any = t.get("amplifier", t.get("gain", ""))
    return (
        f"{gain.get('value', '')} {gain.get('unit', '')}" if isinstance(gain, dict) else str(gain)
    )


def _gain_unit(t: Mapping[str, Any]) -> str | None:
    """Unit of the signal from what the gain is per: "35 N/V" → V."""
    if "resistance" in t:
        return "V"
    match = re.search(r"/\s*(\w+)", _gain_text(t))
    if match is not None and match[1] not in ("rad", "deg", "s"):
        return match[1]
    return "A" if "torque_constant" in t and "amplifier" not in t else None
