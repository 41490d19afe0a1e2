"""What the command line calls: files in, results out."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from dmptm_ctrl.diagnosis.diagnose import diagnose
from dmptm_ctrl.diagnosis.ladder_diagnose import diagnose_chain
from dmptm_ctrl.diagnosis.ladder_files import is_chain
from dmptm_ctrl.diagnosis.ladder_predict import predict_chain_file
from dmptm_ctrl.diagnosis.predict import predict
from dmptm_ctrl.drive.rig_dual import dual_columns, dual_motor
from dmptm_ctrl.drive.rigfile import load_rig
from dmptm_ctrl.signals import load_log, load_logs
from dmptm_ctrl.simulate.model_file import read_model

SPEED_FORMAT = "%.7g"  # finer than any sensor here


def diagnose_files(
    paths: Sequence[Path], *, rig: Path | None = None, jobs: int = 2, seed: int = 0
) -> Any:
    """Diagnose a folder of logs or log files.

    Raises
    ------
    LogError
        Bad input, in one sentence.
    """
    source = paths[0] if len(paths) == 1 else list(paths)
    if rig is None:
        return diagnose(load_logs(source), jobs=jobs, seed=seed)
    declared = load_rig(rig)
    drive = dual_motor(declared)
    if drive is not None:
        campaign = load_logs(source, dual_columns(declared))
        return diagnose(campaign, drive, jobs=jobs, seed=seed)
    from rich.console import Console

    with Console(stderr=True).status("reading logs") as status:  # nothing where no one watches
        return diagnose_chain(source, declared, jobs=jobs, seed=seed, tell=status.update)


def predict_file(log: Path, model: Path) -> str:
    """Predict a log file with a model file; return the CSV text."""
    if is_chain(model):
        table = predict_chain_file(log, model)
    else:
        table = predict(read_model(model), load_log(log))
    return table.to_csv(index=False, float_format=SPEED_FORMAT, lineterminator="\n")
