"""Each effect of the catalogue once by hand, written out with numbers, not with its code."""

from math import cos, e, exp, log, pi, sin, sqrt

import pytest

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.presliding import bristle_lag, build_up_distance, fading
from dmptm_ctrl.effects.stribeck import stribeck_law

RAMP = [2.0 * i for i in range(32)]  # knots of a table

# name, parameters, arguments of the kernel, result
BY_HAND = [
    ("drive_delay", (0.004,), (0,), 0.004),
    ("drive_offset", (0.02, -0.01), (0.5, 1.0, 0), 0.52),
    ("drive_offset", (0.02, -0.01), (0.5, 1.0, 1), 0.49),
    ("drive_dead_band", (0.1,), (0.5, 0.0, 0), 0.4),
    ("drive_dead_band", (0.1,), (-0.5, 0.0, 1), -0.4),
    ("drive_dead_band", (0.1,), (-0.05, 0.0, 1), 0.0),
    ("torque_constant_mismatch", (0.1, 2.0), (0.5, 0.0, 0), 0.55),
    ("torque_constant_mismatch", (0.1, 2.0), (0.5, 0.0, 1), 0.45),
    ("drive_saturation", (2.0,), (0.7, 0.0, 0), 0.5),
    ("drive_saturation", (2.0,), (-0.7, 0.0, 1), -0.5),
    ("drive_saturation", (2.0,), (0.3, 0.0, 1), 0.3),
    ("current_lag", (0.003,), (0.7, 0), (0.7, 0.003)),
    ("cogging", (0.02, 0.01, 0.03, 0.04, 6.0), (5.0, pi / 6, 1.0, 0.0, 0), -0.02),
    ("cogging", (0.02, 0.01, 0.03, 0.04, 6.0), (5.0, pi / 12, 1.0, 0.0, 1), 0.04),
    ("back_emf", (0.002,), (5.0, 3.0, 20.0, 0.0, 1), -0.04),
    # two inertias of 0.125 kg·m² reduce to 0.0625; 2 · 0.03 · √(0.0625/1e-4) = 1.5
    ("reducer_compliance", (1e-4, 0.03), (0.0625,), (1e-4, 1.5)),
    ("pinion_runout", (0.001, 0.002, 0.003, 0.004), (pi / 2, 2.0, 9.0, 9.0, 0),
     (0.002, -0.002, 0.0, 0.0)),
    ("pinion_runout", (0.001, 0.002, 0.003, 0.004), (0.0, 2.0, 9.0, 9.0, 1),
     (0.003, 0.008, 0.0, 0.0)),
    ("ring_gear_eccentricity", (0.001, 0.002), (9.0, 9.0, pi / 2, 2.0, 0),
     (0.002, -0.002, 0.0, 0.0)),
    # the right pinion sits 120° further on: cos 120° = −1/2, sin 120° = √3/2
    ("ring_gear_eccentricity", (0.002, 0.0), (9.0, 9.0, 0.0, 1.0, 1),
     (-0.001, -0.001 * sqrt(3.0), 0.0, 0.0)),
    ("backlash_variation", (0.002, 0.001, 0.0, 0.0, 1.0), (9.0, 9.0, pi / 2, 1.0, 0),
     (0.0, 0.0, 0.001, 0.0)),
    ("backlash_variation", (0.002, 0.0, 0.0, 0.0, 1.0), (9.0, 9.0, 0.0, 1.0, 1),
     (0.0, 0.0, -0.001, 0.0)),
    # what differs is added on the left and taken off on the right
    ("backlash_variation", (0.0, 0.0, 0.002, 0.001, 1.0), (9.0, 9.0, pi / 2, 1.0, 0),
     (0.0, 0.0, 0.001, 0.0)),
    ("backlash_variation", (0.0, 0.0, 0.002, 0.0, 1.0), (9.0, 9.0, 0.0, 1.0, 1),
     (0.0, 0.0, 0.001, 0.0)),
    # an oval gear: an eighth of a turn on, the left pinion is at a quarter of a wave
    ("backlash_variation", (0.002, 0.001, 0.0, 0.0, 2.0), (9.0, 9.0, pi / 4, 1.0, 0),
     (0.0, 0.0, 0.001, 0.0)),
    # 20 teeth: a quarter of a tooth is 2π/80
    ("mesh_error", (1e-4, 2e-4, 0.0, 0.0, 20.0), (pi / 40, 3.0, 9.0, 9.0, 0),
     (2e-4, -6e-3, 0.0, 0.0)),
    ("mesh_error", (0.0, 0.0, 3e-4, 1e-4, 20.0), (0.0, 3.0, 9.0, 9.0, 1), (3e-4, 6e-3, 0.0, 0.0)),
    ("load_dependent_friction", (0.1,), (0.0, 1.0, 0.0, -30.0, 0), (1.0, 3.0)),
    ("load_dependent_friction", (0.1,), (0.0, 1.0, 0.0, 30.0, 2), (1.0, 0.0)),
    ("position_dependent_friction", (2.0, 1.0, 1.0), (pi / 2, 1.0, 0.0, 5.0, 2), (1.0, 1.0)),
    ("position_dependent_friction", (2.0, 1.0, 1.0), (pi, -1.0, 0.0, 5.0, 2), (1.0, -2.0)),
    ("position_dependent_friction", (2.0, 1.0, 1.0), (pi, -1.0, 0.0, 5.0, 0), (1.0, 0.0)),
    ("position_dependent_friction", (2.0, 1.0, 3.0), (pi / 2, 1.0, 0.0, 5.0, 2), (1.0, -1.0)),
    ("local_spot", (10.0, 3.0, 0.1), (3.1, 1.0, 0.0, 5.0, 2), (1.0, 10.0 / sqrt(e))),
    # across ±π: −3.1 is 2π − 6.1 = 0.183 from 3
    ("local_spot", (10.0, 3.0, 0.1), (-3.1, 1.0, 0.0, 5.0, 2),
     (1.0, 10.0 * exp(-0.5 * ((2 * pi - 6.1) / 0.1) ** 2))),
    ("local_spot", (10.0, 3.0, 0.1), (3.0, 1.0, 0.0, 5.0, 1), (1.0, 0.0)),
    ("thermal_drift", (0.4, 0.2, 3.0, 6.0, 20.0), (0.0, 1.0, 6.0, 5.0, 1), (1.0 + 0.4 / e, 0.0)),
    ("thermal_drift", (0.4, 0.2, 3.0, 6.0, 20.0), (0.0, -2.0, 6.0, 5.0, 2), (1.0 + 0.6 / e, -1.2)),
    ("presliding", (5e-4, 1e-4, 1.0, 0.4), (1,), (5e-4, 1.0, 0.4)),
    ("presliding", (5e-4, 1e-4, 0.0, 0.4), (2,), (1e-4, 0.0, 0.4)),
    ("unknown_breakaway", (5.0, 0.01, 2e-4), (0.09, 2), (5.0 * log(10.0), 2e-4)),
    ("unknown_breakaway", (5.0, 0.01, 2e-4), (0.09, 1), (0.0, 0.0)),
    ("unknown_breakaway", (0.0, 0.01, 2e-4), (0.09, 2), (0.0, 0.0)),
    ("unbalance", (3.0, 4.0), (pi / 2, 1.0, 0.0), 4.0),
    ("unbalance", (3.0, 4.0), (pi, -1.0, 0.0), -3.0),
    ("cable_spring", (5.0, 2.0), (0.5, 1.0, 0.0), -0.5),
    ("quadratic_drag", (10.0,), (0.0, 0.2, 0.0), -0.4),
    ("quadratic_drag", (10.0,), (0.0, -0.2, 0.0), 0.4),
    ("base_vibration", (3.0, 4.0, 5.0), (0.0, 0.0, 0.05), 4.0),  # a quarter period of 5 Hz
    ("base_vibration", (3.0, 4.0, 5.0), (0.0, 0.0, 0.1), -3.0),
    ("encoder_eccentricity", (0.001, 0.002), (pi / 2, 1.0, 0.0), (pi / 2 + 0.002, 1.0)),
    ("encoder_eccentricity", (0.001, 0.002), (1.0, 1.0, 0.0),
     (1.0 + 0.001 * cos(1.0) + 0.002 * sin(1.0), 1.0)),
    ("sensor_gain", (0.05,), (2.0, 0.4, 0.0), (2.0, 0.42)),
    ("sensor_delay", (0.006,), (), 0.006),
    # 32 knots from 0 to 31, each worth twice its place: the table doubles, and ends flat
    ("unknown_torque", (1.0, 0.0, 31.0, *RAMP, 1.0), (9.0, 3.25, 9.0), 6.5),
    # over an angle the same table is 3.1 rad wide; behind it is its end, a turn further itself
    ("unknown_torque", (0.0, -1.55, 1.55, *RAMP, 1.0), (0.55, 3.25, 9.0), 42.0),
    ("unknown_torque", (0.0, -1.55, 1.55, *RAMP, 1.0), (0.55 - 4.0 * pi, 3.25, 9.0), 42.0),
    ("unknown_torque", (0.0, -1.55, 1.55, *RAMP, 1.0), (3.0, 3.25, 9.0), 62.0),
    ("unknown_torque", (0.0, -1.55, 1.55, *RAMP, 1.0), (3.2, 3.25, 9.0), 0.0),
    # by the clock: 103 s are 3 s into the third period of 50 s, 98 s are behind the table
    ("unknown_torque", (6.0, 0.0, 31.0, *RAMP, 50.0), (9.0, 9.0, 103.0), 6.0),
    ("unknown_torque", (6.0, 0.0, 31.0, *RAMP, 50.0), (9.0, 9.0, 98.0), 62.0),
    ("unknown_torque", (8.0, -1.55, 1.55, *RAMP, 1.0), (2.0 * pi - 1.25, -0.5, 9.0), -3.0),
    # a wave of 4 rad: its cosine's size at the speed's place, its sine's 16 knots further
    ("unknown_torque", (9.0, 0.0, 31.0, *RAMP, 4.0), (8.0, -3.25, 9.0), 6.5),
    ("unknown_torque", (9.0, 0.0, 31.0, *RAMP, 4.0), (1.0, 3.25, 9.0), 38.5),
    ("unknown_torque", (9.0, 0.0, 31.0, *RAMP, 4.0), (-1.0, 20.0, 9.0), -62.0),
    ("unknown_friction", (2.0, 0.0, 31.0, *RAMP), (9.0, 1.0, 0.5, 5.0, 2), (1.0, 1.0)),
    ("unknown_friction", (1.0, 0.0, 31.0, *RAMP), (9.0, 1.0, 0.5, 5.0, 2), (1.0, 2.0)),
    ("unknown_friction", (1.0, 0.0, 31.0, *RAMP), (9.0, 1.0, 0.5, 5.0, 1), (1.0, 0.0)),
    ("unknown_voltage", (3.0, -31.0, 31.0, *RAMP), (-1.0, 9.0, 1), 29.0),
    ("unknown_voltage", (2.0, 0.0, 31.0, *RAMP), (-1.0, 2.5, 0), 4.0),
    # u, theta_m, omega_m, t, side; of a wave of 31 rad, the right one 2 rad ahead
    ("unknown_motor", (4.0, 0.0, 31.0, *RAMP, 0.0, 0.0, 1.0), (-0.5, 34.0, 9.0, 9.0, 0), -3.0),
    ("unknown_motor", (4.0, -1.0, 30.0, *RAMP, 0.0, 2.0, 1.0), (-0.5, 34.0, 9.0, 9.0, 0), -4.0),
    ("unknown_motor", (4.0, -1.0, 30.0, *RAMP, 0.0, 2.0, 1.0), (-0.5, 34.0, 9.0, 9.0, 1), -6.0),
    ("unknown_motor", (4.0, 0.0, 31.0, *RAMP, 1.0, 0.0, 1.0), (-0.5, 3.0, 9.0, 9.0, 0), 0.0),
    ("unknown_motor", (4.0, 0.0, 31.0, *RAMP, -1.0, 0.0, 1.0), (-0.5, 3.0, 9.0, 9.0, 0), -3.0),
    ("unknown_motor", (4.0, 0.0, 31.0, *RAMP, -1.0, 0.0, 1.0), (-0.5, 3.0, 9.0, 9.0, 1), 0.0),
    ("unknown_motor", (5.0, -31.0, 31.0, *RAMP, 0.0, 0.0, 1.0), (0.5, 3.0, -11.0, 9.0, 1), 10.0),
    ("unknown_motor", (5.0, -31.0, 31.0, *RAMP, 0.0, 0.0, 1.0), (-0.5, 3.0, -11.0, 9.0, 1), -21.0),
    ("unknown_motor", (6.0, -1.0, 30.0, *RAMP, 0.0, 0.0, 50.0), (0.5, 3.0, 9.0, 102.0, 1), 3.0),
    # over a motor's angle: it comes back after 50 rad
    ("unknown_motor", (7.0, 0.0, 31.0, *RAMP, 0.0, 0.0, 50.0), (-0.5, 20.0, 9.0, 9.0, 0), 20.0),
    ("unknown_motor", (7.0, 0.0, 31.0, *RAMP, 0.0, 0.0, 50.0), (0.5, -30.0, 9.0, 9.0, 1), 20.0),
]  # fmt: skip


@pytest.mark.parametrize(("name", "values", "arguments", "expected"), BY_HAND)
def test_by_hand(name, values, arguments, expected):
    effect = CATALOGUE[name]
    result = effect.kernel(*arguments, effect.values(*values))
    assert result == pytest.approx(expected, rel=1e-12, abs=1e-15)


def test_damping_of_bristles_by_hand():
    """Stiffness 20 N·m over 2e-4 rad is 1e5; √(2.5/1e5) = 5 ms, twice ζ of it; at Ω half of it."""
    law = stribeck_law(25.0, 22.0, 0.02, 60.0, 25.0, 18.0, 0.04, 60.0, 1.0)
    assert bristle_lag(2e-4, 0.4, 2.5, law) == pytest.approx(4e-3, rel=1e-12)
    assert fading(0.02, 1.0, law) == pytest.approx(0.5, rel=1e-12)
    assert fading(-0.02, -1.0, law) == pytest.approx(1.0 / 1.5, rel=1e-12)
    # 25 N·m at the same stiffness take 2.5e-4 rad
    assert build_up_distance(2e-4, -25.0, law) == pytest.approx(2.5e-4, rel=1e-12)
    frictionless = law._replace(coulomb_plus=0.0, coulomb_minus=0.0)
    assert bristle_lag(2e-4, 0.4, 2.5, frictionless) == 0.0
    assert build_up_distance(2e-4, 5.0, frictionless) == 2e-4


def test_every_effect_of_this_package_is_done_by_hand():
    own = {n for n, e in CATALOGUE.items() if e.kernel.__module__.startswith("dmptm_ctrl.")}
    assert {name for name, *_ in BY_HAND} == own


SHIFTED = ["pinion_runout", "ring_gear_eccentricity", "mesh_error"]


@pytest.mark.parametrize("name", SHIFTED)
@pytest.mark.parametrize("side", [0, 1])
def test_rate_of_a_mesh_shift_is_its_derivative(name, side):
    """Along a motion with pinion at 3 rad/s and ring gear at 0.4 rad/s."""
    effect = CATALOGUE[name]
    p = effect.values(*(1e-3 * (i + 1) for i in range(len(effect.parameters))))

    def at(t):
        return effect.kernel(0.3 + 3.0 * t, 3.0, 0.7 + 0.4 * t, 0.4, side, p)

    h = 1e-5
    slope = (at(h)[0] - at(-h)[0]) / (2 * h)
    assert at(0.0)[1] == pytest.approx(slope, rel=1e-6)
