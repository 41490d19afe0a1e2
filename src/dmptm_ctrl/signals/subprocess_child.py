"""The process that reads a binary log for `subprocess_reader.read_in_subprocess`."""

import io
import json
import os
import sys
from pathlib import Path

import numpy as np

from dmptm_ctrl.signals import matlab, mdf
from dmptm_ctrl.signals.subprocess_reader import Signal

MAX_BYTES = 16 << 30  # memory of this process; guards against files that unpack endlessly


def _main(path: Path) -> None:
    output = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # whatever a library prints is not our answer
    _limit_memory()
    found: list[Signal] = []
    try:
        reader = matlab if path.suffix.lower() == ".mat" else mdf
        found, meta = reader.find_signals(path)
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
