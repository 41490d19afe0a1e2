"""The paper's simplified linear model: two pinions and the ring gear, rigid reducers.

    M̄ Ẍ + D̄ Ẋ + K̄ X = Ē T,   X = (θ3l, θ3r, θL)            Eqs. 16 to 18, appendix

Twist of a mesh z = θ3 − N2 θL; positive mesh torque drives the ring gear.
"""

from collections.abc import Sequence

import control as ct
import numpy as np

from dmptm_ctrl.drive.parameters import Drive, paper_drive, pinion_inertia, viscous_mean
from dmptm_ctrl.drive.train import GearTrain, Joint


def three_dof_train(drive: Drive | None = None) -> GearTrain:
    """Return the 3-DOF model of a drive in contact, by default the paper's; see `Drive.check`."""
    drive = paper_drive() if drive is None else drive
    drive.check()
    n1, n2 = drive["N_1"], drive["N_2"]
    j3, d3 = pinion_inertia(drive), viscous_mean(drive, "3")
    meshes = {"tau_l": [1.0, 0.0, -n2], "tau_r": [0.0, 1.0, -n2]}
    return GearTrain(
        name="three_dof",
        bodies=("3l", "3r", "L"),
        inertia=np.array([j3, j3, drive["J_L"]]),
        viscous=np.array([d3, d3, viscous_mean(drive, "L")]),
        joints=tuple(
            Joint(name, np.array(row), drive["k_m"], drive["c"]) for name, row in meshes.items()
        ),
        drives=np.array([[n1, 0.0], [0.0, n1], [0.0, 0.0]]),
        torque_per_volt=drive["K_d"] * drive["K_M"],
        readouts={"ml": np.array([n1, 0.0, 0.0]), "mr": np.array([0.0, n1, 0.0])},
    )


def three_dof_ss(
    drive: Drive | None = None,
    *,
    inputs: str = "voltage",
    outputs: Sequence[str] = ("omega_L",),
    states: str = "twists",
) -> ct.StateSpace:
    """Return the 3-DOF model as a state-space system.

    Parameters
    ----------
    drive : Drive, optional
        Default: the paper's, corrected.
    inputs : {"voltage", "torque"}
        ``u_left, u_right`` [V] or ``T_left, T_right`` [N·m] at the motor shafts.
    outputs : sequence of str
        ``theta_…`` [rad] and ``omega_…`` [rad/s] of 3l, 3r, L, ml, mr; ``tau_l``, ``tau_r``
        [N·m], the mesh torques at the pinions.
    states : {"twists", "angles"}
        With "twists" the states are the torques of the mesh springs and all speeds. The angle
        of the whole drive is a state only where an output is an angle, so ``dcgain`` and
        margins are right as they come. With "angles" they are all angles and speeds.

    Returns
    -------
    StateSpace

    Raises
    ------
    ValueError
        A name that does not exist, or a value that no drive has.

    Notes
    -----
    Paper, Eqs. 16 to 18 and appendix (its R4 is R_L).

    Examples
    --------
    >>> plant = dm.three_dof(dm.paper_drive(), outputs=("omega_L", "tau_l"))
    >>> plant.input_labels, plant.output_labels
    (['u_left', 'u_right'], ['omega_L', 'tau_l'])
    """
    return three_dof_train(drive).to_ss(inputs=inputs, outputs=outputs, states=states)
