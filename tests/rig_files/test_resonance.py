"""Two bodies on a belt whose resonance is in the band of the input, simulated by scipy."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lsim

from dmptm_ctrl import diagnose
from dmptm_ctrl.diagnosis.rig_screen import other_scale
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of

J, M, K, D, B_MOTOR, B_SLIDE = 3e-4, 1.6e-3, 8.0, 4e-3, 2e-3, 6e-3
RIG = parse_rig("""
[body.motor]
inertia = "3e-4 kg m^2 ± 20 %"
viscous = "unknown"
[body.slide]
inertia = "1.6e-3 kg m^2 ± 20 %"
viscous = "unknown"
[shaft.belt]
between = ["motor", "slide"]
stiffness = "unknown"
damping = "unknown"
[input.torque]
column = "u"
unit = "N m"
body = "motor"
[sensor.m]
column = "m"
unit = "rad"
body = "motor"
[sensor.s]
column = "s"
unit = "rad"
body = "slide"
[data]
time = "t"
""")
T = 1e-3 * np.arange(4000)
TONES = np.array([0.5, 2.0, 8.0, 14.0, 20.0, 30.0])  # Hz; the slide stands against 11 Hz


def table(seed):
    rng = np.random.default_rng(seed)
    phases = rng.uniform(0.0, 2 * np.pi, TONES.size)
    u = np.array([0.2, 0.16, 0.1, 0.08, 0.08, 0.08]) @ np.sin(
        2 * np.pi * np.outer(TONES, T) + phases[:, None]
    )
    a = [
        [0, 1, 0, 0],
        [-K / J, -(D + B_MOTOR) / J, K / J, D / J],
        [0, 0, 0, 1],
        [K / M, D / M, -K / M, -(D + B_SLIDE) / M],
    ]
    rows = [[1, 0, 0, 0], [0, 0, 1, 0]]
    _, q, _ = lsim((a, [[0], [1 / J], [0], [0]], rows, np.zeros((2, 1))), u, T, interp=False)
    q += 1e-5 * rng.normal(size=q.shape)
    return pd.DataFrame({"t": T, "u": u, "m": q[:, 0], "s": q[:, 1]})


@pytest.mark.long
def test_a_resonance_is_no_other_scale():
    """Motor and slide swing against each other: of one rigid drive that is another inertia."""
    tables = [table(seed) for seed in (0, 1)]
    assert other_scale(RIG, balance_of(RIG, RIG.read(tables)))
    assert diagnose(tables, RIG, jobs=1).warnings == ()
