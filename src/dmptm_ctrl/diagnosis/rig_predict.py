"""Free run of a diagnosed drive of any shape on a log's inputs, as a table."""

from os import PathLike

import numpy as np
import pandas as pd

from dmptm_ctrl.diagnosis.rig_files import read_rig_model
from dmptm_ctrl.identify.rig_simulate import free_run, readings
from dmptm_ctrl.signals import Log
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.rig_model import RigModel


def predict_rig_file(log: str | PathLike[str], model: str | PathLike[str]) -> pd.DataFrame:
    """Predict a log file with a model file that `diagnose` wrote for a rig file.

    Parameters
    ----------
    log : path
        Needs the columns of the rig's inputs. Those of its sensors give the first position and
        speed where they are there; else the drive starts at zero and at rest.
    model : path

    Returns
    -------
    DataFrame
        As `predict_rig`.

    Raises
    ------
    LogError
        A file that cannot be used; the message says why.
    """
    chain, zeros = read_rig_model(model)
    return predict_rig(chain, chain.rig.read_inputs(log), zeros)


def predict_rig(
    model: RigModel, log: Log, zeros: dict[str, dict[str, float]] | None = None
) -> pd.DataFrame:
    """Predict a log: one row per row of it.

    Parameters
    ----------
    model : RigModel
    log : Log
        Of the model's rig.
    zeros : dict of log to dict of effect key to float, optional
        Shift of the encoder's zero in a log [rad or m]; 0 where none is known.

    Returns
    -------
    DataFrame
        ``time_s``; then each sensor under the name, in the unit and with the sign of its column
        in the logs, without noise; then position and speed of every body in SI, with the unit
        in the name.
    """
    run = free_run(model.shifted((zeros or {}).get(log.name, {})), log)
    columns = {"time_s": log.time}
    for name, values in readings(model, log, run).items():
        sensor = next(s for s in model.rig.sensors if s.name == name)
        columns[sensor.column] = values / (parse_unit(sensor.unit).factor * sensor.sign)
    for body in model.rig.bodies:
        unit = body.angle_unit
        columns.setdefault(f"{body.name}_position_{unit}", run.position(body.name))
        columns.setdefault(f"{body.name}_speed_{unit}_s", run.speed(body.name))
    return pd.DataFrame({key: np.asarray(values) for key, values in columns.items()})
