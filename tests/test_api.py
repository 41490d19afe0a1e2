"""help() on a public function tells what goes in, what comes out and what is refused."""

import importlib
import inspect
import pkgutil
import re

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
