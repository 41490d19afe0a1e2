"""Free run of a model on a log's voltages, and the error of it in the band that counts.

What a run does after many bounces depends on digits of the parameters that nobody knows. The
motion to be expected is the mean of runs that differ in them: it misses least.
"""

from collections.abc import Mapping, Sequence
from os import PathLike

import numpy as np
import pandas as pd

from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.identify.compared_signals import BANDWIDTH_HZ, agreement, low_pass
from dmptm_ctrl.identify.records import RING_COUNT, true_angle
from dmptm_ctrl.identify.rig_simulate import SPREAD, TWINS, readings
from dmptm_ctrl.identify.rig_simulate import free_run as rig_free_run
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.signals import Log, load_log
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.batch import march_any
from dmptm_ctrl.simulate.compiled import FINE_SUBSTEPS, OUTPUTS, march, rest
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.rig_model import RigModel

# channels of the dual-motor drive and columns of a prediction, in the order of OUTPUTS
DUAL_COLUMNS = {
    "theta_L": "theta_L_deg",
    "omega_L": "omega_L_deg_s",
    "theta_ml": "theta_ml_deg",
    "theta_mr": "theta_mr_deg",
}
SPEED = (OUTPUTS.index("omega_L"),)
RUNS = 16
TOGETHER = 100_000  # samples of a log, up to which the runs are held at once: 100 MB


def twin_steps(covariance: Floats) -> list[Floats]:
    """Draw how far the numbers of :data:`TWINS` drives within standard errors are from a fit."""
    rng = np.random.default_rng(0)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return [root @ rng.standard_normal(values.size) for _ in range(TWINS)]


def rms_excess(one: float, other: float) -> float:
    """Root of a difference of squares, not below nothing."""
    return float(np.sqrt(max(one**2 - other**2, 0.0)))


def free_run(
    model: Model, log: Log, *, runs: int = RUNS, columns: Sequence[int] = range(len(OUTPUTS))
) -> Floats:
    """Run the plant on the log's voltages from its first angle, at rest, (n, len(columns)), SI.

    With `runs` of 1 the model's own run; with more the mean of that and of runs with slightly other
    meshes, see :func:`expected`. `columns` are of `compiled.OUTPUTS`; readings are as the sensors
    would give, without noise.
    """
    u = np.array([log["u_left"], log["u_right"]])
    model = model.over(u.shape[1] * log.sample_time)
    x0 = rest(model, true_angle(model, float(log["theta_L"][0])))
    return expected(model, u, x0, log.sample_time, runs=runs, count=RING_COUNT, columns=columns)


def expected(
    model: Model,
    u: Floats,
    x0: Floats,
    dt: float,
    *,
    runs: int = RUNS,
    count: float = 0.0,
    columns: Sequence[int] = range(len(OUTPUTS)),
) -> Floats:
    """Mean of a model's free run and of those with meshes changed by :data:`SPREAD`, SI.

    `u`, (2, n) [V], and `x0`, (6,), are as for :func:`~dmptm_ctrl.simulate.compiled.march`,
    `columns` of `compiled.OUTPUTS`. The ring gear's first angle is rounded to `count` [rad]; the
    other runs begin anywhere in it.
    """
    rng = np.random.default_rng(0)
    shares = 1.0 + SPREAD * rng.standard_normal((runs - 1, 2))
    aside = count * np.concatenate([[0.0], rng.uniform(-0.5, 0.5, runs - 1)])
    starts = x0 + np.multiply.outer(aside, rest(model, 1.0))
    stiffness, damping = model.drive["k_m"], model.drive["c"]
    jogged = (model.with_values(k_m=stiffness * a, c=damping * b) for a, b in shares)
    models = [model, *jogged]
    if runs > 1 and u.shape[1] <= TOGETHER:
        many = march_any(models, u, starts, dt, substeps=FINE_SUBSTEPS, columns=columns)
        return np.asarray(many.mean(axis=0))
    total = march(model, u, starts[0], dt, substeps=FINE_SUBSTEPS)
    for other, start in zip(models[1:], starts[1:], strict=True):
        total += march(other, u, start, dt, substeps=FINE_SUBSTEPS)
    return total[:, [*columns]] / runs


def predict(
    model: Model | RigModel | Rig, log: Log | str | PathLike[str], *, runs: int = RUNS
) -> pd.DataFrame:
    """Predict the sensors of a log from its inputs, one row per row of the log.

    Parameters
    ----------
    model : Model, RigModel or Rig
    log : Log or path of a log file
        Its inputs are used, and its first positions. Sensors of a rig that are not in it start
        at zero and at rest.
    runs : int
        The mean of so many runs with slightly other meshes; 1 keeps the impact chatter of one
        run. Of a rig it is always 1.

    Returns
    -------
    DataFrame
        ``time_s``; angles [deg] and speeds [deg/s] of a free run. Of a rig each sensor under the
        name, in the unit and with the sign of its column in the logs, without noise; then
        position and speed of every body in SI, with the unit in the name.

    Raises
    ------
    LogError
        A log file that cannot be used.

    Examples
    --------
    >>> table = dm.predict(dm.Model(), "log.csv.gz")
    >>> list(table)[:2]
    ['time_s', 'theta_L_deg']
    """
    if isinstance(model, Rig):
        model = RigModel(model)
    return prediction(model, inputs_of(model, log), runs)


def inputs_of(model: Model | RigModel, log: Log | str | PathLike[str]) -> Log:
    """Log of a model's drive; of one by rig file the sensors may be missing."""
    if isinstance(model, RigModel):
        return model.rig.read_inputs(log)
    return log if isinstance(log, Log) else load_log(log)


def prediction(model: Model | RigModel, log: Log, runs: int) -> pd.DataFrame:
    """Predict a log of the model's own channels, see `predict`."""
    if isinstance(model, RigModel):
        return _predict_rig(model, log)
    out = np.rad2deg(free_run(model, log, runs=runs))
    columns = {name: out[:, k] for k, name in enumerate(DUAL_COLUMNS.values())}
    return pd.DataFrame({"time_s": log.time, **columns})


def measured(model: Model | RigModel, log: Log) -> dict[str, Floats]:
    """Columns of a prediction as the log has them, where it has."""
    if not isinstance(model, RigModel):
        return {name: np.rad2deg(log[c]) for c, name in DUAL_COLUMNS.items() if c in log}
    sensors = (s for s in model.rig.sensors if s.channel in log)
    return {s.column: log[s.channel] / (parse_unit(s.unit).factor * s.sign) for s in sensors}


def errors_text(model: Model | RigModel, table: pd.DataFrame, seen: Mapping[str, Floats]) -> str:
    """Return a line per predicted sensor: its unit, and its rms error where the log has it.

    That of the ring gear's speed stands also below the bandwidth of a report's errors.
    `seen` are the columns that the log has, see :func:`measured`.
    """
    units = {
        name: ("deg/s" if name.endswith("_s") else "deg", 1.0) for name in DUAL_COLUMNS.values()
    }
    if isinstance(model, RigModel):  # a scale is part of the factor on a column
        units = {s.column: (s.unit, abs(s.sign)) for s in model.rig.sensors}
    lines = []
    for column, (unit, scale) in units.items():
        text = f"in {unit if scale == 1.0 else f'{scale:.6g} {unit}'}, not in the log"
        if column in seen:
            miss = scale * (table[column].to_numpy() - seen[column])
            text = f"rms error {_rms(miss):.3g} {unit} against the log"
            if column == DUAL_COLUMNS["omega_L"] and not isinstance(model, RigModel):
                step = float(table["time_s"].diff().median())
                text += f", {_rms(low_pass(miss, step)):.3g} below {BANDWIDTH_HZ:.0f} Hz"
        lines.append(f"{column}: {text}")
    return "\n".join(lines)


def _rms(miss: Floats) -> float:
    return float(np.sqrt(np.mean(miss**2)))


def _predict_rig(model: RigModel, log: Log) -> pd.DataFrame:
    run = rig_free_run(model.shifted(model.zeros.get(log.name, {})), log)
    columns = {"time_s": log.time}
    seen = readings(model, log, run)
    for sensor in model.rig.sensors:
        with np.errstate(over="ignore"):  # a model that runs away
            factor = parse_unit(sensor.unit).factor * sensor.sign
            columns[sensor.column] = seen[sensor.name] / factor
    for body in model.rig.bodies:
        unit = body.angle_unit
        columns.setdefault(f"{body.name}_position_{unit}", run.position(body.name))
        columns.setdefault(f"{body.name}_speed_{unit}_s", run.speed(body.name))
    return pd.DataFrame({key: np.asarray(values) for key, values in columns.items()})


def speeds(model: Model, log: Log) -> tuple[Floats, Floats]:
    """Measured and predicted speed below 30 Hz [rad/s]."""
    dt = log.sample_time
    return low_pass(log["omega_L"], dt), low_pass(free_run(model, log, columns=SPEED)[:, 0], dt)


def speed_error(model: Model, logs: Sequence[Log], jobs: int = 1) -> dict[str, float]:
    """Error of the predicted speed over all logs together, below 30 Hz [deg/s]."""
    pairs = in_threads(lambda log: speeds(model, log), logs, jobs, lambda log: log.time.size)
    return agreement([(np.rad2deg(seen), np.rad2deg(run)) for seen, run in pairs])
