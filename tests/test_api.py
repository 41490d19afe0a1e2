"""help() on a public function tells what goes in, what comes out and what is refused."""

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import numpy as np
import pytest

import dmptm_ctrl

PACKAGES = [
    f"dmptm_ctrl.{module.name}" for module in pkgutil.iter_modules(dmptm_ctrl.__path__)
    if module.ispkg and module.name != "data"
]  # fmt: skip
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
def test_docstring_says_what_goes_in_and_out(function):
    check_docstring(function)


def unknown_keywords():
    """Calls of what takes keywords by `**`, with one that nothing is called."""
    from dmptm_ctrl import drive, load_log
    from dmptm_ctrl.data import path
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
    assert re.search(rf"^\| `{name}[`(]", API, re.MULTILINE), "not in docs/api.md"


def test_listed_names_exist_and_types_agree():
    assert set(re.findall(r"^\| `(\w+)", API, re.MULTILINE)) == set(dmptm_ctrl.__all__[1:])
    tree = ast.parse(Path(dmptm_ctrl.__file__).read_text(encoding="utf-8"))
    (typed,) = (node for node in tree.body if isinstance(node, ast.If))
    seen = {alias.asname or alias.name for node in typed.body for alias in node.names}
    assert seen == set(dmptm_ctrl.__all__[1:])


def test_public_function_stays_beside_a_subpackage_of_its_name():
    import dmptm_ctrl.reproduce.run
    import dmptm_ctrl.simulate.batch

    for name in ("simulate", "reproduce", "check"):
        importlib.import_module(f"dmptm_ctrl.{name}")
        assert inspect.isfunction(getattr(dmptm_ctrl, name))


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


@pytest.mark.parametrize("kind", dmptm_ctrl._FIRST)
def test_another_first_argument_is_refused_in_one_sentence(kind):
    for name in dmptm_ctrl._FIRST[kind]:
        function = getattr(dmptm_ctrl, name)
        assert kind in str(next(iter(inspect.signature(function).parameters.values())).annotation)
        with pytest.raises(TypeError, match=f"^{name} takes a {kind} as its first argument, not a"):
            function(1.0, 2.0, 3.0)


def test_closed_loop_refuses_what_it_cannot_run_in_one_sentence():
    model, loop = dmptm_ctrl.Model(), dmptm_ctrl.Loop(4.6, 86.0, 10.0)
    slow = dmptm_ctrl.Controller(4.6, 86.0, limit=10.0, sample_time=2e-3)
    time, reference = [0.0, 1e-3], [0.0, 0.1]
    for arguments, said in [
        ((loop, model, time, reference), "takes a Model first, not Loop"),
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
