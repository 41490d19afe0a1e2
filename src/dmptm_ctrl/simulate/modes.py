"""Resonances of any drive: of the dual-motor drive, and of a rig file."""

import numpy as np

from dmptm_ctrl.drive.modes import Modes, solve_modes
from dmptm_ctrl.drive.parameters import Drive
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.drive.train import GearTrain
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import CONSERVATIVE, linear_train


def modes(model: Drive | GearTrain | Model | Rig | RigModel) -> Modes:
    """Solve the generalised symmetric eigenproblem of a drive.

    Parameters
    ----------
    model : Drive, Model, Rig, RigModel or GearTrain
        A Drive or a Model stands for its 3-DOF model;
        :func:`~dmptm_ctrl.drive.nine_dof.nine_dof_train` makes the 9-DOF one. Of a rig, damping
        that is unknown counts as none, and all angles are 0.

    Returns
    -------
    Modes
        Frequencies [Hz], shapes, damping ratios and classes.

    Raises
    ------
    TypeError
        Another kind of model.
    ValueError
        An inertia or a stiffness of a rig that is unknown.
    """
    if isinstance(model, Rig):
        model = RigModel(model)
    if not isinstance(model, RigModel):
        return solve_modes(model.drive if isinstance(model, Model) else model)
    unknown = [
        key for key, quantity in model.quantities.items()
        if not np.isfinite(model.values.get(key, quantity.value))
        and not key.rpartition(".")[2].startswith(CONSERVATIVE)
    ]  # fmt: skip
    return solve_modes(linear_train(model.with_values(dict.fromkeys(unknown, 0.0))))
