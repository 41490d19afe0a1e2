"""Exported plants against the simulator: every effect, and drives of other shapes."""

import re

import numpy as np
import pytest
from tests.export.native import needs_compiler, st_stepper, warns_of_nothing

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.export.native import Compiled
from dmptm_ctrl.export.plant import plant_program
from dmptm_ctrl.export.st_source import st_source
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

DT = 1e-3
TIME = DT * np.arange(600)
# preloaded: the meshes stay closed, and a last bit stays one
VOLTS = 0.5 * np.sin(2 * np.pi * 3.0 * TIME) + np.array([[0.35], [-0.35]])
SIZE = {"drive_delay": 2.6e-3, "sensor_delay": 1.4e-3, "current_lag": 4e-3}

RIG = """\
name = "two masses"

[body.motor]
inertia = "0.002 kg m^2"
viscous = "0.002 N m s/rad"
coulomb = "0.02 N m"

[body.load]
inertia = "0.05 kg m^2"
viscous = "0.01 N m s/rad"
coulomb = "0.1 N m"
static = "0.15 N m"
stribeck_speed = "0.1 rad/s"

[shaft.belt]
between = ["motor", "load"]
ratio = 5
stiffness = "40 N m/rad"
damping = "0.02 N m s/rad"

[input.voltage]
column = "u_V"
body = "motor"
gain = "0.1 N m/V"
delay = "1.7 ms"

[sensor.angle]
column = "theta_deg"
body = "motor"

[sensor.speed]
column = "omega_deg_s"
body = "load"
"""


def visible(name):
    effect = CATALOGUE[name]
    values = {p.name: 3.0 * p.step for p in effect.parameters if not p.bank}
    if name in SIZE:
        values = {effect.amplitudes[0]: SIZE[name]}
    if name == "drive_saturation":
        values = {"inverse_limit": 1.0 / 0.6}
    if name == "reducer_compliance":
        values = {"compliance": 1e-4, "damping": 0.1}
    return Model().with_effect(name, **values)


def c_run(program, inputs, folder, real="double"):
    warns_of_nothing(folder, program, real)
    step = Compiled(program, real)
    return np.array([step(*row) for row in np.transpose(inputs)])


def close(found, true, share=1e-9):
    """Within a share of each signal's range."""
    assert np.isfinite(true).all()
    scale = np.abs(true).max(axis=0)
    np.testing.assert_allclose(found / scale, true / scale, rtol=0, atol=share)


@needs_compiler
@pytest.mark.parametrize("name", ["none", *CATALOGUE])
def test_dual_motor_drive_with_each_effect(name, tmp_path):
    model = Model() if name == "none" else visible(name)
    true = simulate(model, TIME, VOLTS).outputs.T
    if name != "none":
        assert np.abs(true - simulate(Model(), TIME, VOLTS).outputs.T).max() > 0
    close(c_run(plant_program(model, DT), VOLTS, tmp_path), true)


@needs_compiler
def test_dual_motor_drive_with_exponents_of_friction(tmp_path):
    model = Model().with_values(delta3=1.4, deltaL=0.7)
    true = simulate(model, TIME, VOLTS).outputs.T
    assert np.abs(true - simulate(Model(), TIME, VOLTS).outputs.T).max() > 1e-6
    close(c_run(plant_program(model, DT), VOLTS, tmp_path), true)


@needs_compiler
def test_all_effects_at_once(tmp_path):
    """Tables of several effects, each read at its own place, beside every other effect."""
    rng, model = np.random.default_rng(2), Model()
    for name, effect in CATALOGUE.items():
        values = dict(visible(name).effects[name])
        for p in effect.parameters:
            if p.name[0] == "k" and p.name[1:].isdigit():  # a knot of a table
                values[p.name] = p.step * rng.uniform(-1.0, 1.0)
        model = model.with_effect(name, **values)
    volts = 3.0 * VOLTS
    true = simulate(model, TIME, volts).outputs.T
    assert np.ptp(true[:, 0]) > 3e-3  # the premise: it moves
    close(c_run(plant_program(model, DT), volts, tmp_path), true)


@needs_compiler
def test_starts_where_it_is_told(tmp_path):
    from dmptm_ctrl.simulate.compiled import rest

    model = Model().with_effect("unbalance", cosine=20.0)
    true = simulate(model, TIME, VOLTS, rest(model, 0.7)).outputs.T
    found = c_run(plant_program(model, DT, start=0.7), VOLTS, tmp_path)
    close(found, true)
    assert found[0, 0] == 0.7


@needs_compiler
def test_long_samples_are_run_as_finely_as_short_ones(tmp_path):
    """With eight steps per sample of 20 ms the meshes would be unstable."""
    volts = np.repeat(3.0 * VOLTS[:, ::20], 20, axis=1)
    true = simulate(Model(), TIME, volts).outputs.T[::20]
    assert np.ptp(true[:, 0]) > 3e-3  # the premise: it moves
    close(c_run(plant_program(Model(), 20 * DT), volts[:, ::20], tmp_path), true)


@needs_compiler
def test_long_samples_of_a_stiff_rig_are_run_finely(tmp_path):
    """Its fastest mode needs 8000 steps in half a second; 400 gave no numbers."""
    rig = parse_rig(RIG.replace("40 N m/rad", "4000 N m/rad"), "rig.toml")
    held = np.array([6.0, -6.0, 6.0, 6.0])
    true = simulate(RigModel(rig), DT * np.arange(2000), np.repeat(held, 500)[None]).outputs.T
    found = c_run(plant_program(RigModel(rig), 500 * DT), held[None], tmp_path)
    close(found, true[::500], 1e-4)


def rig_model(*effects):
    return RigModel(parse_rig(RIG, "rig.toml"), effects)


RIG_EFFECTS = {
    "none": (),
    "cogging": (Placed("cogging", "motor", {"cosine": 0.02, "sine": 0.01, "order": 8.0}),),
    "backlash": (Placed("backlash", "belt", {"half_gap": 2e-3}),),
    "presliding": (Placed("presliding", "load", {"distance": 2e-3}),),
    "sensors": (
        Placed("sensor_delay", "speed", {"delay": 3.4e-3}),
        Placed("sensor_gain", "speed", {"error": 0.05}),
        Placed("encoder_eccentricity", "angle", {"cosine": 0.01, "sine": -0.02}),
    ),
    "two late sensors": (
        Placed("sensor_delay", "speed", {"delay": 3.4e-3}),
        Placed("sensor_delay", "angle", {"delay": 0.3e-3}),
    ),
    "lag": (Placed("current_lag", "voltage", {"time_constant": 4e-3}),),
    "input": (
        Placed("drive_dead_band", "voltage", {"width": 0.5}),
        Placed("drive_saturation", "voltage", {"inverse_limit": 0.12}),
        Placed("stribeck_friction", "motor", {"excess": 0.02, "speed": 0.5}),
    ),
}


@needs_compiler
@pytest.mark.parametrize("name", RIG_EFFECTS)
def test_rig_of_another_shape(name, tmp_path):
    model = rig_model()
    for effect in RIG_EFFECTS[name]:
        model = model.with_effect(effect)
    u = 6.0 * np.sin(2 * np.pi * 4.0 * TIME)[None] + 6.0 * (TIME > 0.2)
    true = simulate(model, TIME, u).outputs
    plain = simulate(rig_model(), TIME, u).outputs
    assert name == "none" or np.abs(true - plain).max() > 1e-6
    close(c_run(plant_program(model, DT), u, tmp_path), np.atleast_2d(true).T)


AXIS = RIG[: RIG.index("[body.load]")] + RIG[RIG.index("[input.voltage]") :].replace(
    '"load"', '"motor"'
)
GEAR = RIG.replace("[shaft.belt]", '[mesh.belt]\nbacklash = "0.5 deg"\ncontact = "two_state"')
# two motors on a rack, one of them by a current in mA and backwards; an encoder in counts
RACK = (
    RIG.replace('inertia = "0.05 kg m^2"', 'mass = "20 kg"')
    .replace('viscous = "0.01 N m s/rad"\ncoulomb = "0.1 N m"', 'viscous = "9 N s/m"')
    .replace('static = "0.15 N m"\nstribeck_speed = "0.1 rad/s"\n', "")
    .replace("ratio = 5", 'ratio = "50 rad/m"')
    .replace('"omega_deg_s"', '"v_mm_s"')
    + """
[body.helper]
inertia = "1e-3 kg m^2"
coulomb = "0.01 N m"

[mesh.rack]
between = ["helper", "load"]
ratio = "-50 rad/m"
stiffness = "60 N m/rad"
damping = "0.5 s/rad"
backlash = "0.3 deg"
contact = "impact"

[input.current]
column = "i_mA"
body = "helper"
gain = "0.05 N m/A"
sign = -1

[sensor.counter]
column = "n"
unit = "counts"
counts_per_rev = 20000
body = "helper"
"""
)
SHAPES = {"axis": AXIS, "gear with a gap": GEAR, "rack with two motors": RACK}


def all_effects(text):
    """A rig with every effect it may have; with more than two bodies that takes long to compile."""
    model, rng = RigModel(parse_rig(text, "rig.toml")), np.random.default_rng(4)
    rig = model.rig
    parts = {"body": rig.bodies, "link": rig.links, "input": rig.inputs, "sensor": rig.sensors}
    if len(rig.bodies) > 2:
        return model
    placed = [
        (effect, part.name)
        for effect in PLACED_CATALOGUE.values()
        for part in parts[effect.place]
        if rig.links or "mesh_torque" not in effect.effect.depends_on
        if effect.name != "backlash"
    ]
    for effect, part in placed:
        values = dict(zip([p.name for p in effect.keep], effect.defaults, strict=True))
        step = {p.name: p.step for p in effect.keep}
        values |= {name: 0.1 * step[name] * rng.uniform(0.5, 1.0) for name in effect.amplitudes}
        if effect.name in SIZE:
            values[effect.amplitudes[0]] = SIZE[effect.name]
        model = model.with_effect(Placed(effect.name, part, values))
    assert len(placed) > 20
    return model


def driven(model):
    """Signals of its inputs, and what the simulator reads."""
    u = 6.0 * np.sin(2 * np.pi * 4.0 * TIME)[None] + 6.0 * (TIME > 0.2)
    u = np.vstack([u, *([0.3 * u] * (len(model.rig.inputs) - 1))])
    true = np.atleast_2d(simulate(model, TIME, u).outputs).T
    assert (np.ptp(true, axis=0) > 0.01).all()  # the premise: it moves
    return u, true


@needs_compiler
@pytest.mark.parametrize("shape", SHAPES)
def test_rig_with_all_effects_at_once(shape, tmp_path):
    model = all_effects(SHAPES[shape])
    u, true = driven(model)
    close(c_run(plant_program(model, DT), u, tmp_path), true)


def test_ports_say_what_the_logs_columns_are():
    program = plant_program(RigModel(parse_rig(RACK, "rig.toml")), DT)
    told = {p.name: p.text.rpartition("; ")[2] for p in (*program.inputs, *program.outputs)}
    assert told["in_current"] == "column i_mA of the logs times -0.001"
    assert told["out_counter"] == "column n of the logs times 0.000314159265"
    assert told["out_speed"] == "column v_mm_s of the logs times 0.001"


@needs_compiler
def test_names_that_no_program_can_have(tmp_path):
    """Two sensors whose names become one, and signs that would end a comment or a line."""
    text = RIG.replace("[sensor.angle]", '[sensor."θ *) */\\n"]').replace(
        "[sensor.speed]", '[sensor."ω __ for"]'
    )
    model = RigModel(parse_rig(text, "rig.toml"))
    program = plant_program(model, DT)
    assert len({p.name for p in (*program.inputs, *program.outputs)}) == 3
    block = st_source(program)
    assert block.isascii()
    assert "__" not in re.sub(r"\(\*.*\*\)", "", block)  # the standard forbids it
    assert pytest.importorskip("blark.parse").parse_source_code(block).exception is None
    u = 6.0 * np.sin(2 * np.pi * 4.0 * TIME)[None]
    close(c_run(program, u, tmp_path), simulate(model, TIME, u).outputs.T)


def test_structured_text_of_a_plant():
    """It gives the simulator's readings; the grammar of another project reads a short one."""
    parse = pytest.importorskip("blark.parse")
    model = Model().with_effect("drive_delay", delay=2.6e-3)
    program = plant_program(model, DT)
    step = st_stepper(st_source(program), [p.name for p in program.outputs])
    found = np.array([step(*row) for row in VOLTS[:, :60].T])
    close(found, simulate(model, TIME[:60], VOLTS[:, :60]).outputs.T)
    short = st_source(plant_program(RigModel(parse_rig(AXIS)), DT))
    assert "MOD" in short  # the premise: the dead time's ring
    assert parse.parse_source_code(short).exception is None
