import math

import pint
import pytest

from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.units import SUFFIXES, door_column, named_unit, parse_unit, split_column

# The suffixes written out for pint, which knows nothing of our table.
WRITTEN_OUT = {
    "s": "second", "ms": "millisecond", "us": "microsecond", "min": "minute",
    "V": "volt", "mV": "millivolt", "A": "ampere", "mA": "milliampere",
    "Nm": "newton * meter", "mNm": "millinewton * meter", "N": "newton", "kN": "kilonewton",
    "rad": "radian", "mrad": "milliradian", "deg": "degree", "arcmin": "arcminute",
    "arcsec": "arcsecond", "rev": "turn", "turn": "turn",
    "rad_s": "radian / second", "mrad_s": "milliradian / second", "deg_s": "degree / second",
    "rev_s": "turn / second", "rev_min": "turn / minute", "rpm": "turn / minute",
    "rad_s2": "radian / second**2", "deg_s2": "degree / second**2",
    "m": "meter", "mm": "millimeter", "um": "micrometer",
    "m_s": "meter / second", "mm_s": "millimeter / second", "m_s2": "meter / second**2",
    "g": "standard_gravity", "Hz": "hertz", "W": "watt", "K": "kelvin",
    "ns": "nanosecond", "percent": "percent", "pct": "percent", "permille": "permille",
}  # fmt: skip


def test_every_suffix_is_checked():
    assert set(WRITTEN_OUT) == set(SUFFIXES)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_factor_agrees_with_pint(suffix):
    symbol, factor = SUFFIXES[suffix]
    base = symbol.replace("·", "*").replace("²", "**2")
    expected = pint.Quantity(1.0, WRITTEN_OUT[suffix]).to(base).magnitude
    assert factor == pytest.approx(expected, rel=1e-14)


@pytest.mark.parametrize(
    ("column", "channel", "suffix"),
    [
        ("omega_L_deg_s", "omega_L", "deg_s"),
        ("theta_L_deg", "theta_L", "deg"),
        ("u_left_V", "u_left", "V"),
        ("time_s", "time", "s"),
        ("duty_pct", "duty", "pct"),
        ("x_m_s", "x", "m_s"),
        ("shaft_rad_s2", "shaft", "rad_s2"),
    ],
)
def test_column_splits_at_the_longest_unit(column, channel, suffix):
    assert split_column(column) == (channel, SUFFIXES[suffix])


@pytest.mark.parametrize("column", ["deg", "deg_s", "theta_L", "", "_", "theta_L_dge", "x_DEG"])
def test_column_without_a_unit(column):
    split = split_column(column)
    assert split is None or split[0] in ("deg", "")  # deg_s: "deg" in seconds


@pytest.mark.parametrize(
    ("text", "symbol", "factor"),
    [
        ("deg/s", "rad/s", math.pi / 180),
        ("°/s", "rad/s", math.pi / 180),
        ("N·m", "N·m", 1.0),
        ("kgf*m", "N·m", 9.80665),
        ("inch", "m", 0.0254),
        ("rev/min", "rad/s", math.pi / 30),
        ("", "", 1.0),
        ("%", "%", 1.0),
        ("pct", "%", 1.0),
        ("PWM", "", 1.0),
        ("counts", "", 1.0),
        ("ticks", "s", 1e-7),
        ("Volt", "V", 1.0),
        ("1/min", "rad/s", math.pi / 30),
    ],
)
def test_unit_from_an_expression(text, symbol, factor):
    unit = parse_unit(text)
    assert unit.symbol == symbol
    assert unit.factor == pytest.approx(factor, rel=1e-14)


@pytest.mark.parametrize(
    "text", ["foo", "degC", "lb", "9**9**9**9", "__import__('os')", "m" * 1000, "deg/", "/s"]
)
def test_what_is_no_unit_of_a_drive(text):
    with pytest.raises(LogError, match="unit"):
        parse_unit(text)


@pytest.mark.parametrize("text", ["bar", "foo"])
def test_message_names_units_that_are_no_suffixes(text):
    with pytest.raises(LogError, match=r"known are s, .*, %, counts, PWM$"):
        parse_unit(text)


@pytest.mark.parametrize("symbol", sorted({unit.symbol for unit in SUFFIXES.values()}))
@pytest.mark.parametrize("degrees", [True, False])
def test_door_name_parses_back(symbol, degrees):
    column, factor = door_column("x", symbol, degrees=degrees)
    assert split_column(column) == ("x", (symbol, factor))


@pytest.mark.parametrize(
    ("column", "name", "unit"),
    [
        ("q [deg]", "q", "deg"),
        ("q/deg", "q", "deg"),
        ("v/(m/s)", "v", "m/s"),
        ("n/(1/min)", "n", "1/min"),
        ("time in ms", "time", "ms"),
        ("rad/s", "rad/s", ""),
        ("/joint/position", "/joint/position", ""),
        ("motor (left)", "motor (left)", ""),
        ("q[0]", "q[0]", ""),
    ],
)
def test_unit_in_a_name(column, name, unit):
    assert named_unit(column) == (name, unit)


@pytest.mark.parametrize(
    ("text", "symbol", "factor"),
    [
        ("kNm", "N·m", 1e3),
        ("Ncm", "N·m", 1e-2),
        ("oz-in", "N·m", 0.45359237 / 16 * 9.80665 * 0.0254),
        ("lb-ft", "N·m", 0.45359237 * 9.80665 * 0.3048),
        ("Grad/s", "rad/s", math.pi / 180),  # German degrees, no gigaradians
        ("RPM", "rad/s", math.pi / 30),
        ("Umdr/min", "rad/s", math.pi / 30),
        ("r/min", "rad/s", math.pi / 30),
    ],
)
def test_spellings_of_other_programs(text, symbol, factor):
    unit = parse_unit(text)
    assert unit.symbol == symbol
    assert unit.factor == pytest.approx(factor, rel=1e-12)
