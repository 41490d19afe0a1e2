"""Free run of a model on a log's voltages, and the error of it in the band that counts."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy.signal import butter, sosfiltfilt

from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Floats, Model

BANDWIDTH_HZ = 30.0  # above it, rattle that no model predicts sample by sample
ORDER = 4


def free_run(model: Model, log: Log) -> Floats:
    """Run the plant on the log's voltages from its first angle, at rest.

    Returns
    -------
    (n, 8) array
        Columns of `compiled.OUTPUTS`, SI; readings as the sensors would give, no noise.
    """
    u = np.array([log["u_left"], log["u_right"]])
    return march(model.arrays(), u, rest(model, float(log["theta_L"][0])), log.sample_time)


def predict(model: Model, log: Log) -> pd.DataFrame:
    """Predict a log: columns of contract `dmptm predict`, one row per row of the log.

    Parameters
    ----------
    model : Model
    log : Log
        Its voltages and its first angle are used.

    Returns
    -------
    DataFrame
        ``time_s``, angles [deg] and speeds [deg/s] of a free run.
    """
    out = free_run(model, log)
    return pd.DataFrame(
        {
            "time_s": log.time,
            "theta_L_deg": np.rad2deg(out[:, 0]),
            "omega_L_deg_s": np.rad2deg(out[:, 1]),
            "theta_ml_deg": np.rad2deg(out[:, 2]),
            "theta_mr_deg": np.rad2deg(out[:, 3]),
        }
    )


def low_pass(signal: Floats, dt: float) -> Floats:
    """Zero-phase Butterworth low-pass at :data:`BANDWIDTH_HZ`."""
    if 2.0 * BANDWIDTH_HZ * dt >= 1.0:
        return signal
    return np.asarray(sosfiltfilt(butter(ORDER, BANDWIDTH_HZ, fs=1.0 / dt, output="sos"), signal))


def speeds(model: Model, log: Log) -> tuple[Floats, Floats]:
    """Measured and predicted speed below 30 Hz [rad/s]."""
    dt = log.sample_time
    return low_pass(log["omega_L"], dt), low_pass(free_run(model, log)[:, 1], dt)


def speed_error(model: Model, logs: Sequence[Log]) -> dict[str, float]:
    """Error of the predicted speed over all logs together, below 30 Hz.

    Returns
    -------
    dict
        `rmse` [deg/s], `fit_percent` = 100 (1 − NRMSE), `pearson_r`.
    """
    pairs = [speeds(model, log) for log in logs]
    seen = np.concatenate([p[0] for p in pairs])
    run = np.concatenate([p[1] for p in pairs])
    rmse = float(np.sqrt(np.mean((seen - run) ** 2)))
    spread = float(np.std(seen))
    both = spread * float(np.std(run))
    r = float(np.mean((seen - seen.mean()) * (run - run.mean())) / both) if both > 0 else 0.0
    return {
        "rmse": float(np.rad2deg(rmse)),
        "fit_percent": 100.0 * (1.0 - rmse / spread) if spread > 0 else 0.0,
        "pearson_r": r,
    }
