"""Each row of ERRATA: what goes wrong with the printed form, and not with the corrected one."""

import re
from math import exp, pi, sin, sqrt
from pathlib import Path

import numpy as np
import pytest

from dmptm_ctrl.drive import (
    ERRATA,
    cantilever_stiffness,
    friction_at_rest,
    gap_exponent,
    mesh_damping,
    mesh_damping_as_printed,
    mesh_damping_ratio,
    mesh_stiffness,
    nine_dof_parameters,
    paper_drive,
    reduced_pinion_inertia,
    three_dof_train,
)
from dmptm_ctrl.drive.train import GearTrain, Joint
from dmptm_ctrl.effects.backlash import Backlash, gap_rate, mesh_torque

TESTED = {
    "J3_bar": "test_reduced_inertia",
    "gap_exponent": "test_gap_exponent",
    "tooth": "test_tooth_compliance",
    "mesh_phase": "test_mesh_phase",
    "mesh_damping": "test_mesh_damping",
    "c": "test_table_c_is_outside_equation_24",
    "T3s_plus": "test_static_friction_is_not_below_coulomb",
    "J2": "test_table_j2_is_the_motors_inertia",
    "F_34t": "test_only_the_same_force_is_a_reaction",
    "R_L": "test_only_one_radius_turns_freely",
    "rest_friction": "test_ring_gear_at_rest",
    "half_gap": "test_table_gaps_are_half_gaps",
}


def test_every_erratum_has_its_test():
    assert set(TESTED) == set(ERRATA)
    assert all(name in globals() for name in TESTED.values())


def test_page_has_every_row_and_names_tests_that_exist():
    """docs/errata.md: the rows of ERRATA word for word, each with the file and name of a test."""
    root = Path(__file__).parents[2]
    lines = (root / "docs" / "errata.md").read_text(encoding="utf-8").splitlines()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines if line[:2] == "| "]
    shown = {tuple(row[:3]): row[4] for row in rows[1:]}
    assert set(shown) == {(e.where, e.printed, e.corrected) for e in ERRATA.values()}
    for key, erratum in ERRATA.items():
        tests = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", shown[erratum[:3]])
        assert tests[0][1] == TESTED[key]
        for file, name in tests:
            assert f"def {name}(" in (root / file).read_text(encoding="utf-8"), (file, name)


def test_reduced_inertia():
    """Kinetic energy at pinion speed 1: motor and wheel 1 turn N1 times as fast."""
    n1, jm, j1, j2, j3 = 25.0, 2e-4, 1e-4, 0.06, 1e-3
    energy = 0.5 * ((jm + j1) * n1**2 + (j2 + j3))
    assert reduced_pinion_inertia(n1, jm, j1, j2, j3) == pytest.approx(2 * energy, rel=1e-12)
    printed = reduced_pinion_inertia(n1, jm, j1, j2, j3, as_printed=True)
    assert printed < 0.8 * 2 * energy


def position_in_gap(z, rate, k, c, c_f, half_gap, *, as_printed):
    flight = gap_exponent(z, rate, half_gap, k, c, as_printed=as_printed)
    relaxing = (c + c_f) / k * rate * exp(-k / (c + c_f) * flight)
    return z - c_f / k * rate + relaxing


@pytest.mark.parametrize("rate", [0.01, 0.3, 5.0])
def test_gap_exponent(rate):
    """Against the two-state mesh integrated by fine RK4 from the point of release."""
    k, c, c_f, half_gap = 3.6e4, 3.0, 0.3, 14 / 60 * pi / 180
    p = Backlash(k, c, c_f, half_gap)
    start = -half_gap - c / k * rate
    duration = min(8 * (c + c_f) / k, 1.5 * half_gap / rate)
    n = 2000
    h, position = duration / n, -half_gap
    for i in range(n):
        z = start + rate * h * np.array([i, i + 0.5, i + 1])
        k1 = gap_rate(position, z[0], rate, p)
        k2 = gap_rate(position + h / 2 * k1, z[1], rate, p)
        k3 = gap_rate(position + h / 2 * k2, z[1], rate, p)
        k4 = gap_rate(position + h * k3, z[2], rate, p)
        position += h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    z = start + rate * duration
    corrected = position_in_gap(z, rate, k, c, c_f, half_gap, as_printed=False)
    printed = position_in_gap(z, rate, k, c, c_f, half_gap, as_printed=True)
    assert corrected == pytest.approx(position, abs=1e-9)
    scale = (c + c_f) / k * rate  # what the exponential decays from
    assert abs(printed - position) > 0.5 * scale


def test_tooth_compliance():
    """A tapered cantilever, force at its thin end: by 20 000 midpoint slices of ∫ M²/(E I)."""
    length, width, young = 0.006, 0.02, 2e11

    def thickness(x):
        return 0.002 + 0.5 * x

    x = (np.arange(20_000) + 0.5) / 20_000 * length
    moment = x  # of a unit force at the thin end
    second = width * thickness(x) ** 3 / 12
    energy = np.sum(moment**2 / (young * second)) * length / x.size
    args = (thickness, length, width, young)
    assert cantilever_stiffness(*args) == pytest.approx(1 / energy, rel=1e-6)
    assert cantilever_stiffness(*args, as_printed=True) > 5 / energy


def test_mesh_phase():
    """A pinion swinging about one place shows the mesh one stiffness curve k(θ3)."""
    theta, k = [], []
    for t in np.linspace(0, 3, 200):
        theta.append(0.2 * sin(2 * pi * t))
        k.append(mesh_stiffness(3.6e4, 4e3, 20, theta[-1]))
    again = mesh_stiffness(3.6e4, 4e3, 20, theta[0])
    assert k[0] == pytest.approx(again)
    turned = [mesh_stiffness(3.6e4, 4e3, 20, 0.0, as_printed=(t, 0.4)) for t in (0.0, 0.1)]
    assert turned[0] != pytest.approx(turned[1], rel=1e-3)  # same place, other stiffness
    speed = 0.7  # at constant speed from angle 0, both are the same
    for t in (0.1, 1.3):
        printed = mesh_stiffness(3.6e4, 4e3, 20, 0.0, as_printed=(t, speed))
        assert mesh_stiffness(3.6e4, 4e3, 20, speed * t) == pytest.approx(printed)


def test_mesh_damping():
    """Two bodies on one damped mesh: the pole pair's own ζ is the one put in."""
    k, j3, jl, n2, zeta = 3.6e4, 0.25, 2.5, 8.25, 0.1
    c = mesh_damping(zeta, k, j3, jl, n2)
    train = GearTrain(
        name="pair",
        bodies=("3l", "L"),
        inertia=np.array([j3, jl]),
        viscous=np.zeros(2),
        joints=(Joint("tau_l", np.array([1.0, -n2]), k, c),),
        drives=np.eye(2),
        torque_per_volt=1.0,
        readouts={},
    )
    pair = [s for s in train.to_ss().poles() if s.imag > 0]
    assert -pair[0].real / abs(pair[0]) == pytest.approx(zeta, rel=1e-9)
    metres = mesh_damping_as_printed(zeta, k, j3, jl, 0.02, 0.165)
    millimetres = mesh_damping_as_printed(zeta, k, j3, jl, 20.0, 165.0)
    assert millimetres == pytest.approx(1000 * metres)  # a torque law that knows the ruler
    assert abs(metres / c - 1) > 0.5


def test_table_c_is_outside_equation_24():
    args = (3.6e4, 0.25, 2.5, 8.25)
    assert mesh_damping_ratio(1.0, *args) == pytest.approx(0.0147, abs=5e-5)
    assert [mesh_damping(z, *args) for z in (0.03, 0.17)] == pytest.approx([2.04, 11.5], abs=0.05)
    assert paper_drive(as_printed=True)["c"] == 1.0
    low, high = paper_drive().quantities["c"].range
    assert low <= 1.0
    assert 0.03 < mesh_damping_ratio(paper_drive()["c"], *args) < 0.17 < 10 * high


def test_static_friction_is_not_below_coulomb():
    def wrong(drive):
        pairs = [(f"T{b}s_{s}", f"T{b}c_{s}") for b in "3L" for s in ("plus", "minus")]
        return [static for static, coulomb in pairs if drive[static] < drive[coulomb]]

    assert wrong(paper_drive(as_printed=True)) == ["T3s_plus"]
    assert wrong(paper_drive()) == []


def test_table_j2_is_the_motors_inertia():
    drive = paper_drive()
    assert drive["N_1"] ** 2 * drive["J_m"] == pytest.approx(drive["J_2"], rel=1e-12)


def mesh_matrix(pinion_radius, ring_arm):
    """K of pinion and ring when the ring gear's equation uses `ring_arm` for its force."""
    deformation = np.array([pinion_radius, -8.25 * pinion_radius])  # Eq. 14, unit stiffness
    return np.outer([pinion_radius, -ring_arm], deformation)


def test_only_the_same_force_is_a_reaction():
    """Printed F_l34r, the radial force, is F_l34t tan α: energy would come from nowhere."""
    radius = 0.02
    right = mesh_matrix(radius, 8.25 * radius)
    wrong = mesh_matrix(radius, 8.25 * radius * np.tan(np.radians(20)))
    np.testing.assert_allclose(right, right.T, atol=1e-15)
    assert abs(wrong - wrong.T).max() > 0.5 * abs(wrong[0, 1])
    np.testing.assert_allclose(three_dof_train().stiffness, three_dof_train().stiffness.T)


def test_only_one_radius_turns_freely():
    """θ3 = N2 θL must cost no torque; with another R4 in the appendix it does."""
    p = nine_dof_parameters(paper_drive())
    together = np.array([8.25, 1.0])
    for ring, free in ((p["R_L"], True), (1.1 * p["R_L"], False)):
        row = np.array([p["R_3"], -ring])  # appendix: R3 and R4
        torque = 3.6e4 / p["R_3"] ** 2 * np.outer(row, row) @ together
        assert (abs(torque).max() < 1e-6) == free
    assert abs(three_dof_train().stiffness @ [8.25, 8.25, 1.0]).max() < 1e-6


def test_ring_gear_at_rest():
    """Chains in their gaps: no torque reaches the ring gear, so its friction is zero.

    As printed it would be the motor's torque, which would push a free ring gear.
    """
    motor, mesh = 0.39 * 0.6, 0.0
    args = {"net_torque": mesh, "motor_torque": motor}
    assert friction_at_rest(-20.0, 23.0, **args) == 0.0
    assert friction_at_rest(-20.0, 23.0, **args, as_printed=True) == pytest.approx(motor)
    # held within the limits, and saturated beyond them
    assert friction_at_rest(-20.0, 23.0, net_torque=-7.0, motor_torque=0.0) == -7.0
    assert friction_at_rest(-20.0, 23.0, net_torque=31.0, motor_torque=0.0) == 23.0


def test_table_gaps_are_half_gaps():
    """Free play of Eq. 21 between both contacts is twice its Δ, here Table 1's 14′."""
    drive = paper_drive()
    p = Backlash(drive["k_m"], drive["c"], drive["c_f"], drive["gap_l"])
    z = np.linspace(-0.01, 0.01, 200_001)
    free = z[[mesh_torque(x, 0.0, p) == 0.0 for x in z]]
    assert free[-1] - free[0] == pytest.approx(2 * 14 / 60 * pi / 180, abs=2e-7)
    assert sqrt(drive["gap_l"] * drive["gap_r"]) < drive["gap_l"]
