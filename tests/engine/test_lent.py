"""Arrays that compiled functions lend without being counted among their users."""

import ast
from pathlib import Path

import pytest

from dmptm_ctrl.simulate import lanes

SOURCES = sorted(Path(lanes.__file__).parent.glob("*.py"))


def lent(source):
    """Each function that lends, and what it lends that was not given to it."""
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef):
            given = {arg.arg for arg in function.args.args}
            calls = [n for n in ast.walk(function) if isinstance(n, ast.Call)]
            names = [
                name.id
                for call in calls
                if isinstance(call.func, ast.Name) and call.func.id == "borrowed"
                for name in ast.walk(call.args[0])
                if isinstance(name, ast.Name)
            ]
            if names:
                yield function.name, [name for name in names if name not in given]


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.stem)
def test_only_what_a_caller_keeps_is_lent(path):
    """What a function makes is freed after its last use: another thread then writes there too."""
    assert {name: own for name, own in lent(path.read_text()) if own} == {}


def test_what_is_made_and_lent_is_found():
    made = (
        "def f(x):\n    work = np.empty(3)\n    s, x = borrowed(work), borrowed(x[0])\n    s[0] = x"
    )
    assert dict(lent(made)) == {"f": ["work"]}
