"""Exported C made to run on this machine: for a binary, or to try it in a loop."""

import ctypes
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from dmptm_ctrl.export.c_source import c_header, c_source
from dmptm_ctrl.export.program import REAL, WIDE, Program
from dmptm_ctrl.signals import LogError

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC")
_NUMBERS = {"double": ctypes.c_double, "float": ctypes.c_float}


def compiler() -> str | None:
    """Path of the system's C compiler; None where there is none."""
    return next((found for c in COMPILERS if (found := shutil.which(c))), None)


def shared_library(folder: Path, name: str, sources: Mapping[str, str]) -> Path:
    """Compile sources, by their file names, to a library in `folder`; LogError if it fails."""
    found = compiler()
    if found is None:
        raise LogError(f"no C compiler found ({', '.join(COMPILERS)}); install one")
    for key, text in sources.items():
        (folder / key).write_text(text, encoding="ascii")
    ending = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
    library = folder / f"{name}{ending}"
    texts = [str(folder / key) for key in sources if key.endswith(".c")]
    done = subprocess.run(
        [found, *FLAGS, *texts, "-o", str(library), "-lm"], capture_output=True, text=True
    )
    if done.returncode != 0:
        first = (done.stderr.strip().splitlines() or ["no message"])[0]
        raise LogError(f"{found} did not compile {name}: {first}")
    return library


class Compiled:
    """A program compiled from its C, called once per sample.

    ``compiled(*inputs)`` takes one number per input of the program and returns one per output.
    LogError without a C compiler.
    """

    def __init__(self, program: Program, real: str = "double") -> None:
        name, number = program.name, {WIDE: ctypes.c_double, REAL: _NUMBERS[real]}
        sources = {f"{name}.h": c_header(program, real), f"{name}.c": c_source(program, real)}
        self._folder = tempfile.TemporaryDirectory()
        library = ctypes.CDLL(str(shared_library(Path(self._folder.name), name, sources)))
        numbers = len(program.state) + sum(array.size for array, _ in program.arrays)
        self._state = ctypes.create_string_buffer(8 * (numbers + 1))  # none is wider
        self._results = [number[p.kind]() for p in program.outputs]
        self._init = getattr(library, f"{name}_init")
        self._init.argtypes = [ctypes.c_void_p]
        self._step = getattr(library, f"{name}_step")
        given = [number[p.kind] for p in program.inputs]
        pointers = [ctypes.POINTER(number[p.kind]) for p in program.outputs]
        self._step.argtypes = [ctypes.c_void_p, *given, *pointers]
        self._step.restype = None
        self.reset()

    def reset(self) -> None:
        """Start anew."""
        self._init(self._state)

    def peek(self, *inputs: float) -> tuple[float, ...]:
        """Return the outputs of a step that is not kept: a plant's readings before its inputs."""
        before = self._state.raw
        found = self(*inputs)
        self._state.raw = before
        return found

    def __call__(self, *inputs: float) -> tuple[float, ...]:
        self._step(self._state, *inputs, *(ctypes.byref(r) for r in self._results))
        return tuple(r.value for r in self._results)
