"""The FMU in another project's simulator."""

import numpy as np
import pytest
from tests.export.native import needs_compiler
from tests.export.test_plant import DT, GEAR, SHAPES, TIME, VOLTS, all_effects, close, driven

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.export.fmu import write_fmu
from dmptm_ctrl.export.plant import plant_program
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel

fmpy = pytest.importorskip("fmpy")
MODEL = (
    Model()
    .with_effect("cogging", left_cosine=0.01, right_sine=0.02, order=12.0)
    .with_effect("drive_delay", delay=2.6e-3)
    .with_effect("unbalance", cosine=4.0)
)


@pytest.fixture(scope="module")
def fmu(tmp_path_factory):
    file = tmp_path_factory.mktemp("fmu") / "plant.fmu"
    write_fmu(plant_program(MODEL, DT, notes=["A drive."]), DT, file)
    return file


@needs_compiler
def test_runs_as_the_simulator_does(fmu):
    inputs = np.array(
        [(t, *u) for t, u in zip(TIME, VOLTS.T, strict=True)],
        dtype=[("time", float), ("u_left", float), ("u_right", float)],
    )
    true = simulate(MODEL, TIME, VOLTS).outputs.T
    names = ["theta_l", "omega_l", "theta_ml", "theta_mr", "torque_l", "torque_r", "z_l", "z_r"]
    found = fmpy.simulate_fmu(
        str(fmu), stop_time=TIME[-1], output_interval=DT, step_size=DT, input=inputs, output=names
    )
    np.testing.assert_allclose(found["time"], TIME, atol=1e-9)
    close(np.column_stack([found[n] for n in names]), true)


DECLARED = (
    GEAR
    + """
[effect.cogging]
on = "motor"
cosine = 0.02
sine = 0.01
order = 8
[effect.drive_offset]
offset = 0.3
[effect.sensor_delay]
on = "speed"
delay = 0.0034
"""
)
RIGS = {**{name: lambda t=text: all_effects(t) for name, text in SHAPES.items()},
        "declared effects": lambda: RigModel(parse_rig(DECLARED, "rig.toml"))}  # fmt: skip


@needs_compiler
@pytest.mark.parametrize("name", RIGS)
def test_rig_runs_as_the_simulator_does(name, tmp_path):
    """With all effects at once, with two motors, with effects that the rig file declares."""
    model = RIGS[name]()
    u, true = driven(model)
    # a name that the archive's own files might have
    program = plant_program(model, DT, name="fmi2")
    write_fmu(program, DT, tmp_path / "plant.fmu")
    kinds = [("time", float), *((p.name, float) for p in program.inputs)]
    inputs = np.array([(t, *row) for t, row in zip(TIME, u.T, strict=True)], dtype=kinds)
    names = [p.name for p in program.outputs]
    found = fmpy.simulate_fmu(
        str(tmp_path / "plant.fmu"), stop_time=TIME[-1], output_interval=DT, step_size=DT,
        input=inputs, output=names,
    )  # fmt: skip
    close(np.column_stack([found[n] for n in names]), true)


@needs_compiler
def test_its_description_is_valid(fmu):
    from fmpy.validation import validate_fmu

    assert validate_fmu(str(fmu)) == []
    description = fmpy.read_model_description(str(fmu), validate=True)
    assert description.coSimulation.modelIdentifier == "plant"
    units = {v.name: v.unit for v in description.modelVariables}
    assert units["u_left"] == "V"
    assert units["omega_l"] == "rad/s"
    assert description.defaultExperiment.stepSize == str(DT)


@needs_compiler
def test_source_is_inside_and_compiles_alone(fmu, tmp_path):
    import subprocess
    import zipfile

    with zipfile.ZipFile(fmu) as archive:
        archive.extractall(tmp_path)
    texts = sorted(map(str, (tmp_path / "sources").glob("*.c")))
    assert len(texts) == 2
    strict = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "-Wno-unused-parameter"]
    subprocess.run([*strict, "-fsyntax-only", *texts], check=True)


@needs_compiler
def test_a_step_between_samples_is_refused(fmu):
    with pytest.raises(Exception, match="fmi2DoStep"):
        fmpy.simulate_fmu(str(fmu), stop_time=0.01, output_interval=1.5 * DT, step_size=1.5 * DT)


@needs_compiler
def test_the_same_model_gives_the_same_file(fmu, tmp_path):
    write_fmu(plant_program(MODEL, DT, notes=["A drive."]), DT, tmp_path / "again.fmu")
    assert fmu.read_bytes() == (tmp_path / "again.fmu").read_bytes()


def test_without_a_compiler_it_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(LogError, match="no C compiler found"):
        write_fmu(plant_program(Model(), DT), DT, tmp_path / "plant.fmu")
    assert not list(tmp_path.iterdir())
