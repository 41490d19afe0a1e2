"""The linear model of every drive: bodies joined by springs and dampers, as a control.StateSpace.

Each joint (shaft or mesh) has a twist bᵀq and adds the rank-one blocks k b bᵀ and d b bᵀ
to stiffness and damping, so that M q̈ + D q̇ + K q = E T (paper Eqs. 1 to 18).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite
from typing import NamedTuple

import control as ct
import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.drive.parameters import physical
from dmptm_ctrl.drive.state_space import StateSpace

Floats = NDArray[np.float64]

INPUTS = {"voltage": ("u_left", "u_right"), "torque": ("T_left", "T_right")}


class Joint(NamedTuple):
    """A shaft or a mesh."""

    name: str  # of its torque as an output
    row: Floats  # b, (n,); the twist bᵀq is an angle [rad], or a length [m] for a mesh of radii
    stiffness: float  # per unit of twist: N·m/rad or N/m
    damping: float
    lever: float = 1.0  # torque reported per joint force: 1, or the radius [m] at the body


@dataclass(frozen=True)
class GearTrain:
    """Bodies, joints and motors of a linear drive.

    ValueError for an inertia that is not positive, a stiffness or damping that is negative, a
    number that is not finite.
    """

    name: str
    bodies: tuple[str, ...]  # names of the n coordinates
    inertia: Floats  # (n,) kg·m²
    viscous: Floats  # (n,) N·m·s/rad
    joints: tuple[Joint, ...]
    drives: Floats  # (n, m), torque on each body per N·m of the motors, or unit of signal
    torque_per_volt: float  # N·m/V, K_d K_M, Eq. 3
    # (n,) each, angles that are no coordinate, such as the motors of a rigid reducer
    readouts: dict[str, Floats] = field(default_factory=dict)
    ground: Floats | float = 0.0  # (n,) N·m/rad, stiffness that holds each coordinate itself
    lags: Floats | float = 0.0  # (m,) s, of each motor; 0 is none
    labels: tuple[str, ...] = ()  # of the inputs; by default those of two motors
    motion: tuple[str, str] = ("theta", "omega")  # what names of angles and of speeds begin with
    # outputs of other names: which of `motion` they are, and of which turn, (n,)
    sensors: Mapping[str, tuple[str, Floats]] = field(default_factory=dict)
    base: int = -1  # the coordinate whose angle is that of the whole train

    def __post_init__(self) -> None:
        for body, inertia, viscous in zip(self.bodies, self.inertia, self.viscous, strict=True):
            physical(f"{self.name}: inertia of {body}", inertia, "kg·m²")
            if not isfinite(viscous):  # as the slope of friction at a speed it can be negative
                raise ValueError(f"{self.name}: viscous friction of {body} must be finite")
        for joint in self.joints:
            physical(f"{self.name}: stiffness of joint {joint.name}", joint.stiffness, zero=True)
            physical(f"{self.name}: damping of joint {joint.name}", joint.damping, zero=True)

    @property
    def mass(self) -> Floats:
        """M, (n, n) [kg·m²]."""
        return np.diag(self.inertia)

    @property
    def stiffness(self) -> Floats:
        """K, (n, n) [N·m/rad]: what holds coordinates and the sum of k b bᵀ."""
        held = np.diag(self.ground + np.zeros(len(self.bodies)))
        return sum((j.stiffness * np.outer(j.row, j.row) for j in self.joints), held)

    @property
    def damping(self) -> Floats:
        """D, (n, n) [N·m·s/rad]: viscous friction and the sum of d b bᵀ."""
        blocks = (j.damping * np.outer(j.row, j.row) for j in self.joints)
        return sum(blocks, np.diag(self.viscous))

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of everything that can be an output of :meth:`to_ss`."""
        angles = (*self.bodies, *self.readouts)
        moving = (f"{kind}_{a}" for kind in self.motion for a in angles)
        return (*self.sensors, *moving, *(j.name for j in self.joints))

    def to_ss(
        self,
        *,
        inputs: str = "voltage",
        outputs: Sequence[str] = ("omega_L",),
        states: str = "twists",
    ) -> ct.StateSpace:
        """Return the train as a state-space system.

        Inputs are motor "voltage" [V] or "torque" at the motor shafts [N·m]. Outputs are angles
        [rad], speeds [rad/s], joint torques [N·m], see :attr:`outputs`. States are "twists", with
        speeds, and the angle of the base only where an output is an angle; or all "angles" and
        speeds. A twist is counted as the torque [N·m] (force [N] at a mesh of radii) that its
        spring makes of it. Without that angle, which no speed or torque depends on, ``dcgain``,
        ``margin`` and ``bandwidth`` are right as they come. A train that something
        holds has its angles in any case. ValueError for a kind or output that does not exist, and
        for twists of joints that are not one less than the bodies.
        """
        a, b, c = self.matrices(inputs=inputs, outputs=outputs, states=states)
        names = self._positions(outputs, states)[3]
        labels = list(self.labels or INPUTS[inputs])
        late = [labels[j] for j in np.flatnonzero(self.lags)]
        speeds = (f"{self.motion[1]}_{body}" for body in self.bodies)
        return StateSpace(
            a, b, c, np.zeros((len(outputs), len(labels))),
            states=[*names, *speeds, *(f"lag_{name}" for name in late)],
            inputs=labels, outputs=list(outputs), name=self.name,
        )  # fmt: skip

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
        rate, springs, angles, _ = self._positions(outputs, states)
        force = self._rows().T @ springs
        if np.any(self.ground):
            force += np.reshape(self.ground, (-1, 1)) * angles
        (m, n), solve = rate.shape, 1.0 / self.inertia[:, None]
        gain = self.torque_per_volt if inputs == "voltage" else 1.0
        push = gain * solve * self.drives
        a = np.block([[np.zeros((m, m)), rate], [-solve * force, -solve * self.damping]])
        b = np.vstack([np.zeros((m, push.shape[1])), push])
        seen = [self._output_row(name, angles, springs) for name in outputs]
        c = np.reshape(seen, (len(outputs), m + n))
        late = np.flatnonzero(self.lags)
        if late.size:
            slow = 1.0 / np.atleast_1d(self.lags)[late]
            through = np.eye(push.shape[1])[late]
            a = np.block([[a, b[:, late]], [np.zeros((late.size, m + n)), -np.diag(slow)]])
            b[:, late] = 0.0
            b = np.vstack([b, slow[:, None] * through])
            c = np.hstack([c, np.zeros((len(outputs), late.size))])
        return a, b, c

    def _rows(self) -> Floats:
        """Twists of joints over the coordinates."""
        return np.reshape([j.row for j in self.joints], (len(self.joints), len(self.bodies)))

    def _positions(
        self, outputs: Sequence[str], states: str
    ) -> tuple[Floats, Floats, Floats, list[str]]:
        """Return the states of position: their rates, springs and angles by them, their names."""
        n = len(self.bodies)
        rows = self._rows()
        stiffness = np.array([j.stiffness for j in self.joints])
        angle = any(self._seen(name)[0] == self.motion[0] for name in outputs)
        if states == "angles" or np.any(self.ground) or (angle and not stiffness.all()):
            names = [f"{self.motion[0]}_{body}" for body in self.bodies]
            return np.eye(n), stiffness[:, None] * rows, np.eye(n), names
        if len(rows) != n - 1:
            raise ValueError(
                f"{self.name} has {len(rows)} joints for {n} bodies; twists need one "
                'joint less than bodies: use states="angles"'
            )
        # the base's angle first: python-control then finds its pole at 0 exactly
        base = np.eye(n)[[self.base]]
        angles = np.linalg.inv(np.vstack([base, rows]))
        angles[:, 1:] /= np.where(stiffness > 0.0, stiffness, np.inf)
        rate = np.vstack([base, stiffness[:, None] * rows])
        names = [f"{self.motion[0]}_{self.bodies[self.base]}"]
        names += [f"spring_{joint.name}" for joint in self.joints]
        kept = np.flatnonzero([angle, *(stiffness > 0.0)])
        springs = np.eye(n - 1, n, 1)[:, kept]
        return rate[kept], springs, angles[:, kept], [names[i] for i in kept]

    def _seen(self, name: str) -> tuple[str, Floats]:
        """What an output is of: "" of a joint, or one of `motion`; and its row."""
        if name in self.sensors:
            return self.sensors[name]
        for joint in self.joints:
            if name == joint.name:
                return "", joint.row
        kind, _, body = name.partition("_")
        if kind in self.motion and (body in self.bodies or body in self.readouts):
            return kind, self.angle_row(body)
        raise ValueError(f"no output {name!r} in {self.name}; it has {', '.join(self.outputs)}")

    def _output_row(self, name: str, angles: Floats, springs: Floats) -> Floats:
        kind, row = self._seen(name)
        if kind == self.motion[0]:
            return np.concatenate([row @ angles, np.zeros(row.size)])
        if kind:
            return np.concatenate([np.zeros(angles.shape[1]), row])
        at = [j.name for j in self.joints].index(name)
        joint = self.joints[at]
        return joint.lever * np.concatenate([springs[at], joint.damping * row])

    def angle_row(self, body: str) -> Floats:
        """Row that reads the angle of a body or readout from the coordinates, (n,)."""
        if body in self.bodies:
            return np.eye(len(self.bodies))[self.bodies.index(body)]
        return self.readouts[body]
