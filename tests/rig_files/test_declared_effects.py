"""Effects that a rig file declares: what they are, and where they may stand."""

import numpy as np
import pytest

from dmptm_ctrl import Loop, close_loop
from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import RigError, parse_rig
from dmptm_ctrl.simulate.rig_model import RigModel

RIG = """[body.motor]
inertia = "2e-4 kg m^2"
[body.load]
inertia = "0.01 kg m^2"
[mesh.gear]
between = ["motor", "load"]
ratio = 10
stiffness = "{stiffness}"
damping = 0
[input.u]
column = "u_Nm"
body = "motor"
[sensor.q]
column = "q_rad"
body = "load"
"""


def effects_of(lines, stiffness="40 N m/rad"):
    return RigModel(parse_rig(RIG.format(stiffness=stiffness) + lines)).effects


@pytest.mark.parametrize(
    ("lines", "on"),
    [
        ("[effect.drive_delay]\ndelay = 0.02", "u"),
        ("[effect.drive_offset]\noffset = -0.4", "u"),
        ("[effect.sensor_delay]\ndelay = 0.02", "q"),
        ('[effect.sensor_delay]\non = "q"\ndelay = 0.02', "q"),
        ("[effect.backlash]\nhalf_gap = 0.001", "gear"),
        ("[effect.cable_spring]\nstiffness = 3", "motor"),
        ('[effect.cable_spring]\non = "load"\nstiffness = 3', "load"),
    ],
)
def test_an_effect_stands_where_it_can(lines, on):
    model = RigModel(parse_rig(RIG.format(stiffness="40 N m/rad") + lines))
    assert [effect.on for effect in model.effects] == [on]
    model.plant()


@pytest.mark.parametrize(
    ("lines", "line", "words"),
    [
        ("[effect.cable_sprung]", 16, "no effect 'cable_sprung'; did you mean 'cable_spring'?"),
        ("[effect.cable_spring]\nstifness = 1", 17, "no parameter 'stifness'; it has stiffness"),
        ("[effect.coulomb_friction]\nlevel = -1", 17, "level is -1; it must be zero or more"),
        ("[effect.shaft_compliance]\nshare = 0.4", 16, "needs antiresonance, damping_ratio"),
        ('[effect.drive_delay]\non = "load"', 17, "stands on an input: u; not on 'load'"),
        ('[effect.drive_offset]\non = "gear"', 17, "stands on an input: u; not on 'gear'"),
        ('[effect.backlash]\non = "motor"', 17, "stands on a shaft or mesh: gear; not on 'motor'"),
        ('[effect.cable_spring]\non = "u"', 17, "stands on a body: motor, load; not on 'u'"),
        ('[effect.sensor_delay]\non = "load"', 17, "stands on a sensor: q; not on 'load'"),
        ('[effect.sensor_delay]\non = ["q"]', 17, "no ['q'] in the rig"),
        ("[effect.cogging]\norder = 7", 16, "does nothing; give cosine [N·m], sine [N·m]"),
    ],
)
def test_an_effect_that_cannot_stand_there_is_refused(lines, line, words):
    with pytest.raises(RigError) as caught:
        effects_of(lines)
    assert f"line {line}:" in str(caught.value)
    assert words in str(caught.value)


def test_an_effect_of_one_of_two_inputs_says_which():
    more = '[input.v]\ncolumn = "v_Nm"\nbody = "load"\n[effect.drive_delay]\ndelay = 0.1'
    with pytest.raises(RigError, match="on = … is missing; drive_delay stands on an input: u, v"):
        effects_of(more)


def test_teeth_of_a_rigid_mesh_have_no_errors():
    with pytest.raises(RigError, match="gear, which is rigid; give it a stiffness"):
        effects_of('[effect.pinion_runout]\non = "gear"', "rigid")
    assert len(effects_of("[effect.pinion_runout]\ncosine = 1e-4")) == 1


@pytest.mark.parametrize("lines", ["[effect.cable_sprung]", '[effect.drive_delay]\non = "load"'])
def test_the_commands_refuse_it_in_one_line(tmp_path, capsys, lines):
    file = tmp_path / "rig.toml"
    file.write_text(RIG.format(stiffness="40 N m/rad") + lines)
    for command in (["rig", "check", str(file)], ["bode", str(file), "--out", str(tmp_path / "b")]):
        assert main(command) == 2
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.count("\n") == 1
        assert "rig.toml, line 1" in said.err
    assert [p.name for p in tmp_path.iterdir()] == ["rig.toml"]


def test_an_effect_is_added_to_a_model_by_name():
    bare = RigModel(parse_rig('name = "bench"\n' + RIG.format(stiffness="40 N m/rad")))
    model = bare.with_effect("cogging", on="motor", cosine=0.01, order=7.0)
    text = '[effect.cogging]\non = "motor"\ncosine = 0.01\norder = 7'
    assert model.effects == effects_of(text)
    assert str(model) == "bench: declared, cogging@motor"
    with pytest.raises(ValueError, match="no speed sensor; tune_controller makes a loop"):
        close_loop(model, Loop(1.0, 1.0, limit=1.0), 1e-3 * np.arange(10), np.zeros(10))
    with pytest.raises(RigError, match="no effect 'coging'; did you mean 'cogging'?"):
        bare.with_effect("coging", cosine=0.01)


SLIDE = RIG.replace('[body.load]\ninertia = "0.01 kg m^2"', '[body.load]\nmass = "2 kg"').replace(
    "[mesh.gear]", "[shaft.gear]"
).replace("ratio = 10", 'lead = "10 mm"').replace("u_Nm", 'u"\nunit = "percent').replace(
    "q_rad", "q_m"
)  # fmt: skip


def test_what_goes_with_a_turn_is_no_effect_of_a_slide():
    text = SLIDE.format(stiffness="40 N m/rad") + '[effect.unbalance]\non = "load"\ncosine = 1'
    with pytest.raises(RigError, match="goes with a turn, and load slides"):
        RigModel(parse_rig(text))


def test_a_size_is_asked_for_in_the_unit_of_the_input():
    text = SLIDE.format(stiffness="40 N m/rad") + '[effect.drive_offset]\non = "u"'
    with pytest.raises(RigError, match=r"give offset \[%\]"):
        RigModel(parse_rig(text))


def test_a_gain_of_a_share_says_per_what():
    """As a number and with its unit it is the same; without the percent it could be either."""
    gains = ("0.02", '"0.02 N m/percent"')
    texts = [SLIDE.format(stiffness="40 N m/rad").replace(
        'body = "motor"\n[sensor', f'body = "motor"\ngain = {gain}\n[sensor') for gain in (
        *gains, '"0.02 N m"')]  # fmt: skip
    values = [parse_rig(text).inputs[0].gain.value for text in texts[:2]]
    assert values[0] == pytest.approx(values[1], rel=1e-12)
    with pytest.raises(RigError, match="per what"):
        parse_rig(texts[2])


def test_a_prediction_needs_every_value(tmp_path, capsys):
    text = RIG.format(stiffness="40 N m/rad").replace('"0.01 kg m^2"', '"unknown"')
    (tmp_path / "rig.toml").write_text(text, encoding="utf-8")
    rows = "".join(f"{0.01 * k:.2f},0.1,0\n" for k in range(200))
    (tmp_path / "log.csv").write_text("time_s,u_Nm,q_rad\n" + rows, encoding="utf-8")
    paths = [str(tmp_path / name) for name in ("log.csv", "rig.toml", "pred.csv")]
    assert main(["predict", paths[0], "--model", paths[1], "--out", paths[2]]) == 2
    said = capsys.readouterr().err
    assert "body.load.inertia is declared unknown" in said
    assert "report it" not in said
    assert not (tmp_path / "pred.csv").exists()


@pytest.mark.parametrize("gain", ['"unknown"', '"2e-2"', '"0.02 N m/%"'])
def test_a_gain_of_a_share_may_be_unknown_or_a_number(gain):
    text = SLIDE.format(stiffness="40 N m/rad").replace(
        'body = "motor"\n[sensor', f'body = "motor"\ngain = {gain}\n[sensor'
    )
    value = parse_rig(text).inputs[0].gain.value
    assert np.isnan(value) if "unknown" in gain else value == pytest.approx(0.02, rel=1e-12)
