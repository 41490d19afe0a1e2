"""The compiled loop against the same text run as plain Python, without numba."""

import os
import subprocess
import sys

import numpy as np
import pytest

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model

SCRIPT = """
import sys
import numpy as np
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compiled import march
assert not hasattr(CATALOGUE["cogging"].kernel, "py_func"), "numba is on"
data = np.load(sys.argv[1])
runs = [
    march((data["base"], on, values), data["u"], data["x0"], 1e-3, substeps=4)
    for on, values in zip(data["on"], data["values"])
]
np.save(sys.argv[2], np.array(runs))
"""


@pytest.fixture(scope="module")
def runs(tmp_path_factory, request):
    """One run without effects, one with each effect, one with all of them together."""
    folder = tmp_path_factory.mktemp("uncompiled")
    models = [Model()]
    everything = Model()
    for name, effect in CATALOGUE.items():
        values = {
            p.name: p.bank[len(p.bank) // 2] if p.bank else 0.1 * p.high for p in effect.parameters
        }
        models.append(Model().with_effect(name, **values))
        everything = everything.with_effect(name, **values)
    models.append(everything)
    arrays = [m.arrays() for m in models]
    time = 1e-3 * np.arange(60)
    u = 0.85 * np.sin(2 * np.pi * 12.0 * time) + np.array([[0.15], [-0.15]])
    x0 = rest(models[0], 0.1)
    np.savez(
        folder / "in.npz",
        base=arrays[0][0],
        on=np.array([a[1] for a in arrays]),
        values=np.array([a[2] for a in arrays]),
        u=u,
        x0=x0,
    )
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "DMPTM_CACHE_DIR": str(folder)}
    subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder / "in.npz"), str(folder / "out.npy")],
        env=environment,
        check=True,
        timeout=300,
    )
    plain = np.load(folder / "out.npy")
    compiled = np.array([march(a, u, x0, 1e-3, substeps=4) for a in arrays])
    return ["none", *CATALOGUE, "all"], plain, compiled


def test_plain_python_gives_the_same_run(runs):
    """Only rounding in exp, sin and cos may differ."""
    names, plain, compiled = runs
    assert np.ptp(compiled[0, :, 0]) > 1e-4  # it moved
    for name, a, b in zip(names, plain, compiled, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)
