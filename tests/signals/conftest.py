import numpy as np
import pytest

RATIO = 206.25  # motor turns per ring-gear turn of the paper's rig


@pytest.fixture
def columns():
    """A consistent run of the paper's rig as a logger prints it: 2 s at 1 kHz."""
    time = np.arange(2000) * 1e-3
    rate = 2 * np.pi * 0.5
    angle = 10 * np.sin(rate * time)  # deg
    speed = 10 * rate * np.cos(rate * time)  # deg/s
    volts = 0.1 * np.sign(speed) + 0.02 * speed
    return {
        "time_s": time,
        "u_left_V": volts,
        "u_right_V": volts,
        "theta_L_deg": angle,
        "omega_L_deg_s": speed,
        "theta_ml_deg": RATIO * angle,
        "theta_mr_deg": RATIO * angle,
    }


@pytest.fixture
def write_csv(tmp_path):
    """Write columns (or lines of text) to a CSV file and give its path."""

    def write(content, name="run.csv"):
        path = tmp_path / name
        if isinstance(content, dict):
            rows = [",".join(content)]
            for row in zip(*content.values(), strict=True):
                rows.append(",".join(f"{value:.9g}" for value in row))
            content = "\n".join(rows) + "\n"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write
