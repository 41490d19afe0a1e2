"""MuJoCo's joint against the package's own simulator, where what is lost plays no part."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.export.test_plant import RIG, rig_model, visible

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.export.mujoco import mujoco_joint, mujoco_text
from dmptm_ctrl.export.run import export_file
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import rig_model_to_toml
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

SOURCE = Path(__file__)


def test_dual_motor_drive_by_hand():
    model = Model().with_effect("drive_delay", delay=3e-3).with_effect("cogging", left_sine=0.01)
    joint, d = mujoco_joint(model), model.drive
    n = d["N_1"] * d["N_2"]
    assert joint.armature == pytest.approx(2 * (n**2 * d["J_m"] + d["N_2"] ** 2 * d["J_2"]))
    assert joint.frictionloss == pytest.approx(18.5 + 2 * 8.25 * 2.15)
    gear = n * d["K_d"] * d["K_M"]
    assert joint.actuators == (("left", gear, 3e-3, 0.0), ("right", gear, 3e-3, 0.0))
    text = mujoco_text(joint, SOURCE)
    assert "effect cogging" in text
    assert "effect drive_delay" not in text
    assert "backlash: half-gaps" in text


def run(joint, signals, dt=1e-3):
    mujoco = pytest.importorskip("mujoco")
    text = mujoco_text(joint, SOURCE)
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    speed = []
    for row in signals.T:
        speed.append(float(data.qvel[0]))
        data.ctrl[:] = row
        mujoco.mj_step(model, data)
    return np.array(speed)


def test_steady_speed_and_start_are_those_of_the_simulator():
    model = Model()
    u = np.full((2, 3000), 1.2)
    own = march(model, u, rest(model, 0.0), 1e-3)[:, 1]
    found = run(mujoco_joint(model), u)
    assert own[-1] > 0.2
    # its friction is the mean of both directions and without Stribeck's part
    assert found[-1] == pytest.approx(own[-1], rel=0.25)


VALUES = {"body.load.static": 0.1, "link.belt.stiffness": 4000.0, "link.belt.damping": 2.0}


@pytest.mark.parametrize("delay", [0.0, 5e-3, 20e-3])
def test_a_dead_time_is_the_simulators_to_the_sample(delay):
    late = rig_model().with_values({**VALUES, "input.voltage.delay": delay})
    u = 6.0 * (np.arange(400) >= 100.0)[None]
    own = simulate(late, 1e-3 * np.arange(400), u).outputs[1]
    found = run(mujoco_joint(late), u)
    assert np.argmax(own > 0.0) == pytest.approx(101 + 1e3 * delay, abs=1)
    np.testing.assert_allclose(found, own, rtol=0, atol=2e-3 * own.max())


@pytest.mark.parametrize("name", CATALOGUE)
def test_each_effect_is_in_the_joint_or_said_to_be_lost(name):
    model = visible(name)
    joint, plain = mujoco_joint(model), mujoco_joint(Model())
    assert (f"effect {name}" in joint.lost) != (replace(joint, lost=()) != replace(plain, lost=()))


@pytest.mark.parametrize("name", PLACED_CATALOGUE)
def test_each_effect_of_a_rig_is_in_the_joint_or_said_to_be_lost(name):
    placed = PLACED_CATALOGUE[name]
    at = {"body": "load", "link": "belt", "input": "voltage", "sensor": "speed"}[placed.place]
    values = dict(zip([p.name for p in placed.keep], placed.defaults, strict=True))
    values |= {p.name: p.step for p in placed.keep if p.name in placed.amplitudes}
    model = rig_model().with_effect(Placed(name, at, values))
    joint, plain = mujoco_joint(model), mujoco_joint(rig_model())
    kept = replace(joint, lost=()) != replace(plain, lost=())
    assert f"effect {name}" in joint.lost or kept
    assert "belt: compliance" in "".join(joint.lost)


def test_names_of_any_letters(tmp_path):
    rig = parse_rig(
        RIG.replace('"load"', '"Drehkörper"').replace("[body.load]", '[body."Drehkörper"]')
    )
    (tmp_path / "rig.toml").write_text(rig_model_to_toml(RigModel(rig)), encoding="utf-8")
    export_file(tmp_path / "rig.toml", "mujoco", tmp_path / "out")
    model = pytest.importorskip("mujoco").MjModel.from_xml_path(str(tmp_path / "out" / "joint.xml"))
    assert model.joint(0).name == "Drehkörper"


def test_rig_follows_where_nothing_is_lost():
    rig = rig_model()
    lag = Placed("current_lag", "voltage", {"time_constant": 0.02})
    stiff = RigModel(rig.rig, (lag,), VALUES)
    time = 1e-3 * np.arange(1500)
    u = 6.0 * np.sin(2 * np.pi * 1.0 * time)[None]
    own = simulate(stiff, time, u).outputs[1]
    found = run(mujoco_joint(stiff), u)
    assert np.abs(own).max() > 1.0
    assert np.sqrt(np.mean((found - own) ** 2)) < 0.03 * np.abs(own).max()
