"""`dmptm export`: files, messages, exit codes."""

import hashlib
import re
import runpy
import subprocess
import zipfile
from dataclasses import replace

import control as ct
import numpy as np
import pytest
from tests.export.native import STRICT, needs_compiler
from tests.export.test_plant import RACK, RIG, TIME, VOLTS, rig_model

from dmptm_ctrl.cli import main
from dmptm_ctrl.design.controller import Controller, Notch, read_controller
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import read_model, rig_model_to_toml, to_toml
from dmptm_ctrl.simulate.rig_model import RigModel

MODEL = Model().with_effect("unbalance", cosine=4.0)
CONTROLLER = Controller(12.0, 60.0, notches=(Notch(60.0, 0.1, 0.5),), model=MODEL, effects=1.0)


@pytest.fixture
def files(tmp_path):
    CONTROLLER.save(tmp_path / "controller.toml")
    (tmp_path / "model.toml").write_text(to_toml(MODEL), encoding="utf-8")
    (tmp_path / "rig_model.toml").write_text(rig_model_to_toml(rig_model()), encoding="utf-8")
    replace(CONTROLLER, notches=3 * CONTROLLER.notches).save(tmp_path / "three.toml")
    Controller(1.0, 5.0, model=rig_model()).save(tmp_path / "rig_controller.toml")
    rack = RigModel(parse_rig(RACK, "rig.toml"))
    Controller(1.0, 5.0, sample_time=2e-3, model=rack, input="current", sensor="speed").save(
        tmp_path / "rack_controller.toml"
    )
    (tmp_path / "rig.toml").write_text(RIG, encoding="utf-8")
    (tmp_path / "open.toml").write_text(RIG.replace('"40 N m/rad"', '"unknown"'), encoding="utf-8")
    return tmp_path


@pytest.mark.parametrize(
    ("source", "to", "names"),
    [
        ("controller.toml", "c", ["controller.c", "controller.h"]),
        ("controller.toml", "st", ["controller.st"]),
        ("controller.toml", "python", ["controller.py"]),
        ("rig_controller.toml", "c", ["controller.c", "controller.h"]),
        ("rig_controller.toml", "st", ["controller.st"]),
        ("rig_controller.toml", "python", ["controller.py"]),
        ("model.toml", "c", ["plant.c", "plant.h"]),
        ("model.toml", "st", ["plant.st"]),
        ("model.toml", "python", ["plant.py"]),
        ("rig_model.toml", "c", ["plant.c", "plant.h"]),
        ("rig_model.toml", "python", ["plant.py"]),
        ("rig.toml", "c", ["plant.c", "plant.h"]),
        ("rig.toml", "table", ["friction.csv"]),
        ("rig.toml", "mujoco", ["joint.xml"]),
        pytest.param("rig_model.toml", "fmu", ["plant.fmu"], marks=needs_compiler),
    ],
)
def test_writes(files, source, to, names, capsys):
    out = files / "out"
    before = (files / source).read_bytes()
    assert main(["export", str(files / source), "--to", to, "--out", str(out)]) == 0
    assert sorted(p.name for p in out.iterdir()) == names
    written = capsys.readouterr().out
    assert all(name in written for name in names)
    assert (files / source).read_bytes() == before


ANGLES = {"theta_left": "rad", "theta_right": "rad"}
VOLTAGES = {"u_left": "V", "u_right": "V"}
OF_DUAL = {"setpoint": "rad/s", "theta_load": "rad", "omega_load": "rad/s", **ANGLES, **VOLTAGES}
PORTS = {
    "controller.toml": OF_DUAL,
    "rig_controller.toml": {"setpoint": "rad/s", "out_speed": "rad/s", "in_voltage": "V"},
    # a slide, of which logs have mm/s, moved by a current, of which they have mA
    "rack_controller.toml": {"setpoint": "m/s", "out_speed": "m/s", "in_current": "A"},
    "model.toml": {"u_left": "V", "theta_l": "rad", "omega_l": "rad/s", "torque_l": "N m"},
    "rig_model.toml": {"in_voltage": "V", "out_angle": "rad", "out_speed": "rad/s"},
}


@pytest.mark.parametrize("to", ["c", "st"])
@pytest.mark.parametrize("source", PORTS)
def test_says_units_sample_time_and_where_it_is_from(files, source, to):
    out = files / "out"
    options = ["--to", to, "--real", "float", "--out", str(out)]
    assert main(["export", str(files / source), *options]) == 0
    sample_time = "0.002" if source == "rack_controller.toml" else "0.001"
    digest = hashlib.sha256((files / source).read_bytes()).hexdigest()
    for text in (file.read_text("ascii") for file in out.iterdir()):
        head = re.split(r"^(?:#include|#ifndef|FUNCTION_BLOCK) ", text, flags=re.M)[0]
        assert f"Sample time: {sample_time} s." in head
        assert f"Source: {source}, SHA-256 {digest}." in head
        assert "Units: SI" in head
    (ports,) = (f.read_text("ascii") for f in out.iterdir() if f.suffix in (".h", ".st"))
    for name, unit in PORTS[source].items():
        assert re.search(rf"^ .*\b{name}\b.*\[{unit}\]", ports, re.M), name


@needs_compiler
def test_an_fmu_says_where_it_is_from(files):
    out = files / "out"
    assert main(["export", str(files / "rig_model.toml"), "--to", "fmu", "--out", str(out)]) == 0
    digest = hashlib.sha256((files / "rig_model.toml").read_bytes()).hexdigest()
    with zipfile.ZipFile(out / "plant.fmu") as archive:
        description = archive.read("modelDescription.xml").decode()
    assert f"Source: rig_model.toml, SHA-256 {digest}." in description
    assert "Sample time: 0.001 s." in description
    for unit in ("V", "rad", "rad/s"):
        assert f'<Unit name="{unit}">' in description


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none.toml", "--to", "c"], "none.toml: no readable model or controller file"),
        (["open.toml", "--to", "c"], "open.toml: link.belt.stiffness is declared unknown; fit the"),
        (["model.toml", "--to", "ladder"], "no target 'ladder'; there are c, st, fmu"),
        (["model.toml", "--to", "c", "--real", "half"], "no number type 'half'"),
        (["model.toml", "--to", "c", "--name", "2 axes"], "name '2 axes': must be a new word"),
        (["model.toml", "--to", "c", "--name", "Return"], "name 'Return': must be a new word"),
        (["model.toml", "--to", "st", "--name", "a__b"], "name 'a__b': must be a new word"),
        (["three.toml", "--to", "c"], "three.toml: 3 notches; the loop has room for 2"),
        (["model.toml", "--to", "c", "--sample-time", "0"], "must lie between 0 and 1 s"),
        (["controller.toml", "--to", "fmu"], "fmu is of a plant"),
        (["rig_controller.toml", "--to", "table"], "table is of a plant"),
        (["controller.toml", "--to", "c", "--sample-time", "0.01"], "its own sample time"),
    ],
)
def test_bad_input_is_one_line_and_nothing_written(files, arguments, message, capsys):
    out = files / "out"
    assert main(["export", str(files / arguments[0]), *arguments[1:], "--out", str(out)]) == 2
    line = capsys.readouterr().err
    assert message in line
    assert line.count("\n") == 1
    assert not out.exists()


def test_an_effect_that_is_no_scalar_arithmetic_is_refused_in_one_line(files, monkeypatch, capsys):
    def halved(theta_L, omega_L, t, p):
        while theta_L > 1.0:
            theta_L = 0.5 * theta_L
        return theta_L

    kernel = CATALOGUE["unbalance"]._replace(kernel=halved)
    monkeypatch.setitem(CATALOGUE, "unbalance", kernel)
    out = files / "out"
    assert main(["export", str(files / "model.toml"), "--to", "c", "--out", str(out)]) == 2
    line = capsys.readouterr().err
    assert "model.toml: an effect has no program: cannot follow a While" in line
    assert not out.exists()


@needs_compiler
def test_programs_stand_beside_each_other_in_c_and_in_cplusplus(files):
    """Two controllers and a plant as one text, and linked: no name is there twice."""
    out, names = files / "out", {"axis_a": "double", "axis_b": "float", "drive": "float"}
    for name, real in names.items():
        source = "model.toml" if name == "drive" else "controller.toml"
        options = ["--to", "c", "--name", name, "--real", real, "--out", str(out)]
        assert main(["export", str(files / source), *options]) == 0
    starts = "".join(f"    {n}_state {n}_1;\n    {n}_init(&{n}_1);\n" for n in names)
    program = f"int main(void) {{\n{starts}    return 0;\n}}\n"
    for ending in ("c", "h"):
        head = "".join(f'#include "{n}.{ending}"\n' for n in names)
        (out / f"main_{ending}.c").write_text(head + program, encoding="ascii")
    apart = ["main_h.c", *(f"{n}.c" for n in names)]
    for language in (["cc", "-std=c99"], ["c++", "-std=c++11", "-x", "c++"]):
        for texts in (["main_c.c"], apart):
            command = [*language, *STRICT, *texts, "-o", "program", "-lm"]
            subprocess.run(command, cwd=out, check=True)
            subprocess.run([out / "program"], check=True)


@pytest.mark.parametrize(
    ("source", "units"),
    [("controller.toml", ("rad/s", "V")), ("rack_controller.toml", ("m/s", "A"))],
)
def test_controller_as_python_control(files, source, units):
    main(["export", str(files / source), "--to", "python", "--out", str(files / "out")])
    file = files / "out" / "controller.py"
    found, given = runpy.run_path(str(file))["feedback"], read_controller(files / source)
    true = given.to_discrete()
    for name, unit in zip(("error", "u"), units, strict=True):
        assert f'puts=["{name}"],  # {unit}\n' in file.read_text("utf-8")
    assert isinstance(found, ct.StateSpace)
    assert found.dt == given.sample_time
    z = np.exp(1j * np.linspace(0.1, 3.0, 20))
    np.testing.assert_allclose(found(z), true(z), rtol=1e-12)


@pytest.mark.parametrize("source", ["model.toml", "rig_model.toml"])
def test_python_program_has_the_model(files, source):
    main(["export", str(files / source), "--to", "python", "--out", str(files / "out")])
    found = runpy.run_path(str(files / "out" / "plant.py"))
    assert isinstance(found["plant"], ct.InterconnectedSystem)
    made, read = found["model"].plant(), read_model(files / source).plant()
    for name in ("law", "link_values", "inertia", "on", "values"):
        np.testing.assert_array_equal(getattr(made, name), getattr(read, name))
    assert np.isfinite(found["response"].outputs).all()


def test_a_rig_file_of_the_dual_motor_drive_is_that_drive(files):
    from dmptm_ctrl.data import PAPER_RIG

    (files / "paper.toml").write_text(to_toml(Model()), encoding="utf-8")
    for source, out in ((PAPER_RIG, "rig"), (files / "paper.toml", "drive")):
        assert main(["export", str(source), "--to", "c", "--out", str(files / out)]) == 0
    one, other = ((files / d / "plant.h").read_text("ascii") for d in ("rig", "drive"))
    assert one.split("#ifndef")[1] == other.split("#ifndef")[1]
    assert "theta_ml" in one


@needs_compiler
def test_the_sample_time_of_a_plant_is_as_told(files):
    from dmptm_ctrl.export.c_source import c_source
    from dmptm_ctrl.export.native import Compiled
    from dmptm_ctrl.export.plant import plant_program
    from dmptm_ctrl.simulate import simulate

    out = files / "out"
    options = ["--to", "c", "--sample-time", "0.002", "--out", str(out)]
    assert main(["export", str(files / "model.toml"), *options]) == 0
    program = plant_program(MODEL, 2e-3)
    begin = '#include "plant.h"'
    written = (out / "plant.c").read_text("ascii")
    assert written.split(begin)[1] == c_source(program).split(begin)[1]
    step = Compiled(program)
    found = np.array([step(*row) for row in VOLTS[:, :200].T])
    true = simulate(MODEL, 2.0 * TIME[:200], VOLTS[:, :200]).outputs.T
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-9 * np.abs(true).max())
