"""What the command line calls: files in, results out."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dmptm_ctrl.diagnosis.diagnose import diagnose_dual
from dmptm_ctrl.diagnosis.predict import RUNS, errors_text, inputs_of, measured, prediction
from dmptm_ctrl.diagnosis.report import Diagnosis
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig
from dmptm_ctrl.diagnosis.screen import READ_ROWS
from dmptm_ctrl.drive import Drive, paper_drive
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.drive.rig_dual import dual_columns, dual_motor
from dmptm_ctrl.drive.rigfile import load_rig
from dmptm_ctrl.signals import Campaign, LogError, load_logs
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.model_file import read_model
from dmptm_ctrl.simulate.rig_model import RigModel

RUNAWAY = 1e3  # times the motion of a log; a model that misses so predicts nothing
SPEED_FORMAT = "%.7g"  # finer than any sensor here
CHUNK_ROWS = 100_000  # text of so many is in memory at once


def diagnose(
    logs: str | PathLike[str] | Iterable[Any],
    rig: Rig | Drive | str | PathLike[str] | None = None,
    *,
    jobs: int = 2,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Diagnosis:
    """Find what a declared drive lacks, and what each part of it is worth.

    Parameters
    ----------
    logs : folder, log files, or Logs of one drive
    rig : rig file, Rig or Drive, optional
        The declared model with its tolerances; the paper's drive by default.
    jobs : int
        Threads. The result does not depend on it.
    seed : int
        Kept in the provenance.
    progress : callable, optional
        Is called with the name of each stage, ``print`` for instance.

    Returns
    -------
    Diagnosis
        `.verdict`, `.effects`, `.budget`, `.summary()`, `.augmented`, `.save(folder)`.

    Raises
    ------
    LogError
        Bad input, in one sentence.

    Examples
    --------
    >>> found = dm.diagnose("logs")
    >>> print(found.summary())
    >>> found.save("result")
    """
    say = progress or (lambda _: None)
    if rig is None or isinstance(rig, Drive):
        given = logs if isinstance(logs, Campaign) else load_logs(logs, max_rows=READ_ROWS)
        return diagnose_dual(given, rig or paper_drive(), jobs, seed, say)
    declared = load_rig(rig) if isinstance(rig, str | PathLike) else rig
    drive = dual_motor(declared)
    if drive is None:
        return diagnose_rig(logs, declared, jobs=jobs, seed=seed, say=say)
    columns = dual_columns(declared)
    left_out: list[str] = []
    read = declared.read(logs, columns=columns, max_rows=READ_ROWS, notes=left_out)
    campaign = Campaign(read, tuple(left_out))
    return diagnose_dual(campaign, drive, jobs, seed, say)


def predict_file(
    log: Path, model: Path, *, single: bool = False, notes: list[str] | None = None
) -> tuple[Iterator[str], str]:
    """Predict a log file with a model file.

    Return the CSV text in parts, and what is in it: units, and errors against the log.

    Parameters
    ----------
    single : bool
        One run instead of the mean of several; that of a drive by rig.toml is one always.
    notes : list
        Gets a sentence about each thing that was mended in the log.
    """
    read = read_model(model)
    given = inputs_of(read, log)
    if notes is not None:
        notes += given.warnings
    if isinstance(read, RigModel):
        try:
            read.plant()
        except ValueError as error:  # something is unknown
            raise LogError(f"{model.name}: {error}") from None
    table = prediction(read, given, 1 if single else RUNS)
    seen = measured(read, given)
    _refuse_runaway(table, model.name, seen)
    return _csv(table), errors_text(read, table, seen)


def _csv(table: pd.DataFrame) -> Iterator[str]:
    for start in range(0, len(table), CHUNK_ROWS):
        part = table.iloc[start : start + CHUNK_ROWS]
        yield part.to_csv(
            index=False, header=start == 0, float_format=SPEED_FORMAT, lineterminator="\n"
        )


def _refuse_runaway(table: pd.DataFrame, model: str, seen: Mapping[str, Floats]) -> None:
    """LogError for a run that ends in no number, or moves a thousand times as far as its log."""
    far = ~np.isfinite(table.to_numpy(float)).all(axis=1)
    for column, values in seen.items():
        moved = np.abs(table[column] - values[0]).to_numpy()
        far |= (moved > RUNAWAY * np.ptp(values)) & (np.ptp(values) > 0.0)
    if far.any():
        at = float(table["time_s"].iloc[int(np.argmax(far))])
        raise LogError(
            f"{model}: the run leaves all motion of the log at {at:.6g} s; a value in the model, "
            "or in the log's inputs, is far from any drive"
        )
