"""Units of logged columns: a column is called NAME_UNIT, everything inside is SI and radians."""

import re
from functools import cache
from math import pi
from typing import Any, NamedTuple

from dmptm_ctrl.signals.errors import LogError


class Unit(NamedTuple):
    """How a logged unit becomes SI: value_SI = factor · value."""

    symbol: str  # SI symbol, "" for a pure number
    factor: float


_DEG = pi / 180
_REV = 2 * pi

# Column suffix -> SI. Checked against pint in the tests.
_TABLE = {  # SI symbol -> column suffixes and their factors
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
    "V": {"V": 1.0, "mV": 1e-3},
    "A": {"A": 1.0, "mA": 1e-3},
    "N·m": {"Nm": 1.0, "mNm": 1e-3},
    "N": {"N": 1.0, "kN": 1e3},
    "rad": {
        "rad": 1.0, "mrad": 1e-3, "deg": _DEG, "arcmin": _DEG / 60, "arcsec": _DEG / 3600,
        "rev": _REV, "turn": _REV,
    },
    "rad/s": {
        "rad_s": 1.0, "mrad_s": 1e-3, "deg_s": _DEG, "rev_s": _REV, "rpm": _REV / 60,
        "rev_min": _REV / 60,
    },
    "rad/s²": {"rad_s2": 1.0, "deg_s2": _DEG},
    "m": {"m": 1.0, "mm": 1e-3, "um": 1e-6},
    "m/s": {"m_s": 1.0, "mm_s": 1e-3},
    "m/s²": {"m_s2": 1.0, "g": 9.80665},  # standard gravity, as accelerometers print it
    "Hz": {"Hz": 1.0},
    "W": {"W": 1.0},
    "K": {"K": 1.0},
    "%": {"percent": 1.0, "pct": 1.0, "permille": 0.1},  # of what, the gain says
}  # fmt: skip
SUFFIXES = {
    suffix: Unit(symbol, factor)
    for symbol, factors in _TABLE.items()
    for suffix, factor in factors.items()
}

TICKS = ("ticks", "tick", "100ns", "100 ns", "filetime")  # of a clock: 100 ns on Windows
# What counts, as encoders do.
COUNTS = (
    *("count", "counts", "cnt", "cnts", "cts", "inc", "incr", "increments", "pulses", "steps"),
    *("inkr", "ink", "inkremente", "imp", "impulse"),
)
_NUMBERS = (  # a signal in such is a number; its gain says what it stands for
    *("", "1", "-", *COUNTS, "lsb", "digit", "digits", "pwm", "raw", "bool", "none"),
)
# Of what stands beside a drive's signals; no quantity of a drive.
FOREIGN = (
    *("°c", "degc", "°f", "degf", "bar", "mbar", "pa", "kpa", "mpa", "l/min", "ohm", "kw", "db"),
)
_SPELLINGS = {
    "%": "percent", "pwm %": "percent", "% pwm": "percent", "pwm%": "percent",
    "‰": "permille", "promille": "permille", "arms": "A", "apk": "A", "adc": "A", "vrms": "V",
    "vdc": "V", "volt": "V", "volts": "V", "amp": "A", "amps": "A", "ampere": "A",
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "msec": "ms", "usec": "us",
    "degree": "deg", "degrees": "deg", "grad": "deg", "°": "deg", "u/min": "rpm", "1/min": "rpm",
    "min-1": "rpm", "min^-1": "rpm", "min⁻¹": "rpm", "upm": "rpm", "nmm": "mNm", "n.m": "Nm",
    "newton": "N", "radian": "rad", "radians": "rad", "meter": "m", "metre": "m",
    "umdr": "rev", "umdr.": "rev", "umdrehungen": "rev",
}  # fmt: skip

CANONICAL = ("time", "u_left", "u_right", "theta_L", "omega_L", "theta_ml", "theta_mr", "ref")

_SYMBOL_OF = {"time": "s", "u_left": "V", "u_right": "V", "ref": "rad/s"}
_SYMBOL_OF_STEM = {"theta": "rad", "omega": "rad/s"}


def expected_symbol(channel: str) -> str | None:
    """SI symbol that a channel must have by its name; None if the name is free."""
    return _SYMBOL_OF.get(channel) or _SYMBOL_OF_STEM.get(channel.split("_")[0])


def split_column(column: str) -> tuple[str, Unit] | None:
    """Split NAME_UNIT into the name and its unit, the longest known suffix first.

    ``omega_L_deg_s`` is omega_L in deg/s, not omega_L_deg in seconds. None if the column
    ends in no known unit.
    """
    parts = column.split("_")
    for length in (2, 1):
        unit = SUFFIXES.get("_".join(parts[-length:]))
        if unit is not None and len(parts) > length:
            return "_".join(parts[:-length]), unit
    return None


def parse_unit(text: str) -> Unit:
    """Unit from its text: a suffix of the table ("deg_s"), or an expression ("deg/s", "kgf*m").

    LogError if it does not convert to SI by a factor alone.
    """
    given = text.strip().replace("·", "*").replace("²", "**2").replace("µ", "u")
    suffix = given.replace("/", "_").replace("*", "").replace("^", "")
    if suffix in SUFFIXES:
        return SUFFIXES[suffix]
    if given.lower() in TICKS:
        return Unit("s", 1e-7)
    if given.lower() in _NUMBERS:
        return Unit("", 1.0)
    if given.lower() in _SPELLINGS:
        return SUFFIXES[_SPELLINGS[given.lower()]]
    return _parse_with_pint(given)


def unit_of(text: str) -> Unit | None:
    """Unit of a drive's signals, None if it is none."""
    try:
        return parse_unit(text)
    except LogError:
        return None


_IN_BRACKETS = re.compile(r"(?P<name>.*?[^\s/])\s*(?P<unit>\[[^\[\]]*\]|\([^()]*\))\s*$")
_AFTER_WORD = re.compile(r"(?P<name>.*\S)(?:\s+/|\s+in|,)\s+(?P<unit>\S+)$")
_AFTER_SLASH = re.compile(r"(?P<name>[^/\s][^/]*)/(?P<unit>\S+|\([^()]+\))$")  # q/deg, v/(m/s)


def named_unit(column: str) -> tuple[str, str]:
    """Split ``q [deg]``, ``q (deg)``, ``q / deg``, ``q/deg``, ``q in deg``; the unit may be empty.

    Brackets that hold no unit, as in ``motor (left)`` or ``q[0]``, belong to the name.
    """
    if unit_of(column) is not None:
        return column, ""
    for form in (_IN_BRACKETS, _AFTER_WORD, _AFTER_SLASH):
        if (match := form.match(column)) is not None:
            unit = match["unit"].strip("()[] ")
            plain = not unit or unit.isdigit() or unit_of(unit) is None
            return (column, "") if plain else (match["name"], unit)
    return column, ""


# What pint may see: products and quotients of names with exponents of one digit. Its parser
# would compute 9**9**9 to the end.
_EXPRESSION = re.compile(r"(1\s*/\s*)?[^\W\d_]+(\*\*-?\d)?([\s*/]+[^\W\d_]+(\*\*-?\d)?){0,6}")


_RUN_TOGETHER = (  # written without a space, pint reads them as something else
    (r"\b([mcuk]?)Nms\b", r"\1N*m*s"),
    (r"\b([mcuk]?)Nm\b", r"\1N*m"),
    (r"\bNcm\b", "N*cm"),
    (r"\bVs\b", "V*s"),
    (r"\b(oz|lb)f?[-.· ]?(in|ft)\b(?!\*\*2)", r"\1f*\2"),  # lb in² is of masses
    (r"\b(in|ft)[-.· ]?(oz|lb)f?\b", r"\2f*\1"),
    (r"\s+per\s+", "/"),
    (r"/\s*\(\s*1\s*/\s*min\s*\)", "/rpm"),  # turns, of a motor
    (r"(?<=[/\d])\s*min(\s*\*\*\s*)?-1", " rpm"),
    (r"(?<=[A-Za-z])[.-](?=[A-Za-z])", "*"),
    (r"(?i)\brpm\b", "rpm"),
    (r"\b[Gg]rad\b", "deg"),
    (r"^(Umdr|U|tr|r)\.?(?=/)", "turn"),
    (r"(?<=/)\s*(Umdr|U|tr)\.?$", "turn"),
    (r"\b1000\s*[*/]?\s*rpm\b", "krpm"),
    (r"\bkgm", "kg*m"),
    (r"\bkgcm", "kg*cm"),
    (r"\bgcm", "g*cm"),
    (r"\brevs?\b|\brevolutions?\b", "turn"),
    (r"%|\bpct\b", "percent"),
    (r"‰|\b[Pp]romille\b", "permille"),
    (r"\b(?:pwm|PWM|lsb|LSB|digits?|inc|increments?|ticks?)\b", "count"),  # a number, to pint
)


def plain(unit: str) -> str:
    """Unit in the spelling that pint reads: ``kg·m²`` → ``kg*m**2``."""
    text = unit.strip().replace("·", "*").replace("²", "**2").replace("³", "**3")
    text = text.replace("µ", "u").replace("μ", "u").replace("°", "deg").replace("^", "**")
    text = text.replace("Ω", "ohm").replace("⁻¹", "**-1")
    text = re.sub(r"/\s*\(([^()]+)\)", _divided, text)
    for pattern, right in _RUN_TOGETHER:
        text = re.sub(pattern, right, text)
    text = re.sub(r"(?<=[A-Za-z])([23])(?!\d)", r"**\1", text)
    return re.sub(r"\s*\*\s*", "*", text)


def _divided(match: re.Match[str]) -> str:
    """Division by what stands in brackets: "/(rad/s)" is "/rad*s"."""
    inside = match[1].strip()
    if inside.startswith("1"):  # 1/min, 1000 rpm
        return match[0] if "/" in inside else f"/{inside}"
    turned = re.sub(r"/|(?<!\*)\*(?!\*)|\s+", lambda m: "*" if m[0] == "/" else "/", inside)
    return f"/{turned}"


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


def one_of(unit: str) -> Any:
    """Return one of a unit as pint's quantity; ValueError where pint knows none such."""
    text = plain(unit)
    try:
        if len(text) > 40 or not _EXPRESSION.fullmatch(text):
            raise ValueError(unit)
        return _registry().Quantity(1.0, text)
    except Exception as error:  # pint raises its own, tokenizer's and arithmetic errors
        raise ValueError(unit) from error


_KNOWN = ", ".join((*SUFFIXES, "%", "counts", "PWM"))


def _parse_with_pint(text: str) -> Unit:
    try:
        quantity = one_of(text)
        for unit in SUFFIXES.values():
            base = plain(unit.symbol)
            if quantity.to_root_units().units == one_of(base).to_root_units().units:
                if type(quantity)(0.0, quantity.units).to(base).magnitude != 0:
                    break  # °C and the like have another zero
                return Unit(unit.symbol, float(quantity.to(base).magnitude))
    except Exception as error:
        raise LogError(f"unknown unit {text[:40]!r}; known are {_KNOWN}") from error
    raise LogError(f"unit {text!r} is no quantity of a drive; known are {_KNOWN}")


# SI symbol -> (suffix, factor) for people: angles in degrees.
_DOOR = {"rad": "deg", "rad/s": "deg_s", "rad/s²": "deg_s2"}
_PLAIN = {unit.symbol: suffix for suffix, unit in reversed(SUFFIXES.items()) if unit.factor == 1.0}


def door_column(channel: str, symbol: str, *, degrees: bool = True) -> tuple[str, float]:
    """Column name for people and the number to divide SI values by."""
    suffix = (_DOOR.get(symbol) if degrees else None) or _PLAIN.get(symbol)
    if suffix is None:
        return channel, 1.0
    return f"{channel}_{suffix}", SUFFIXES[suffix].factor
