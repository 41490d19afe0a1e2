"""Friction and a mesh taken out of the diagram, on a body of the user's own."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.simulate.blocks import to_blocks
from dmptm_ctrl.simulate.model import Model

INERTIA, COULOMB = 0.4, 2.0  # kg·m², N·m
DRY = ("T3s_plus", "T3c_plus", "T3s_minus", "T3c_minus")


def block(name, **values):
    blocks = {system.name: system for system in to_blocks(Model().with_values(**values)).syslist}
    return blocks[name]


def own_body(brake):
    """An inertia: the torque on it and what brakes it in, its motion out."""
    return ct.ss(
        [[0.0, 1.0], [0.0, 0.0]],
        np.array([[0.0, 0.0], [1.0, -1.0]]) / INERTIA,
        np.eye(2),
        np.zeros((2, 2)),
        inputs=["net_l", brake],
        outputs=["theta_3l", "omega_3l"],
        name="own",
    )


@pytest.fixture(scope="module")
def braked():
    """Dry friction of one torque on the body; the torque on it comes from outside."""
    dry = block("friction_l", **dict.fromkeys(DRY, COULOMB), B3_plus=0.0, B3_minus=0.0)
    system = ct.interconnect(
        [own_body("friction_torque_l"), dry],
        inputs=["net_l"],
        outputs=["theta_3l", "omega_3l", "friction_torque_l", "held_l"],
    )
    assert system.state_labels == ["own_x[0]", "own_x[1]"]
    return system


def test_friction_alone_brakes_and_holds(braked):
    """J ω̇ = −Tc: the body stops after ω₀ J/Tc at ω₀² J/(2 Tc), and a smaller torque leaves it."""
    speed, time = 1.5, np.linspace(0.0, 0.6, 601)
    stop = speed * INERTIA / COULOMB
    torque = np.where(time < 0.4, 0.0, 0.7 * COULOMB)
    run = ct.input_output_response(
        braked, time, torque, [0.0, speed], solve_ivp_kwargs={"max_step": 1e-3, "rtol": 1e-8}
    )
    theta, omega, rub, held = run.outputs
    np.testing.assert_allclose(omega, np.maximum(speed * (1.0 - time / stop), 0.0), atol=2e-4)
    assert theta[-1] == pytest.approx(0.5 * speed * stop, rel=1e-3)
    assert (held == (time > stop)).mean() > 0.99
    np.testing.assert_allclose(rub[time > 0.45], 0.7 * COULOMB, rtol=1e-12)


def test_friction_alone_lets_go_above_breakaway(braked):
    time = np.linspace(0.0, 0.2, 201)
    run = ct.input_output_response(
        braked, time, np.full(time.size, 1.5 * COULOMB), solve_ivp_kwargs={"max_step": 1e-3}
    )
    np.testing.assert_allclose(run.outputs[1], 0.5 * COULOMB / INERTIA * time, atol=1e-6)


def test_a_mesh_alone_is_a_dead_zone_and_a_spring():
    """On a fixed ring gear: the torque by the twist, and the body swings at √(k/J) on a flank."""
    stiffness, half_gap, push = 3.0e4, 3e-3, 30.0
    mesh = block("mesh_l", k_m=stiffness, gap_l=half_gap, c=0.0, c_f=0.0)
    twists = np.array([-2.0, -1.0, -0.5, 0.0, 0.9, 1.5]) * half_gap
    torques = [mesh.output(0.0, [], [twist, 0.0, 0.0, 0.0])[0] for twist in twists]
    beyond = np.sign(twists) * np.maximum(np.abs(twists) - half_gap, 0.0)
    np.testing.assert_allclose(torques, stiffness * beyond, atol=1e-12)
    system = ct.interconnect(
        [own_body("torque_l"), mesh],
        inputs=["net_l", "ring_angle", "ring_speed"],
        outputs=["theta_3l"],
        check_unused=False,
    )
    time = np.linspace(0.0, 0.2, 401)
    drive = np.zeros((3, time.size))
    drive[0] = push
    at_rest = half_gap + push / stiffness
    start = [at_rest + 0.5 * push / stiffness, 0.0]
    run = ct.input_output_response(
        system, time, drive, start, solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-12}
    )
    swing = 0.5 * push / stiffness * np.cos(np.sqrt(stiffness / INERTIA) * time)
    np.testing.assert_allclose(run.outputs[0], at_rest + swing, atol=1e-3 * push / stiffness)
