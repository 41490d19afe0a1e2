"""The compiled loop against the same text run as plain Python, without numba."""

import os
import pickle
import subprocess
import sys

import numpy as np
import pytest

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model

SCRIPT = """
import pickle, sys
import numpy as np
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compiled import march
assert not hasattr(CATALOGUE["cogging"].kernel, "py_func"), "numba is on"
models, u, x0 = pickle.load(open(sys.argv[1], "rb"))
runs = [march(model, u, x0, 1e-3, substeps=4) for model in models]
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
    time = 1e-3 * np.arange(60)
    u = 0.85 * np.sin(2 * np.pi * 12.0 * time) + np.array([[0.15], [-0.15]])
    x0 = rest(models[0], 0.1)
    (folder / "in").write_bytes(pickle.dumps((models, u, x0)))
    environment = {**os.environ, "NUMBA_DISABLE_JIT": "1", "DMPTM_CACHE_DIR": str(folder)}
    subprocess.run(
        [sys.executable, "-c", SCRIPT, str(folder / "in"), str(folder / "out.npy")],
        env=environment,
        check=True,
        timeout=300,
    )
    plain = np.load(folder / "out.npy")
    compiled = np.array([march(m, u, x0, 1e-3, substeps=4) for m in models])
    return ["none", *CATALOGUE, "all"], plain, compiled


def test_plain_python_gives_the_same_run(runs):
    """Only rounding in exp, sin and cos may differ."""
    names, plain, compiled = runs
    assert np.ptp(compiled[0, :, 0]) > 1e-4  # it moved
    for name, a, b in zip(names, plain, compiled, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9, err_msg=name)
