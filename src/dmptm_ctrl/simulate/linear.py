"""Linear models of the drive about a steady turn under preload."""

import warnings
from collections.abc import Mapping, Sequence

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import root

from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.backlash import mesh_region
from dmptm_ctrl.simulate.blocks import REST_SPEED, SIDES, drive_states, initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import OUTPUTS
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plain import RING, Sites
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import linear_rig

TURN = np.deg2rad(10.0)  # rad/s, a speed of the paper's experiments
PRELOAD = 0.3  # V; holds both meshes closed on opposite flanks at TURN
BALANCED = 1e-6  # rad/s², what may be left of the accelerations
TWIST = 1e-3  # rad, size of a half-gap: scale of the search
BODIES = {"left chain": "chain_l", "right chain": "chain_r", "ring gear": "ring"}


def turning(
    model: Model, *, speed: float = TURN, preload: float = PRELOAD, theta_L: float = 0.0
) -> tuple[Floats, Floats]:
    """Return a steady turn: the state, and the voltages that keep it, at time 0.

    Parameters
    ----------
    model : Model
    speed : float
        Of the ring gear [rad/s]; not 0, where friction leaves the balance open.
    preload : float
        Half the difference of the left and right voltage [V].
    theta_L : float
        Ring-gear angle [rad].

    Returns
    -------
    x0 : (6,) array
        θ3l, θ3r, θL [rad] and their speeds [rad/s].
    u0 : (2,) array [V]

    Raises
    ------
    ValueError
        No such turn: speed 0, or a mesh that would have to stay in its gap.
    """
    if abs(speed) <= REST_SPEED:
        raise ValueError("a steady turn needs a speed; at rest friction leaves the balance open")
    sites = Sites(model)
    omega, way = sites.n2 * speed, 1.0 if speed > 0.0 else -1.0

    def state(z):
        return np.array([*(sites.n2 * theta_L + np.asarray(z)), theta_L, omega, omega, speed])

    def friction(body, theta, rate, carried):
        return way * sites.sliding(body, way, theta, rate, 0.0, carried)

    def drive(side, common, theta):
        volts = sites.drive_voltage(common + (preload, -preload)[side], 0.0, side)
        return sites.motor_torque(volts, sites.n1 * theta, sites.n1 * omega, 0.0, side)

    def unbalanced(unknown):
        common, x0 = unknown[0], state(unknown[1:] * TWIST)
        torques = [sites.mesh_torque(x0[s], omega, theta_L, speed, s) for s in (0, 1)]
        net = [
            drive(s, common, x0[s]) - torques[s] - friction(s, x0[s], omega, torques[s])
            for s in (0, 1)
        ]
        resisting = friction(RING, theta_L, speed, abs(torques[0]) + abs(torques[1]))
        load = sites.load_torque(theta_L, speed, 0.0)
        return np.array([*net, sites.n2 * sum(torques) + load - resisting])

    # Guess: what the bodies resist without effects of load, on the flank that carries it.
    theta = sites.n2 * theta_L
    resisting = friction(RING, theta_L, speed, 0.0) - sites.load_torque(theta_L, speed, 0.0)
    own = [drive(s, 0.0, theta) - friction(s, theta, omega, 0.0) for s in (0, 1)]
    per_volt = sites.n1 * sites.gain
    common = (resisting / sites.n2 - sum(own)) / (2.0 * per_volt)
    guess = [common]
    for s in (0, 1):
        z, _, law = sites.mesh(theta, omega, theta_L, speed, s)
        torque = own[s] + per_volt * common
        flank = np.copysign(law.half_gap, torque) + torque / law.stiffness
        guess.append((flank - z) / TWIST)
    found = root(unbalanced, guess, tol=1e-13)
    x0 = state(found.x[1:] * TWIST)
    closed = all(mesh_region(*sites.mesh(x0[s], omega, theta_L, speed, s)) for s in (0, 1))
    if np.max(np.abs(unbalanced(found.x))) > BALANCED or not closed:
        raise ValueError(
            f"no steady turn at {speed:.4g} rad/s with a preload of {preload:.4g} V was found "
            "with both meshes closed; try another preload or speed"
        )
    return x0, found.x[0] + np.array([preload, -preload])


def linearize(
    model: Model | RigModel | Rig,
    x0: ArrayLike | Mapping[str, float] | None = None,
    u0: ArrayLike | None = None,
    *,
    outputs: Sequence[str] | None = None,
) -> ct.StateSpace:
    """Return the linear model of a drive about a state.

    Parameters
    ----------
    model : Model, RigModel or Rig
        Of a rig of any shape: :func:`~dmptm_ctrl.simulate.rig_run.linear_rig`.
    x0 : (6,) array, optional
        θ3l, θ3r, θL [rad] and their speeds [rad/s]; by default :func:`turning`. Of a rig of
        any shape a mapping of body to position [rad or m], by default 0.
    u0 : (2,) array, optional [V]
        Of a dual-motor model only.
    outputs : sequence of str, optional
        Of :data:`~dmptm_ctrl.simulate.compiled.OUTPUTS`, by default ``omega_L``; of a rig of any
        shape its sensors, by default all.

    Returns
    -------
    StateSpace
        Signals and states named as in :func:`~dmptm_ctrl.simulate.blocks.to_blocks`. With
        both meshes closed, everything moving and no further effects it is the 3-DOF model
        of paper Eq. 17 with the slope of the friction as damping. Where nothing depends on the
        angle of the whole drive and no output is an angle, ``twist_l`` and ``twist_r`` [rad at
        the pinion] take the place of three angles; so ``dcgain``, ``margin`` and ``step_info``
        are right as they come.

    Raises
    ------
    ValueError
        An output that does not exist; voltages for a rig of any shape.

    Warns
    -----
    UserWarning
        A mesh is in its gap, where it has no stiffness and the model poles at the origin;
        or a body is held by friction, where it does not move at all.
    """
    if not isinstance(model, Model):
        if u0 is not None or not isinstance(x0, Mapping | None):
            raise ValueError(
                "a rig of any shape is linearised at x0, a mapping of body to position"
            )
        chain = RigModel(model) if isinstance(model, Rig) else model
        return linear_rig(chain, outputs=outputs, position=x0)
    outputs = ("omega_L",) if outputs is None else outputs
    for name in outputs:
        if name not in OUTPUTS:
            raise ValueError(f"no output {name!r}; there are {', '.join(OUTPUTS)}")
    if x0 is None:
        x0, volts = turning(model)
    else:
        x0, volts = np.asarray(x0, float), np.zeros(2)
    if u0 is not None:
        volts = np.asarray(u0, float)
    sites = Sites(model)
    for side, s in enumerate(("left", "right")):
        z, z_rate, law = sites.mesh(x0[side], x0[3 + side], x0[2], x0[5], side)
        if mesh_region(z, z_rate, law) == 0.0:
            warnings.warn(
                f"the {s} mesh is in its gap (z = {z:.3g} rad, half-gap {law.half_gap:.3g} rad): "
                "linearised there it has no stiffness, and the model poles at the origin; "
                "linearise under preload, as `turning` does",
                UserWarning,
                stacklevel=2,
            )
    sys = to_blocks(model)
    state = _sustained(model, sites, initial_state(model, sys, x0), sys.state_labels, volts)
    linear = sys.linearize(state, volts, copy_names=True)
    for name, block in BODIES.items():
        row, column = (sys.state_labels.index(f"{block}_{q}") for q in ("theta", "omega"))
        if linear.A[row, column] == 0.0:
            warnings.warn(
                f"the {name} is held by friction: linearised there it does not move; "
                "linearise about a steady turn, as `turning` gives",
                UserWarning,
                stacklevel=2,
            )
    rows = [linear.output_labels.index(name) for name in outputs]
    a, b, c, d = linear.A, linear.B, linear.C[rows], linear.D[rows]
    labels = list(linear.state_labels)
    if _turns_freely(model) and not any(name.startswith("theta_") for name in outputs):
        a, b, c, labels = _without_angle(a, b, c, labels, model.drive["N_2"])
    return ct.ss(
        a, b, c, d, states=labels, inputs=linear.input_labels, outputs=list(outputs),
        name="drive_linear",
    )  # fmt: skip


def _turns_freely(model: Model) -> bool:
    """Whether nothing in a model depends on the angle of the whole drive."""
    acting = (
        CATALOGUE[name]
        for name, values in model.effects.items()
        if any(values.get(a, 0.0) != 0.0 for a in CATALOGUE[name].amplitudes)
    )
    by_angle = any("theta" in x for effect in acting for x in effect.depends_on)
    return model.drive["k_a"] == 0.0 and not by_angle


def _without_angle(
    a: Floats, b: Floats, c: Floats, labels: list[str], n2: float
) -> tuple[Floats, Floats, Floats, list[str]]:
    """Count the angles of the chains from the ring gear's, and leave that one out.

    By the structure of the drive nothing depends on the turn of all bodies together; the
    columns of differences that would say so are rounding.
    """
    size = len(labels)
    ring = labels.index("ring_theta")
    new = np.eye(size)  # new states over old ones
    for i, label in enumerate(labels):
        if label.startswith("chain_") and "_theta" in label:
            new[i, ring] = -n2
    old = 2.0 * np.eye(size) - new  # its inverse: the ring gear's angle is added again
    keep = [i for i in range(size) if i != ring]
    named = {f"chain_{s}_theta": f"twist_{s}" for s in SIDES}
    return (
        (new @ a @ old)[np.ix_(keep, keep)],
        (new @ b)[keep],
        (c @ old)[:, keep],
        [named.get(labels[i], labels[i]) for i in keep],
    )


def _sustained(model: Model, sites: Sites, state: Floats, labels: list[str], u0: Floats) -> Floats:
    """Return the state with voltages and presliding torques as if they had lasted for long."""
    new = dict(zip(labels, state, strict=True))
    ring = new["ring_theta"], new["ring_omega"]
    meshes = []
    for side, s in enumerate(SIDES):
        new.update(drive_states(model, side, u0[side]))
        pinion = new[f"chain_{s}_theta"], new[f"chain_{s}_omega"]
        meshes.append(sites.mesh_torque(*pinion, *ring, side))
        _preload_bristle(new, sites, f"chain_{s}", side, meshes[side])
    _preload_bristle(new, sites, "ring", RING, abs(meshes[0]) + abs(meshes[1]))
    return np.array([new[label] for label in labels])


def _preload_bristle(
    state: dict[str, float], sites: Sites, block: str, body: int, carried: float
) -> None:
    if sites.distances[body] > 0.0:
        theta, omega = state[f"{block}_theta"], state[f"{block}_omega"]
        way = float(np.sign(omega))
        given = way, theta, omega, 0.0, carried
        held = sites.sliding(body, *given) - sites.at_once(body, *given)
        state[f"friction_{'L' if body == RING else SIDES[body]}_friction"] = way * held
