"""Exported controllers against the one that the simulator runs, sample by sample."""

import re

import numpy as np
import pytest
from tests.export.native import needs_compiler, st_stepper, warns_of_nothing
from tests.export.test_plant import RACK, RIG_EFFECTS, rig_model

from dmptm_ctrl.design.controller import Controller, Notch
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.export.c_source import c_header, c_source
from dmptm_ctrl.export.controller import controller_program
from dmptm_ctrl.export.native import Compiled
from dmptm_ctrl.export.st_source import st_source
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel

SAMPLES = 10_000
LIMIT = 10.0  # V, full scale
TABLE = {f"k{i}": 3.0 * np.sin(i) for i in range(32)}

RICH = (
    Model()
    .with_effect(
        "cogging", left_cosine=0.01, left_sine=0.02, right_cosine=0.01, right_sine=0.0, order=12.0
    )
    .with_effect("unbalance", cosine=4.0, sine=-3.0)
    .with_effect("thermal_drift", rise=0.2, time_constant=4.0)
    .with_effect("local_spot", height=2.0, place=0.1, width=0.05)
    .with_effect("unknown_torque", variable=0.0, low=-1.0, high=1.0, **TABLE)
)
CONTROLLERS = {
    "pi": Controller(12.0, 60.0, LIMIT, preload=0.2),
    "notches": Controller(
        12.0, 60.0, 1.0, tracking=20.0, notches=(Notch(60.0, 0.1, 0.5), Notch(9.0, 2.0, 0.2))
    ),
    "friction": Controller(
        12.0, 60.0, LIMIT, inertia=1.0, friction=0.9, lead=2e-3, late=1e-3, acceleration=8.0,
        softness=0.01, distance=1e-3, preload=0.3, relief_from=1.0, relief_to=3.0,
    ),
    "effects": Controller(
        12.0, 60.0, LIMIT, inertia=1.0, friction=1.0, effects=1.0, lead=2e-3, model=RICH,
        acceleration=20.0,
    ),
    "inverse": Controller(
        12.0, 60.0, LIMIT, invert=True,
        model=Model()
        .with_effect("drive_dead_band", width=0.05)
        .with_effect("drive_offset", left=0.1, right=-0.05)
        .with_effect("torque_constant_mismatch", error=0.1, pattern=0.0)
        .with_effect("drive_saturation", inverse_limit=0.15)
        .with_effect("sensor_gain", error=0.02)
        .with_effect("encoder_eccentricity", cosine=1e-3, sine=2e-3),
    ),
    "rig": Controller(
        2.0, 10.0, LIMIT, inertia=1.0, friction=0.9, effects=1.0, lead=2e-3, invert=True,
        distance=1e-3, acceleration=20.0, notches=(Notch(60.0, 0.1, 0.5),),
        model=rig_model(*RIG_EFFECTS["cogging"], *RIG_EFFECTS["sensors"], *RIG_EFFECTS["input"]),
    ),
    "encoder": Controller(
        2.0, 10.0, LIMIT, inertia=1.0, friction=1.0, effects=1.0, acceleration=20.0,
        model=rig_model(*RIG_EFFECTS["cogging"]), sensor="angle",
    ),
    "rack": Controller(  # of the second of two motors, in mA; the load slides, in mm/s
        20.0, 60.0, 5.0, inertia=1.0, friction=1.0, acceleration=5.0,
        model=RigModel(parse_rig(RACK, "rig.toml")), input="current", sensor="speed",
    ),
    "no gains": Controller(0.0, 0.0, LIMIT, friction=1.0, preload=0.2),
}  # fmt: skip


def readings(controller, real="double"):
    """Setpoints with steps and reversals, and readings that lag behind them, as `real` has them.

    From 2 s on the drive is far from its zero: 500 rad, the motors 100 000.
    """
    rng = np.random.default_rng(5)
    time = 1e-3 * np.arange(SAMPLES)
    ref = 0.3 * np.sin(2 * np.pi * 0.4 * time) + 0.4 * (np.sin(2 * np.pi * 0.15 * time) > 0.6)
    ref[1600:1800] = 0.0
    speed = 0.9 * np.roll(ref, 3) + 0.02 * rng.standard_normal(SAMPLES)
    angle = 1e-3 * np.cumsum(speed) + 500.0 * (time > 2.0)
    motors = [206.25 * angle + offset for offset in (0.4, -0.7)]
    if real == "float":
        ref, speed = (x.astype(np.float32).astype(float) for x in (ref, speed))
    if not isinstance(controller.model, RigModel):
        return np.column_stack([ref, angle, speed, *motors])
    if controller.sensor == "angle":
        return np.column_stack([ref, angle])
    if controller.input:
        return np.column_stack([ref, -50.0 * angle, speed, -50.0 * angle])
    return np.column_stack([ref, 5.0 * angle, speed])


def expected(controller, rows):
    stepper = controller.law().stepper(controller.sample_time)
    return np.array([stepper(*row) for row in rows])


@needs_compiler
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("name", CONTROLLERS)
def test_c_gives_the_voltages_of_the_simulated_loop(name, real, tmp_path):
    controller = CONTROLLERS[name]
    program = controller_program(controller)
    warns_of_nothing(tmp_path, program, real)
    step = Compiled(program, real)
    rows = readings(controller, real)
    found = np.array([step(*row) for row in rows])
    true = expected(controller, rows)
    assert np.ptp(true) > 0.5  # the premise: the controller works
    share = 1e-12 if real == "double" else 1e-5
    np.testing.assert_allclose(found, true, rtol=0, atol=share * controller.limit)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_structured_text_does_the_same(name):
    controller = CONTROLLERS[name]
    program = controller_program(controller)
    step = st_stepper(st_source(program), [p.name for p in program.outputs])
    rows = readings(controller)[1000:2200]
    np.testing.assert_allclose(
        [step(*row) for row in rows], expected(controller, rows), rtol=0, atol=1e-12 * LIMIT
    )


READ = {"pi": "float", "notches": "double", "inverse": "double", "effects": "double"}


def test_structured_text_is_of_few_words():
    """Programs that are short to read have all words and signs of the longer ones."""
    words = {}
    for name, controller in CONTROLLERS.items():
        text = re.sub(r"\(\*.*?\*\)", "", st_source(controller_program(controller)))
        words[name] = set(re.findall(r"\b[A-Z]{2,}\b|[^\w\s.]+", text)) - {"ABS"}  # as EXP
    assert set().union(*words.values()) == set().union(*(words[name] for name in READ))


@pytest.mark.parametrize(("name", "real"), READ.items())
def test_structured_text_is_of_the_language(name, real):
    """Read by the grammar of another project's parser."""
    parse = pytest.importorskip("blark.parse")
    program = controller_program(CONTROLLERS[name])
    text = st_source(program, real)
    tree = parse.parse_source_code(text)
    assert tree.exception is None
    items = tree.transform().items
    assert [type(item).__name__ for item in items] == ["FunctionBlock"]
    assert items[0].name == "controller"


def test_a_controller_without_a_limit_has_none():
    free = controller_program(Controller(12.0, 60.0, np.inf))
    assert "INFINITY" not in c_source(free)
    assert st_source(free).count("MIN(") == 0


def test_only_what_it_uses_is_in_it():
    plain = c_source(controller_program(CONTROLLERS["pi"]))
    assert "section" not in plain
    assert "exp" not in plain.split("#include <math.h>")[1]
    assert len(c_source(controller_program(CONTROLLERS["effects"]))) > 2 * len(plain)


def test_says_units_sample_time_and_where_it_is_from(tmp_path):
    import hashlib

    from dmptm_ctrl import __version__
    from dmptm_ctrl.export.controller import provenance

    file = tmp_path / "controller.toml"
    CONTROLLERS["pi"].save(file)
    notes = provenance(CONTROLLERS["pi"], file)
    program = controller_program(CONTROLLERS["pi"], notes=notes)
    for text in (c_header(program), c_source(program), st_source(program)):
        assert __version__ in text
        assert "controller.toml" in text
        assert hashlib.sha256(file.read_bytes()).hexdigest() in text
        assert "Sample time: 0.001 s" in text
        assert text.isascii()
    for text in (c_header(program), st_source(program)):
        assert "[rad/s]" in text
        assert "[V]" in text
