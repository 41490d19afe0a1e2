"""What no run may do: create energy, pull a tooth, know the zero of an angle, creep at rest."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.blocks import REST_SPEED, initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import OUTPUTS, march
from dmptm_ctrl.simulate.model import Model

COUNT = 2.0 * np.pi / 2**18  # rad, the ring gear's encoder
PASSIVE = {
    "none": {},
    "load_dependent_friction": {"coefficient": 0.1},
    "position_dependent_friction": {"cosine": 5.0, "sine": -8.0},
    "local_spot": {"height": 10.0, "place": 0.0, "width": 0.1},
    "thermal_drift": {"rise": 0.5, "time_constant": 0.7},
    "quadratic_drag": {"coefficient": 100.0},
    "back_emf": {"damping": 0.002},
    "reducer_compliance": {"compliance": 1e-4},
}


def passive_model(name):
    model = Model()
    return model if name == "none" else model.with_effect(name, **PASSIVE[name])


states = st.tuples(
    st.floats(-0.01, 0.01),
    st.floats(-0.01, 0.01),
    st.floats(-0.5, 0.5),
    *[st.floats(-3.0, 3.0)] * 2,
    st.floats(-0.4, 0.4),
)


def bodies(z_l, z_r, theta_L, v_l, v_r, v_L):
    """State with the given twists of the meshes."""
    n2 = Model().drive["N_2"]
    return np.array([n2 * theta_L + z_l, n2 * theta_L + z_r, theta_L, v_l, v_r, v_L])


@pytest.mark.parametrize("name", PASSIVE)
@settings(max_examples=40, deadline=None, derandomize=True)
@given(state=states, twist=st.floats(-2e-3, 2e-3), damping=st.floats(1.0, 10.0))
def test_power_of_passive_elements_is_never_positive(name, state, twist, damping):
    """d/dt (½ Σ J ω² + ½ k depth² + ½ twist²/C) ≤ 0 without voltage, in the blocks.

    Speeds in the band that counts as rest are left out: there the net torque, not the
    speed, says which way friction points.
    """
    assume(all(v == 0.0 or abs(v) > REST_SPEED for v in state[3:]))
    model = passive_model(name).with_values(c=damping)
    drive = model.drive
    sys = to_blocks(model)
    x = dict(zip(sys.state_labels, initial_state(model, sys, bodies(*state)), strict=True))
    for s in "lr":
        if f"motor_{s}_theta" in x:
            x[f"motor_{s}_theta"] += twist
    full = np.array([x[label] for label in sys.state_labels])
    rate = dict(zip(sys.state_labels, sys.dynamics(0.0, full, np.zeros(2)), strict=True))
    motor = drive["N_1"] ** 2 * drive["J_m"]
    elastic = "motor_l_theta" in x
    inertias = {"ring": drive["J_L"]}
    terms = []
    for s, gap in (("l", drive["gap_l"]), ("r", drive["gap_r"])):
        inertias[f"pinion_{s}"] = drive["J_2"] + (0.0 if elastic else motor)
        z = x[f"pinion_{s}_theta"] - drive["N_2"] * x["ring_theta"]
        z_rate = rate[f"pinion_{s}_theta"] - drive["N_2"] * rate["ring_theta"]
        terms.append(drive["k_m"] * max(abs(z) - gap, 0.0) * np.sign(z) * z_rate)
        if elastic:
            turned = x[f"motor_{s}_theta"] - x[f"pinion_{s}_theta"]
            turning = rate[f"motor_{s}_theta"] - rate[f"pinion_{s}_theta"]
            terms.append(turned * turning / PASSIVE[name]["compliance"])
            terms.append(motor * x[f"motor_{s}_omega"] * rate[f"motor_{s}_omega"])
    for block, inertia in inertias.items():
        terms.append(inertia * x[f"{block}_omega"] * rate[f"{block}_omega"])
    assert sum(terms) <= 1e-12 * sum(abs(term) for term in terms)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(state=states, damping=st.floats(1.0, 10.0), dry=st.sampled_from([0.0, 1.0]))
def test_free_decay_of_the_compiled_loop_gains_no_energy(state, damping, dry):
    """Energy at each step, from speeds that the midpoint rule's angles give back exactly.

    The scheme keeps a neighbouring energy, which differs by (ω h)²/8 of the whole; between
    samples no more may come back.
    """
    model = Model()
    frictions = [n for n in model.drive if n[:2] in ("T3", "TL", "B3", "BL")]
    model = model.with_values(c=damping, **{n: dry * model.drive[n] for n in frictions})
    drive = model.drive
    h, steps = 1e-5, 4000  # s; 40 ms of free decay
    x0 = bodies(*state)
    out = march(model, np.zeros((2, steps)), x0, h, substeps=1)
    angles = np.array(
        [out[:, 2] / drive["N_1"], out[:, 3] / drive["N_1"], out[:, OUTPUTS.index("theta_L")]]
    )
    # q₊ = q + ½ h (v + v₊), solved for v₊ from the first on: an alternating sum
    turns = 2.0 * np.diff(angles, prepend=angles[:, :1]) / h
    turns[:, 0] = x0[3:]
    sign = (-1.0) ** np.arange(steps)
    speeds = sign * np.cumsum(sign * turns, axis=1)
    np.testing.assert_allclose(speeds[2], out[:, OUTPUTS.index("omega_L")], atol=1e-6)
    pinion = drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]
    inertia = np.array([pinion, pinion, drive["J_L"]])
    energy = 0.5 * inertia @ speeds**2
    for column, gap in (("z_l", "gap_l"), ("z_r", "gap_r")):
        depth = np.maximum(np.abs(out[:, OUTPUTS.index(column)]) - drive[gap], 0.0)
        energy += 0.5 * drive["k_m"] * depth**2
    least = np.minimum.accumulate(energy)
    stiffest = np.sqrt(drive["k_m"] * (1.0 / pinion + 2.0 * drive["N_2"] ** 2 / drive["J_L"]))
    allowed = 0.25 * (stiffest * h) ** 2 * energy[0]  # 5e-5 of the first energy
    assert np.all(energy - least <= allowed + 1e-12)


@pytest.mark.parametrize("method", ["compiled", "reference"])
def test_mesh_never_pulls(paper, lively, method):
    """Dry gap: the torque has the sign of z, and none inside the gap but contact damping."""
    model = paper.with_values(c_f=0.0)
    time, u, x0 = lively
    out = simulate(model, time, u, x0, method=method).outputs
    for s in "lr":
        torque, z = (out[OUTPUTS.index(f"{q}_{s}")] for q in ("torque", "z"))
        assert np.all(torque * z >= 0.0)
        inside = np.abs(z) < 0.9 * model.drive[f"gap_{s}"]
        assert inside.sum() > 5
        assert np.all(torque[inside] == 0.0)
        assert np.abs(torque).max() > 1.0


@pytest.mark.parametrize("turn", [0.75, -40.0])
def test_zero_of_the_angles_is_arbitrary(paper, lively, turn):
    """All angles moved together: the same motion, moved. Rounding only."""
    time, u, x0 = lively
    n1, n2 = paper.drive["N_1"], paper.drive["N_2"]
    moved = x0 + np.array([n2 * turn, n2 * turn, turn, 0.0, 0.0, 0.0])
    here = simulate(paper, time, u, x0).outputs
    there = simulate(paper, time, u, moved).outputs
    shift = {"theta_L": turn, "theta_ml": n1 * n2 * turn, "theta_mr": n1 * n2 * turn}
    for i, name in enumerate(OUTPUTS):
        difference = there[i] - shift.get(name, 0.0) - here[i]
        assert np.abs(difference).max() < 1e-8 * max(1.0, np.abs(there[i]).max()), name


def test_held_by_friction_for_1000_s_drifts_less_than_a_count(paper):
    """Voltages near breakaway, with a dither, after the gaps have closed."""
    dt = 4e-3  # s
    time = dt * np.arange(250_001)
    u = np.array([[0.27], [-0.19]]) + 0.005 * np.sin(2 * np.pi * 7.0 * time)
    out = simulate(paper, time, u).outputs
    settled = time >= 1.0
    drift = np.ptp(out[0, settled])
    assert drift < COUNT
    assert np.all(out[OUTPUTS.index("omega_L"), settled] == 0.0)
    motors = out[OUTPUTS.index("theta_ml") : OUTPUTS.index("theta_mr") + 1, settled]
    assert np.all(np.ptp(motors, axis=1) / (paper.drive["N_1"] * paper.drive["N_2"]) < COUNT)


def test_held_by_friction_does_not_move_in_blocks_and_reference(paper):
    """No rate at all in the blocks; the reference steps over 1000 s in one hold."""
    u = np.array([0.27, -0.19])
    sys = to_blocks(paper)
    state = initial_state(paper, sys, np.zeros(6))
    np.testing.assert_array_equal(sys.dynamics(0.0, state, u), np.zeros(sys.nstates))
    pushed = sys.dynamics(0.0, state, np.array([0.3, -0.19]))
    assert np.any(pushed != 0.0)  # 2.9 N·m are more than the 2.8 that hold
    time = np.array([0.0, 500.0, 1000.0])
    held = np.tile(u[:, None], 3)
    out = simulate(paper, time, held, method="reference").outputs
    assert np.ptp(out[0]) == 0.0
