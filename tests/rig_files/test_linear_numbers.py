"""Linear models of rig files: declared springs and gravity, python-control's own numbers."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.drive.state_space import step_info
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.blocks import to_blocks
from dmptm_ctrl.simulate.linear import linearize, modes, modes_text
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

ARM = """
name = "arm"
[body.arm]
inertia = "0.02 kg m^2"
viscous = "0.05 N m s/rad"
[input.torque]
column = "u"
unit = "N m"
gain = 1
[sensor.angle]
column = "q"
unit = "rad"
[sensor.speed]
column = "w"
unit = "rad/s"
[effect.{effect}]
on = "arm"
{values}
"""
SPRING = ARM.format(effect="cable_spring", values="stiffness = 8.0\noffset = 0.3")
HANGING = ARM.format(effect="unbalance", values="cosine = 0.0\nsine = -1.0")


def two(stiffness="40", extra=""):
    return (
        "[body.motor]\ninertia = 0.01\nviscous = 0.02\n[body.load]\ninertia = 0.3\nviscous = 0.5\n"
        f'[shaft.s]\nbetween = ["motor", "load"]\nratio = 5\nstiffness = {stiffness}\n'
        'damping = 0.01\n[input.m]\ncolumn = "u_V"\nbody = "motor"\ngain = "0.5 N m/V"\n'
        '[sensor.w]\ncolumn = "w_rad_s"\nbody = "load"\n'
        '[sensor.q]\ncolumn = "q_rad"\nbody = "load"\n' + extra
    )


@pytest.mark.parametrize(
    ("text", "position", "stiffness"),
    [
        (SPRING, 0.0, 8.0),
        (SPRING, 1.3, 8.0),
        (HANGING, 0.0, 1.0),  # −d/dq of −sin q
        (HANGING, 1.0, np.cos(1.0)),
        (HANGING, np.pi, -1.0),  # upright: it falls
    ],
)
def test_poles_of_an_arm(text, position, stiffness):
    """J s² + B s + k = 0, by hand."""
    model = RigModel(parse_rig(text))
    system = linearize(model, {"arm": position})
    expected = np.roots([0.02, 0.05, stiffness])
    assert np.sort_complex(system.poles()) == pytest.approx(np.sort_complex(expected), rel=1e-8)
    angle = linearize(model, {"arm": position}, outputs=["angle"])
    assert ct.dcgain(angle) == pytest.approx(1.0 / stiffness, rel=1e-9)
    hertz = np.sqrt(max(stiffness, 0.0) / 0.02) / (2 * np.pi)
    assert modes(model, position={"arm": position}).hz == pytest.approx([hertz], rel=1e-8)


def test_linearize_takes_rigs_too():
    rig = parse_rig(HANGING)
    for model in (rig, RigModel(rig)):
        poles = linearize(model, {"arm": 1.0}, outputs=["angle"]).poles()
        expected = np.roots([0.02, 0.05, np.cos(1.0)])
        assert np.sort_complex(poles) == pytest.approx(np.sort_complex(expected), rel=1e-8)
    with pytest.raises(ValueError, match="a mapping of body to position"):
        linearize(rig, np.zeros(2))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("stiffness = 8.0", "stiffness = -8.0", "stiffness is -8; it must be zero or more"),
        ("offset = 0.3", "offset = nan", "offset is nan; it must be a finite number"),
        ('"0.02 kg m^2"', '"-0.02 kg m^2"', "inertia: -0.02 kg·m² is negative"),
        ('"0.02 kg m^2"', "0", "inertia of 0 cannot be"),
    ],
)
def test_rig_check_refuses_what_no_machine_has(tmp_path, capsys, old, new, said):
    (tmp_path / "rig.toml").write_text(SPRING.replace(old, new))
    assert main(["rig", "check", str(tmp_path / "rig.toml")]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "rig.toml, line " in error


def test_rig_check_says_the_modes(tmp_path, capsys):
    for text, hertz in ((SPRING, "3.183 Hz"), (HANGING, "1.125 Hz")):
        (tmp_path / "rig.toml").write_text(text)
        assert main(["rig", "check", str(tmp_path / "rig.toml")]) == 0
        said = capsys.readouterr().out
        assert f"modes: {hertz}; linearised with all angles 0" in said
    upright = HANGING.replace("sine = -1.0", "sine = 1.0")
    assert "modes: unstable, grows e-fold in 0.141 s" in modes_text(parse_rig(upright))


def test_small_swing_of_the_simulated_arm_is_the_linear_one():
    """The compiled loop and the linear model with gravity, over a swing of a milliradian."""
    time = 1e-3 * np.arange(2000)
    push = np.where(time < 0.1, 1e-3, 0.0)
    model = RigModel(parse_rig(HANGING))
    nonlinear = simulate(model, time, push, substeps=8)
    held = ct.c2d(linearize(model), 1e-3, "zoh")
    linear = np.asarray(ct.forced_response(held, time, push).outputs)
    off = np.abs(np.asarray(nonlinear.outputs) - linear).max(axis=1)
    assert (off < 1e-3 * np.abs(linear).max(axis=1)).all()


@pytest.mark.parametrize("text", [SPRING, HANGING.replace("arm", "arm 1.2", 1), two()])
def test_blocks_linearised_at_rest_with_the_default_step(text):
    """Without dry friction nothing sticks: A, B of the blocks are those of the linear model."""
    model = RigModel(parse_rig(text))
    blocks = to_blocks(model)
    at_rest = np.zeros(blocks.nstates)
    found = ct.linearize(blocks, at_rest, 0.0)
    known = linearize(model)
    s = 2j * np.pi * np.array([0.1, 1.0, 4.0])
    np.testing.assert_allclose(found(s), known(s), rtol=1e-4)
    if text == SPRING:
        np.testing.assert_allclose(found.A, [[0.0, 1.0], [-400.0, -2.5]], rtol=1e-4, atol=1e-4)


def test_with_dry_friction_it_holds():
    model = RigModel(
        parse_rig(two(extra="")), (Placed("coulomb_friction", "motor", {"level": 0.1}),)
    )
    blocks = to_blocks(model)
    assert blocks.dynamics(0.0, np.zeros(4), [0.1]) == pytest.approx(np.zeros(4))
    assert blocks.dynamics(0.0, np.zeros(4), [0.4])[1] == pytest.approx((0.2 - 0.1) / 0.01)


def test_free_train_as_it_comes():
    """Steady speed by the viscous friction; −3 dB and margins by the equations of motion."""
    model = RigModel(parse_rig(two()))
    plant = linearize(model, outputs=["w"])
    assert plant.state_labels == ["spring_s", "v_motor", "v_load"]
    # torque 0.5 N·m at the motor: 5 times that at the load, friction 0.5 + 25 · 0.02
    assert ct.dcgain(plant) == pytest.approx(2.5 / 1.0, rel=1e-9)

    def response(w):
        b = np.array([1.0, -5.0])
        stiff = (40.0 + 0.01j * w) * np.outer(b, b)
        dynamic = stiff + 1j * w * np.diag([0.02, 0.5]) - w**2 * np.diag([0.01, 0.3])
        return 1j * w * np.linalg.solve(dynamic, [0.5, 0.0])[1]

    w = np.geomspace(0.01, 1e3, 200_001)
    values = np.array([response(x) for x in w[::100]])
    np.testing.assert_allclose(plant(1j * w[::100]), values, rtol=1e-8)
    falls = ct.bandwidth(plant)
    assert abs(response(falls)) == pytest.approx(2.5 * 10 ** (-3 / 20), rel=1e-6)
    gain, phase, at, over = ct.margin(plant)
    assert response(at).imag == pytest.approx(0.0, abs=1e-6 * abs(response(at)))
    assert gain == pytest.approx(1 / abs(response(at)), rel=1e-6)
    assert abs(response(over)) == pytest.approx(1.0, rel=1e-6)
    beyond = 180 + np.degrees(np.angle(response(over)))
    assert np.cos(np.radians(phase - beyond)) == pytest.approx(1.0, abs=1e-9)
    info = ct.step_info(plant)
    assert info["SteadyStateValue"] == pytest.approx(2.5)
    assert info["SettlingTime"] == pytest.approx(3.912 * (0.3 + 25 * 0.01) / 1.0, rel=0.02)
    angle = linearize(model, outputs=["q"])
    assert angle.state_labels == ["q_motor", "spring_s", "v_motor", "v_load"]
    assert np.isinf(ct.dcgain(angle))
    np.testing.assert_allclose(angle(1j * w[::100]), values / (1j * w[::100]), rtol=1e-7)


def test_a_gear_that_reverses_has_the_same_bandwidth():
    """python-control asks for a gain below a negative one."""
    forth, back = (
        linearize(parse_rig(text), outputs=["w"])
        for text in (two(), two().replace("ratio = 5", "ratio = -5"))
    )
    assert ct.dcgain(back) == pytest.approx(-2.5, rel=1e-9)
    assert ct.bandwidth(back) == pytest.approx(ct.bandwidth(forth), rel=1e-9)


@pytest.mark.parametrize("late", ["", "delay = 0.001\n"])
def test_a_speed_beside_an_angle_has_the_numbers_of_the_speed_alone(late):
    """The angle of a free train returns to nothing; the speed beside it is not infinite."""
    rig = parse_rig(two().replace("gain =", late + "gain ="))
    both, alone = linearize(rig), linearize(rig, outputs=["w"])
    np.testing.assert_allclose(ct.dcgain(both).ravel(), [2.5, np.inf])
    assert ct.dcgain(both[0, 0]) == pytest.approx(2.5)
    assert ct.bandwidth(both["w", 0]) == pytest.approx(ct.bandwidth(alone), rel=1e-9)
    assert np.array(ct.margin(both["w", "m"])) == pytest.approx(np.array(ct.margin(alone)))
    said, known = ct.step_info(both)[0][0], ct.step_info(alone)
    assert said["SteadyStateValue"] == pytest.approx(2.5)
    assert said["SettlingTime"] == pytest.approx(known["SettlingTime"], rel=0.02)
    assert both["w", 0].state_labels == alone.state_labels


def test_gravity_of_a_level_arm_holds_no_angle():
    """Its slope is 0 there, not what rounding leaves: the speed by viscous friction, 1/B."""
    level = linearize(parse_rig(HANGING), {"arm": 20.5 * np.pi}, outputs=["speed"])
    assert ct.dcgain(level) == pytest.approx(1.0 / 0.05)


@pytest.mark.parametrize("output", ["q", "w"])
def test_step_of_a_stiff_plant_over_all_its_time_scales(output):
    """Against the sum of its modes: an arm on a spring behind a stiff shaft and a dead time."""
    text = two("4e4", '[effect.cable_spring]\non = "load"\nstiffness = 50\n')
    rig = parse_rig(text.replace("gain =", "delay = 0.0005\ngain =").replace("0.5\n", "0.05\n"))
    plant = linearize(rig, outputs=[output])
    found = step_info(plant)
    poles, shapes = np.linalg.eig(plant.A)
    parts = (plant.C @ shapes)[0] * np.linalg.solve(shapes, plant.B)[:, 0] / poles
    time = np.linspace(0.0, 8.0 / -poles.real.max(), 500_001)
    final = 2.5 / 50.0 if output == "q" else 0.0
    values = final + sum((p * np.exp(s * time)).real for p, s in zip(parts, poles, strict=True))
    assert found["Peak"] == pytest.approx(np.abs(values).max(), rel=1e-3)
    assert found["SteadyStateValue"] == pytest.approx(final, rel=1e-9, abs=0.0)
    if output == "w":  # it returns to nothing
        assert np.isnan(found["SettlingTime"])
        return
    settled = time[np.flatnonzero(np.abs(values / final - 1.0) >= 0.02)[-1]]
    assert found["SettlingTime"] == pytest.approx(settled, rel=1e-3)
    assert found["Overshoot"] == pytest.approx(100.0 * (values.max() / final - 1.0), rel=1e-3)
    rises = [time[np.argmax(values >= share * final)] for share in (0.1, 0.9)]
    assert found["RiseTime"] == pytest.approx(rises[1] - rises[0], rel=2e-3)


def test_a_step_that_does_not_settle_is_refused():
    with pytest.raises(ValueError, match="poles that decay"):
        step_info(linearize(parse_rig(two()), outputs=["q"]))


def test_an_undamped_resonance_has_no_margins(tmp_path, capsys):
    undamped = SPRING.replace("viscous", "# viscous")
    (tmp_path / "rig.toml").write_text(undamped)
    (tmp_path / "damped.toml").write_text(SPRING)
    rows = []
    for name in ("rig", "damped"):
        file = str(tmp_path / f"{name}.toml")
        assert main(["bode", file, "--out", str(tmp_path / "bode.png")]) == 0
        rows.append(next(x for x in capsys.readouterr().out.splitlines() if x.startswith("arm")))
    assert rows[0].split()[-2:] == ["undamped", "undamped"]
    assert "undamped" not in rows[1]


def test_torques_of_links_and_motion_of_bodies_are_outputs():
    """(k + jω d) times the twist, and jω times the angle, by the equations of motion."""
    plant = linearize(parse_rig(two()), outputs=["s", "v_motor", "q_load"])
    b = np.array([1.0, -5.0])
    for w in np.geomspace(0.1, 500.0, 30):
        stiff = (40.0 + 0.01j * w) * np.outer(b, b)
        dynamic = stiff + 1j * w * np.diag([0.02, 0.5]) - w**2 * np.diag([0.01, 0.3])
        q = np.linalg.solve(dynamic, [0.5, 0.0])
        expected = [(40.0 + 0.01j * w) * (b @ q), 1j * w * q[0], q[1]]
        np.testing.assert_allclose(plant(1j * w).ravel(), expected, rtol=1e-7)


def test_two_like_sides_swing_together_or_against_each_other():
    """A base between two arms: ω² = k/J against each other, k (1/J + 2/J0) together."""
    text = "[body.base]\ninertia = 0.3\n"
    for side in "lr":
        text += f"[body.arm_{side}]\ninertia = 0.1\n[shaft.{side}]\n"
        text += f'between = ["base", "arm_{side}"]\nstiffness = 40\ndamping = 0.01\n'
    text += '[input.m]\ncolumn = "u_V"\nbody = "base"\ngain = "1 N m/V"\n'
    found = modes(parse_rig(text + '[sensor.w]\ncolumn = "w_rad_s"\nbody = "base"\n'))
    assert found.kinds == ("rigid", "antisymmetric", "symmetric")
    assert found.omega[1:] == pytest.approx(np.sqrt([400.0, 40.0 * (10.0 + 2.0 / 0.3)]))


@pytest.mark.parametrize("build", [linearize, modes, to_blocks])
@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"body.load.inertia": -1.0}, "body.load.inertia is -1 kg·m², it must be more than zero"),
        ({"body.load.inertia": 0.0}, "body.load.inertia is 0"),
        ({"link.s.stiffness": -40.0}, "link.s.stiffness is -40 N·m/rad, it must be zero or more"),
        ({"body.load.viscous": np.inf}, "declared unknown|body.load.viscous is inf"),
        ({"link.s.ratio": 0.0}, "link.s.ratio is 0"),
    ],
)
def test_what_no_machine_has_is_refused(build, values, said):
    with pytest.raises(ValueError, match=said):
        build(RigModel(parse_rig(two())).with_values(values))


def test_refusals_name_what_there_is():
    model = RigModel(parse_rig(two()))
    with pytest.raises(ValueError, match="no output 'v' in rig; it has w, q"):
        linearize(model, outputs=["v"])
    with pytest.raises(ValueError, match="no body 'arm' in rig; it has motor, load"):
        linearize(model, {"arm": 0.0})
    with pytest.raises(ValueError, match="stiffness of cable_spring@load is no number"):
        linearize(model.with_effect(Placed("cable_spring", "load", {"stiffness": np.nan})))
    with pytest.raises(ValueError, match="stiffness of cable_spring@load is -8; it must be zero"):
        linearize(model.with_effect(Placed("cable_spring", "load", {"stiffness": -8.0})))
    with pytest.raises(KeyError, match=r"no 'load.inertia'; it has body\.motor\.inertia"):
        model.value("load.inertia")
    still = np.zeros((1, 20))
    for signals in (still[0], np.zeros((2, 20))):
        with pytest.raises(ValueError, match=r"^u has shape .*; needs \(1, n\): inputs by"):
            march(model, signals, 1e-3)
    with pytest.raises(ValueError, match="^no body 'arm' in rig; it has motor, load$"):
        march(model, still, 1e-3, push={"arm": still[0]})
    run = march(model, still, 1e-3)
    for call, said in (
        (run.speed, "no body 'arm' in rig; it has motor, load"),
        (run.link, "no soft link 'arm' in rig; it has s"),
        (run.reading, "no sensor 'arm' in rig; it has w, q"),
    ):
        with pytest.raises(ValueError, match=f"^{said}$"):
            call("arm")


def test_params_in_block_simulation():
    """As the blocks of a model with that value; other names are refused."""
    model = RigModel(parse_rig(two()))
    time, x0 = np.linspace(0.0, 0.5, 51), np.zeros(4)
    drive = np.ones(time.size)

    def run(system, **more):
        return ct.input_output_response(
            system, time, drive, x0, solve_ivp_kwargs={"rtol": 1e-8, "atol": 1e-10}, **more
        ).outputs

    value = {"body.load.inertia": 0.6}
    honoured = run(to_blocks(model), params=value)
    np.testing.assert_allclose(honoured, run(to_blocks(model.with_values(value))), rtol=1e-6)
    assert np.abs(honoured - run(to_blocks(model))).max() > 0.1
    with pytest.raises(ValueError, match=r"the blocks have no 'inertia'; they have body\.motor"):
        run(to_blocks(model), params={"inertia": 0.6})
    with pytest.raises(ValueError, match="more than zero"):
        run(to_blocks(model), params={"body.load.inertia": -0.6})


def test_declared_dead_times_turn_the_phase():
    """As e^(−jωT) does; the static gain stays, and margins by python-control know of it."""
    plain = parse_rig(two())
    late = parse_rig(two().replace("gain =", "delay = 0.002\ngain =", 1))
    w = np.geomspace(0.1, 500.0, 60)
    one, other = (linearize(rig).frequency_response(w).complex for rig in (plain, late))
    expected = one * np.exp(-1j * w * 0.002)
    np.testing.assert_allclose(other, expected, rtol=1e-3, atol=0)
    speeds = [linearize(rig, outputs=["w"]).dcgain() for rig in (plain, late)]
    assert speeds[0] == pytest.approx(speeds[1], rel=1e-9)
    assert np.isinf(linearize(late, outputs=["q"]).dcgain())
    blocks = to_blocks(RigModel(late))
    model = ct.linearize(blocks, np.zeros(blocks.nstates), 0.0, copy_names=True)
    names = linearize(late).output_labels
    model = ct.ss(model)[[model.output_labels.index(n) for n in names], :]
    np.testing.assert_allclose(model.frequency_response(w).complex, other, rtol=1e-3, atol=0)
