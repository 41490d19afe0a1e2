"""help() on a public function tells what goes in, what comes out and what is refused."""

import ast
import doctest
import importlib
import inspect
import pkgutil
import re
import shutil
from pathlib import Path

import control
import numpy as np
import pytest

import dmptm_ctrl
from dmptm_ctrl.cli import main
from dmptm_ctrl.data import PAPER_RIG, path
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.model_file import rig_model_to_toml, to_toml
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

PACKAGES = [
    f"dmptm_ctrl.{module.name}" for module in pkgutil.iter_modules(dmptm_ctrl.__path__)
    if module.ispkg and module.name != "data"
]  # fmt: skip
WITHOUT_EXAMPLE = {"LogError"}  # made by functions, not by their users
LONG = {"diagnose", "reproduce", "tune_controller", "monte_carlo", "impact", "limit_cycles"}
LONG |= {"Diagnosis", "check", "constant_speed", "load_logs", "simulate_with_sensitivities"}
LONG |= {"register_effect"}  # it would stay
API = (Path(__file__).parents[1] / "docs" / "api.md").read_text(encoding="utf-8")
RETURNS = re.compile(r"^(Returns|Yields)\n---|^(Return|Whether) ", re.MULTILINE)


def public_functions():
    """Functions that a package of ours offers, with the package's name."""
    for package in PACKAGES:
        module = importlib.import_module(package)
        for name in sorted({n for n in dir(module) if not n.startswith("_")}):
            found = getattr(module, name)
            function = getattr(found, "py_func", found)
            own = getattr(function, "__module__", "").startswith("dmptm_ctrl")
            if own and inspect.isfunction(function):
                yield pytest.param(function, id=f"{package}.{name}")


def check_docstring(function):
    """What goes in, what comes out and what is refused stands in the docstring."""
    text = inspect.getdoc(function) or ""
    signature = inspect.signature(function)
    if signature.parameters:
        assert "\nParameters\n---" in text
    for name in signature.parameters:
        assert re.search(rf"\b{name}\b", text), f"no word on {name}"
    if signature.return_annotation not in (None, "None", inspect.Signature.empty):
        assert RETURNS.search(text), "no word on what is returned"
    if re.search(r"^\s+raise ", inspect.getsource(function), re.MULTILINE):
        assert "\nRaises\n---" in text


@pytest.mark.parametrize("function", list(public_functions()))
def test_function_of_a_package_says_what_it_does(function):
    """In a sentence at least; names in dmptm_ctrl.__all__ have all sections, see below."""
    assert (inspect.getdoc(function) or "\n").splitlines()[0].endswith(".")


def unknown_keywords():
    """Calls of what takes keywords by `**`, with one that nothing is called."""
    from dmptm_ctrl import drive, load_log
    from dmptm_ctrl.simulate import simulate
    from dmptm_ctrl.simulate.model import Model

    declared, model = drive.paper_drive(), Model()
    log = path("demo_rig") / "open_sine_0v60.csv.gz"
    return {
        "Drive.with_values": lambda: declared.with_values(nonsense=1.0),
        "Model.with_values": lambda: model.with_values(nonsense=1.0),
        "Model.with_effect": lambda: model.with_effect("cogging", nonsense=1.0),
        "Model.to_blocks": lambda: model.to_blocks(nonsense=1.0),
        "nine_dof_ss": lambda: drive.nine_dof_ss(nonsense=1.0),
        "nine_dof_parameters": lambda: drive.nine_dof_parameters(nonsense=1.0),
        "simplification_cost": lambda: drive.simplification_cost(nonsense=1.0),
        "load_log": lambda: load_log(log, nonsense=1.0),
        "simulate": lambda: simulate(model, [0.0, 0.001], [[0.0, 0.0]] * 2, nonsense=1.0),
    }


@pytest.mark.parametrize("name", dmptm_ctrl.__all__[1:])
def test_public_name_loads_explains_itself_and_is_listed(name):
    found = getattr(dmptm_ctrl, name)
    if inspect.isfunction(found):
        check_docstring(found)
        assert "\nReturns\n---" in inspect.getdoc(found)
    elif not issubclass(found, Exception):
        assert re.search(r"\n(Attributes|Parameters)\n---", inspect.getdoc(found))
    if name not in WITHOUT_EXAMPLE:
        assert "\nExamples\n---" in inspect.getdoc(found)
    assert re.search(rf"^\| `{name}[`(]", API, re.MULTILINE), "not in docs/api.md"


def test_examples_of_public_names_run(tmp_path, monkeypatch):
    """But those that take many seconds; the others have their files here."""
    monkeypatch.chdir(tmp_path)
    model = dmptm_ctrl.Model().with_effect("unbalance", cosine=8.0, sine=0.0)
    (tmp_path / "model.toml").write_text(to_toml(model), encoding="utf-8")
    dmptm_ctrl.Controller(5.0, 90.0, preload=0.3).save("controller.toml")
    shutil.copy(PAPER_RIG, "rig.toml")
    shutil.copy(path("demo_rig") / "open_sine_0v60.csv.gz", "log.csv.gz")
    tried = 0
    for name in sorted(set(dmptm_ctrl.__all__[1:]) - WITHOUT_EXAMPLE - LONG):
        names = {"dm": dmptm_ctrl, "np": np, "ct": control}
        text = inspect.getdoc(getattr(dmptm_ctrl, name))
        said: list[str] = []
        test = doctest.DocTestParser().get_doctest(text, names, name, None, None)
        tried += doctest.DocTestRunner(verbose=False).run(test, out=said.append).attempted
        assert not said, "".join(said)
    assert tried > 50


def test_signatures_in_help_are_short():
    """Types are in the docstring, with units and shapes; numpy's array type fills four lines."""
    said = "(model, x0=None, u0=None, *, outputs=None)"
    assert str(inspect.signature(dmptm_ctrl.linearize)) == said


def test_drives_and_rigs_print_as_tables():
    drive, rig = dmptm_ctrl.paper_drive(), dmptm_ctrl.paper_rig()
    assert re.search(r"^J_L +2\.5 kg·m² ± 6 % +Table 1$", str(drive), re.MULTILINE)
    assert re.search(r"^c +3 N·m·s/rad \(1 to 10\) ", str(drive), re.MULTILINE)
    assert max(map(len, str(drive).splitlines())) < 100
    antisymmetric = str(dmptm_ctrl.modes(drive)).splitlines()[1]
    assert antisymmetric.strip() == "60.4 Hz  antisymmetric, damping ratio 0.0185"
    assert "[ring_gear] inertia 2.5 kg·m² ± 6 %; friction: static_plus 23 N·m" in str(rig)
    assert len(repr((dmptm_ctrl.Model(drive), rig))) < 200
    assert dmptm_ctrl.Diagnosis.__str__ is dmptm_ctrl.Diagnosis.summary


def test_listed_names_exist_and_have_these_arguments():
    assert set(re.findall(r"^\| `(\w+)", API, re.MULTILINE)) == set(dmptm_ctrl.__all__[1:])
    for name, arguments in re.findall(r"^\| `(\w+)\((.*?)\)`", API, re.MULTILINE):
        listed = [a.partition("=")[0] for a in arguments.split(", ") if a not in ("", "…")]
        taken = [*inspect.signature(getattr(dmptm_ctrl, name)).parameters]
        assert listed == taken[: len(listed)], name


def test_help_shows_no_address_of_an_object():
    for name in dmptm_ctrl.__all__[1:]:
        found = getattr(dmptm_ctrl, name)
        if inspect.isfunction(found):
            assert " at 0x" not in str(inspect.signature(found)), name


def test_public_function_stays_beside_a_subpackage_of_its_name():
    import dmptm_ctrl.reproduce.run
    import dmptm_ctrl.simulate.batch

    for name in ("simulate", "reproduce", "check"):
        importlib.import_module(f"dmptm_ctrl.{name}")
        assert inspect.isfunction(getattr(dmptm_ctrl, name))


def test_modules_behind_such_a_function_are_imported_under_a_short_name():
    import dmptm_ctrl.check.moved as moved
    import dmptm_ctrl.export.run as run

    assert moved.find_moved.__module__ == "dmptm_ctrl.check.moved"
    assert run.export_file.__module__ == "dmptm_ctrl.export.run"


def test_closed_loop_is_the_compiled_one_as_a_response():
    from dmptm_ctrl.simulate import compiled

    model, loop = dmptm_ctrl.Model(), dmptm_ctrl.Loop(4.6, 86.0, 10.0, 0.3, -0.3)
    time = 0.5 + 1e-3 * np.arange(400)
    reference = 0.17 * np.sin(np.pi * time)
    run = dmptm_ctrl.close_loop(model, loop, time, reference)
    u, out = compiled.close_loop(model, loop, reference, 1e-3)
    np.testing.assert_allclose(run.outputs, np.vstack([out.T, u]), rtol=1e-6, atol=1e-9)
    assert run.output_labels[-2:] == ["u_left", "u_right"]
    np.testing.assert_array_equal(run.inputs[0], reference)


FIRST = {  # what a function takes first -> which functions
    "Drive": ("baseline", "three_dof", "nine_dof", "constant_speed"),
    "a Model or a RigModel": ("simulate_with_sensitivities",),
    "Model": ("stepped_sine", "multisine", "tune_controller"),
    "a Model": ("limit_cycles", "smallest_preload", "monte_carlo"),
    "a Model or a RigModel or a Rig": ("close_loop", "linearize", "predict"),
    "a model first": ("simulate",),
    "Drive or a GearTrain or a Model or a Rig or a RigModel": ("modes",),
    "dict of LTI": ("bode_compare", "step_compare"),
    "StateSpace": ("common_mode", "close_speed_loop", "margins", "tune_pi", "step_info"),
}


@pytest.mark.parametrize("kinds", FIRST)
def test_another_first_argument_is_refused_in_one_sentence(kinds):
    for name in FIRST[kinds]:
        function = getattr(dmptm_ctrl, name)
        count = sum(p.default is p.empty for p in inspect.signature(function).parameters.values())
        with pytest.raises(TypeError, match=f"^{name}:? .*(must be|takes) .*{kinds}"):
            function(*[1.0] * max(1, count))


def test_models_in_the_place_of_logs_are_refused_in_one_sentence():
    for name in dmptm_ctrl._LOGS:
        with pytest.raises(TypeError, match=f"^{name} takes logs as its first argument, not a Dr"):
            getattr(dmptm_ctrl, name)(dmptm_ctrl.paper_drive(), "logs")


@pytest.mark.parametrize("name", dmptm_ctrl.__all__[1:])
def test_unknown_keywords_of_public_functions_are_refused_in_one_sentence(name):
    found = getattr(dmptm_ctrl, name)
    if not inspect.isfunction(found):
        return
    parameters = inspect.signature(found).parameters.values()
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters):
        return  # test_unknown_keywords_are_refused has these
    with pytest.raises(TypeError, match=rf"^{name}: .*'nonsense'; it takes ") as said:
        found(nonsense=1.0)
    assert "\n" not in str(said.value)


def rig_of(text=""):
    """A flywheel, with damping [N·m·s/rad] and a motor without gain: τ = J/b = 0.5 s."""
    return parse_rig(
        'name = "wheel"\n[body.wheel]\ninertia = "0.02 kg m^2"\nviscous = "0.04 N m s/rad"\n'
        '[input.motor]\ncolumn = "u"\nunit = "V"\ngain = "0.1 N m/V"\n'
        '[sensor.w]\ncolumn = "w"\nunit = "rad/s"\n' + text
    )


def test_a_rig_simulates_linearises_and_closes_its_loop_as_a_model_does():
    """Against the closed form of a first-order lag: 2.5 (1 − exp(−2 t)) rad/s per volt."""
    rig, time = rig_of(), 1e-3 * np.arange(2001)
    wanted = 2.5 * (1.0 - np.exp(-2.0 * time))
    for model in (rig, RigModel(rig)):
        run = dmptm_ctrl.simulate(model, time, np.ones_like(time))
        assert run.output_labels == ["w"]
        np.testing.assert_allclose(run.outputs[0], wanted, atol=5e-3)
        plant = dmptm_ctrl.linearize(model)
        assert plant.poles() == pytest.approx([-2.0])
        assert dmptm_ctrl.modes(model).hz == pytest.approx([0.0])
    blocks = RigModel(rig).to_blocks()
    assert (blocks.input_labels, blocks.output_labels) == (["motor"], ["w"])
    loop = dmptm_ctrl.Loop(4.0, 0.0, 100.0)  # pole at −(2 + 5·4) 1/s, end at 20/22
    closed = dmptm_ctrl.close_loop(rig, loop, time, np.ones_like(time))
    assert closed.output_labels == ["w", "motor"]
    assert closed.outputs[0][-1] == pytest.approx(20.0 / 22.0, rel=1e-3)
    with pytest.raises(ValueError, match="preload needs two motors"):
        dmptm_ctrl.close_loop(rig, dmptm_ctrl.Loop(1.0, 0.0, 1.0, 0.3), time, np.ones_like(time))
    with pytest.raises(TypeError, match="method 'compiled' has no option 'nonsense'"):
        dmptm_ctrl.simulate(rig, time, np.ones_like(time), nonsense=1.0)


def test_modes_of_a_rig_by_hand():
    """Two inertias on a spring: ω² = k (1/J1 + 1/J2); ζ = d (1/J1 + 1/J2) / (2 ω)."""
    rig = parse_rig(
        '[body.a]\ninertia = "2e-3 kg m^2"\n[body.bell]\ninertia = "6e-3 kg m^2"\n'
        'viscous = "unknown"\n[shaft.s]\nbetween = ["a", "bell"]\nstiffness = "30 N m/rad"\n'
        'damping = "1e-3 N m s/rad"\n[input.u]\ncolumn = "u"\nunit = "V"\nbody = "a"\n'
        'gain = "1 N m/V"\n[sensor.w]\ncolumn = "w"\nunit = "rad/s"\nbody = "bell"\n'
    )
    found = dmptm_ctrl.modes(rig)
    both = 1 / 2e-3 + 1 / 6e-3
    omega = np.sqrt(30.0 * both)
    assert found.kinds == ("rigid", "elastic")
    assert found.omega == pytest.approx([0.0, omega])
    assert found.damping_ratios == pytest.approx([0.0, 1e-3 * both / (2 * omega)], rel=1e-6)
    ratio = found.shapes[1, 1] / found.shapes[0, 1]
    assert ratio == pytest.approx(-2e-3 / 6e-3)


def test_one_reader_reads_the_models_of_every_drive(tmp_path):
    model = dmptm_ctrl.Model().with_effect("unbalance", cosine=3.0, sine=-1.0)
    zeros = {"run_a": {"cogging@wheel": 0.25}}
    effect = Placed("cogging", "wheel", {"order": 6.0, "cosine": 0.01, "sine": 0.0})
    own = RigModel(rig_of(), (effect,), {"body.wheel.inertia": 0.03}, zeros)
    (tmp_path / "dual.toml").write_text(to_toml(model), encoding="utf-8")
    (tmp_path / "rig.toml").write_text(rig_model_to_toml(own), encoding="utf-8")
    found = dmptm_ctrl.read_model(tmp_path / "dual.toml")
    assert found.effects["unbalance"]["cosine"] == 3.0
    rig = dmptm_ctrl.read_model(tmp_path / "rig.toml")
    assert rig.effects == own.effects
    assert rig.value("body.wheel.inertia") == 0.03
    assert rig.zeros == zeros
    assert main(["tune", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "t")]) == 2


def test_step_of_a_run_counts_from_where_the_setpoint_moves():
    """A first-order loop: overshoot 0, rise ln(9) time constants, settling ln(50)."""
    rig, time = rig_of(), 1e-3 * np.arange(4001)
    run = dmptm_ctrl.close_loop(
        rig, dmptm_ctrl.Loop(1.0, 0.0, 100.0), time, np.where(time < 1.0, 0.0, 1.0)
    )
    found = dmptm_ctrl.step_info(run)  # pole at −(2 + 5) 1/s
    assert found["Overshoot"] == pytest.approx(0.0, abs=0.1)
    assert found["RiseTime"] == pytest.approx(np.log(9.0) / 7.0, abs=4e-3)
    assert found["SettlingTime"] == pytest.approx(np.log(50.0) / 7.0, abs=4e-3)
    assert found["SteadyStateValue"] == pytest.approx(5.0 / 7.0, rel=1e-3)
    with pytest.raises(ValueError, match="^no output 'omega_L'; the run has w, motor$"):
        dmptm_ctrl.step_info(run, "omega_L")
    both = dmptm_ctrl.three_dof(outputs=("omega_L", "omega_ml"), inputs="voltage")
    one = dmptm_ctrl.common_mode(both, "omega_ml")
    assert dmptm_ctrl.step_info(one, "omega_ml") == dmptm_ctrl.step_info(one)
    with pytest.raises(ValueError, match="^no output 'omega_L'; the model has omega_ml$"):
        dmptm_ctrl.step_info(one, "omega_L")
    many = dmptm_ctrl.simulate(rig, time, np.sin(time))
    with pytest.raises(ValueError, match="^the inputs of the run change 4000 times, a step"):
        dmptm_ctrl.step_info(many)


def test_closed_loop_refuses_what_it_cannot_run_in_one_sentence():
    model, loop = dmptm_ctrl.Model(), dmptm_ctrl.Loop(4.6, 86.0, 10.0)
    slow = dmptm_ctrl.Controller(4.6, 86.0, limit=10.0, sample_time=2e-3)
    time, reference = [0.0, 1e-3], [0.0, 0.1]
    for arguments, said in [
        ((loop, model, time, reference), "^close_loop: model must be a Model or a RigModel"),
        ((model, "PI", time, reference), "a Loop or a Controller second, not str"),
        ((model, loop, time, [0.0]), r"reference has shape \(1,\); needs \(2,\)"),
        ((model, slow, time, reference), "the controller's sample time is 0.002 s"),
    ]:
        with pytest.raises((TypeError, ValueError), match=said):
            dmptm_ctrl.close_loop(*arguments)


@pytest.mark.parametrize("name", list(unknown_keywords()))
def test_unknown_keywords_are_refused(name):
    with pytest.raises((TypeError, KeyError, ValueError), match="nonsense"):
        unknown_keywords()[name]()


def test_only_the_command_prints():
    root = Path(dmptm_ctrl.__file__).parent
    calls = {
        file.relative_to(root).as_posix()
        for file in root.rglob("*.py")
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Name)
        and node.func.id == "print"
    }
    assert calls == {"cli.py", "progress.py"}  # what the command tells goes through both


ONE = np.zeros(9)
WRONG = {  # call with a first argument that is right -> what is said of another
    "simulate": (lambda f, m: f(m, "t", ONE), "timepts must be an array, not a str"),
    "simulate_batch": (
        lambda f, m: f(m, ONE, ONE),
        "models must be a sequence of Model or RigModel, n",
    ),
    "tune_pi": (lambda f, m: f(dmptm_ctrl.three_dof(), "20"), "bandwidth_hz must be a number, not"),
    "tune_controller": (lambda f, m: f(m, 5), "aims must be an Aims, not an int"),
    "stepped_sine": (lambda f, m: f(m, 0.6, [1.0, 2.0]), "amplitude must be a number, not a list"),
    "limit_cycles": (lambda f, m: f(m, "a", 3), "kp must be a number, not a str"),
    "monte_carlo": (lambda f, m: f(m, 3, 4), "controller must be a Controller, not an int"),
    "linearize": (lambda f, m: f(m, outputs="omega_L"), "outputs must be a sequence of str, not"),
    "bode_compare": (lambda f, m: f({"a": 1}), "systems must be a dict of LTI, not a dict"),
    "check": (
        lambda f, m: f(ONE, "logs"),
        "model must be a Model or a RigModel or a te",
    ),
    "predict": (lambda f, m: f(m, 3.0), "log must be a Log or a text or a path, not a float"),
    "diagnose": (
        lambda f, m: f([], m),
        "rig must be a Rig or a Drive or a text or a path, not a M",
    ),
    "export": (lambda f, m: f(m, "c", "out"), "source must be a text or a path, not a Model"),
    "register_effect": (lambda f, m: f(3), "effect must be an Effect, not an int"),
    "reproduce": (lambda f, m: f(3), "out must be a text or a path, not an int"),
}


def test_an_inertia_that_may_be_zero(tmp_path):
    """What the pinion adds to the rotor: a model without it is read, a negative one is not."""
    text = to_toml(dmptm_ctrl.Model(dmptm_ctrl.paper_drive().with_values(J_2=0.0)))
    (tmp_path / "m.toml").write_text(text, encoding="utf-8")
    assert dmptm_ctrl.read_model(tmp_path / "m.toml").drive["J_2"] == 0.0
    (tmp_path / "m.toml").write_text(text.replace("J_2 = 0.0", "J_2 = -1.0"), encoding="utf-8")
    with pytest.raises(dmptm_ctrl.LogError, match="J_2 is -1 kg·m², it must be zero or more"):
        dmptm_ctrl.read_model(tmp_path / "m.toml")


@pytest.mark.parametrize(
    ("call", "error", "said"),
    [
        (lambda m: dmptm_ctrl.simulate_batch([m], [m], ONE), TypeError, "timepts must be an array"),
        (lambda m: dmptm_ctrl.bode_compare({}, dB="yes"), TypeError, "dB must be True or False"),
        (lambda m: dmptm_ctrl.multisine(m, [], 0.5), ValueError, "no frequencies; give at least"),
        (lambda m: dmptm_ctrl.stepped_sine(m, [], 0.5), ValueError, "no frequencies; give at"),
        (lambda m: dmptm_ctrl.Log("a", ONE, [ONE]), TypeError, "channels of a Log must be a map"),
        (lambda m: dmptm_ctrl.constant_speed(m.drive, m.drive), TypeError, "logs must be a seq"),
        (
            lambda m: dmptm_ctrl.margins(dmptm_ctrl.three_dof(), 5.0, 90.0, sample_time=-1.0),
            ValueError,
            "sample_time is -1; it must be more than 0 and finite",
        ),
        (lambda m: dmptm_ctrl.multisine(m, [5.0], 0.5, period=np.inf), ValueError, "period is inf"),
        (lambda m: dmptm_ctrl.multisine(m, [5.0], 0.5, seed=-1), ValueError, "seed is -1; it must"),
        (lambda m: dmptm_ctrl.linearize(m, None, [0.1, np.nan]), ValueError, "u0 of a Model has a"),
        (
            lambda m: dmptm_ctrl.tune_controller(m, input="left"),
            ValueError,
            "input and sensor are those of a rig",
        ),
    ],
)
def test_what_is_empty_or_of_another_kind_is_refused_in_one_sentence(call, error, said):
    with pytest.raises(error, match=f"^(\\w+: )?{said}") as refused:
        call(dmptm_ctrl.Model())
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", WRONG)
def test_arguments_of_a_wrong_type_are_refused_in_one_sentence(name):
    call, said = WRONG[name]
    with pytest.raises(TypeError, match=f"^{name}: {said}"):
        call(getattr(dmptm_ctrl, name), dmptm_ctrl.Model())


def test_numbers_of_any_library_are_numbers():
    plant = dmptm_ctrl.three_dof()
    for twenty in (20, np.float32(20.0), np.int64(20), np.array(20.0)):
        assert dmptm_ctrl.tune_pi(plant, twenty).kp == pytest.approx(
            dmptm_ctrl.tune_pi(plant, 20.0).kp, rel=1e-4
        )


def test_models_and_blocks_refuse_what_is_in_the_place_of_a_part():
    with pytest.raises(TypeError, match="^Model takes a Drive first, not a StateSpace$"):
        dmptm_ctrl.Model(dmptm_ctrl.three_dof())
    with pytest.raises(TypeError, match="not a Rig; read_model makes the model of a rig file$"):
        dmptm_ctrl.Model(dmptm_ctrl.paper_rig())
    with pytest.raises(TypeError, match="^loop must be a Loop, not a int$"):
        dmptm_ctrl.Model().to_blocks(loop=3)
    with pytest.raises(TypeError, match="^impact takes a Model, a RigModel or a Diagnosis first"):
        dmptm_ctrl.impact(3, dmptm_ctrl.Controller(1.0, 2.0))
    with pytest.raises(TypeError, match="^effect 'unbalance' is 3; it must be a dict of"):
        dmptm_ctrl.Model(effects={"unbalance": 3})
    with pytest.raises(TypeError, match="^effect unbalance: cosine is 'a'; it must be a number$"):
        dmptm_ctrl.Model().with_effect("unbalance", cosine="a")
    with pytest.raises(TypeError, match="^J_L is 'a'; it must be a number$"):
        dmptm_ctrl.Model().with_values(J_L="a")


def test_classes_refuse_what_functions_refuse():
    for make, said in [
        (lambda: dmptm_ctrl.Loop("a", 1, 2), "^Loop: kp must be a number, not a str$"),
        (lambda: dmptm_ctrl.Loop(1, 2), "^Loop: missing .*: 'limit'; it takes kp, ki"),
        (lambda: dmptm_ctrl.Aims(limit="5"), "^Aims: limit must be a number, not a str$"),
        (lambda: dmptm_ctrl.Controller(1, 2, gain=3), "^Controller: .*'gain'; it takes kp, ki"),
    ]:
        with pytest.raises(TypeError, match=said):
            make()


@pytest.mark.parametrize("call", ["Loop", "Aims", "Controller", "multisine"])
def test_no_number_is_refused(call):
    arguments = {"Loop": (1.0, np.nan, 2.0), "multisine": (dmptm_ctrl.Model(), [10.0], np.nan)}
    arguments |= {"Aims": (np.float64("nan"),), "Controller": (1.0, np.nan)}
    with pytest.raises(ValueError, match=f"^{call}: .* is NaN; it must be a number$"):
        getattr(dmptm_ctrl, call)(*arguments[call])


@pytest.mark.parametrize("gains", [(np.inf, 90.0), (5.0, -np.inf), (np.nan, 90.0)])
def test_gains_that_are_not_finite_are_refused(gains):
    model, plant = dmptm_ctrl.Model(), dmptm_ctrl.three_dof()
    for name, first in [("limit_cycles", model), ("margins", plant), ("close_speed_loop", plant)]:
        with pytest.raises(
            ValueError, match=f"^{name}: k[pi] is .*; it must be (finite|a number)$"
        ):
            getattr(dmptm_ctrl, name)(first, *gains)
    for name in ("Loop", "Controller"):
        with pytest.raises(ValueError, match=f"^{name}: k[pi] is"):
            getattr(dmptm_ctrl, name)(*gains, 10.0)
        with pytest.raises(ValueError, match=f"^{name}: limit is -10; it must be more than 0$"):
            getattr(dmptm_ctrl, name)(5.0, 90.0, -10.0)
    assert dmptm_ctrl.Loop(5.0, 90.0, np.inf).limit == np.inf  # a loop without a limit


def test_a_refusal_says_how_to_make_what_is_wanted():
    drive, model = dmptm_ctrl.paper_drive(), dmptm_ctrl.Model()
    loop = dmptm_ctrl.Loop(5.0, 90.0, 10.0)
    for call, said in [
        (lambda: dmptm_ctrl.linearize(drive), r"not a Drive; Model\(drive\) makes one"),
        (lambda: dmptm_ctrl.tune_pi(drive, 20.0), r"three_dof\(drive\) or nine_dof\(drive\)"),
        (lambda: dmptm_ctrl.tune_pi(model, 20.0), r"linearize\(model\) makes one"),
        (lambda: dmptm_ctrl.three_dof(model), r"not a Model; model\.drive is one"),
        (lambda: dmptm_ctrl.monte_carlo(model, loop, 2), r"Controller\(kp, ki, limit, preload="),
    ]:
        with pytest.raises(TypeError, match=f"{said}[^\n]*$"):
            call()


def test_linear_models_and_pictures_refuse_other_shapes_in_one_sentence():
    model, plant = dmptm_ctrl.Model(), dmptm_ctrl.three_dof()
    for x0 in (3, [0.0] * 5, {"ring_gear": 1.0}):
        with pytest.raises(ValueError, match=r"^x0 of a Model is .*; it must be an array of shape"):
            dmptm_ctrl.linearize(model, x0)
    for draw in (dmptm_ctrl.bode_compare, lambda systems: dmptm_ctrl.step_compare(systems, 1.0)):
        with pytest.raises(ValueError, match="^own: 2 inputs and 1 outputs, needs one of each"):
            draw({"own": plant})
        with pytest.raises(ValueError, match="^no systems to draw"):
            draw({})
    systems = {"own": dmptm_ctrl.common_mode(plant)}
    for limits in ([1.0], [2.0, 1.0], [0.0, 1.0]):
        with pytest.raises(ValueError, match=r"^omega_limits are .*; they must be two numbers"):
            dmptm_ctrl.bode_compare(systems, omega_limits=limits)
    with pytest.raises(TypeError, match="^ax must be matplotlib's Axes"):
        dmptm_ctrl.bode_compare(systems, ax=(1, 2))
