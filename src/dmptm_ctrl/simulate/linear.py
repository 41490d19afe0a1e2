"""Linear models: of the paper's drive about a steady turn under preload, of rigs at rest."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import isfinite
from typing import Any

import control as ct
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.optimize import root

from dmptm_ctrl.drive.modes import Modes, solve_modes
from dmptm_ctrl.drive.parameters import Drive
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.drive.state_space import StateSpace, system_name
from dmptm_ctrl.drive.train import GearTrain, Joint
from dmptm_ctrl.effects.backlash import mesh_region, mesh_torque
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.block_parts import PADE_ORDER, Delay
from dmptm_ctrl.simulate.blocks import (
    DUAL,
    REST_SPEED,
    SIDES,
    drive_states,
    initial_state,
    to_blocks,
)
from dmptm_ctrl.simulate.compiled import OUTPUTS
from dmptm_ctrl.simulate.dual import MOTORS, RING
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import link_matrices
from dmptm_ctrl.simulate.rig_model import RigModel

TURN = np.deg2rad(10.0)  # rad/s, a speed of the paper's experiments
PRELOAD = 0.3  # V; holds both meshes closed on opposite flanks at TURN
BALANCED = 1e-6  # rad/s², what may be left of the accelerations
TWIST = 1e-3  # rad, size of a half-gap: scale of the search
STEP = 2.0**-13  # rad or m; of derivatives: far below the shortest tooth or cogging period
ROUNDING = 8.0 * np.finfo(float).eps  # of five values and their arguments
STILL = 1e-6  # of the fastest mode; slower is the rigid one
CONSERVATIVE = ("inertia", "stiffness", "ratio", "gain", "stribeck_speed", "stribeck_exponent")
BODIES = {"left pinion": "pinion_l", "right pinion": "pinion_r", "ring gear": "ring"}


def turning(
    model: Model, *, speed: float = TURN, preload: float = PRELOAD, theta_L: float = 0.0
) -> tuple[Floats, Floats]:
    """Return a steady turn at time 0: the state as of :func:`linearize`, and its voltages [V].

    `speed` [rad/s] and angle [rad] are those of the ring gear; `preload` is half the difference of
    the voltages. ValueError at speed 0, where friction leaves the balance open, and for a mesh
    that would have to stay in its gap.
    """
    if abs(speed) <= REST_SPEED:
        raise ValueError("a steady turn needs a speed; at rest friction leaves the balance open")
    parts = Parts(model.plant())
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    omega, way = n2 * speed, 1.0 if speed > 0.0 else -1.0

    def state(z):
        return np.array([*(n2 * theta_L + np.asarray(z)), theta_L, omega, omega, speed])

    def friction(body, theta, rate, carried):
        return way * parts.sliding(body, way, theta, rate, 0.0, carried, 0.0)[0]

    def drive(side, common, theta):
        volts = parts.signal(side, common + (preload, -preload)[side], 0.0)
        own = parts.torque(MOTORS[side], volts, n1 * theta, n1 * omega, 0.0)
        return n1 * (parts.inputs[side][0] * volts + own)

    def mesh(side, theta):
        return parts.twist(side, theta, omega, theta_L, speed)

    def unbalanced(unknown):
        common, x0 = unknown[0], state(unknown[1:] * TWIST)
        torques = [float(mesh_torque(*mesh(s, x0[s]))) for s in (0, 1)]
        net = [
            drive(s, common, x0[s]) - torques[s] - friction(s, x0[s], omega, torques[s])
            for s in (0, 1)
        ]
        resisting = friction(RING, theta_L, speed, abs(torques[0]) + abs(torques[1]))
        load = parts.torque(RING, 0.0, theta_L, speed, 0.0)
        return np.array([*net, n2 * sum(torques) + load - resisting])

    # Guess: what the bodies resist without effects of load, on the flank that carries it.
    theta = n2 * theta_L
    resisting = friction(RING, theta_L, speed, 0.0) - parts.torque(RING, 0.0, theta_L, speed, 0.0)
    own = [drive(s, 0.0, theta) - friction(s, theta, omega, 0.0) for s in (0, 1)]
    per_volt = n1 * parts.inputs[0][0]
    common = (resisting / n2 - sum(own)) / (2.0 * per_volt)
    guess = [common]
    for s in (0, 1):
        z, _, law = mesh(s, theta)
        torque = own[s] + per_volt * common
        flank = np.copysign(law.half_gap, torque) + torque / law.stiffness
        guess.append((flank - z) / TWIST)
    found = root(unbalanced, guess, tol=1e-13)
    x0 = state(found.x[1:] * TWIST)
    closed = all(mesh_region(*mesh(s, x0[s])) for s in (0, 1))
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

    Of a rig of any shape in contact and at rest: springs and dampers of links, viscous friction,
    current lags, and the derivatives of torques that depend on an angle (cable springs, gravity,
    cogging). Not in it: dry friction, gaps, saturation.

    Parameters
    ----------
    model : Model, RigModel or Rig
    x0 : (6,) array, optional
        θ3l, θ3r, θL [rad] and their speeds [rad/s]; by default :func:`turning`. Of a rig of
        any shape a mapping of body to position [rad or m], by default 0.
    u0 : (2,) array, optional [V]
        Of a dual-motor model only.
    outputs : sequence of str, optional
        As of :func:`~dmptm_ctrl.simulate.simulate`, by default ``omega_L``; of a rig of any
        shape its sensors, by default all, ``q_BODY``, ``v_BODY`` or torques by their link.

    Returns
    -------
    StateSpace
        Signals and states named as in :meth:`~dmptm_ctrl.simulate.model.Model.to_blocks`. With
        both meshes closed, everything moving and no further effects it is the 3-DOF model
        of paper Eq. 17 with the slope of the friction as damping. Where nothing depends on the
        angle of the whole drive, ``twist_l`` and ``twist_r`` [rad at the pinion] take the place
        of two angles, and the third is a state only where an output is an angle; so ``dcgain``,
        ``margin`` and ``bandwidth`` are right as they come. A dead time is a Padé approximation
        of order 4.

        Of a rig of any shape the states are ``q_BODY`` [rad or m] of each rigid group of bodies
        that a torque by angle holds; of a train that turns freely ``spring_LINK``, the torque in
        each link's spring, and one ``q_BODY`` only where an angle is an output; ``v_BODY``;
        ``lag_INPUT``.

    Raises
    ------
    ValueError
        An output or body that does not exist; voltages for a rig of any shape; an inertia or a
        stiffness of it that is unknown, a value that no machine has.

    Warns
    -----
    UserWarning
        A mesh is in its gap, where it has no stiffness and the model poles at the origin;
        or a body is held by friction, where it does not move at all; or friction or damping of
        a rig is declared unknown, and counts as none.

    Examples
    --------
    >>> plant = dm.linearize(dm.Model(dm.paper_drive()), outputs=["omega_L", "torque_l"])
    >>> plant.output_labels
    ['omega_L', 'torque_l']
    """
    if not isinstance(model, Model):
        if u0 is not None or not isinstance(x0, Mapping | None):
            raise ValueError(
                "a rig of any shape is linearised at x0, a mapping of body to position"
            )
        rig, unknown = lossless(RigModel(model) if isinstance(model, Rig) else model)
        said = [f"declared unknown, taken as 0: {', '.join(unknown)}"] if unknown else []
        for text in (*said, *rig.rig.cautions()):
            warnings.warn(text, UserWarning, stacklevel=2)
        train = linear_train(rig, x0)
        return _late(rig, train.to_ss(outputs=[*train.sensors] if outputs is None else outputs))
    outputs = ("omega_L",) if outputs is None else outputs
    for name in outputs:
        if name not in OUTPUTS:
            raise ValueError(f"no output {name!r}; there are {', '.join(OUTPUTS)}")
    if x0 is None:
        x0, volts = turning(model)
    else:
        x0, volts = _shaped("x0", x0, (6,)), np.zeros(2)
    if u0 is not None:
        volts = _shaped("u0", u0, (2,))
    parts = Parts(model.plant())
    for side, s in enumerate(("left", "right")):
        z, z_rate, law = parts.twist(side, x0[side], x0[3 + side], x0[2], x0[5])
        if mesh_region(z, z_rate, law) == 0.0:
            warnings.warn(
                f"the {s} mesh is in its gap (z = {z:.3g} rad, half-gap {law.half_gap:.3g} rad): "
                "linearised there it has no stiffness, and the model poles at the origin; "
                "linearise under preload, as `turning` does",
                UserWarning,
                stacklevel=2,
            )
    sys = to_blocks(model)
    state = _sustained(model, parts, initial_state(model, sys, x0), sys.state_labels, volts)
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
    if _turns_freely(model):
        angles = [name.startswith("theta_") for name in outputs]
        a, b, c, labels = _from_ring(a, b, c, labels, model.drive["N_2"], angles)
    return StateSpace(
        a, b, c, d, states=labels, inputs=linear.input_labels, outputs=list(outputs),
        name="drive_linear",
    )  # fmt: skip


def _shaped(name: str, values: Any, shape: tuple[int]) -> Floats:
    """Return an array of a shape, or say what is wrong with it."""
    if isinstance(values, Mapping) or np.shape(values) != shape:
        given = "a mapping" if isinstance(values, Mapping) else f"of shape {np.shape(values)}"
        raise ValueError(f"{name} of a Model is {given}; it must be an array of shape {shape}")
    array = np.asarray(values, float)
    if not np.isfinite(array).all():
        raise ValueError(f"{name} of a Model has a value that is not finite")
    return array


def _late(model: RigModel, system: ct.StateSpace) -> ct.StateSpace:
    """Put the dead times of inputs and sensors before and behind a linear model."""
    plant = model.plant()
    late = {s.name: float(t) for s, t in zip(model.rig.sensors, plant.sensor_delay, strict=True)}
    dead = [Delay(float(t), PADE_ORDER) for t in plant.input_values[:, 1]]
    behind = [Delay(late.get(name, 0.0), PADE_ORDER) for name in system.output_labels]
    if not any(d.order for d in (*dead, *behind)):
        return system
    names = dict(zip(system.input_labels, dead, strict=True))
    names |= dict(zip(system.output_labels, behind, strict=True))
    own = {name: [f"{s}_{name}" for s in d.states] for name, d in names.items()}
    before, after = (ct.append(*map(Delay.system, each)) for each in (dead, behind))
    states = [x for name in system.input_labels for x in own[name]] + system.state_labels
    states += [x for name in system.output_labels for x in own[name]]
    whole = after * system * before
    # the drive's own states first: python-control then finds a pole at 0 exactly
    order = sorted(range(whole.nstates), key=lambda k: states[k] not in system.state_labels)
    return StateSpace(
        whole.A[np.ix_(order, order)], whole.B[order], whole.C[:, order], whole.D,
        states=[states[k] for k in order], inputs=system.input_labels,
        outputs=system.output_labels, name=system.name,
    )  # fmt: skip


def _turns_freely(model: Model) -> bool:
    """Whether nothing in a model depends on the angle of the whole drive."""
    by_angle = any("theta" in x for effect in model.acting for x in effect.depends_on)
    return model.drive["k_a"] == 0.0 and not by_angle


def _from_ring(
    a: Floats, b: Floats, c: Floats, labels: list[str], n2: float, angles: list[bool]
) -> tuple[Floats, Floats, Floats, list[str]]:
    """Count the angles of the pinions from the ring gear's, which is kept for outputs of angle.

    By the structure of the drive nothing else depends on the turn of all bodies together; the
    columns of differences that would say so are rounding.
    """
    size = len(labels)
    ring = labels.index("ring_theta")
    new = np.eye(size)  # new states over old ones
    for i, label in enumerate(labels):
        if label.endswith("_theta") and i != ring:
            new[i, ring] = -n2
    old = 2.0 * np.eye(size) - new  # its inverse: the ring gear's angle is added again
    # that angle first: python-control then finds its pole at 0 exactly
    keep = [ring] * any(angles) + [i for i in range(size) if i != ring]
    named = {f"pinion_{s}_theta": f"twist_{s}" for s in SIDES}
    turned, seen = new @ a @ old, c @ old
    turned[:, ring], seen[np.logical_not(angles), ring] = 0.0, 0.0
    return (
        turned[np.ix_(keep, keep)],
        (new @ b)[keep],
        seen[:, keep],
        [named.get(labels[i], labels[i]) for i in keep],
    )


def _sustained(model: Model, parts: Parts, state: Floats, labels: list[str], u0: Floats) -> Floats:
    """Return the state with voltages and presliding torques as if they had lasted for long."""
    new = dict(zip(labels, state, strict=True))
    motion = [(new[f"{b}_theta"], new[f"{b}_omega"]) for b in BODIES.values()]
    torques = dict.fromkeys(range(len(parts.ends)), 0.0)  # a reducer's presses on no bearing
    for side in (0, 1):
        new.update(drive_states(model, side, u0[side]))
        twist = parts.twist(side, *motion[side], *motion[RING])
        torques[side] = parts.link_torque(side, *twist)
    for g in range(len(BODIES)):
        if parts.elastic[g] is not None:
            theta, omega = motion[g]
            way = float(np.sign(omega))
            slides = parts.friction(g, way, theta, omega, 0.0, torques, {}, moving=True)
            share = parts.bristle(g)[1]
            new[f"friction_{DUAL.friction[g]}_bristle"] = way * (slides[0] - share * slides[1])
    return np.array([new[label] for label in labels])


def lossless(model: RigModel) -> tuple[RigModel, list[str]]:
    """Return a model whose unknown friction and damping is none, and the keys of these."""
    unknown = [
        key
        for key, quantity in model.quantities.items()
        if np.isnan(model.values.get(key, quantity.value))
        and not key.rpartition(".")[2].startswith(CONSERVATIVE)
    ]
    return model.with_values(dict.fromkeys(unknown, 0.0)), unknown


def linear_train(model: RigModel, position: Mapping[str, float] | None = None) -> GearTrain:
    """Return masses, springs and dampers of a rig in contact at a position [rad or m]."""
    model.check()
    plant, layout = model.plant(), model.layout
    unit = np.eye(layout.coordinates)
    turn = {b: layout.ratio[b] * unit[layout.coordinate[b]] for b in layout.bodies}
    ground, lossy = _slopes(model, position)
    rows, springs, dampers, viscous = link_matrices(plant)
    for effect in model.effects:
        if effect.name == "viscous_friction":
            lossy += turn[effect.on] ** 2 * effect.values["coefficient"]
    joined = zip(layout.links, rows, springs.tolist(), dampers.tolist(), strict=True)
    pushed = [turn[layout.input_body[name]] for name in layout.inputs]
    kinds = {"position": "q", "speed": "v"}
    return GearTrain(
        name=system_name(model.rig.name),
        bodies=tuple(_leads(model)),
        inertia=plant.inertia,
        viscous=viscous + lossy,
        joints=tuple(Joint(*link) for link in joined),
        drives=np.transpose(pushed) * plant.input_values[:, 0],
        torque_per_volt=1.0,
        ground=ground,
        lags=plant.input_values[:, 2],
        labels=layout.inputs,
        motion=("q", "v"),
        sensors={
            s.name: (kinds[s.measures], turn[layout.sensor_body[s.name]]) for s in model.rig.sensors
        },
        base=0,
    )


def _leads(model: RigModel) -> list[str]:
    """Body of each group whose angle is the coordinate itself."""
    coordinate = model.layout.coordinate
    first = {group: body for body, group in reversed(coordinate.items())}
    ones = {g: b for b, g in coordinate.items() if model.layout.ratio[b] == 1.0}
    return [ones.get(g, first[g]) for g in range(model.layout.coordinates)]


def _slopes(model: RigModel, position: Mapping[str, float] | None) -> tuple[Floats, Floats]:
    """Stiffness and damping that effects give each coordinate at rest at `position`."""
    plant, layout = model.plant(), model.layout
    q = np.zeros(layout.coordinates)
    for body, value in (position or {}).items():
        if body not in layout.coordinate:
            bodies = ", ".join(layout.bodies)
            raise ValueError(f"position: no body {body!r} in {model.rig.name}; it has {bodies}")
        if not isfinite(value):
            raise ValueError(f"position of {body} is {value:g}; it must be finite")
        q[layout.coordinate[body]] = value / layout.ratio[body]
    stiffness, damping = np.zeros(q.size), np.zeros(q.size)
    parts = Parts(plant)
    for b, (group, r) in enumerate(zip(parts.group, parts.ratio, strict=True)):
        torque, at = partial(parts.torque, b, 0.0, t=0.0), r * float(q[group])
        stiffness[group] -= r**2 * _slope(lambda x: torque(x, 0.0), at)  # noqa: B023
        damping[group] -= r**2 * _slope(lambda v: torque(at, v), 0.0)  # noqa: B023
    return stiffness, damping


def _slope(function: Callable[[float], float], at: float) -> float:
    """Derivative by five points; of a polynomial to the fourth degree it is exact."""
    values = np.array([function(at + k * STEP) for k in (-2, -1, 1, 2)])
    slope = float(values @ [1.0, -8.0, 8.0, -1.0]) / (12.0 * STEP)
    # of gravity on a level arm nothing is left but rounding, and an angle held by nothing
    return slope if abs(slope) * STEP > ROUNDING * np.abs(values).max() else 0.0


def modes_text(rig: Rig) -> str:
    """Return the modes of a declared rig as a line of text; or what must be known for them."""
    try:
        model, _ = lossless(RigModel(rig))
        train = linear_train(model)
    except ValueError as error:
        return f"modes: not computed; {error.args[0]}"
    except (KeyError, ZeroDivisionError) as error:
        raise LogError(f"{rig.source}: {error.args[0]}") from None
    squares = eigh(train.stiffness, train.mass, eigvals_only=True)
    grounded = np.asarray(train.ground)
    still = STILL**2 * np.abs(squares).max(initial=0.0)
    text = "modes: " + ", ".join(_mode(square, still) for square in squares)
    if grounded.any():
        place = model.layout.coordinate
        by = [e.key for e in model.effects if e.on in place and grounded[place[e.on]]]
        text += f"; linearised with all angles 0, with {', '.join(by)}"
    return text


def _mode(square: float, still: float) -> str:
    if abs(square) <= still:
        return "0 (rigid body)"
    if square < 0.0:
        return f"unstable, grows e-fold in {1.0 / np.sqrt(-square):.3g} s"
    return f"{np.sqrt(square) / (2 * np.pi):.4g} Hz"


def modes(
    model: Drive | GearTrain | Model | Rig | RigModel,
    *,
    position: Mapping[str, float] | None = None,
) -> Modes:
    """Return the modes of a drive, lowest first.

    Parameters
    ----------
    model : Drive, Model, Rig, RigModel or GearTrain
        A Drive or a Model stands for its 3-DOF model;
        :func:`~dmptm_ctrl.drive.nine_dof.nine_dof_train` makes the 9-DOF one. Of a rig, damping
        that is unknown counts as none.
    position : mapping of body to float, optional
        Where torques of a rig that depend on an angle are linearised [rad or m]; 0 for bodies
        not named. A mode that such a torque makes unstable has the frequency 0.

    Returns
    -------
    Modes
        Printed as a table. ``hz``, ``damping_ratios``, ``kinds`` (rigid, antisymmetric, symmetric,
        …), and ``turns``, the shapes over the rigid turn, a column per mode.

    Raises
    ------
    TypeError
        Another kind of model.
    ValueError
        An inertia or a stiffness of a rig that is unknown.

    Examples
    --------
    >>> dm.modes(dm.paper_drive()).hz.round(1)
    array([  0. ,  60.4, 230.9])
    """
    if isinstance(model, Rig):
        model = RigModel(model)
    if not isinstance(model, RigModel):
        return solve_modes(model.drive if isinstance(model, Model) else model)
    return solve_modes(linear_train(lossless(model)[0], position))
