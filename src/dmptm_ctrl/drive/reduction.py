"""What the paper's simplification costs: 3-DOF and balanced reduction against the 9-DOF."""

from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import ArrayLike, NDArray

from dmptm_ctrl.drive.nine_dof import nine_dof_parameters, nine_dof_train, reduced_pinion_inertia
from dmptm_ctrl.drive.parameters import Drive, paper_drive
from dmptm_ctrl.drive.three_dof import three_dof_train
from dmptm_ctrl.drive.train import GearTrain

# Everything the rig measures: speeds of ring gear and motors.
OUTPUTS = ("omega_L", "omega_ml", "omega_mr")


def rigid_equivalent(drive: Drive, parameters: dict[str, float]) -> Drive:
    """Return the drive whose 3-DOF model has the corrected J̄3 of 9-DOF parameters [SI]."""
    n1 = drive["N_1"]
    own = [parameters[key] for key in ("J_1", "J_2", "J_3")]
    total = reduced_pinion_inertia(n1, drive["J_m"], *own)
    return drive.with_values(J_2=total - n1**2 * drive["J_m"])


class SimplificationCost(NamedTuple):
    """9-DOF model, its two simplifications of one order, and their errors.

    Outputs are scaled to the ring gear's speed: motor speeds are divided by N1 N2.
    """

    full: ct.StateSpace
    three_dof: ct.StateSpace
    balanced: ct.StateSpace
    h_inf: dict[str, float]  # (rad/s)/V, "full", "three_dof", "balanced": of the error
    h_2: dict[str, float]

    def error_over(self, omega: ArrayLike) -> dict[str, NDArray[np.float64]]:
        """Largest singular value of each error over frequency [rad/s], (n,) each."""
        full, three, other = (
            np.moveaxis(model(1j * np.asarray(omega)), -1, 0)
            for model in (self.full, self.three_dof, self.balanced)
        )
        errors = {"full": full, "three_dof": full - three, "balanced": full - other}
        return {name: np.linalg.norm(e, 2, axis=(1, 2)) for name, e in errors.items()}


def simplification_cost(drive: Drive | None = None, **overrides: float) -> SimplificationCost:
    """Return the 3-DOF model beside a balanced truncation of the same order.

    From both motor voltages to the speeds of ring gear and motors. The rigid angle is left
    out (2n − 1 states): with viscous friction the speeds are stable and both norms finite.
    Overrides are 9-DOF parameters; the numbers depend on them, and their defaults are ours.
    """
    drive = paper_drive() if drive is None else drive
    p = nine_dof_parameters(drive, **overrides)
    scale = np.array([1.0, *[1.0 / (drive["N_1"] * drive["N_2"])] * 2])
    full = _balanced_units(nine_dof_train(drive, **p), scale)
    three = _balanced_units(three_dof_train(rigid_equivalent(drive, p)), scale)
    balanced = ct.balred(full, three.nstates, method="truncate")
    errors = {"full": full, "three_dof": full - three, "balanced": full - balanced}
    h_inf, h_2 = ({n: float(ct.norm(e, p)) for n, e in errors.items()} for p in ("inf", 2))
    return SimplificationCost(full, three, balanced, h_inf, h_2)


def _balanced_units(train: GearTrain, scale: NDArray[np.float64]) -> ct.StateSpace:
    """Speeds with `scale`d outputs, and states in √J: in other units Gramians lose digits."""
    system = train.to_ss(outputs=OUTPUTS)
    compliance = [1.0 / j.stiffness for j in train.joints]
    energy = np.sqrt(np.concatenate([compliance, train.inertia]))
    return ct.ss(
        energy[:, None] * system.A / energy,
        energy[:, None] * system.B,
        scale[:, None] * system.C / energy,
        system.D,
        states=[f"energy_{name}" for name in system.state_labels],
        inputs=system.input_labels,
        outputs=system.output_labels,
        name=train.name,
    )
