"""The benchmark's loop around a rig is that rig's own loop when the controller is."""

import sys
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[2] / "benchmarks"))

from compensation import GYRO_NOISE, SUBSTEPS, run_on_rig
from rigs.experiments import GAINS
from rigs.plant import record_log

from dmptm_ctrl.design.controller import Controller
from rigs import make_rig

DEG = np.pi / 180


def test_a_plain_pi_gives_the_rigs_own_log():
    rig = make_rig(
        5, effects=[("drive_delay", 1.0), ("sensor_delay", 1.0)], logs=["closed_sine_15"]
    )
    signal = 15.0 * np.sin(2 * np.pi * 1e-3 * np.arange(400))  # deg/s
    noise = GYRO_NOISE * np.random.default_rng(3).standard_normal(signal.size)
    theirs = record_log(rig.record[0], signal, True, GAINS, 0.15, 0.3, noise, SUBSTEPS)
    controller = Controller(GAINS[0] / DEG, GAINS[1] / DEG, preload=0.15, tracking=0.0)
    _, ours = run_on_rig(rig.record, controller, signal * DEG, 0.3, np.random.default_rng(3))
    np.testing.assert_allclose(ours, theirs[:2], atol=1e-9)
