"""Control-design workbench for geared servo drives.

Public names load on first use, so that ``import dmptm_ctrl`` stays quick. ``docs/api.md`` lists
them in groups; ``help()`` on each gives units, shapes and errors.
"""
# ruff: noqa: F401 (type checkers read the imports; at run time names load on first use)

import sys
from functools import wraps
from importlib import import_module
from inspect import Parameter, Signature, isfunction, signature
from types import ModuleType
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

# public name -> "module" or "module:name there", in the groups of docs/api.md
_LAZY = {
    # models
    "paper_drive": "drive.parameters",
    "paper_rig": "drive.rig_dual",
    "baseline": "drive.baseline:baseline_drive",
    "Drive": "drive.parameters",
    "load_rig": "drive.rigfile",
    "Rig": "drive.rig",
    "Model": "simulate.model",
    "read_model": "simulate.model_file",
    "register_effect": "effects:register",
    # linear models
    "three_dof": "drive.three_dof:three_dof_ss",
    "nine_dof": "drive.nine_dof:nine_dof_ss",
    "linearize": "simulate.linear",
    "modes": "simulate.linear",
    "common_mode": "control.pi",
    "close_speed_loop": "control.pi",
    "margins": "control.tuning:assess_pi",
    "bode_compare": "plots.linear",
    "step_compare": "plots.linear",
    "step_info": "drive.state_space",
    # simulation
    "simulate": "simulate",
    "simulate_batch": "simulate.batch",
    "simulate_with_sensitivities": "simulate.sensitivity",
    "close_loop": "simulate.closed",
    "Loop": "simulate.compiled",
    # frequency responses and experiments
    "stepped_sine": "identify.frequency_response",
    "multisine": "identify.frequency_response",
    "response_from_log": "identify.frequency_response:from_log",
    "constant_speed": "identify.experiments_steady",
    # control design
    "tune_pi": "control.tuning",
    "tune_controller": "design.tune",
    "Aims": "design.aims",
    "Controller": "design.controller",
    "read_controller": "design.controller",
    "impact": "design.impact",
    "limit_cycles": "design.limit_cycle",
    "smallest_preload": "design.preload",
    "monte_carlo": "design.montecarlo",
    # logs, diagnosis, and what follows
    "load_log": "signals.loaders",
    "load_logs": "signals.loaders",
    "Log": "signals.log",
    "LogError": "signals.errors",
    "diagnose": "diagnosis.run",
    "Diagnosis": "diagnosis.report",
    "predict": "diagnosis.predict",
    "check": "check.run",
    "export": "export.run:export_file",
    # the paper
    "reproduce": "reproduce.run",
}

# of functions that read logs, whose first argument may be nearly anything
_NO_LOGS = {"Model", "RigModel", "Rig", "Drive", "Diagnosis", "StateSpace", "int", "float"}
_LOGS = ("diagnose", "response_from_log", "load_log", "load_logs")

__all__ = ["__version__", *_LAZY]

if TYPE_CHECKING:
    from dmptm_ctrl.check.run import check
    from dmptm_ctrl.control.pi import close_speed_loop, common_mode
    from dmptm_ctrl.control.tuning import assess_pi as margins
    from dmptm_ctrl.control.tuning import tune_pi
    from dmptm_ctrl.design.aims import Aims
    from dmptm_ctrl.design.controller import Controller, read_controller
    from dmptm_ctrl.design.impact import impact
    from dmptm_ctrl.design.limit_cycle import limit_cycles
    from dmptm_ctrl.design.montecarlo import monte_carlo
    from dmptm_ctrl.design.preload import smallest_preload
    from dmptm_ctrl.design.tune import tune_controller
    from dmptm_ctrl.diagnosis.predict import predict
    from dmptm_ctrl.diagnosis.report import Diagnosis
    from dmptm_ctrl.diagnosis.run import diagnose
    from dmptm_ctrl.drive.baseline import baseline_drive as baseline
    from dmptm_ctrl.drive.nine_dof import nine_dof_ss as nine_dof
    from dmptm_ctrl.drive.parameters import Drive, paper_drive
    from dmptm_ctrl.drive.rig import Rig
    from dmptm_ctrl.drive.rig_dual import paper_rig
    from dmptm_ctrl.drive.rigfile import load_rig
    from dmptm_ctrl.drive.state_space import step_info
    from dmptm_ctrl.drive.three_dof import three_dof_ss as three_dof
    from dmptm_ctrl.effects import register as register_effect
    from dmptm_ctrl.export.run import export_file as export
    from dmptm_ctrl.identify.experiments_steady import constant_speed
    from dmptm_ctrl.identify.frequency_response import from_log as response_from_log
    from dmptm_ctrl.identify.frequency_response import multisine, stepped_sine
    from dmptm_ctrl.plots.linear import bode_compare, step_compare
    from dmptm_ctrl.reproduce.run import reproduce
    from dmptm_ctrl.signals.errors import LogError
    from dmptm_ctrl.signals.loaders import load_log, load_logs
    from dmptm_ctrl.signals.log import Log
    from dmptm_ctrl.simulate import simulate
    from dmptm_ctrl.simulate.batch import simulate_batch
    from dmptm_ctrl.simulate.closed import close_loop
    from dmptm_ctrl.simulate.compiled import Loop
    from dmptm_ctrl.simulate.linear import linearize, modes
    from dmptm_ctrl.simulate.model import Model
    from dmptm_ctrl.simulate.model_file import read_model
    from dmptm_ctrl.simulate.sensitivity import simulate_with_sensitivities


class _Front(ModuleType):
    """A package in which `simulate` stays the function once the subpackage is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (isinstance(value, ModuleType) and name in _LAZY):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Front


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        said = f"module {__name__!r} has no attribute {name!r}"
        raise AttributeError(said, name=name, obj=sys.modules[__name__])  # Python names the nearest
    module, _, there = _LAZY[name].partition(":")
    value = getattr(import_module(f"{__name__}.{module}"), there or name)
    if isfunction(value):
        value = _checked(name, value)
    globals()[name] = value
    return value


def _checked(name: str, function: Any) -> Any:
    """Return the function, with a sentence for wrong arguments and a ``help()`` without types."""
    from dmptm_ctrl.arguments import refuse_wrong_call

    wanted = signature(function)

    @wraps(function)
    def checked(*args: Any, **options: Any) -> Any:
        kind = type(args[0]) if args else object
        if name in _LOGS and _NO_LOGS & {c.__name__ for c in kind.__mro__}:
            raise TypeError(f"{name} takes logs as its first argument, not a {kind.__name__}")
        refuse_wrong_call(name, wanted, args, options)
        return function(*args, **options)

    # ``import dmptm_ctrl.check.run as run`` looks behind the function by its name
    checked.__name__ = f"{__name__}.{name}"
    plain = [p.replace(annotation=Parameter.empty) for p in wanted.parameters.values()]
    checked.__signature__ = Signature(plain)  # type: ignore[attr-defined]
    return checked


def __dir__() -> list[str]:
    return sorted(__all__)
