"""Compensation tables against closed forms."""

import numpy as np
import pandas as pd
import pytest
from tests.export.test_plant import RACK, rig_model

from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.export.tables import compensation_tables
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

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
    q = load.position_rad
    np.testing.assert_allclose(load.load_N_m, -0.5 * np.cos(q) - 0.2 * np.sin(q), atol=1e-12)
    friction = tables["friction"]
    v = friction.speed_rad_s[friction.speed_rad_s > 0]
    expected = 0.1 + 0.05 * np.exp(-v / 0.1) + 0.01 * v
    np.testing.assert_allclose(friction.load_N_m[v.index], expected, rtol=1e-12)
    # the motor turns five times as fast
    np.testing.assert_allclose(friction.motor_N_m[v.index], 0.02 + 0.002 * 5 * v, rtol=1e-12)


@pytest.mark.parametrize("order", [12.0, 180.0, 360.0, 1000.0])
def test_between_rows_lies_a_straight_line(order):
    """Also where as many teeth as rows would make each row alike."""
    model = rig_model().with_effect(
        Placed("cogging", "motor", {"cosine": 0.02, "sine": 0.0, "order": order})
    )
    load = compensation_tables(model)["load"]
    q = np.linspace(0.0, 2 * np.pi, 100_001)
    found = np.interp(q, load.position_rad, load.motor_N_m)
    np.testing.assert_allclose(found, -0.02 * np.cos(order * q), atol=0.02 * 0.012)


def test_sliding_bodies_have_a_table_of_their_own():
    model = RigModel(parse_rig(RACK, "rig.toml")).with_effect(
        Placed("cogging", "load", {"cosine": 3.0, "sine": 0.0, "order": 2 * np.pi / 0.03})
    )
    tables = compensation_tables(model)
    assert list(tables) == ["friction", "slide"]
    slide, friction = tables["slide"], tables["friction"]
    expected = -3.0 * np.cos(2 * np.pi * slide.position_m / 0.03)  # a period of 30 mm
    np.testing.assert_allclose(slide.load_N, expected, atol=1e-9)
    forward = friction[friction.speed_rad_s > 0]  # of the last body, a motor
    np.testing.assert_allclose(forward.load_N, -9.0 / 50 * forward.speed_rad_s, rtol=1e-12)
    np.testing.assert_allclose(forward.motor_N_m, -0.02 - 0.002 * forward.speed_rad_s, rtol=1e-12)


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


def test_files_hold_the_tables(tmp_path):
    """Read as others read them: a comment line begins with a sharp."""
    (tmp_path / "model.toml").write_text(to_toml(MODEL), encoding="utf-8")
    out = tmp_path / "out"
    assert main(["export", str(tmp_path / "model.toml"), "--to", "table", "--out", str(out)]) == 0
    for name, table in compensation_tables(MODEL).items():
        found = pd.read_csv(out / f"{name}.csv", comment="#")
        pd.testing.assert_frame_equal(found, table, rtol=1e-8, atol=1e-12)
