"""help() on a public function tells what goes in, what comes out and what is refused."""

import ast
import importlib
import inspect
import pkgutil
import re
from pathlib import Path

import pytest

import dmptm_ctrl

PACKAGES = ["dmptm_ctrl"] + [
    f"dmptm_ctrl.{module.name}" for module in pkgutil.iter_modules(dmptm_ctrl.__path__)
    if module.ispkg and module.name != "data"
]  # fmt: skip
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


@pytest.mark.parametrize("function", list(public_functions()))
def test_docstring_says_what_goes_in_and_out(function):
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
