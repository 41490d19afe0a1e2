"""The blocks linearised under preload are the 3-DOF model, and say so where they are not."""

import warnings
from math import exp

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.drive import three_dof_ss
from dmptm_ctrl.simulate.blocks import initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop
from dmptm_ctrl.simulate.linear import linearize, turning

SAME = 1e-6
ORDER = ["twist_l", "twist_r", "ring_theta", "pinion_l_omega", "pinion_r_omega", "ring_omega"]


def three_dof(drive, slopes):
    """A and B of paper Eq. 17 with the matrices of its appendix; K34 R3² C34 = k, R_L/R3 = N2."""
    n1, n2, k, c = (drive[name] for name in ("N_1", "N_2", "k_m", "c"))
    j3 = n1**2 * drive["J_m"] + drive["J_2"]
    M = np.diag([j3, j3, drive["J_L"]])
    K = k * np.array([[1.0, 0.0, -n2], [0.0, 1.0, -n2], [-n2, -n2, 2.0 * n2**2]])
    D = np.diag(slopes) + c / k * K
    E = n1 * drive["K_d"] * drive["K_M"] * np.eye(3, 2)
    zero, one = np.zeros((3, 3)), np.eye(3)
    A = np.block([[zero, one], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    return A, np.vstack([np.zeros((3, 2)), np.linalg.solve(M, E)])


def in_order(linear, n2):
    """A, B and C by θ3l, θ3r, θL and their speeds; a twist is θ3 − N2 θL."""
    rows = [linear.state_labels.index(name) for name in ORDER]
    assert linear.nstates == len(rows)
    twists = np.eye(6)
    twists[:2, 2] = -n2
    angles = np.linalg.inv(twists)
    A, B, C = linear.A[np.ix_(rows, rows)], linear.B[rows], linear.C[:, rows]
    return angles @ A @ twists, angles @ B, C @ twists


def slope(drive, body, speed):
    """Derivative of Eq. 25 at a positive speed."""
    fall = drive[f"T{body}s_plus"] - drive[f"T{body}c_plus"]
    scale = drive[f"W{body}_plus"]
    return drive[f"B{body}_plus"] - fall / scale * exp(-speed / scale)


@pytest.mark.parametrize("preload", [0.3, 0.05])  # on opposite flanks, on the same
def test_is_the_three_dof_model_about_a_turn(paper, preload):
    drive = paper.drive
    x0, u0 = turning(paper, preload=preload)
    assert (x0[1] < 0.0) == (preload == 0.3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        linear = linearize(paper, x0, u0, outputs=OUTPUTS)
    A, B, C = in_order(linear, drive["N_2"])
    reducer = slope(drive, "3", drive["N_2"] * x0[5])
    slopes = [reducer, reducer, slope(drive, "L", x0[5])]
    A_own, B_own = three_dof(drive, slopes)
    np.testing.assert_allclose(A, A_own, rtol=SAME, atol=SAME * np.abs(A_own[3:, 3:]).max())
    np.testing.assert_allclose(B, B_own, rtol=SAME)
    assert list(linear.input_labels) == ["u_left", "u_right"]
    row = dict(zip(linear.output_labels, C, strict=True))
    np.testing.assert_allclose(row["omega_L"], np.eye(6)[5], rtol=SAME)
    drives = ct.dcgain(linear)[linear.output_labels.index("omega_L")]
    np.testing.assert_allclose(drives, ct.dcgain(linearize(paper, x0, u0))[0], rtol=SAME)
    np.testing.assert_allclose(row["theta_ml"], drive["N_1"] * np.eye(6)[0], rtol=SAME)
    twist = np.array([1.0, 0.0, -drive["N_2"], 0.0, 0.0, 0.0])
    torque = drive["k_m"] * twist + drive["c"] * np.roll(twist, 3)
    np.testing.assert_allclose(row["torque_l"], torque, rtol=SAME, atol=SAME)


def test_without_friction_is_the_3_dof_state_space(frictionless):
    """At any state with closed meshes, here at rest; the package's other assembly."""
    drive = frictionless.drive
    per_volt = drive["N_1"] * drive["K_d"] * drive["K_M"]
    x0 = np.zeros(6)
    x0[0] = drive["gap_l"] + per_volt * 0.5 / drive["k_m"]
    x0[1] = -drive["gap_r"] - per_volt * 0.5 / drive["k_m"]
    linear = linearize(frictionless, x0, [0.5, -0.5], outputs=OUTPUTS)
    A, B, _ = in_order(linear, drive["N_2"])
    system = three_dof_ss(drive, states="angles")  # its states are in ORDER
    np.testing.assert_allclose(A, system.A, rtol=SAME, atol=SAME * np.abs(system.A[3:, 3:]).max())
    np.testing.assert_allclose(B, system.B, rtol=SAME)
    omega = 2 * np.pi * np.geomspace(0.1, 1000.0, 60)
    own = three_dof_ss(drive, outputs=("omega_L",))
    a = linearize(frictionless, x0, [0.5, -0.5]).frequency_response(omega).complex[0]
    b = own.frequency_response(omega).complex[0]
    np.testing.assert_allclose(a, b, rtol=1e-5)


def test_warns_inside_the_gap(frictionless):
    with pytest.warns(UserWarning, match=r"mesh is in its gap .* under preload") as said:
        linear = linearize(frictionless, np.zeros(6), np.zeros(2), outputs=OUTPUTS)
    assert [str(w.message)[:8] for w in said] == ["the left", "the righ"]
    assert np.sum(np.abs(linear.poles()) < 1e-3) >= 3


def test_warns_of_what_friction_holds(paper):
    x0 = np.array([0.00411, -0.00294, 0.0, 0.0, 0.0, 0.0])  # both meshes closed
    with pytest.warns(UserWarning, match="is held by friction") as said:
        linearize(paper, x0, np.zeros(2))
    assert len(said) == 3  # two chains and the ring gear


def test_a_turn_is_steady(paper):
    """Also with effects in the way: no acceleration at the state that `turning` gives."""
    model = paper.with_effect("unbalance", cosine=6.0).with_effect("drive_offset", left=0.03)
    model = model.with_effect("ring_gear_eccentricity", cosine=1e-3)
    x0, u0 = turning(model, speed=-0.2, preload=0.5, theta_L=0.4)
    assert x0[5] == -0.2
    assert u0[0] - u0[1] == pytest.approx(1.0)
    sys = to_blocks(model)
    rate = dict(
        zip(sys.state_labels, sys.dynamics(0.0, initial_state(model, sys, x0), u0), strict=True)
    )
    for block in ("pinion_l", "pinion_r", "ring"):
        assert abs(rate[f"{block}_omega"]) < 1e-6


def test_no_steady_turn_says_so(paper):
    """At rest friction leaves the balance open; 0.1 V are too little to turn at all."""
    with pytest.raises(ValueError, match="a steady turn needs a speed"):
        turning(paper, speed=0.0)
    with pytest.raises(ValueError, match="no steady turn at 0.1745 rad/s"):
        turning(paper.with_effect("drive_saturation", inverse_limit=10.0))


@pytest.mark.parametrize("effect", [{"drive_delay": 0.004}, {"sensor_delay": 0.004}])
def test_delay_is_padé_of_the_exact_one(frictionless, effect):
    """Against e^(−sT) up to ω T = 3; the plant without delay cancels."""
    ((name, delay),) = effect.items()
    x0 = np.zeros(6)
    x0[0], x0[1] = 0.006, -0.006
    plain = linearize(frictionless, x0, np.zeros(2))
    late = linearize(frictionless.with_effect(name, delay=delay), x0, np.zeros(2))
    omega = np.linspace(1.0, 3.0 / delay, 40)
    row = plain.output_labels.index("omega_L")
    ratio = (
        late.frequency_response(omega).complex[row, 0]
        / plain.frequency_response(omega).complex[row, 0]
    )
    np.testing.assert_allclose(ratio, np.exp(-1j * omega * delay), atol=2e-3)


def test_loop_of_the_blocks_is_the_loop_of_the_linear_model(paper):
    """Closed by the PI block, linearised = linear plant with G_c = kp + ki/s around it."""
    loop = Loop(kp=4.0, ki=80.0, limit=10.0, bias_l=0.3, bias_r=-0.3)
    x0, u0 = turning(paper, preload=0.3)
    plant = linearize(paper, x0, u0)
    closed = to_blocks(paper, loop=loop)
    state = initial_state(paper, closed, x0)
    state[closed.state_labels.index("pi_integral")] = np.mean(u0) / loop.ki
    found = closed.linearize(state, x0[5], copy_names=True)
    speed = plant.output_labels.index("omega_L")
    both = plant[speed, 0] + plant[speed, 1]  # the PI drives the two motors alike
    open_loop = both * ct.tf([loop.kp, loop.ki], [1.0, 0.0])
    omega = 2 * np.pi * np.geomspace(0.1, 300.0, 50)
    expected = open_loop.frequency_response(omega).complex
    expected = expected / (1.0 + expected)
    row = found.output_labels.index("omega_L")
    np.testing.assert_allclose(found.frequency_response(omega).complex[row, 0], expected, rtol=1e-4)
