"""Units as people write them in a rig file, and what a wrong one is answered with."""

from math import pi

import pytest

from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig
from dmptm_ctrl.drive.rig_units import UnitError, quantity
from dmptm_ctrl.drive.rigfile import RigError, parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.model_file import rig_model_to_toml
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

RIG = """
[body.motor]
inertia = "unknown"
[input.u]
column = "u"
unit = "V"
[sensor.encoder]
column = "{column}"
{rest}
"""


def sensor(rest, column="phi"):
    return parse_rig(RIG.format(column=column, rest=rest)).sensors[0]


@pytest.mark.parametrize(
    "rest",
    [
        'unit = "counts"\nresolution = "8192 counts/rev"',
        'unit = "counts"\ncounts_per_rev = 8192',
        'unit = "ticks"\nresolution = "8192 ticks per turn"',
    ],
)
def test_counts_of_an_encoder(rest):
    found = sensor(rest)
    assert found.measures == "position"
    assert found.sign == pytest.approx(2 * pi / 8192)  # rad per count
    assert found.resolution.value == pytest.approx(2 * pi / 8192)


def test_counts_of_a_fine_encoder():
    assert sensor('unit = "Inkr"\ncounts_per_rev = 1048576').sign == pytest.approx(2 * pi / 2**20)


def test_resolution_alone_leaves_the_column_as_it_is():
    found = sensor('unit = "deg"\nresolution = "20000 counts/rev"')
    assert found.sign == 1
    assert found.resolution.value == pytest.approx(2 * pi / 20000)


def test_revolutions():
    assert sensor('unit = "rev"\nresolution = "0.001 rev"').resolution.value == pytest.approx(
        2e-3 * pi
    )
    assert sensor('unit = "rev/s"').measures == "speed"


@pytest.mark.parametrize(
    ("column", "rest", "line", "words"),
    [
        ("phi_m", "", 8, "'phi_m' has no unit of its own"),
        ("phi", "", 7, "states no unit"),
        ("phi", 'unit = "m"', 9, "is in m, but motor turns: rad or rad/s"),
        ("phi", 'unit = "1"', 9, 'of an encoder unit = "counts", with counts_per_rev'),
        ("phi", 'unit = "counts"', 9, "resolution = '8192 counts/rev'"),
        ("phi", 'unit = "counts"\nresolution = "50 counts/mm"', 10, "another quantity than rad"),
        ("phi", 'unit = "rad"\nmeasures = "speed"', 10, "is in rad, no speed"),
        ("phi", 'unit = "rad"\ncounts_per_rev = "many"', 10, "such as 8192"),
        ("phi", 'unit = "rad"\ncounts_per_rev = -4096', 10, "a number above 0, such as 8192"),
        ("phi", 'unit = "rad"\ncounts_per_rev = 0', 10, "no counts at all; write"),
        ("phi", 'unit = "rad"\nnoise = "2 counts"', 10, "counts of what size? Give counts_per_rev"),
        ("phi", 'unit = "deg"\nresolution = "1 count"', 10, "count of what size?"),
        ("phi", 'unit = "rad"\nnoise = "1 bit"', 10, "'bit' is of another quantity than rad"),
        ("phi", 'unit = "rad"\nnoise = "1 percent"', 10, "another quantity than rad"),
        (
            "phi",
            'unit = "counts"\ncounts_per_rev = 10000\nresolution = "2500 counts/rev"',
            11,
            "give either counts_per_rev or resolution",
        ),
        ("phi", 'unit = "rad"\nsign = 2', 10, "sign = 1 or -1, not 2; scale takes any factor"),
        ("phi", 'unit = "rad"\nscale = nan', 10, "scale is a number other than 0"),
        ("phi", 'unit = "rad"\nresolution = "0,05 deg"', 10, "decimal comma; write a point"),
    ],
)
def test_a_wrong_unit_is_answered_with_the_right_one(column, rest, line, words):
    with pytest.raises(RigError) as caught:
        sensor(rest, column)
    assert f"line {line}:" in str(caught.value)
    assert words in str(caught.value)


def test_a_shaft_and_a_gear_between_the_same_bodies_are_one_mesh():
    text = RIG.format(column="phi", rest='unit = "rad"\nbody = "motor"')
    text = text.replace('unit = "V"', 'unit = "V"\nbody = "motor"')
    text += """
[body.load]
inertia = "unknown"
[shaft.coupling]
between = ["motor", "load"]
[mesh.gear]
between = ["motor", "load"]
"""
    with pytest.raises(RigError, match=r"write one \[mesh\], with the shaft's stiffness in it"):
        parse_rig(text)


def test_a_body_that_nothing_tells_is_refused():
    """Unknown inertia between two springs, without a sensor."""
    text = """
[body.motor]
inertia = "2e-4 kg m^2"
[body.hub]
inertia = "unknown"
[body.load]
inertia = "unknown"
[shaft.coupling]
between = ["motor", "hub"]
stiffness = "unknown"
[mesh.gear]
between = ["hub", "load"]
[input.u]
column = "u_V"
body = "motor"
[sensor.motor_encoder]
column = "a_rad"
body = "motor"
[sensor.load_encoder]
column = "b_rad"
body = "load"
"""
    with pytest.raises(LogError, match="unknown inertia between coupling and gear, and no sensor"):
        diagnose_rig([], parse_rig(text))


def test_parameters_of_an_input_are_in_the_units_of_its_signal():
    text = (
        '[body.a]\ninertia = 1\n[input.d]\ncolumn = "T"\nunit = "N m"\n[sensor.q]\ncolumn = "q"\n'
    )
    rig = parse_rig('name = "x"\n' + text + 'unit = "rad"\n', "rig.toml")
    offset = Placed("drive_offset", "d", {"offset": 0.1})
    limit = Placed("drive_saturation", "d", {"inverse_limit": 0.2})
    lines = rig_model_to_toml(RigModel(rig, (offset, limit))).splitlines()
    assert "offset = 0.1 # N·m" in lines
    assert "inverse_limit = 0.2 # 1/(N·m)" in lines


@pytest.mark.parametrize(
    ("text", "si", "value", "tolerance"),
    [
        ("2.1 ± 0.2 kg cm^2", "kg·m²", 2.1e-4, 0.2 / 2.1),
        ("(2.1 ± 0.2) kg cm^2", "kg·m²", 2.1e-4, 0.2 / 2.1),
        ("2.1 kg cm^2 ± 0.2", "kg·m²", 2.1e-4, 0.2 / 2.1),
        ("2.1 kg cm^2 +/- 2e-5 kg m^2", "kg·m²", 2.1e-4, 0.2 / 2.1),
        ("45000 ± 500 g", "kg", 45.0, 1 / 90),
        ("2.1e-4 ± 10 % kg m^2", "kg·m²", 2.1e-4, 0.1),
        ("2.1e-4 kg m^2 ± 10%", "kg·m²", 2.1e-4, 0.1),
        ("45 ± 5", "kg", 45.0, 1 / 9),
        ({"value": 45, "unit": "kg", "tolerance": "500 g"}, "kg", 45.0, 1 / 90),
        ({"value": 45, "unit": "kg", "tolerance": 0.1}, "kg", 45.0, 0.1),
    ],
)
def test_a_unit_behind_the_tolerance_is_that_of_both(text, si, value, tolerance):
    read = quantity(text, si)
    assert read.value == pytest.approx(value)
    assert read.tolerance == pytest.approx(tolerance)


@pytest.mark.parametrize(
    ("raw", "words"),
    [
        ({"value": 45, "unit": "kg", "tolerance": 5}, "write '5 %' or '5 kg'"),
        ({"value": 45, "unit": "kg", "tolerance": "5"}, "write '5 %' or '5 kg'"),
        ("45 kg ± 10 % kg", "has two units"),
    ],
)
def test_a_tolerance_that_may_be_two_things_is_refused(raw, words):
    with pytest.raises(UnitError, match=words):
        quantity(raw, "kg")


SCREW = """
[body.motor]
inertia = 1
[body.slide]
mass = 1
[shaft.screw]
between = ["motor", "slide"]
lead = {lead}
[input.u]
column = "u_V"
body = "motor"
[sensor.q]
column = "q_rad"
body = "motor"
"""


@pytest.mark.parametrize(
    ("given", "length"),
    [
        ('"10 mm"', 0.01),
        ('"10 mm/rev"', 0.01),
        ('"10 mm/turn ± 1 %"', 0.01),
        ('"10 mm per rev"', 0.01),
        ('"10 mm/U"', 0.01),
        ('"0.2 in/rev"', 0.2 * 0.0254),
        ('"10 mm/rad"', 0.01 * 2 * pi),
        ('{value = 10, unit = "mm/rev", source = "a/b"}', 0.01),
        ('{value = 10, unit = "mm", source = "a/b"}', 0.01),
    ],
)
def test_a_lead_is_per_turn(given, length):
    assert parse_rig(SCREW.format(lead=given)).links[0].ratio.value == pytest.approx(
        2 * pi / length
    )


@pytest.mark.parametrize("lead", ["10", '"10 m"'])
def test_a_lead_of_metres_is_warned_of(lead):
    (said,) = parse_rig(SCREW.format(lead=lead)).cautions()
    assert "moves slide by 10 m per turn of motor" in said
    assert said.endswith("write lead = '10 mm'")
    assert parse_rig(SCREW.format(lead="0.01")).cautions() == []


def test_a_lead_of_nothing_is_refused():
    with pytest.raises(RigError, match="line 8: .*a lead of 0 moves nothing"):
        parse_rig(SCREW.format(lead=0))


RPM = 2 * pi / 60


@pytest.mark.parametrize(
    ("unit", "si", "factor"),
    [
        ("mV/rpm", "V*s/rad", 1e-3 / RPM),
        ("mV/min^-1", "V*s/rad", 1e-3 / RPM),
        ("mV/min⁻¹", "V*s/rad", 1e-3 / RPM),
        ("mV/(1/min)", "V*s/rad", 1e-3 / RPM),
        ("V/(1000 min-1)", "V*s/rad", 1e-3 / RPM),
        ("V/1000 rpm", "V*s/rad", 1e-3 / RPM),
        ("V/krpm", "V*s/rad", 1e-3 / RPM),
        ("V/(rad/s)", "V*s/rad", 1.0),
        ("Nm/min^-1", "N·m·s/rad", 1 / RPM),
        ("Nm/(1000 rpm)", "N·m·s/rad", 1e-3 / RPM),
        ("N m/(rad/s)", "N·m·s/rad", 1.0),
        ("N/(m/s)", "N·s/m", 1.0),
        ("min^-1", "rad/s", RPM),
        ("1/min", "Hz", 1 / 60),
        ("lb in^2", "kg·m²", 0.45359237 * 0.0254**2),
        ("lb·in²", "kg·m²", 0.45359237 * 0.0254**2),
        ("oz in^2", "kg·m²", 0.45359237 / 16 * 0.0254**2),
        ("lb ft^2", "kg·m²", 0.45359237 * 0.3048**2),
        ("lb in", "N·m", 0.45359237 * 9.80665 * 0.0254),
        ("oz-in-s^2", "kg·m²", 0.45359237 / 16 * 9.80665 * 0.0254),
    ],
)
def test_units_in_daily_use(unit, si, factor):
    assert quantity(f"3 {unit}", si).value == pytest.approx(3 * factor)


@pytest.mark.parametrize(
    ("rest", "resolution", "noise"),
    [
        ('unit = "counts"\ncounts_per_rev = 1000\nnoise = "2 counts"', 2e-3 * pi, 4e-3 * pi),
        ('unit = "deg"\nresolution = "17 bit"\nnoise = "0.5 counts"', 2 * pi / 2**17, pi / 2**17),
        ('unit = "counts/s"\ncounts_per_rev = 1000\nnoise = "3 counts/s"', None, 6e-3 * pi),
        ('unit = "rpm"\ncounts_per_rev = 1000\nresolution = "2 counts/ms"', 4 * pi, None),
        ('unit = "rad/s"\nresolution = "20000 counts/rev"', None, None),
    ],
)
def test_counts_and_bits_are_those_of_the_encoder(rest, resolution, noise):
    found = sensor(rest)
    assert (found.resolution and found.resolution.value) == pytest.approx(resolution)
    assert (found.noise and found.noise.value) == pytest.approx(noise)


def test_a_column_in_steps_of_so_many_bits():
    assert sensor('unit = "counts"\nresolution = "17 bit"').sign == pytest.approx(2 * pi / 2**17)


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ('gain = "2 N m/V"\ntorque_constant = "0.05 N m/A"', "give either gain or torque_const"),
        ('gain = "2 N m/V"\namplifier = "2 A/V"', "line 7: .* give either gain or amplifier"),
        (
            'torque_constant = 0.05\nresistance = 1.2\ninductance = "1 mH"\ntime_constant = "1 ms"',
            "line 8: .*give either time_constant or inductance",
        ),
        ('torque_constant = 0.05\nresistance = 1.2\namplifier = "2 A/V"', "amplifier or resist"),
        ('gain = "2 N m/V"\ninductance = "1 mH"', "inductance needs a resistance"),
    ],
)
def test_keys_of_an_input_that_say_the_same_are_refused(lines, words):
    text = RIG.format(column="phi", rest='unit = "rad"')
    with pytest.raises(RigError, match=words):
        parse_rig(text.replace('unit = "V"', lines))


@pytest.mark.parametrize(
    ("given", "value"), [("10:1", 10), ("1:10", 0.1), ("50/3", 50 / 3), ("-50 / 3 ± 1 %", -50 / 3)]
)
def test_a_ratio_of_teeth(given, value):
    assert quantity(given, "", positive=False).value == pytest.approx(value)


@pytest.mark.parametrize(
    ("given", "si", "words"),
    [
        ("10,5", "", "has a decimal comma; write a point, as in '1.5'$"),
        ("10:0", "", "':0' is no unit; a plain number has none$"),
        ("1,200.5 g cm^2", "kg·m²", "has a comma between thousands; leave it out$"),
    ],
)
def test_a_number_that_cannot_be_read_is_answered_with_the_right_one(given, si, words):
    with pytest.raises(UnitError, match=words):
        quantity(given, si)


@pytest.mark.parametrize(
    "table",
    [
        {"value": "2.1 kg cm^2", "range": [1.9, 2.5]},
        {"value": "2.1 ± 0.1 kg cm^2", "range": [1.9, 2.5]},
        {"value": 2.1, "unit": "kg cm^2", "range": [1.9, 2.5]},
    ],
)
def test_ends_of_a_range_are_in_the_unit_of_the_value(table):
    read = quantity(table, "kg·m²")
    assert read.value == pytest.approx(2.1e-4)
    assert read.range == pytest.approx((1.9e-4, 2.5e-4))
