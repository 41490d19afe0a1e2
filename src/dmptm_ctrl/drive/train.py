"""A linear gear train: bodies joined by springs and dampers, as a control.StateSpace.

Each joint (shaft or mesh) has a twist bᵀq and adds the rank-one blocks k b bᵀ and d b bᵀ
to stiffness and damping, so that M q̈ + D q̇ + K q = E T (paper Eqs. 1 to 18).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

INPUTS = {"voltage": ("u_left", "u_right"), "torque": ("T_left", "T_right")}


class Joint(NamedTuple):
    """A shaft or a mesh.

    Attributes
    ----------
    name : str
        Of its torque as an output.
    row : (n,) array
        b; the twist bᵀq is an angle [rad], or a length [m] for a mesh given by radii.
    stiffness, damping : float
        Per unit of twist: N·m/rad and N·m·s/rad, or N/m and N·s/m.
    lever : float
        Torque reported per unit of joint force: 1, or the radius [m] at the reported body.
    """

    name: str
    row: Floats
    stiffness: float
    damping: float
    lever: float = 1.0


@dataclass(frozen=True)
class GearTrain:
    """Bodies, joints and motors of a linear drive.

    Attributes
    ----------
    name : str
    bodies : tuple of str
        Names of the n coordinates, the ring gear "L" last.
    inertia, viscous : (n,) arrays [kg·m²], [N·m·s/rad]
    joints : tuple of Joint
    drives : (n, 2) array
        Torque on each body per N·m of the left and right motor.
    torque_per_volt : float [N·m/V]
        K_d K_M, Eq. 3.
    readouts : mapping of str to (n,) array
        Angles that are no coordinate, such as the motors of a rigid reducer.
    """

    name: str
    bodies: tuple[str, ...]
    inertia: Floats
    viscous: Floats
    joints: tuple[Joint, ...]
    drives: Floats
    torque_per_volt: float
    readouts: dict[str, Floats]

    @property
    def mass(self) -> Floats:
        """M, (n, n) [kg·m²]."""
        return np.diag(self.inertia)

    @property
    def stiffness(self) -> Floats:
        """K, (n, n) [N·m/rad]: the sum of k b bᵀ."""
        return sum((j.stiffness * np.outer(j.row, j.row) for j in self.joints), self._zeros())

    @property
    def damping(self) -> Floats:
        """D, (n, n) [N·m·s/rad]: viscous friction and the sum of d b bᵀ."""
        blocks = (j.damping * np.outer(j.row, j.row) for j in self.joints)
        return sum(blocks, np.diag(self.viscous))

    def _zeros(self) -> Floats:
        return np.zeros((len(self.bodies), len(self.bodies)))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of everything that can be an output of :meth:`to_ss`."""
        angles = (*self.bodies, *self.readouts)
        return (
            *(f"theta_{a}" for a in angles),
            *(f"omega_{a}" for a in angles),
            *(j.name for j in self.joints),
        )

    def to_ss(
        self,
        *,
        inputs: str = "voltage",
        outputs: Sequence[str] = ("omega_L",),
        states: str = "angles",
    ) -> ct.StateSpace:
        """Return the train as a state-space system.

        Parameters
        ----------
        inputs : {"voltage", "torque"}
            Motor voltages [V] or torques at the motor shafts [N·m], left and right.
        outputs : sequence of str
            Of :attr:`outputs`: angles [rad], speeds [rad/s], joint torques [N·m].
        states : {"angles", "twists"}
            Angles and speeds (2n states), or joint twists and speeds (2n − 1, without the
            rigid body's angle, so that norms of stable systems are finite).

        Raises
        ------
        ValueError
            An input kind, output or state kind that does not exist.
        """
        a, b, c = self.matrices(inputs=inputs, outputs=outputs, states=states)
        angles = [f"theta_{body}" for body in self.bodies]
        twists = [f"twist_{joint.name}" for joint in self.joints]
        return ct.ss(
            a,
            b,
            c,
            np.zeros((len(outputs), 2)),
            states=[
                *(angles if states == "angles" else twists),
                *(f"omega_{body}" for body in self.bodies),
            ],
            inputs=list(INPUTS[inputs]),
            outputs=list(outputs),
            name=self.name,
        )

    def matrices(
        self, *, inputs: str = "voltage", outputs: Sequence[str] = ("omega_L",), states: str
    ) -> tuple[Floats, Floats, Floats]:
        """Return A, B and C of :meth:`to_ss` as arrays, for work in loops."""
        if inputs not in INPUTS:
            raise ValueError(f"inputs is {inputs!r}, it must be one of {', '.join(INPUTS)}")
        if states not in ("angles", "twists"):
            raise ValueError(f"states is {states!r}, it must be angles or twists")
        rows = np.array([j.row for j in self.joints])
        position = np.eye(len(self.bodies)) if states == "angles" else rows
        springs = rows if states == "angles" else np.eye(len(self.joints))
        m = position.shape[0]
        pull = rows.T @ (np.array([j.stiffness for j in self.joints])[:, None] * springs)
        solve = 1.0 / self.inertia[:, None]
        gain = self.torque_per_volt if inputs == "voltage" else 1.0
        a = np.block([[np.zeros((m, m)), position], [-solve * pull, -solve * self.damping]])
        b = np.vstack([np.zeros((m, 2)), gain * solve * self.drives])
        c = np.array([self._output_row(name, states, springs) for name in outputs])
        return a, b, c

    def _output_row(self, name: str, states: str, springs: Floats) -> Floats:
        zero = np.zeros(springs.shape[1])
        for joint, spring in zip(self.joints, springs, strict=True):
            if name == joint.name:
                twist, rate = joint.stiffness * spring, joint.damping * joint.row
                return joint.lever * np.concatenate([twist, rate])
        kind, _, body = name.partition("_")
        if kind in ("theta", "omega") and (body in self.bodies or body in self.readouts):
            row = self.angle_row(body)
            if kind == "omega":
                return np.concatenate([zero, row])
            if states == "angles":
                return np.concatenate([row, np.zeros(len(self.bodies))])
            raise ValueError(f"output {name!r}: states='twists' has no absolute angles")
        raise ValueError(f"no output {name!r} in {self.name}; it has {', '.join(self.outputs)}")

    def angle_row(self, body: str) -> Floats:
        """Row that reads the angle of a body or readout from the coordinates, (n,)."""
        if body in self.bodies:
            return np.eye(len(self.bodies))[self.bodies.index(body)]
        return self.readouts[body]
