"""Controllers designed and judged on the nonlinear model; names load on first use."""

from importlib import import_module
from typing import Any

# public name -> module that defines it
_LAZY = {
    "Aims": "tune",
    "Controller": "controller",
    "Duty": "duty",
    "Notch": "controller",
    "boundary": "preload",
    "draw_plants": "draws",
    "limit_cycles": "limit_cycle",
    "monte_carlo": "montecarlo",
    "read_controller": "controller",
    "smallest_preload": "preload",
    "tune_controller": "tune",
    "usual_duty": "duty",
}


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
