"""Read binary logs in a process of its own.

The libraries for MATLAB and MDF files crash on some damaged ones, or write to standard error.
``python -m dmptm_ctrl.signals.apart FILE`` reads the file and writes what it finds to its standard
output; if it dies, the file is not readable.
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

MAX_BYTES = 16 << 30  # memory of the reading process; guards against files that unpack endlessly
MAX_SECONDS = 600


class Signal(NamedTuple):
    """Numbers found in a file."""

    path: tuple[str, ...]  # where in the file, outermost first
    values: Any
    unit: str | None = None
    clock: int = 0  # which time it belongs to, where a file has several
    is_time: bool = False  # the time of a clock [s]


def read_apart(path: Path) -> tuple[list[Signal], dict[str, Any]]:
    """Signals of a .mat or .mf4 file, and its scalars and texts.

    Raises
    ------
    LogError
        Not readable, damaged, a library is not installed, or it takes too long.
    OSError
        Not there, or not allowed.
    """
    path.open("rb").close()
    unreadable = NotALogError(f"{path.name}: not a readable {path.suffix} file, or damaged")
    try:
        child = subprocess.run(
            # -P: no module from the folder that the user happens to be in
            [sys.executable, "-P", "-m", "dmptm_ctrl.signals.apart", str(path)],
            env=os.environ | {"PYTHONPATH": _python_path()},
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


def _python_path() -> str:
    """Where the child finds this package, installed or not."""
    here = str(Path(__file__).parents[2])
    return os.pathsep.join(filter(None, [here, os.environ.get("PYTHONPATH")]))


def _main(path: Path) -> None:
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints is not our answer
    _limit_memory()
    found: list[Signal] = []
    try:
        if path.suffix.lower() == ".mat":
            from dmptm_ctrl.signals.matlab import find_signals
        else:
            from dmptm_ctrl.signals.mdf import find_signals
        found, meta = find_signals(path)
        head = {"signals": [(s.path, s.unit, s.clock, s.is_time) for s in found], "meta": meta}
    except ImportError as error:
        head = {"missing": str(error)}
    except Exception as error:  # the libraries raise what their parsers stumble on
        head = {"damaged": str(error)}
    text = np.frombuffer(json.dumps(head).encode(), np.uint8)
    buffer = io.BytesIO()
    arrays = {f"v{i}": signal.values for i, signal in enumerate(found)}
    np.savez(buffer, allow_pickle=False, head=text, **arrays)
    with output:
        output.write(buffer.getbuffer())


def _limit_memory() -> None:
    try:
        import resource
    except ImportError:  # not on Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    limit = MAX_BYTES if hard == resource.RLIM_INFINITY else min(MAX_BYTES, hard)
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))


if __name__ == "__main__":
    _main(Path(sys.argv[1]))
