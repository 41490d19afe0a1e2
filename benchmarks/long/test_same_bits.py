"""Whether code just compiled and code from the disk give the same runs, to the bit.

A verdict would otherwise depend on whether the package was used before: bounces grow the last bit.
"""

import os
import subprocess
import sys

import numpy as np

SCRIPT = """
import sys
import numpy as np
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import Loop, march, rest
from dmptm_ctrl.simulate.model import Model

models = [Model()]
for name, effect in CATALOGUE.items():
    values = {
        p.name: p.bank[len(p.bank) // 2] if p.bank else p.low + 0.6 * (p.high - p.low)
        for p in effect.parameters
    }
    models.append(Model().with_effect(name, **values))
time = 1e-3 * np.arange(1000)
u = 0.9 * np.sin(2 * np.pi * 1.5 * time) + np.array([[0.15], [-0.15]])
x0 = rest(models[0], 0.1)
alone = [march(one, u, x0, 1e-3) for one in models]
loop = Loop(kp=20.0, ki=60.0, limit=10.0, bias_l=0.4, bias_r=-0.4)
target = np.deg2rad(10.0) * np.sin(np.pi * time)
together = simulate_batch(models, time, target, loop=loop, outputs=("omega_L", "torque_l"))
np.savez(sys.argv[1], alone=alone, together=np.asarray(together.outputs))
"""


def test_compiled_anew_and_from_the_disk(tmp_path):
    places = ("DMPTM_CACHE_DIR", "NUMBA_CACHE_DIR")
    environment = {**os.environ, **dict.fromkeys(places, str(tmp_path))}
    runs = []
    for name in ("anew", "from_the_disk"):
        file = str(tmp_path / f"{name}.npz")
        subprocess.run([sys.executable, "-c", SCRIPT, file], env=environment, check=True)
        runs.append(np.load(file))
    for key in ("alone", "together"):
        anew, again = (run[key] for run in runs)
        assert np.ptp(anew) > 0.0
        np.testing.assert_array_equal(anew, again, err_msg=key)
