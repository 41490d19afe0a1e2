"""Chains of 1, 2, 3 and 5 bodies and a branched train: linear, block and compiled agree."""

import control as ct
import numpy as np
import pytest
from scipy.signal import cont2discrete

from dmptm_ctrl.diagnosis.rig_report import counted_unit, torque_unit
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.blocks import to_blocks
from dmptm_ctrl.simulate.linear import linearize, modes
from dmptm_ctrl.simulate.reference import run_exactly
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT = 1e-3


def train(joints, count, extra=""):
    """Bodies 0 … count−1, links (i, j, ratio, stiffness) with stiffness 0 for rigid."""
    text = ['name = "train"']
    for i in range(count):
        text += [f"[body.b{i}]", f"inertia = {0.01 * (i + 1)}", f"viscous = {0.02 * (i + 1)}"]
    for i, j, ratio, stiffness in joints:
        text += [f"[shaft.s{i}{j}]", f'between = ["b{i}", "b{j}"]', f"ratio = {ratio}"]
        text += [f"stiffness = {stiffness}", "damping = 0.05"] if stiffness else []
    text += ["[input.m]", 'column = "u_V"', 'body = "b0"', 'gain = "0.5 N m/V"']
    text += ["[sensor.first]", 'column = "w0_rad_s"', 'body = "b0"']
    text += ["[sensor.last]", 'column = "q_rad"', f'body = "b{count - 1}"']
    return parse_rig("\n".join(text) + "\n" + extra)


TRAINS = {
    "1 body": train([], 1),
    "2 bodies": train([(0, 1, 3, 40)], 2),
    "2 rigid": train([(0, 1, 3, 0)], 2),
    "3 bodies": train([(0, 1, 3, 40), (1, 2, -0.5, 90)], 3),
    "5 bodies": train([(0, 1, 1, 40), (1, 2, 2, 0), (2, 3, 1, 60), (3, 4, 4, 30)], 5),
    "branched": train([(0, 1, 2, 40), (0, 2, 3, 25), (2, 3, 1, 0), (2, 4, 1, 60)], 5),
}
TIME = DT * np.arange(600)
DRIVE = np.where(TIME < 0.2, 1.0, -0.5)


# each is a loop to compile: the others are like these, or parts of them
@pytest.mark.parametrize("name", ["1 body", "2 rigid", "5 bodies", "branched"])
def test_compiled_follows_the_exact_linear_response(name):
    """Held inputs: zero-order hold is exact; the step's error falls with its square."""
    model = RigModel(TRAINS[name])
    system = linearize(model)
    a, b, c, *_ = cont2discrete((system.A, system.B, system.C, system.D), DT, method="zoh")
    x, exact = np.zeros(a.shape[0]), []
    for u in DRIVE:
        exact.append(c @ x)
        x = a @ x + b[:, 0] * u
    exact = np.array(exact).T
    errors = []
    for substeps in (8, 16):
        run = march(model, DRIVE[None], DT, substeps=substeps)
        done = np.array([run.reading("first"), run.reading("last")])
        scale = np.abs(exact).max(axis=1, keepdims=True)
        errors.append(np.abs((done - exact) / scale).max())
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


@pytest.mark.parametrize("name", TRAINS)
def test_blocks_are_the_linear_model(name):
    model = RigModel(TRAINS[name])
    blocks = to_blocks(model)
    # linearised where everything moves: at rest friction would hold it
    moving = np.ones(blocks.nstates)
    linear = ct.linearize(blocks, moving, 1.0, eps=1e-6)
    known = linearize(model)
    for hertz in (0.3, 3.0, 30.0):
        s = 2j * np.pi * hertz
        assert linear(s) == pytest.approx(known(s), rel=1e-5)


def test_modes_of_a_chain_by_hand():
    """Three equal discs, two equal springs: ω² = 0, k/J, 3k/J."""
    text = "".join(f"[body.b{i}]\ninertia = 0.02\n" for i in range(3))
    for i, j in ((0, 1), (1, 2)):
        text += f'[shaft.s{i}]\nbetween = ["b{i}", "b{j}"]\nstiffness = 50\ndamping = 0\n'
    text += '[input.m]\ncolumn = "u_V"\nbody = "b0"\n[sensor.s]\ncolumn = "q_rad"\nbody = "b2"\n'
    expected = np.sqrt(np.array([0, 1, 3]) * 50 / 0.02) / (2 * np.pi)
    assert modes(RigModel(parse_rig(text))).hz == pytest.approx(expected, abs=1e-5)


def test_friction_gap_and_cogging_in_blocks_and_compiled():
    """Every kernel of a nonlinear chain, in an ODE solver and in the compiled loop."""
    rig = train([(0, 1, 3, 400)], 2)
    model = RigModel(
        rig,
        (
            Placed("coulomb_friction", "b0", {"level": 0.05}),
            Placed("cogging", "b0", {"cosine": 0.03, "sine": 0.02, "order": 5.0}),
            Placed("backlash", "s01", {"half_gap": 0.02}),
            Placed("current_lag", "m", {"time_constant": 0.01}),
        ),
    )
    drive = 1.5 * np.sin(2 * np.pi * 2 * TIME)
    run = march(model, drive[None], DT, substeps=40)
    blocks = to_blocks(model)
    held = ct.input_output_response(
        blocks, TIME, drive, np.zeros(blocks.nstates),
        solve_ivp_method="LSODA", solve_ivp_kwargs={"max_step": 2e-4, "rtol": 1e-7},
    )  # fmt: skip
    # the solver's input is a ramp from sample to sample, half a sample ahead of the held one
    seen = np.interp(TIME - DT / 2, TIME, held.outputs[0])
    scale = np.abs(seen).max()
    assert scale > 1.0
    assert np.sqrt(np.mean((run.reading("first") - seen) ** 2)) < 0.01 * scale


def test_dead_times_and_presliding_have_blocks():
    """Beside the reference, which takes dead times exactly and shares no time stepping."""
    effects = (
        Placed("drive_delay", "m", {"delay": 0.01}),
        Placed("sensor_delay", "last", {"delay": 0.004}),
        Placed("presliding", "b0", {"distance": 0.05}),
        Placed("coulomb_friction", "b0", {"level": 0.3}),
    )
    rig = train([(0, 1, 3, 400)], 2)
    model = RigModel(rig, effects)
    drive = np.sin(2 * np.pi * 2 * TIME[:250])
    blocks = to_blocks(model)
    found = ct.input_output_response(
        blocks, TIME[:250], drive, np.zeros(blocks.nstates),
        solve_ivp_method="LSODA", solve_ivp_kwargs={"max_step": 1e-3, "rtol": 1e-8, "atol": 1e-10},
    ).outputs  # fmt: skip
    # the solver's input is a ramp from sample to sample, half a sample ahead of the held one
    seen = np.array([np.interp(TIME[:250] - DT / 2, TIME[:250], y) for y in found])
    plant = model.plant()
    start = np.zeros(plant.inertia.size)
    exact = run_exactly(plant, drive[None], start, start, DT, rtol=1e-8).readings.T
    scale = np.abs(exact).max(axis=1)
    assert (np.sqrt(np.mean((exact - seen) ** 2, axis=1)) < 0.01 * scale).all()
    plain = run_exactly(
        RigModel(rig, effects[3:]).plant(), drive[None], start, start, DT, rtol=1e-8
    ).readings.T
    assert (np.sqrt(np.mean((exact - plain) ** 2, axis=1)) > 0.03 * scale).all()


def test_a_dead_time_cannot_come_by_params():
    text = """
[body.b]
inertia = 0.02
[input.m]
column = "u_V"
body = "b"
delay = "10 ms"
[sensor.s]
column = "q_rad"
body = "b"
"""
    blocks = to_blocks(RigModel(parse_rig(text)))
    x = 0.1 * np.ones(blocks.nstates)
    slower = blocks.dynamics(0.0, x, [0.1], params={"input.m.delay": 0.02})
    at = blocks.state_labels.index("input_m_delay_0")
    assert slower[at] == pytest.approx(0.5 * blocks.dynamics(0.0, x, [0.1])[at])
    with pytest.raises(ValueError, match="a dead time, friction or presliding cannot come or go"):
        blocks.dynamics(0.0, x, [0.1], params={"input.m.delay": 0.0})


@pytest.mark.parametrize(
    ("unit", "torque", "inertia"),
    [("PWM", "PWM", "PWM·s²/rad"), ("1", "duty", "duty·s²/rad"), ("percent", "%", "%·s²/rad")],
)
def test_torques_count_in_what_the_rig_calls_its_input(unit, torque, inertia):
    rig = parse_rig(
        f'[body.a]\ninertia = "unknown"\n[input.u]\ncolumn = "duty"\nunit = "{unit}"\n'
        '[sensor.q]\ncolumn = "q_rad"\n'
    )
    assert torque_unit(rig) == torque
    assert counted_unit(rig, "kg·m²") == inertia


LIKE = """
[body.left]
inertia = "2e-4 kg m^2 ± 10 %"
viscous = 0.01
[body.right]
like = "left"
viscous = 0.02
[body.table]
inertia = 0.01
[mesh.one]
between = ["left", "table"]
ratio = 3
backlash = 0.004
stiffness = "90 ± 20 %"
damping = 0.05
[mesh.two]
like = "one"
between = ["right", "table"]
[input.m]
column = "u_V"
body = "left"
gain = 0.5
[sensor.first]
column = "w0_rad_s"
body = "table"
"""


def test_what_is_like_another_is_one_number_with_it():
    model = RigModel(parse_rig(LIKE))
    apart = LIKE.replace('like = "left"', 'inertia = "2e-4 kg m^2"')
    whole = "ratio = 3\nbacklash = 0.004\nstiffness = 90\ndamping = 0.05"
    apart = RigModel(parse_rig(apart.replace('like = "one"', whole)))
    one, other = model.plant(), apart.plant()
    for field in ("inertia", "law", "link_values"):
        np.testing.assert_array_equal(getattr(one, field), getattr(other, field))
    assert "body.right.inertia" not in model.quantities
    assert {"body.right.viscous", "link.one.half_gap"} <= set(model.quantities)
    for key in ("body.left.inertia", "body.right.inertia"):
        moved = model.with_values({key: 5e-4})
        assert moved.value("body.left.inertia") == moved.value("body.right.inertia") == 5e-4
    moved = model.with_values({"link.two.half_gap": 3e-3}).plant()
    np.testing.assert_array_equal(moved.link_values[:, 4], 3e-3)


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ('like = "left"', 'like = "top"', "top"),
        ('like = "left"', 'like = "right"', "right"),
        ("[body.table]\ninertia = 0.01", '[body.table]\nlike = "right"', "like another itself"),
    ],
)
def test_what_is_like_nothing_is_refused(old, new, reported):
    with pytest.raises(LogError, match=reported):
        parse_rig(LIKE.replace(old, new))
