"""Simulate chains and branched trains: compiled, linear, and as python-control blocks."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import ceil
from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.drive.parameters import physical
from dmptm_ctrl.drive.rig import Controller, Rig, Sensor
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.observer import Observer
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import ELASTIC_IMPACT, Floats, Plant
from dmptm_ctrl.simulate.rig_control import controller_of
from dmptm_ctrl.simulate.rig_model import RigModel, check_physical, declared_effects
from dmptm_ctrl.simulate.run import Controller as RunController
from dmptm_ctrl.simulate.run import (
    Motion,
    State,
    advance,
    advance_by,
    start_state,
    structure_for,
)

__all__ = [
    "RigRun",
    "declared_effects",
    "linear_rig",
    "march",
    "modes_text",
    "rig_modes",
    "simulate_rig",
    "substeps_for",
]

STEPS_PER_RADIAN = 8.0  # of the fastest mode, and of the fastest decay
MAX_SUBSTEPS = 400
STEP = 2.0**-13  # rad or m; of slopes: far below the shortest tooth or cogging period
_NO_ROWS = np.zeros((0, 0))
STILL = 1e-6  # of the fastest mode; slower is the rigid one
MARCH_OPTIONS = (
    *("position", "speed", "substeps", "given", "controller", "reference", "added", "before"),
    *("push", "state"),
)
CONSERVATIVE = ("inertia", "stiffness", "ratio", "gain", "stribeck_speed", "stribeck_exponent")


def as_rig_model(model: Rig | RigModel, name: str) -> RigModel:
    """Return a rig as a model; anything else is refused in the name of a function."""
    if isinstance(model, Rig):
        return RigModel(model)
    if not isinstance(model, RigModel):
        raise TypeError(f"{name} takes a model first, not a {type(model).__name__}")
    return model


class RigRun:
    """Motion of a chain on a clock.

    Attributes
    ----------
    time : (n,) array [s]
    u : (inputs, n) array
        Signals of the inputs, as the controller gave them where a loop was closed.
    state : State
        From which another run goes on.
    """

    def __init__(self, model: RigModel, time: Floats, motion: Motion) -> None:
        self.model, self.time, self.u = model, time, motion.u
        self.state = motion.state
        self._motion = motion

    def position(self, body: str) -> Floats:
        """Angle [rad] or position [m] of a body, (n,)."""
        layout = self.model.layout
        return layout.ratio[body] * self._motion.q[:, layout.coordinate[body]]

    def speed(self, body: str) -> Floats:
        """Speed of a body [rad/s or m/s], (n,)."""
        layout = self.model.layout
        return layout.ratio[body] * self._motion.v[:, layout.coordinate[body]]

    def link(self, name: str) -> Floats:
        """Torque [N·m] or force of a link at its first body, (n,)."""
        return self._motion.links[:, self.model.layout.links.index(name)]

    def reading(self, sensor: str) -> Floats:
        """What a sensor would read, without noise and quantisation, (n,), SI."""
        names = [s.name for s in self.model.rig.sensors]
        return self._motion.readings[:, names.index(sensor)]


def substeps_for(plant: Plant, dt: float) -> int:
    """Substeps per sample that resolve the fastest mode and the fastest decay of a plant."""
    stiffness, damping = _matrices(plant)
    inverse = 1.0 / plant.inertia
    fast = float(np.sqrt(np.abs(np.linalg.eigvals(inverse[:, None] * stiffness)).max(initial=0.0)))
    decay = float(np.abs(np.linalg.eigvals(inverse[:, None] * damping)).max(initial=0.0))
    steps = dt * STEPS_PER_RADIAN * max(fast, decay)
    return int(min(max(ceil(steps), 1), MAX_SUBSTEPS))


def march(
    model: RigModel,
    u: Floats,
    dt: float,
    *,
    position: Mapping[str, float] | None = None,
    speed: Mapping[str, float] | None = None,
    substeps: int | None = None,
    given: Mapping[str, tuple[Floats, Floats]] | None = None,
    controller: Controller | RunController | Callable[..., Any] | None = None,
    reference: Floats | None = None,
    added: Floats | None = None,
    before: Floats | None = None,
    push: Mapping[str, Floats] | None = None,
    state: State | None = None,
    observer: Observer | None = None,
    measured: Floats | None = None,
) -> RigRun:
    """Run a chain.

    Parameters
    ----------
    model : RigModel
    u : (inputs, n) array
        Signals of the inputs, SI, held from each sample to the next.
    dt : float
        Sample time [s].
    position, speed : mapping of body to float, optional
        Where and how fast it starts; 0 for bodies not named. Bodies that a rigid link ties
        together need one.
    substeps : int, optional
        Steps per sample; by default what the fastest mode needs.
    given : mapping of body to (position, speed) arrays, optional
        Bodies whose motion is prescribed instead of computed.
    controller, reference, added : optional
        A rig's controller, a :class:`~.run.Controller` or a Python ``law(t, target, y)``, (n,)
        and (n,) arrays: closes the loop; `added` is put on the controller's output.
    before : (inputs,) array, optional
        Signals before the first sample, which dead times make act in the run; 0.
    push : mapping of body to (n,) array, optional
        Torques [N·m] or forces added on bodies.
    state : State, optional
        Of an earlier run of the same model, to go on from.
    observer, measured : Observer and (m, n) array, optional
        Lead the run by what its sensors measured.

    Returns
    -------
    RigRun
    """
    plant, layout = model.plant(), model.layout
    n = u.shape[1]
    motion = _NO_ROWS, _NO_ROWS
    if given:
        groups = sorted((layout.coordinate[body], body) for body in given)
        plant = plant._replace(given=tuple(group for group, _ in groups))
        rows = [[signal / layout.ratio[b] for signal in given[b]] for _, b in groups]
        q, v = zip(*rows, strict=True)
        motion = np.array(q, float), np.array(v, float)
    structure = structure_for(plant)
    if state is None:
        q0, v0 = np.zeros(layout.coordinates), np.zeros(layout.coordinates)
        for start, into in ((position, q0), (speed, v0)):
            for body, value in (start or {}).items():
                into[layout.coordinate[body]] = value / layout.ratio[body]
        state = start_state(structure, q0, v0)
    torque = None
    if push:
        torque = np.zeros((n, layout.coordinates))
        for body, values in push.items():
            torque[:, layout.coordinate[body]] += layout.ratio[body] * values
    steps = substeps or substeps_for(plant, dt)
    if callable(controller) and not isinstance(controller, RunController):
        goal = np.zeros(n) if reference is None else reference
        done = advance_by(plant, state, controller, goal, dt, steps, push=torque)
    else:
        law = controller_of(model, controller) if isinstance(controller, Controller) else controller
        done = advance(
            plant, state, u, dt, steps, structure=structure, before=before, push=torque,
            controller=law, target=reference, noise=added, given=motion,
            observer=observer, measured=measured,
        )  # fmt: skip
    time: Floats = state.time + dt * np.arange(n, dtype=np.float64)
    return RigRun(model, time, done)


def simulate_rig(
    model: RigModel, timepts: ArrayLike, inputs: ArrayLike, **options: Any
) -> control.TimeResponseData:
    """Simulate a chain from rest.

    Parameters
    ----------
    model : RigModel
    timepts : (n,) array_like [s]
        Evenly spaced.
    inputs : (n,) or (inputs, n) array_like
        SI.
    **options
        As in `march`.

    Returns
    -------
    TimeResponseData
        One output per sensor of the rig, SI.

    Raises
    ------
    ValueError
        A value that is unknown or that no machine has.
    """
    check_physical(model)
    time = np.asarray(timepts, float)
    u = np.atleast_2d(np.asarray(inputs, float))
    run = march(model, u, float(time[1] - time[0]), **options)
    names = [s.name for s in model.rig.sensors]
    return control.TimeResponseData(
        time,
        np.array([run.reading(name) for name in names]),
        inputs=run.u,
        output_labels=names,
        input_labels=list(model.layout.inputs),
        title=model.rig.name,
        issiso=False,
    )


def _row(plant: Plant, k: int) -> Floats:
    """Twist of a link over the coordinates."""
    first, second = plant.link_body[k]
    b: Floats = np.zeros(plant.inertia.size)
    b[plant.body_coordinate[first]] += plant.body_ratio[first]
    b[plant.body_coordinate[second]] -= plant.link_values[k, 0] * plant.body_ratio[second]
    return b


def _matrices(plant: Plant) -> tuple[Floats, Floats]:
    """Stiffness and damping of the coordinates: each link adds a rank-one block k b bᵀ."""
    n = plant.inertia.size
    stiffness, damping = np.zeros((n, n)), np.zeros((n, n))
    for k in range(plant.link_gap.size):
        _, spring, damper = plant.link_values[k, :3]
        b = _row(plant, k)
        stiffness += spring * np.outer(b, b)
        if plant.link_gap[k] != ELASTIC_IMPACT:  # which does not damp where contact begins
            damping += damper * np.outer(b, b)
    for b_index, group in enumerate(plant.body_coordinate):
        viscous = 0.5 * (plant.law[b_index, 3] + plant.law[b_index, 7])
        damping[group, group] += plant.body_ratio[b_index] ** 2 * viscous
    return stiffness, damping


def linear_rig(
    model: RigModel,
    *,
    outputs: Sequence[str] | None = None,
    position: Mapping[str, float] | None = None,
) -> control.StateSpace:
    """Return the linear model of a chain in contact.

    In it: springs and dampers of links, viscous friction, current lags, and the slopes of
    torques that depend on an angle (cable springs, gravity, cogging) where all stands still at
    `position`. Not in it: dry friction, gaps, delays, saturation.

    Parameters
    ----------
    model : RigModel
        ``RigModel(load_rig("rig.toml"))`` has all that the file declares.
    outputs : sequence of str, optional
        Sensors of the rig; by default all.
    position : mapping of body to float, optional
        Where it is linearised [rad or m]; 0 for bodies not named.

    Returns
    -------
    StateSpace
        Inputs: those of the rig. States: ``q_BODY`` [rad or m] of each rigid group of bodies
        that a torque by angle holds; of a train that turns freely ``spring_LINK``, the torque in
        each link's spring, and one ``q_BODY`` only where an angle of it is an output;
        ``v_BODY``; ``lag_INPUT``. So ``dcgain``, ``margin``, ``bandwidth`` and ``step_info`` are
        right as they come.

    Raises
    ------
    ValueError
        A sensor or body that the rig does not have; a value that is unknown or that no machine
        has.
    """
    check_physical(model)
    plant, layout = model.plant(), model.layout
    sensors = _chosen(model, outputs)
    n, inputs = layout.coordinates, len(layout.inputs)
    _, damping = _matrices(plant)
    grounded, lossy = _slopes(model, position)
    damping += np.diag(lossy)
    for effect in model.effects:
        if effect.name == "viscous_friction":
            group, r = layout.coordinate[effect.on], layout.ratio[effect.on]
            damping[group, group] += r**2 * effect.values["coefficient"]
    angles = {
        layout.coordinate[layout.sensor_body[s.name]] for s in sensors if s.measures == "position"
    }
    into, force, read, names = _positions(model, angles, grounded)
    push = np.zeros((n, inputs))
    for j, name in enumerate(layout.inputs):
        body = layout.input_body[name]
        push[layout.coordinate[body], j] = layout.ratio[body] * plant.input_values[j, 0]
    inverse = 1.0 / plant.inertia[:, None]
    lagging = [j for j in range(inputs) if plant.input_values[j, 2] > 0]
    m = len(names)
    size = m + n + len(lagging)
    a, b = np.zeros((size, size)), np.zeros((size, inputs))
    speeds = slice(m, m + n)
    a[:m, speeds] = into
    a[speeds, :m] = -inverse * force
    a[speeds, speeds] = -inverse * damping
    for j in range(inputs):
        if j in lagging:
            k = m + n + lagging.index(j)
            tau = plant.input_values[j, 2]
            a[speeds, k] = (inverse * push)[:, j]
            a[k, k], b[k, j] = -1.0 / tau, 1.0 / tau
        else:
            b[speeds, j] = (inverse * push)[:, j]
    leads = _leads(model)
    c = np.zeros((len(sensors), size))
    for row, sensor in enumerate(sensors):
        body = layout.sensor_body[sensor.name]
        group = layout.coordinate[body]
        if sensor.measures == "speed":
            c[row, m + group] = layout.ratio[body]
        else:
            c[row, :m] = layout.ratio[body] * read[group]
    return control.ss(
        a, b, c, np.zeros((c.shape[0], inputs)),
        states=[*names, *(f"v_{x}" for x in leads), *(f"lag_{layout.inputs[j]}" for j in lagging)],
        inputs=list(layout.inputs), outputs=[s.name for s in sensors],
        name=model.rig.name.replace(" ", "_").replace(".", "_"),
    )  # fmt: skip


def _chosen(model: RigModel, outputs: Sequence[str] | None) -> list[Sensor]:
    by_name = {s.name: s for s in model.rig.sensors}
    chosen = list(by_name) if outputs is None else list(outputs)
    for name in chosen:
        if name not in by_name:
            raise ValueError(f"no sensor {name!r} in {model.rig.name}; it has {', '.join(by_name)}")
    return [by_name[name] for name in chosen]


def _leads(model: RigModel) -> list[str]:
    """Body of each group whose angle is the coordinate itself."""
    coordinate = model.layout.coordinate
    first = {group: body for body, group in reversed(coordinate.items())}
    ones = {g: b for b, g in coordinate.items() if model.layout.ratio[b] == 1.0}
    return [ones.get(g, first[g]) for g in range(model.layout.coordinates)]


def _positions(
    model: RigModel, angles: set[int], grounded: Floats
) -> tuple[Floats, Floats, Floats, list[str]]:
    """Return the position states: rates over the speeds, forces, coordinates, names.

    A train that nothing holds has the torques of its springs as states, one less than its
    coordinates: the angle of the whole train is left out without any rounding. Where it is
    asked for it comes first, so that python-control finds its pole at 0 exactly.
    """
    plant, layout = model.plant(), model.layout
    n = layout.coordinates
    rows = [_row(plant, k) for k in range(plant.link_gap.size)]
    train = np.arange(n)  # coordinates joined by links have one number
    for b in rows:
        joined = np.isin(train, train[b != 0.0])
        train[joined] = train[joined].min()
    stiffness = _matrices(plant)[0] + np.diag(grounded)
    leads, unit = _leads(model), np.eye(n)
    found: list[tuple[Floats, Floats, Floats, str]] = []  # rate, force, coordinates, name
    for root in np.unique(train):
        own = np.flatnonzero(train == root)
        links = [k for k, b in enumerate(rows) if b[own].any()]
        springs = [float(plant.link_values[k, 1]) for k in links]
        asked = bool(angles & set(own.tolist()))
        if grounded[own].any() or (asked and 0.0 in springs):
            found += [(unit[g], stiffness[:, g], unit[g], f"q_{leads[g]}") for g in own]
            continue
        turn = np.zeros((n, own.size))
        turn[own] = np.linalg.inv(np.vstack([unit[root], *(rows[k] for k in links)])[:, own])
        if asked:
            found.insert(0, (unit[root], np.zeros(n), turn[:, 0], f"q_{leads[root]}"))
        found += [
            (spring * rows[k], rows[k], turn[:, i] / spring, f"spring_{layout.links[k]}")
            for i, (k, spring) in enumerate(zip(links, springs, strict=True), 1)
            if spring > 0.0
        ]
    shape = len(found), n
    into, force, read = (np.reshape([x[i] for x in found], shape) for i in range(3))
    return into, force.T, read.T, [x[3] for x in found]


def _slopes(model: RigModel, position: Mapping[str, float] | None) -> tuple[Floats, Floats]:
    """Stiffness and damping that effects give each coordinate at rest at `position`."""
    plant, layout = model.plant(), model.layout
    q = np.zeros(layout.coordinates)
    for body, value in (position or {}).items():
        if body not in layout.coordinate:
            bodies = ", ".join(layout.bodies)
            raise ValueError(f"position: no body {body!r} in {model.rig.name}; it has {bodies}")
        physical(f"position of {body}", abs(value), zero=True)
        q[layout.coordinate[body]] = value / layout.ratio[body]
    stiffness, damping = np.zeros(q.size), np.zeros(q.size)
    parts = Parts(plant)
    for b, (group, r) in enumerate(zip(parts.group, parts.ratio, strict=True)):
        torque, at = partial(_torque, parts, b), r * float(q[group])
        stiffness[group] -= r**2 * _slope(lambda x: torque(x, 0.0), at)  # noqa: B023
        damping[group] -= r**2 * _slope(lambda v: torque(at, v), 0.0)  # noqa: B023
    return stiffness, damping


def _torque(parts: Parts, body: int, theta: float, omega: float) -> float:
    return float(parts.torque(body, 0.0, theta, omega, 0.0))


def _slope(function: Callable[[float], float], at: float) -> float:
    """Derivative by five points; of a polynomial to the fourth degree it is exact."""
    near, far = (function(at + k * STEP) - function(at - k * STEP) for k in (1, 2))
    return (8.0 * near - far) / (12.0 * STEP)


def modes_text(rig: Rig) -> str:
    """Return the modes of a declared rig as a line of text; or what must be known for them."""
    try:
        model = RigModel(rig)
        losses = [k for k in model.quantities if not k.rpartition(".")[2].startswith(CONSERVATIVE)]
        model = model.with_values(dict.fromkeys(losses, 0.0))
        squares = _squares(model, None)
        grounded, _ = _slopes(model, None)
    except ValueError as error:
        return f"modes: not computed; {error.args[0]}"
    except (KeyError, ZeroDivisionError) as error:
        raise LogError(f"{rig.source}: {error.args[0]}") from None
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


def rig_modes(model: RigModel, *, position: Mapping[str, float] | None = None) -> Floats:
    """Undamped natural frequencies of a chain in contact.

    Parameters
    ----------
    model : RigModel
    position : mapping of body to float, optional
        Where torques that depend on an angle are linearised [rad or m]; 0 for bodies not named.

    Returns
    -------
    (n,) array [Hz]
        Ascending; 0 is the rigid body's, or a mode that such a torque makes unstable.

    Raises
    ------
    ValueError
        As :func:`linear_rig`.
    """
    return np.sqrt(np.maximum(_squares(model, position), 0.0)) / (2 * np.pi)


def _squares(model: RigModel, position: Mapping[str, float] | None) -> Floats:
    """Squares of the undamped frequencies [rad²/s²], ascending."""
    from scipy.linalg import eigh

    check_physical(model)
    plant = model.plant()
    stiffness, _ = _matrices(plant)
    grounded, _ = _slopes(model, position)
    return eigh(stiffness + np.diag(grounded), np.diag(plant.inertia), eigvals_only=True)
