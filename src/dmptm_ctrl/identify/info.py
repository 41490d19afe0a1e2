"""What is in a log, by its column names or by what a rig file says of them."""

from pathlib import Path

from dmptm_ctrl.signals.info import LogInfo, describe, describe_file


def describe_log(file: Path, rig: Path | None = None) -> LogInfo:
    """Say what is in a log file and what it can and cannot tell.

    Parameters
    ----------
    rig : path of a rig file, optional
        Says what the columns are; else their names do.

    Raises
    ------
    LogError
        A log or a rig file that cannot be used.
    """
    if rig is None:
        return describe_file(file)
    from dmptm_ctrl.drive.rigfile import load_rig
    from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE

    drive = load_rig(rig)
    return describe(
        drive.read(file)[0],
        labels=drive.labels(),
        declared=drive.declared_names(),
        effects=PLACED_CATALOGUE,
        inputs=[source.channel for source in drive.inputs],
    )
