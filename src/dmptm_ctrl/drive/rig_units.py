"""Declared numbers as people write them: "2.1e-4 kg m^2 ± 10 %", or a table with a source."""

import re
from dataclasses import replace
from math import inf, isfinite, pi
from typing import Any

import pint

from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import DEFAULT_TOLERANCE, Rig, unknown
from dmptm_ctrl.signals.units import COUNTS, one_of, parse_unit, plain

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_TEXT = re.compile(
    rf"^\s*(?P<value>{_NUMBER})\s*(?P<unit>[^±]*?)\s*"
    rf"(?:(?:±|\+/?-)\s*(?P<tol>{_NUMBER})\s*(?P<tol_unit>[^±]*?)\s*)?$"
)
_AROUND = re.compile(r"^\s*\((?P<inside>[^()]*±[^()]*|[^()]*\+/?-[^()]*)\)(?P<unit>[^±]*)$")
_PER_MINUTE = re.compile(r"\s*(?:1\s*/\s*min|min\s*(?:\^?-1|⁻¹))\s*")
_PERCENT = re.compile(r"(?:%|percent\b)\s*")
_COUNTS = ("ticks", "tick", *COUNTS)
_PER_TURN = re.compile(
    rf"^\s*(\d+\.?\d*(?:[eE]\+?\d+)?)\s*(?:{'|'.join(_COUNTS)})\s*(?:/|per)\s*(\w+)\s*$"
)
_BITS = re.compile(r"\s*(\d{1,2})\s*-?bits?\s*", re.I)
_RATIO = re.compile(rf"^\s*({_NUMBER})\s*[:/]\s*({_NUMBER})(?=\s*(?:±|\+/?-|$))")
_NO_ANGLE = re.compile(rf"(?:{'|'.join(_COUNTS)}|bits?|percent|permille)\b|[%‰]", re.I)
_COUNTED = re.compile(rf"\s*(?:{'|'.join(_COUNTS)})\s*(?:(?:/|per\b|_)\s*(s|ms|us|min))?\s*", re.I)


def counted_per(unit: str) -> str | None:
    """Unit of time in "counts/s", "" for "counts"; None for what is not counted."""
    match = _COUNTED.fullmatch(unit)
    return None if match is None else match[1] or ""


class UnitError(ValueError):
    """A number or unit that cannot be read; the message says what would be right."""


def factor(unit: str, si: str) -> float:
    """Number that turns a value in `unit` into `si`; UnitError where there is none."""
    if "rad" in si and _PER_MINUTE.fullmatch(unit):
        unit = "rpm"
    try:
        given = one_of(unit)
    except ValueError as error:
        right = f"write it as in {si}" if si else "a plain number has none"
        raise UnitError(f"{unit[:40]!r} is no unit; {right}") from error
    if si.startswith("rad") and _NO_ANGLE.match(unit):  # numbers without a unit, to pint
        raise UnitError(f"{unit[:40]!r} is of another quantity than {si}")
    # An angle is a number here: N·m/rad is as good as N·m.
    try:
        return float(given.to(plain(si) or "dimensionless").magnitude)
    except pint.DimensionalityError:
        raise UnitError(f"{unit!r} is of another quantity than {si or 'a plain number'}") from None


def quantity(raw: Any, si: str, *, exact: bool = False, positive: bool = True) -> Quantity:
    """Read a declared number in the unit `si`; UnitError where it cannot be read.

    It is ``"2.1e-4 kg m^2 ± 10 %"``, ``"3 N m/rad"``, ``"unknown"``, a number in SI, or
    ``{value = 3, unit = "…", tolerance = "10 %", range = [1, 10], source = "…"}``. With `exact` a
    value that states no tolerance has none, instead of 30 %; `positive` refuses negative values.
    """
    if isinstance(raw, dict):
        return _from_table(raw, si, exact=exact, positive=positive)
    if isinstance(raw, str) and raw.strip().lower() in ("unknown", "?", "free"):
        return unknown(si)
    if isinstance(raw, str) and not si:
        raw = _RATIO.sub(_quotient, raw)  # 10:1
    match = _matched(raw) if isinstance(raw, str) else None
    if match is None and (isinstance(raw, bool) or not isinstance(raw, int | float)):
        raise UnitError(f"{raw!r} is no number with a unit; write it as in {_as_in(si)}")
    if match is not None:
        if match["unit"].startswith(","):
            if "." in match["unit"]:
                raise UnitError(f"{raw!r} has a comma between thousands; leave it out")
            raise UnitError(f"{raw!r} has a decimal comma; write a point, as in {_as_in(si)}")
        # "95 kg ± 5" and "95 ± 5 kg" mean 5 kg; of "95 ± 5 % kg" the percent is the tolerance's
        share = match["tol"] is not None and _PERCENT.match(match["tol_unit"])
        behind = match["tol_unit"][share.end() :] if share else match["tol_unit"]
        if share and behind and match["unit"]:
            raise UnitError(f"{raw!r} has two units; write it as in {_as_in(f'{si} ± 10 %')}")
        unit = match["unit"] or behind
        value = float(match["value"]) * (factor(unit, si) if unit else 1.0)
        tol_unit = "%" if share else behind or unit or si
        tolerance = _tolerance(match["tol"], tol_unit, value, si, exact)
    else:
        value, tolerance = float(raw), 0.0 if exact else DEFAULT_TOLERANCE
    return _checked(Quantity(value, si, tolerance, "rig file"), positive)


def _quotient(match: re.Match[str]) -> str:
    """Number of a ratio such as 50/3."""
    by = float(match[2])
    return repr(float(match[1]) / by) if by else match[0]


def _as_in(unit: str, number: str = "1.5") -> str:
    return f"'{number} {unit}'" if unit else f"'{number}'"


def _matched(text: str) -> re.Match[str] | None:
    """Parts of a number with a unit and a tolerance, also of "(2.1 ± 0.2) kg"."""
    around = _AROUND.match(text)
    return _TEXT.match(text if around is None else f"{around['inside']} {around['unit']}")


def counts(raw: Any, si: str) -> float | None:
    """Size of a count [rad or m] from "8192 counts/rev", "50 counts/mm", "17 bit"; else None."""
    if isinstance(raw, str) and (bits := _BITS.fullmatch(raw)) is not None:
        if si != "rad":
            raise UnitError(f"{raw!r} of what length")
        return float(2 * pi / 2 ** int(bits[1]))
    match = _PER_TURN.match(raw) if isinstance(raw, str) else None
    if match is None:
        return None
    if float(match[1]) == 0:
        raise UnitError(f"{raw!r}: no counts at all")
    return factor(match[2], si) / float(match[1])


def in_counts(raw: Any, count: float | None, si: str) -> Any:
    """Return a number of counts, "2 counts" or "2 counts/s", in `si` [rad or m]; else as it is."""
    match = _TEXT.match(raw) if isinstance(raw, str) else None
    if match is None or (per := counted_per(match["unit"])) is None:
        return raw
    if count is None:
        raise UnitError(f"{match['unit']} of what size? Give counts_per_rev, or write it in {si}")
    size = count / (factor(per, "s") if per else 1.0)
    return f"{float(match['value']) * size!r} {si}{'/s' * bool(per)}"


def lead(raw: Any) -> Quantity:
    """Travel per turn [m] from "10 mm", "10 mm/rev", "0.2 in per turn"."""
    read = quantity(raw, "m", exact=True)
    if read.value == 0:
        raise UnitError("a lead of 0 moves nothing")
    text = f"{raw.get('value')} {raw.get('unit')}" if isinstance(raw, dict) else str(raw)
    per_angle = re.search(r"/|\bper\b", text)
    return replace(read, value=read.value * 2 * pi) if per_angle else read


_TABLE_KEYS = ("value", "unit", "tolerance", "range", "source")


def _from_table(raw: dict[str, Any], si: str, *, exact: bool, positive: bool) -> Quantity:
    wrong = [key for key in raw if key not in _TABLE_KEYS]
    if wrong:
        raise UnitError(f"a number has no {wrong[0]!r}; it has {', '.join(_TABLE_KEYS)}")
    source = str(raw.get("source", "rig file"))
    if "value" not in raw or str(raw["value"]).strip().lower() == "unknown":
        return unknown(si)
    if isinstance(raw["value"], str):
        text = raw["value"] + (f" {raw['unit']}" if "unit" in raw else "")
        read = quantity(text, si, exact=exact, positive=positive)
        value, tolerance = read.value, read.tolerance
        match = _matched(text)
        number = float(match["value"]) if match else 0.0
        scale = value / number if number else 1.0  # ends of a range are in the value's unit
    else:
        scale = factor(str(raw["unit"]), si) if raw.get("unit") else 1.0
        value, tolerance = float(raw["value"]) * scale, 0.0 if exact else DEFAULT_TOLERANCE
    if "tolerance" in raw:
        given = raw["tolerance"]
        match = re.match(rf"^\s*({_NUMBER})\s*(.*?)\s*$", str(given))
        if match is None:
            raise UnitError(f"tolerance {given!r} is no number; write '10 %' or '0.5 {si}'")
        unit = match[2]
        if not unit and (isinstance(given, str) or abs(given) >= 1):
            own = f" or {_as_in(si, match[1])}" if si else ""
            raise UnitError(f"tolerance {given!r} has no unit; write '{match[1]} %'{own}")
        tolerance = _tolerance(match[1], unit, value, si, exact)
    low = high = None
    if "range" in raw:
        ends = raw["range"]
        if not isinstance(ends, list) or len(ends) != 2:
            raise UnitError(f"range {ends!r} is not [lowest, highest]")
        low, high = (
            float(e) * scale if isinstance(e, int | float) else quantity(e, si).value for e in ends
        )
        if not low <= value <= high:
            raise UnitError(f"value {value:g} {si} is outside its range {low:g} to {high:g}")
        tolerance = 0.0
    return _checked(Quantity(value, si, tolerance, source, low, high), positive)


def _tolerance(text: str | None, unit: str, value: float, si: str, exact: bool) -> float:
    """Relative tolerance."""
    if text is None:
        return 0.0 if exact else DEFAULT_TOLERANCE
    amount = abs(float(text))
    if unit in ("%", "percent"):
        return amount / 100
    if unit == "":
        return amount
    return amount * factor(unit, si) / abs(value) if value else inf


def _checked(found: Quantity, positive: bool) -> Quantity:
    if not isfinite(found.value):
        raise UnitError("the value is not finite; write a number, or 'unknown'")
    if positive and found.value < 0:
        raise UnitError(f"{found.value:g} {found.unit} is negative")
    return found


def unit_at(on: str, rig: Rig, unit: str) -> str:
    """Unit of an effect's parameter where it stands: an input's signal need not be a voltage."""
    if all(source.name != on for source in rig.inputs):
        return unit
    symbol = input_symbol(rig, on)
    return unit.replace("V", f"({symbol})" if unit == "1/V" and "·" in symbol else symbol)


def input_symbol(rig: Rig, name: str) -> str:
    """SI unit of an input's signal; of a number what the rig file calls it, or its column."""
    source = next(i for i in rig.inputs if i.name == name)
    called = source.column if source.unit.strip() in ("", "1") else source.unit
    return parse_unit(source.unit).symbol or called
