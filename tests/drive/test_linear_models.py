from math import cos

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.drive import (
    Drive,
    nine_dof_parameters,
    nine_dof_ss,
    nine_dof_train,
    paper_drive,
    rigid_equivalent,
    solve_modes,
    three_dof_ss,
    three_dof_train,
)


def paper_equations(drive: Drive, p: dict[str, float], q, v, torque):
    """Eqs. 1 to 15 as the paper writes them, one body after another."""
    c12 = cos(p["alpha_1"]) * cos(p["delta_1"])
    acceleration, ring_force = [], 0.0
    mesh = {}
    for s, side in enumerate("lr"):
        t0, t1, t2, t3 = q[4 * s : 4 * s + 4]
        w0, w1, w2, w3 = v[4 * s : 4 * s + 4]
        t01 = p["K_01"] * (t0 - t1)  # 4, 5
        length = (t1 * p["R_1"] - t2 * p["R_2"]) * c12  # 9
        rate = (w1 * p["R_1"] - w2 * p["R_2"]) * c12
        f12r = (p["K_12"] * length + p["D_12"] * rate) * cos(p["alpha_1"])  # 7, 8
        t23 = p["K_23"] * (t2 - t3)  # 11, 12
        length = (t3 * p["R_3"] - q[8] * p["R_L"]) * cos(p["alpha_3"])  # 14
        rate = (w3 * p["R_3"] - v[8] * p["R_L"]) * cos(p["alpha_3"])
        f34t = (p["K_34"] * length + p["D_34"] * rate) * cos(p["alpha_3"])  # 13
        acceleration += [
            (torque[s] - t01 - p["D_m"] * w0) / drive["J_m"],  # 1
            (t01 - f12r * p["R_1"] - p["D_1"] * w1) / p["J_1"],  # 2
            (f12r * p["R_2"] - t23 - p["D_2"] * w2) / p["J_2"],  # 6
            (t23 - f34t * p["R_3"] - p["D_3"] * w3) / p["J_3"],  # 10
        ]
        ring_force += f34t
        mesh[side] = f34t * p["R_3"]
    acceleration.append((ring_force * p["R_L"] - p["D_L"] * v[8]) / drive["J_L"])  # 15
    return np.array(acceleration), mesh


def test_nine_dof_is_the_papers_equations():
    drive, rng = paper_drive(), np.random.default_rng(1)
    p = nine_dof_parameters(drive, D_m=1e-4, D_1=2e-4, D_2=0.3)
    system = nine_dof_ss(drive, inputs="torque", outputs=("tau_l", "tau_r"), states="angles", **p)
    for _ in range(5):
        q, v, torque = rng.normal(size=9), rng.normal(size=9), rng.normal(size=2)
        expected, mesh = paper_equations(drive, p, q, v, torque)
        rate = system.A @ np.concatenate([q, v]) + system.B @ torque
        np.testing.assert_allclose(rate[:9], v)
        np.testing.assert_allclose(rate[9:], expected, rtol=1e-10)
        reading = system.C @ np.concatenate([q, v])
        np.testing.assert_allclose(reading, [mesh["l"], mesh["r"]], rtol=1e-10)


def test_three_dof_is_the_appendix():
    drive = paper_drive()
    train = three_dof_train(drive)
    k, c, n2 = drive["k_m"], drive["c"], drive["N_2"]
    pattern = np.array([[1, 0, -n2], [0, 1, -n2], [-n2, -n2, 2 * n2**2]])  # R_L/R3 = N2
    d3, d_ring = 0.009 * 180 / np.pi, 1.1 * 180 / np.pi  # Table 2, mean of both directions
    np.testing.assert_allclose(train.stiffness, k * pattern, rtol=1e-12)
    np.testing.assert_allclose(train.damping, c * pattern + np.diag([d3, d3, d_ring]), rtol=1e-12)
    np.testing.assert_allclose(train.mass, np.diag([0.25, 0.25, 2.5]), rtol=1e-12)


def test_names_of_states_inputs_outputs():
    system = three_dof_ss(outputs=("theta_L", "omega_ml", "tau_r"))
    speeds = ["omega_3l", "omega_3r", "omega_L"]
    assert system.state_labels == ["theta_L", "spring_tau_l", "spring_tau_r", *speeds]
    without = three_dof_ss(outputs=("omega_ml", "tau_r"))
    assert without.state_labels == ["spring_tau_l", "spring_tau_r", *speeds]
    angles = three_dof_ss(states="angles").state_labels
    assert angles == ["theta_3l", "theta_3r", "theta_L", *speeds]
    assert system.input_labels == ["u_left", "u_right"]
    assert system.output_labels == ["theta_L", "omega_ml", "tau_r"]
    every = nine_dof_train().outputs
    torque = nine_dof_ss(inputs="torque", outputs=every)
    assert torque.input_labels == ["T_left", "T_right"]
    assert torque.nstates == 18
    assert torque.noutputs == 9 + 9 + 8
    s = 30j  # angles by springs and one angle are the angles themselves
    np.testing.assert_allclose(
        torque(s), nine_dof_ss(inputs="torque", outputs=every, states="angles")(s), rtol=1e-6
    )


def test_voltage_is_torque_times_gain():
    """Eq. 3: 3 A/V · 0.13 N·m/A; steady speed of both chains against viscous friction."""
    assert three_dof_ss().B[2, 0] == pytest.approx(0.39 * three_dof_ss(inputs="torque").B[2, 0])
    system = three_dof_ss(outputs=("omega_L", "omega_mr", "tau_l"))
    d3, d_ring = 0.009 * 180 / np.pi, 1.1 * 180 / np.pi
    speed = 2 * 25 * 8.25 * 0.39 / (d_ring + 2 * 8.25**2 * d3)
    mesh = d_ring * speed / (2 * 8.25)
    steady = ct.dcgain(system) @ np.ones(2)
    np.testing.assert_allclose(steady, [speed, 25 * 8.25 * speed, mesh], rtol=1e-9)


@pytest.mark.parametrize("train", [three_dof_train(), nine_dof_train()], ids=["3", "9"])
@pytest.mark.parametrize("states", ["angles", "twists"])
def test_response_is_the_dynamic_stiffness_inverted(train, states):
    """jω c (K + jω D − ω² M)⁻¹ E, without any state space."""
    system = train.to_ss(outputs=("omega_L", "omega_ml"), states=states)
    rows = np.array([train.angle_row("L"), train.angle_row("ml")])
    drives = train.torque_per_volt * train.drives
    for w in np.logspace(0, 4, 20):
        dynamic = train.stiffness + 1j * w * train.damping - w**2 * train.mass
        expected = 1j * w * rows @ np.linalg.solve(dynamic, drives)
        inverse = np.linalg.solve(1j * w * np.eye(system.nstates) - system.A, system.B)
        np.testing.assert_allclose(system.C @ inverse, expected, rtol=1e-6)
        # python-control's own evaluation reduces to Hessenberg form and keeps fewer digits
        assert abs(system(1j * w) - expected).max() < 1e-3 * abs(expected).max()


def low_modes(softness: float, *, as_printed: bool) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of the 9-DOF with K01, K12, K23 divided by `softness`, and of the 3-DOF."""
    drive = paper_drive()
    p = nine_dof_parameters(drive, J_1=1e-4)  # N1² J1 is a quarter of J̄3: well visible
    for name in ("K_01", "K_12", "K_23"):
        p[name] /= softness
    rigid = rigid_equivalent(drive, p)
    if as_printed:
        rigid = drive.with_values(J_2=p["J_1"] + p["J_2"] + p["J_3"])
    nine = solve_modes(nine_dof_train(drive, **p)).omega[1:3]
    return nine, solve_modes(three_dof_train(rigid)).omega[1:]


def test_nine_dof_converges_to_three_dof_at_first_order_in_compliance():
    softness = np.array([1e-2, 1e-3, 1e-4])
    pairs = [low_modes(s, as_printed=False) for s in softness]
    errors = np.array([abs(nine / three - 1) for nine, three in pairs])
    order = np.diff(np.log(errors), axis=0) / np.diff(np.log(softness))[:, None]
    assert order[-1] == pytest.approx([1.0, 1.0], abs=0.02)
    assert (errors[-1] < 1e-4).all()


def test_printed_reduced_inertia_is_not_the_limit():
    nine, three = low_modes(1e-5, as_printed=True)
    assert abs(nine / three - 1).max() > 0.05


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: three_dof_ss(outputs=("omega_2l",)), "no output 'omega_2l'.*omega_3l"),
        (lambda: three_dof_ss(inputs="amps"), "voltage, torque"),
        (lambda: three_dof_ss(states="modal"), "angles or twists"),
        (lambda: nine_dof_ss(K_99=1.0), "no 9-DOF parameter 'K_99'"),
        (lambda: nine_dof_ss(K_01=0.0), "K_01 is 0, it must be more than zero"),
        (lambda: nine_dof_ss(J_1=1.0), "J_2 is -"),
    ],
)
def test_refusals(call, message):
    with pytest.raises(ValueError, match=message):
        call()
