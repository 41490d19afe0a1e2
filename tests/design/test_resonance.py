"""Where the paper's 5.5 Hz comes from (section 4.3.4): not a mode, not the gap."""

import numpy as np
import pytest

from dmptm_ctrl.control.pi import sampled_drive
from dmptm_ctrl.drive import three_dof_ss
from dmptm_ctrl.identify.frequency_response import stepped_sine
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DT = 1e-3
KP, KI = 0.08 / DEG, 6.03 / DEG  # the rig's kp, and the ki that the search finds for 5.5 Hz
HZ = np.geomspace(3.5, 9.0, 25)
DRY = dict.fromkeys([n for n in Model().drive if n[:2] in ("T3", "TL")], 0.0)
CLOSED = {"gap_l": 1e-6, "gap_r": 1e-6}


def closed_loop(model, amplitude):
    found = stepped_sine(model, HZ, amplitude, loop=Loop(KP, KI, 1e3))
    return found.hz, np.abs(found.values)


def peak(model, amplitude):
    hz, gain = closed_loop(model, amplitude)
    k = int(gain.argmax())
    a, b, _ = np.polyfit(np.log(hz[k - 1 : k + 2]), gain[k - 1 : k + 2], 2)
    return float(np.exp(-b / (2 * a))), float(gain[k])


def test_no_mode_is_near():
    """det(K − ω²M) of the 3-DOF model: 0, 60.4 and 230.9 Hz."""
    d = Model().drive
    pinion, n2, k = d["N_1"] ** 2 * d["J_m"] + d["J_2"], d["N_2"], d["k_m"]
    stiffness = k * np.array([[1, 0, -n2], [0, 1, -n2], [-n2, -n2, 2 * n2**2]])
    mass = np.diag([pinion, pinion, d["J_L"]])

    def determinant(hz):
        return np.linalg.det(stiffness / k - (2 * np.pi * hz) ** 2 * mass / k)

    signs = np.sign([determinant(hz) for hz in np.linspace(0.5, 300.0, 3000)])
    crossings = np.linspace(0.5, 300.0, 3000)[np.flatnonzero(np.diff(signs))]
    np.testing.assert_allclose(crossings, [60.4, 230.9], atol=0.15)


def test_without_gap_and_dry_friction_it_is_the_linear_loop():
    """The integral's torque on the whole inertia: amplitude is immaterial."""
    linear = Model().with_values(**DRY, **CLOSED)
    held = sampled_drive(three_dof_ss(linear.drive), DT)
    for amplitude in (5 * DEG, 15 * DEG):
        hz, gain = closed_loop(linear, amplitude)
        z = np.exp(2j * np.pi * hz * DT)
        loop = held(z) * (KP + KI * DT * z / (z - 1))
        np.testing.assert_allclose(gain, np.abs(loop / (1 + loop)), rtol=1e-3)


def test_friction_lowers_it_and_the_gap_hardly_moves_it():
    hz, height = peak(Model().with_values(**DRY, **CLOSED), 10 * DEG)
    gap_hz, gap_height = peak(Model().with_values(**DRY), 10 * DEG)
    dry_hz, dry_height = peak(Model().with_values(**CLOSED), 10 * DEG)
    assert gap_hz == pytest.approx(hz, rel=0.05)
    assert gap_height > 0.9 * height
    assert dry_hz < 0.96 * hz
    assert dry_height < 0.85 * height
    slow_hz, slow_height = peak(Model().with_values(**CLOSED), 5 * DEG)
    assert slow_hz < dry_hz  # dry friction weighs more at small amplitudes
    assert slow_height < dry_height
