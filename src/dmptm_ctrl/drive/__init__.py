"""Declared models of geared drives: parameters, linear models, resonances, the baseline.

Names that need python-control load on first use: the simulator does without it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dmptm_ctrl.drive.baseline import baseline_drive
from dmptm_ctrl.drive.errata import ERRATA, Erratum, friction_at_rest, gap_exponent, mesh_stiffness
from dmptm_ctrl.drive.parameters import (
    Drive,
    Quantity,
    paper_drive,
    pinion_inertia,
    viscous_mean,
)

# public name -> module that defines it
_LAZY = {
    "Modes": "modes",
    "both_readings": "modes",
    "closed_form": "modes",
    "determinant": "modes",
    "sensitivities": "modes",
    "solve_modes": "modes",
    "NINE_DOF_DEFAULTS": "nine_dof",
    "nine_dof_parameters": "nine_dof",
    "nine_dof_ss": "nine_dof",
    "nine_dof_train": "nine_dof",
    "reduced_pinion_inertia": "nine_dof",
    "SimplificationCost": "reduction",
    "rigid_equivalent": "reduction",
    "simplification_cost": "reduction",
    "three_dof_ss": "three_dof",
    "three_dof_train": "three_dof",
    "Tooth": "tooth",
    "cantilever_stiffness": "tooth",
    "iso_single_stiffness": "tooth",
    "mesh_damping": "tooth",
    "mesh_damping_as_printed": "tooth",
    "mesh_damping_ratio": "tooth",
    "mesh_torsion": "tooth",
    "pair_stiffness": "tooth",
    "tooth_stiffness": "tooth",
    "GearTrain": "train",
    "Joint": "train",
}

__all__ = [
    "ERRATA",
    "NINE_DOF_DEFAULTS",
    "Drive",
    "Erratum",
    "GearTrain",
    "Joint",
    "Modes",
    "Quantity",
    "SimplificationCost",
    "Tooth",
    "baseline_drive",
    "both_readings",
    "cantilever_stiffness",
    "closed_form",
    "determinant",
    "friction_at_rest",
    "gap_exponent",
    "iso_single_stiffness",
    "mesh_damping",
    "mesh_damping_as_printed",
    "mesh_damping_ratio",
    "mesh_stiffness",
    "mesh_torsion",
    "nine_dof_parameters",
    "nine_dof_ss",
    "nine_dof_train",
    "pair_stiffness",
    "paper_drive",
    "pinion_inertia",
    "reduced_pinion_inertia",
    "rigid_equivalent",
    "sensitivities",
    "simplification_cost",
    "solve_modes",
    "three_dof_ss",
    "three_dof_train",
    "tooth_stiffness",
    "viscous_mean",
]

if TYPE_CHECKING:
    from dmptm_ctrl.drive.modes import (
        Modes,
        both_readings,
        closed_form,
        determinant,
        sensitivities,
        solve_modes,
    )
    from dmptm_ctrl.drive.nine_dof import (
        NINE_DOF_DEFAULTS,
        nine_dof_parameters,
        nine_dof_ss,
        nine_dof_train,
        reduced_pinion_inertia,
    )
    from dmptm_ctrl.drive.reduction import (
        SimplificationCost,
        rigid_equivalent,
        simplification_cost,
    )
    from dmptm_ctrl.drive.three_dof import (
        three_dof_ss,
        three_dof_train,
    )
    from dmptm_ctrl.drive.tooth import (
        Tooth,
        cantilever_stiffness,
        iso_single_stiffness,
        mesh_damping,
        mesh_damping_as_printed,
        mesh_damping_ratio,
        mesh_torsion,
        pair_stiffness,
        tooth_stiffness,
    )
    from dmptm_ctrl.drive.train import (
        GearTrain,
        Joint,
    )


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})
