"""A linear gear train: bodies joined by springs and dampers, as a control.StateSpace.

Each joint (shaft or mesh) has a twist bᵀq and adds the rank-one blocks k b bᵀ and d b bᵀ
to stiffness and damping, so that M q̈ + D q̇ + K q = E T (paper Eqs. 1 to 18).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.drive.parameters import physical

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

    Raises
    ------
    ValueError
        An inertia or stiffness that is not positive, a damping that is negative, a number that
        is not finite.
    """

    name: str
    bodies: tuple[str, ...]
    inertia: Floats
    viscous: Floats
    joints: tuple[Joint, ...]
    drives: Floats
    torque_per_volt: float
    readouts: dict[str, Floats]

    def __post_init__(self) -> None:
        for body, inertia, viscous in zip(self.bodies, self.inertia, self.viscous, strict=True):
            physical(f"{self.name}: inertia of {body}", inertia, "kg·m²")
            if not isfinite(viscous):  # as the slope of friction at a speed it can be negative
                raise ValueError(f"{self.name}: viscous friction of {body} must be finite")
        for joint in self.joints:
            physical(f"{self.name}: stiffness of joint {joint.name}", joint.stiffness)
            physical(f"{self.name}: damping of joint {joint.name}", joint.damping, zero=True)

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
        states: str = "twists",
    ) -> ct.StateSpace:
        """Return the train as a state-space system.

        Parameters
        ----------
        inputs : {"voltage", "torque"}
            Motor voltages [V] or torques at the motor shafts [N·m], left and right.
        outputs : sequence of str
            Of :attr:`outputs`: angles [rad], speeds [rad/s], joint torques [N·m].
        states : {"twists", "angles"}
            The ring gear's angle only where an output is an angle, joint twists, speeds; or
            all angles and speeds. A twist is counted as the torque [N·m] (force [N] at a mesh
            of radii) that its spring makes of it. Without that angle, which no speed or torque
            depends on, ``dcgain``, ``margin``, ``bandwidth`` and ``step_info`` are right as
            they come.

        Raises
        ------
        ValueError
            An input kind, output or state kind that does not exist; twists of joints that are
            not one less than the bodies.
        """
        a, b, c = self.matrices(inputs=inputs, outputs=outputs, states=states)
        names = [f"theta_{body}" for body in self.bodies]
        if states == "twists":
            turns = names[-1:] if _has_angle(outputs) else []
            names = [*turns, *(f"spring_{joint.name}" for joint in self.joints)]
        return ct.ss(
            a,
            b,
            c,
            np.zeros((len(outputs), 2)),
            states=[*names, *(f"omega_{body}" for body in self.bodies)],
            inputs=list(INPUTS[inputs]),
            outputs=list(outputs),
            name=self.name,
        )

    def matrices(
        self,
        *,
        inputs: str = "voltage",
        outputs: Sequence[str] = ("omega_L",),
        states: str = "twists",
    ) -> tuple[Floats, Floats, Floats]:
        """Return A, B and C of :meth:`to_ss` as arrays, for work in loops."""
        if inputs not in INPUTS:
            raise ValueError(f"inputs is {inputs!r}, it must be one of {', '.join(INPUTS)}")
        if states not in ("angles", "twists"):
            raise ValueError(f"states is {states!r}, it must be angles or twists")
        rows = np.array([j.row for j in self.joints])
        stiffness = np.array([j.stiffness for j in self.joints])
        n = len(self.bodies)
        if states == "angles":
            position = angles = np.eye(n)
            springs = stiffness[:, None] * rows
        else:
            if len(self.joints) != n - 1:
                raise ValueError(
                    f"{self.name} has {len(self.joints)} joints for {n} bodies; twists need one "
                    'joint less than bodies: use states="angles"'
                )
            # the ring gear's angle first: python-control then finds its pole at 0 exactly
            k = int(_has_angle(outputs))
            ring = np.eye(n)[n - 1 :]
            position = np.vstack([ring[:k], stiffness[:, None] * rows])
            springs = np.eye(n - 1, n - 1 + k, k)
            angles = np.linalg.inv(np.vstack([ring, rows]))[:, 1 - k :]
            angles[:, k:] /= stiffness
        m = position.shape[0]
        solve = 1.0 / self.inertia[:, None]
        gain = self.torque_per_volt if inputs == "voltage" else 1.0
        a = np.block(
            [[np.zeros((m, m)), position], [-solve * (rows.T @ springs), -solve * self.damping]]
        )
        b = np.vstack([np.zeros((m, 2)), gain * solve * self.drives])
        c = np.array([self._output_row(name, angles, springs) for name in outputs])
        return a, b, c

    def _output_row(self, name: str, angles: Floats, springs: Floats) -> Floats:
        for joint, spring in zip(self.joints, springs, strict=True):
            if name == joint.name:
                return joint.lever * np.concatenate([spring, joint.damping * joint.row])
        kind, _, body = name.partition("_")
        if kind in ("theta", "omega") and (body in self.bodies or body in self.readouts):
            row = self.angle_row(body)
            if kind == "omega":
                return np.concatenate([np.zeros(springs.shape[1]), row])
            return np.concatenate([row @ angles, np.zeros(len(self.bodies))])
        raise ValueError(f"no output {name!r} in {self.name}; it has {', '.join(self.outputs)}")

    def angle_row(self, body: str) -> Floats:
        """Row that reads the angle of a body or readout from the coordinates, (n,)."""
        if body in self.bodies:
            return np.eye(len(self.bodies))[self.bodies.index(body)]
        return self.readouts[body]


def _has_angle(outputs: Sequence[str]) -> bool:
    return any(name.startswith("theta_") for name in outputs)
