"""Declared models of geared drives: parameters, linear models, resonances, the baseline.

Names that need python-control load on first use: the simulator does without it.
"""

from importlib import import_module
from typing import Any

from dmptm_ctrl.drive.baseline import baseline_drive
from dmptm_ctrl.drive.errata import ERRATA, Erratum, friction_at_rest, gap_exponent, mesh_stiffness
from dmptm_ctrl.drive.parameters import Drive, Quantity, paper_drive, pinion_inertia, viscous_mean

# module -> names that it defines
_LAZY = {
    "modes": "Modes both_readings closed_form sensitivities solve_modes",
    "nine_dof": "NINE_DOF_DEFAULTS nine_dof_parameters nine_dof_ss nine_dof_train "
    "reduced_pinion_inertia",
    "reduction": "SimplificationCost rigid_equivalent simplification_cost",
    "three_dof": "three_dof_ss three_dof_train",
    "tooth": "Tooth cantilever_stiffness iso_single_stiffness mesh_damping "
    "mesh_damping_as_printed mesh_damping_ratio mesh_torsion pair_stiffness tooth_stiffness",
    "train": "GearTrain Joint",
}
_MODULE_OF = {name: module for module, names in _LAZY.items() for name in names.split()}

__all__ = ["ERRATA", "Drive", "Erratum", "Quantity", "baseline_drive", "friction_at_rest"]
__all__ += ["gap_exponent", "mesh_stiffness", "paper_drive", "pinion_inertia", "viscous_mean"]
__all__ += list(_MODULE_OF)


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_MODULE_OF})
