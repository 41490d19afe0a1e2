"""Logs of real machines; they are not ours to redistribute, so that most checkouts skip this."""

from pathlib import Path

import numpy as np
import pytest

from dmptm_ctrl import load_log, load_logs

REAL = Path(__file__).parents[3] / "shared" / "real"

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason="the measured logs are not here")

BLDC = {
    "Time": "time_s",
    "Position": ("theta", "rad"),
    "Velocity": ("omega", "rad/s"),
    "Iq": ("i", "A"),
}


def test_emps():
    columns = {"t": "time_s", "qm": "q_m", "qg": ("ref", "m"), "vir": "u_V"}
    campaign = load_logs(REAL / "emps", columns)
    assert campaign.names == ("DATA_EMPS", "DATA_EMPS_PULSES")
    assert [len(log) for log in campaign] == [24841, 24841]
    assert campaign.sample_time == pytest.approx(1e-3)
    for log in campaign:
        assert log.meta["gtau"] == pytest.approx(35.15065, rel=1e-6)
        assert log.units == {"q": "m", "ref": "m", "u": "V"}


def test_flexible_coupling_has_no_usable_clock():
    columns = {
        "iq_adx": ("i", "A"),
        "theta_mx": ("theta_motor", "rad"),
        "theta_my": ("theta_load", "rad", -1.0),
    }
    log = load_log(REAL / "flexible_coupling/MultisineTypeA.mat", columns, sample_time=1 / 2500)
    assert len(log) == 50000
    # Well below the antiresonance at 53 Hz both sides turn alike once the sign is mended.
    lines = slice(11 * 20, 16 * 20 + 1)  # 11 to 16 Hz in 20 s
    motor, load = (np.fft.rfft(log[c])[lines] for c in ("theta_motor", "theta_load"))
    assert np.vdot(motor, load) / np.vdot(motor, motor) == pytest.approx(1.0, abs=0.15)


def test_bldc_has_a_jittery_clock():
    path = REAL / "bldc_cogging/acc_current.txt"
    log = load_log(path, BLDC)
    assert any("resampled to even steps of 0.001 s" in warning for warning in log.warnings)
    assert log.sample_time == pytest.approx(1e-3)
    # Published: 0.4 A sine at 2 Hz.
    spectrum = np.abs(np.fft.rfft(log["i"] - log["i"].mean()))
    frequency = np.fft.rfftfreq(len(log), log.sample_time)
    assert frequency[np.argmax(spectrum)] == pytest.approx(2.0, abs=0.05)
