"""The paper's rig as a file is the built-in model."""

import numpy as np
import pandas as pd
import pytest

from dmptm_ctrl import data
from dmptm_ctrl.cli import main
from dmptm_ctrl.diagnosis import run
from dmptm_ctrl.drive import paper_drive, three_dof_ss
from dmptm_ctrl.drive.rig_dual import dual_columns, dual_motor
from dmptm_ctrl.drive.rigfile import load_rig, parse_rig
from dmptm_ctrl.signals import load_log, load_logs
from dmptm_ctrl.simulate.compiled import march as march_built_in
from dmptm_ctrl.simulate.compiled import rest
from dmptm_ctrl.simulate.linear import linearize, modes
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march


@pytest.fixture(scope="module")
def rig():
    return load_rig(data.PAPER_RIG)


def test_declared_values_are_the_tables(rig):
    found, known = dual_motor(rig).quantities, paper_drive().quantities
    for name, quantity in known.items():
        assert found[name].value == pytest.approx(quantity.value, rel=1e-12, abs=1e-300), name
        assert found[name].range == pytest.approx(quantity.range, rel=1e-12, abs=1e-300), name
        assert found[name].unit == quantity.unit


def test_modes(rig):
    """Physics of three bodies in closed form: 0, 60.4 and 230.9 Hz."""
    assert modes(rig).hz == pytest.approx([0, 60.4, 230.9], abs=0.1)


def test_linear_model(rig):
    """Same response from both voltages to both readings."""
    linear = linearize(RigModel(rig))
    built_in = three_dof_ss(outputs=("theta_L", "omega_L"))
    for hertz in (0.1, 5.0, 60.4, 231.0, 900.0):
        s = 2j * np.pi * hertz
        assert linear(s) == pytest.approx(built_in(s), rel=1e-7)  # condition of the states


def test_motion_with_gaps_and_friction(rig):
    """Preloaded reversal, both compiled loops; they differ by their treatment of the gap."""
    t = 1e-3 * np.arange(2000)
    push = 0.9 * np.sin(2 * np.pi * 1.5 * t)
    u = np.array([push + 0.2, push - 0.2])
    model = Model(paper_drive())
    one = march_built_in(model, u, rest(model, 0.0), 1e-3)
    other = march(RigModel(rig), u, 1e-3, substeps=50)
    size = np.abs(one[:, 1]).max()
    assert size > 0.05
    assert np.sqrt(np.mean((other.speed("ring_gear") - one[:, 1]) ** 2)) < 0.05 * size


def test_logs_come_in_under_the_built_in_names(rig):
    one = load_logs(data.path("demo_rig"), dual_columns(rig))[0]
    other = load_logs(data.path("demo_rig"))[0]
    for channel in ("u_left", "u_right", "theta_L", "omega_L"):
        assert np.array_equal(one[channel], other[channel])


def test_patterns_that_fit_no_log_are_told(monkeypatch):
    """As for drives of any shape."""
    monkeypatch.setattr(run, "diagnose_dual", lambda logs, *_: logs)
    more = '\n[data]\nignore = ["summary*"]\nheld_out = ["closed*"]\n'
    logs = run.diagnose(data.path("demo_rig"), parse_rig(data.PAPER_RIG.read_text() + more))
    assert [text.partition(",")[0] for text in logs.warnings] == ["[data] ignore names 'summary*'"]


def test_another_drive_is_not_taken_for_it(rig):
    text = data.PAPER_RIG.read_text()
    assert (
        dual_motor(parse_rig(text.replace('amplifier = "3 A/V"', 'amplifier = "4 A/V"', 1))) is None
    )
    assert dual_motor(parse_rig(text.replace("ratio = 25", "ratio = 30", 1))) is None


def test_own_names_units_and_motor_encoders(tmp_path):
    """The file that `dmptm rig init --dual` writes, with the columns of another recorder."""
    file = tmp_path / "rig.toml"
    assert main(["rig", "init", "--dual", str(file)]) == 0
    text = file.read_text()
    for old, new in (
        ('column = "u_left_V"', 'column = "U1"\nunit = "mV"'),
        ('column = "omega_L_deg_s"', 'column = "gyro"\nunit = "rpm"\nsign = -1'),
        *((f"# {line}", line) for line in (
            "[sensor.motor_left]", "[sensor.motor_right]", 'body = "motor_left"',
            'body = "motor_right"', 'column = "theta_ml_deg"',
        )),
        ('# column = "theta_mr_deg"', 'column = "enc2"\nunit = "turn"'),
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    rig = parse_rig(text + '\n[data]\ntime = { column = "t", unit = "ms" }\n')
    assert dual_motor(rig) is not None
    source = data.path("null_rig") / "open_sine_0v60.csv.gz"
    table = pd.read_csv(source)
    mine = pd.DataFrame(
        {
            "t": 1e3 * table.time_s, "U1": 1e3 * table.u_left_V, "u_right_V": table.u_right_V,
            "theta_L_deg": table.theta_L_deg, "gyro": -table.omega_L_deg_s / 6,
            "theta_ml_deg": table.theta_ml_deg, "enc2": table.theta_mr_deg / 360,
        }
    )  # fmt: skip
    one, other = load_log(mine, dual_columns(rig)), load_log(source)
    assert set(one) == set(other)
    for channel in one:
        np.testing.assert_allclose(one[channel], other[channel], rtol=1e-9, atol=1e-9)
    alone = text.replace('column = "theta_ml_deg"\nbody = "motor_left"', "", 1)
    alone = alone.replace("[sensor.motor_left]", "", 1)
    assert dual_motor(parse_rig(alone)) is None
