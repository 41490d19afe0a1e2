"""Source text as a module, kept where numba can cache what it compiles."""

import hashlib
import importlib.util
import inspect
import os
import sys
import tempfile
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.simulate import elementary

# one thread writes an engine at a time: where two parse at once Python 3.11.0 to 3.11.7 counts
# their depths together and fails (CPython issue 106905)
LOADING = RLock()
_LOADED: dict[str, ModuleType] = {}


def key_of(text: str, modules: Iterable[ModuleType], effects: Iterable[Effect]) -> str:
    """Hash of a text and of all kernels that it calls."""
    parts = [text, *(inspect.getsource(m) for m in modules)]
    parts += [kernel_text(effect) for effect in effects]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def kernel_text(effect: Effect) -> str:
    """Name of an effect's kernel, and source of the file that it is in."""
    module = sys.modules.get(effect.kernel.__module__)
    file = getattr(module, "__file__", None)
    if not file:
        return cell(effect.kernel)
    return f"{getattr(effect.kernel, '__name__', '')}\0{_file_text(file)}"


@cache
def _file_text(file: str) -> str:
    return Path(file).read_text(encoding="utf-8")


def cell(kernel: object) -> str:
    """Source of a kernel defined in a notebook, or its bytecode where that is not kept."""
    function = getattr(kernel, "py_func", kernel)
    try:
        return inspect.getsource(function)  # type: ignore[arg-type]
    except OSError:
        return repr(function.__code__.co_code)  # type: ignore[attr-defined]


def cache_folder() -> Path:
    """Folder of the compiled engine; a temporary one where nothing can be written."""
    places = [os.environ.get("DMPTM_CACHE_DIR"), os.environ.get("XDG_CACHE_HOME")]
    candidates = [Path(p) / "dmptm_ctrl" for p in places if p]
    candidates.append(Path.home() / ".cache" / "dmptm_ctrl")
    for folder in candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="dmptm_ctrl_"))


@cache
def loops(lanes: int = 16) -> ModuleType:
    """Return `loops.py` as a module of the cache, which knows all that the file uses."""
    text = Path(__file__).with_name("loops.py").read_text(encoding="utf-8")
    text = text.replace("LANES = 16", f"LANES = {lanes}")
    return load(f"loops_{key_of(text, (elementary,), ())}", text, "the loops over samples")


_SAID: set[str] = set()  # of what is compiled


def load(key: str, text: str, what: str = "", **names: Any) -> ModuleType:
    """Return the module of a text, with `names` in it before it runs; each key once."""
    with LOADING:
        if key not in _LOADED:
            _LOADED[key] = _load(key, text, what, names)
        return _LOADED[key]


def _load(key: str, text: str, what: str, names: dict[str, Any]) -> ModuleType:
    file = cache_folder() / f"engine_{key}.py"
    if not file.exists() or file.read_text(encoding="utf-8") != text:
        if what and what not in _SAID and elementary.COMPILED:
            _SAID.add(what)
            sys.stderr.write(f"Compiling {what}, once; some seconds.\n")
            sys.stderr.flush()
        fresh = file.with_suffix(f".{os.getpid()}")
        fresh.write_text(text, encoding="utf-8")
        os.replace(fresh, file)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot load the engine from {file.name}")
    module = importlib.util.module_from_spec(spec)
    module.__dict__.update(names)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module
