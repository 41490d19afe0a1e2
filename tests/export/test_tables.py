"""Compensation tables against closed forms."""

import numpy as np
import pytest
from tests.export.test_plant import rig_model

from dmptm_ctrl.cli import main
from dmptm_ctrl.export.tables import compensation_tables
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml
from dmptm_ctrl.simulate.rig_model import Placed

MODEL = (
    Model()
    .with_effect("cogging", left_cosine=0.01, right_sine=0.02, order=12.0)
    .with_effect("unbalance", cosine=4.0, sine=-3.0)
)


def test_friction_is_the_law_of_the_paper():
    table = compensation_tables(MODEL)["friction"]
    d = MODEL.drive
    forward = table[table.speed_rad_s > 0]
    v = forward.speed_rad_s.to_numpy()
    bearing = (
        d["TLc_plus"]
        + (d["TLs_plus"] - d["TLc_plus"]) * np.exp(-v / d["WL_plus"])
        + d["BL_plus"] * v
    )
    np.testing.assert_allclose(forward.ring_N_m, bearing, rtol=1e-12)
    gain = d["N_1"] * d["K_d"] * d["K_M"]
    volts = (bearing / (2 * d["N_2"]) + forward.left_N_m) / gain
    np.testing.assert_allclose(forward.u_left_V, volts, rtol=1e-12)
    assert float(table.ring_N_m[table.speed_rad_s == 0].iloc[0]) == 0.0
    assert (table.ring_N_m[table.speed_rad_s < 0] < 0).all()


def test_load_and_motor_are_what_cancels_the_effects():
    tables = compensation_tables(MODEL)
    load, motor = tables["load"], tables["motor"]
    q = load.theta_L_rad
    np.testing.assert_allclose(load.torque_N_m, -4 * np.cos(q) + 3 * np.sin(q), atol=1e-12)
    q = motor.theta_m_rad
    np.testing.assert_allclose(motor.torque_left_N_m, -0.01 * np.cos(12 * q), atol=1e-12)
    np.testing.assert_allclose(motor.torque_right_N_m, -0.02 * np.sin(12 * q), atol=1e-12)
    constant = MODEL.drive["K_d"] * MODEL.drive["K_M"]
    np.testing.assert_allclose(motor.u_left_V * constant, motor.torque_left_N_m, atol=1e-12)


def test_a_drive_without_effects_has_its_friction_only():
    assert list(compensation_tables(Model())) == ["friction"]


def test_rig_of_another_shape():
    model = rig_model().with_effect(Placed("unbalance", "load", {"cosine": 0.5, "sine": 0.2}))
    tables = compensation_tables(model)
    load = tables["load"]
    q = load.position_SI
    np.testing.assert_allclose(load.load_N_m, -0.5 * np.cos(q) - 0.2 * np.sin(q), atol=1e-12)
    friction = tables["friction"]
    v = friction.speed_SI[friction.speed_SI > 0]
    expected = 0.1 + 0.05 * np.exp(-v / 0.1) + 0.01 * v
    np.testing.assert_allclose(friction.load_N_m[v.index], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("to", "names"),
    [("table", ["friction.csv", "load.csv", "motor.csv"]), ("mujoco", ["joint.xml"])],
)
def test_command(to, names, tmp_path):
    (tmp_path / "model.toml").write_text(to_toml(MODEL), encoding="utf-8")
    out = tmp_path / "out"
    assert main(["export", str(tmp_path / "model.toml"), "--to", to, "--out", str(out)]) == 0
    assert sorted(p.name for p in out.iterdir()) == names
    assert all("model.toml, SHA-256" in p.read_text("utf-8") for p in out.iterdir())
