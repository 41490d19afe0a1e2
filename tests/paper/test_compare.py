"""`dmptm bode` and `dmptm step`: four models in one picture, with python-control's numbers."""

import matplotlib.image as image
import numpy as np
import pytest

from dmptm_ctrl import data
from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.reproduce.compare import linear_models, step
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import rig_model_to_toml, to_toml
from dmptm_ctrl.simulate.rig_model import RigModel

ARM = """
name = "arm"
[body.arm]
inertia = 0.02
viscous = 0.05
[input.torque]
column = "u"
unit = "N m"
gain = 1
[sensor.q]
column = "q"
unit = "rad"
[sensor.w]
column = "w"
unit = "rad/s"
[effect.cable_spring]
on = "arm"
stiffness = 8.0
offset = 0.0
"""


@pytest.mark.parametrize("command", ["bode", "step"])
def test_command(tmp_path, capsys, command):
    (tmp_path / "rig.toml").write_text(ARM)
    out = tmp_path / "picture.png"
    assert main([command, str(tmp_path / "rig.toml"), "--out", str(out), "--output", "q"]) == 0
    said = capsys.readouterr().out
    rows = {line.split("  ")[0]: line.split() for line in said.splitlines()}
    arm = "arm: q over torque [rad per N·m]"
    assert {"9-DOF", "3-DOF", "baseline", arm} < set(rows)
    at_rest = -4  # column
    assert float(rows["3-DOF"][at_rest]) == pytest.approx(1.208, abs=1e-3)
    assert float(rows[arm][at_rest]) == pytest.approx(1 / 8)
    assert float(rows["baseline"][at_rest]) < 0.5  # its friction stands in for the dry one
    if command == "step":  # overshoot of J s² + B s + k: exp(−π ζ/√(1 − ζ²))
        zeta = 0.05 / (2 * np.sqrt(0.02 * 8))
        over = 100 * np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2))
        assert float(rows[arm][-1]) == pytest.approx(over, rel=0.02)
    assert image.imread(out).std() > 0.05


def test_another_drive_steps_on_axes_of_its_own(tmp_path):
    """A position that grows without end, in its unit, does not flatten the speeds."""
    (tmp_path / "rig.toml").write_text(ARM.replace("stiffness = 8.0", "stiffness = 0.0"))
    figure, said = step(linear_models(tmp_path / "rig.toml", output="q"), 2.0)
    speeds, own = figure.axes
    assert speeds.get_ylabel() == "speed of the ring gear [rad/s]"
    assert speeds.get_ylim()[1] < 1.5
    assert (own.get_title(), own.get_ylabel()) == ("Step of 1 N·m", "q [rad]")
    at, seen = own.lines[0].get_data()  # J = 0.02, b = 0.05: (t − τ (1 − exp(−t/τ)))/b
    np.testing.assert_allclose(seen, (at - 0.4 * (1 - np.exp(-at / 0.4))) / 0.05, atol=1e-6)
    assert said.endswith("–: no steady value.")


def test_own_model_file_and_rig_of_two_motors(tmp_path):
    model = Model().with_values(J_L=4.0).with_effect("drive_delay", delay=2e-3)
    (tmp_path / "mine.toml").write_text(to_toml(model))
    models = linear_models(tmp_path / "mine.toml")
    assert list(models) == ["9-DOF", "3-DOF", "baseline", "mine, linearised"]
    s = 2j * np.pi * 20.0  # far above friction: all are the inertia of that very drive
    inertia = 4.0 + 2 * 8.25**2 * 0.25
    expected = 2 * 25 * 8.25 * 0.39 / (inertia * s)
    for label in ("3-DOF", "mine, linearised"):
        assert abs(models[label](s)) == pytest.approx(abs(expected), rel=0.03)
    late = np.angle(models["mine, linearised"](s) / models["3-DOF"](s))
    assert late == pytest.approx(-abs(s) * 2e-3, abs=0.03)
    assert f"{data.PAPER_RIG.stem}, linearised" in linear_models(data.PAPER_RIG)


@pytest.mark.parametrize(
    ("output", "unit"), [("q", "rad"), ("w", "rad/s"), ("q_arm", "rad"), ("v_arm", "rad/s")]
)
def test_each_position_and_speed_has_its_unit(tmp_path, output, unit):
    (tmp_path / "rig.toml").write_text(ARM)
    models = linear_models(tmp_path / "rig.toml", output=output)
    assert f"arm: {output} over torque [{unit} per N·m]" in models


def test_model_of_a_diagnosis(tmp_path):
    """A model.toml of a drive of another shape: fitted values, not those of its rig file."""
    rig = parse_rig(ARM)
    text = rig_model_to_toml(RigModel(rig).with_values({"body.arm.viscous": 0.2}))
    (tmp_path / "model.toml").write_text(text)
    own = linear_models(tmp_path / "model.toml")["arm: w over torque [rad/s per N·m]"]
    assert np.sort_complex(own.poles()) == pytest.approx(
        np.sort_complex(np.roots([0.02, 0.2, 8.0])), rel=1e-8
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            ["rig.toml", "--output", "v"],
            "rig.toml: no output 'v' in arm; it has q, w",
        ),
        (["rig.toml", "--input", "u"], "rig.toml: no input 'u'; it has torque"),
        (["none.toml"], "no readable model file"),
        (["rig.toml", "--out", "picture.xyz"], "picture.xyz: call the figure .png, .svg or .pdf"),
        (["rig.toml", "--low", "10", "--high", "1"], "--low 10 must be below --high 1"),
        (["open.toml"], "open.toml: body.arm.inertia is declared unknown"),
        (["dual.toml", "--output", "q"], "dual.toml: a dual-motor drive is drawn from one voltage"),
    ],
)
def test_refusals(tmp_path, monkeypatch, capsys, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rig.toml").write_text(ARM)
    (tmp_path / "dual.toml").write_text(to_toml(Model()))
    (tmp_path / "open.toml").write_text(ARM.replace("inertia = 0.02", 'inertia = "unknown"'))
    assert main(["bode", *arguments]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not list(tmp_path.glob("*.p*"))


def test_model_of_nonsense(tmp_path):
    text = to_toml(Model()).replace("K_M = 0.13", "K_M = -0.13")
    assert "-0.13" in text
    (tmp_path / "model.toml").write_text(text)
    with pytest.raises(LogError, match=r"model\.toml: .*K_M is -0\.13 N·m/A, it must be more than"):
        linear_models(tmp_path / "model.toml")


def test_template_of_a_rig_file_is_drawn(tmp_path, capsys):
    """Unknown friction and damping count as none, and are named; a spring must be known."""
    rig = tmp_path / "rig.toml"
    assert main(["rig", "init", str(rig)]) == 0
    with pytest.warns(UserWarning, match="taken as 0: body.motor.viscous, body.load.viscous, link"):
        own = linear_models(rig)["two-inertia bench: load_speed over voltage [rad/s per V]"]
    resonance = np.sqrt(40.0 * (1.0 / 2.1e-4 + 10.0**2 / 0.013))
    assert np.abs(own.poles().imag).max() == pytest.approx(resonance)
    capsys.readouterr()
    for command in ("bode", "step"):
        assert main([command, str(rig), "--out", str(tmp_path / "p.svg")]) == 0
        assert "declared unknown, taken as 0: body.motor" in capsys.readouterr().err
    rig.write_text(rig.read_text().replace("40 N m/rad ± 50 %", "unknown"))
    assert main(["bode", str(rig)]) == 2
    assert "link.gear.stiffness is declared unknown" in capsys.readouterr().err
