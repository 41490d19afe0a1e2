"""Control-design workbench for dual-motor geared servo drives.

Public names load on first use, so that ``import dmptm_ctrl`` stays quick.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# public name -> module that defines it
_LAZY = {
    "Campaign": "dmptm_ctrl.signals",
    "Log": "dmptm_ctrl.signals",
    "LogError": "dmptm_ctrl.signals",
    "load_log": "dmptm_ctrl.signals",
    "load_logs": "dmptm_ctrl.signals",
    "diagnose": "dmptm_ctrl.diagnosis",
}

__all__ = ["Campaign", "Log", "LogError", "__version__", "diagnose", "load_log", "load_logs"]

if TYPE_CHECKING:
    from dmptm_ctrl.diagnosis import diagnose
    from dmptm_ctrl.signals import Campaign, Log, LogError, load_log, load_logs


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(_LAZY[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
