"""k(t) by mesh phase, Eq. 23 put right: the stiffness belongs to the pinion's angle."""

import numpy as np
import pytest

from dmptm_ctrl.drive import mesh_stiffness
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import OUTPUTS

K_A, PHASE = 4e3, 0.4
COLUMN = OUTPUTS.index("torque_l")


@pytest.mark.parametrize("method", ["compiled", "reference", "blocks"])
def test_torque_at_rest_follows_the_pinions_angle(frictionless, method):
    """Two pinion teeth passed in steps of a ninth of a tooth, the same twist everywhere."""
    drive = frictionless.drive
    model = frictionless.with_values(k_a=K_A, phi_r=PHASE)
    twist = 1e-3  # rad beyond the flank
    for tooth in np.arange(0.0, 2.0, 1 / 9):
        ring = tooth * 2 * np.pi / drive["z_3"] / drive["N_2"]
        pinion = drive["N_2"] * ring + drive["gap_l"] + twist
        x0 = np.array([pinion, drive["N_2"] * ring, ring, 0.0, 0.0, 0.0])
        found = simulate(model, np.array([0.0, 1e-3]), np.zeros((2, 2)), x0, method=method)
        k = mesh_stiffness(drive["k_m"], K_A, drive["z_3"], pinion, phase=PHASE)
        assert found.outputs[COLUMN, 0] == pytest.approx(k * twist, rel=1e-9)


def test_a_turn_hears_z3_per_pinion_turn(frictionless):
    """At constant speed the mesh torque under preload is modulated at z3 θ̇3, as printed."""
    drive = frictionless.drive
    model = frictionless.with_values(k_a=2e3)
    dt, speed = 1e-3, 2.0  # s, rad/s of the pinion: 6.4 Hz, far below the modes
    time = dt * np.arange(8001)
    volts = 0.5
    start = np.zeros(6)
    push = drive["N_1"] * drive["K_d"] * drive["K_M"] * volts
    start[:2] = np.array([1.0, -1.0]) * (drive["gap_l"], drive["gap_r"])
    start[:2] += np.array([1.0, -1.0]) * push / drive["k_m"]
    start[3:] = speed, speed, speed / drive["N_2"]
    u = np.tile([[volts], [-volts]], time.size)
    found = simulate(model, time, u, start).outputs[OUTPUTS.index("z_l")]
    spectrum = np.abs(np.fft.rfft((found - found.mean()) * np.hanning(found.size)))
    hz = np.fft.rfftfreq(found.size, dt)
    low = (hz > 1.0) & (hz < 40.0)
    line = hz[low][spectrum[low].argmax()]
    assert line == pytest.approx(drive["z_3"] * speed / (2 * np.pi), abs=0.15)
