"""Read binary logs in a process of its own.

The libraries for MATLAB and MDF files crash on some damaged ones, or write to standard error.
``python -m dmptm_ctrl.signals.subprocess_child FILE`` reads the file and writes what it finds
to its standard output; if it dies, the file is not readable.
"""

import io
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.signals.errors import LogError, NotALogError

MAX_SECONDS = 600


class Signal(NamedTuple):
    """Numbers found in a file."""

    path: tuple[str, ...]  # where in the file, outermost first
    values: Any
    unit: str | None = None
    clock: int = 0  # which time it belongs to, where a file has several
    is_time: bool = False  # the time of a clock [s]


def read_in_subprocess(path: Path) -> tuple[list[Signal], dict[str, Any]]:
    """Signals of a .mat or .mf4 file, and its scalars and texts; LogError if not readable."""
    path.open("rb").close()
    # where the child finds this package, installed or not
    here = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")]
    unreadable = NotALogError(f"{path.name}: not a readable {path.suffix} file, or damaged")
    try:
        child = subprocess.run(
            # -P: no module from the folder that the user happens to be in
            [sys.executable, "-P", "-m", "dmptm_ctrl.signals.subprocess_child", str(path)],
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, here))},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=MAX_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise LogError(f"{path.name}: not read within {MAX_SECONDS} s") from error
    if child.returncode != 0:
        raise unreadable
    with np.load(io.BytesIO(child.stdout), allow_pickle=False) as archive:
        head = json.loads(archive["head"].tobytes())
        if "missing" in head:
            raise LogError(f"{path.name}: {head['missing']}")
        if "damaged" in head:
            raise unreadable
        found = [
            Signal(tuple(where), archive[f"v{i}"], unit, clock, is_time)
            for i, (where, unit, clock, is_time) in enumerate(head["signals"])
        ]
    return found, head["meta"]
