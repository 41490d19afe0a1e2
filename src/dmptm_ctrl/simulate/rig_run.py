"""Simulate chains and branched trains: compiled, linear, and as python-control blocks."""

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import ceil
from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.drive.parameters import physical
from dmptm_ctrl.drive.rig import Controller, Rig
from dmptm_ctrl.drive.train import GearTrain, Joint
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
    rows, springs, dampers, viscous = _links(plant)
    inverse = 1.0 / plant.inertia[:, None]
    stiffness, damping = ((rows.T * values) @ rows for values in (springs, dampers))
    damping += np.diag(viscous)
    fast = float(np.sqrt(np.abs(np.linalg.eigvals(inverse * stiffness)).max(initial=0.0)))
    decay = float(np.abs(np.linalg.eigvals(inverse * damping)).max(initial=0.0))
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


def _links(plant: Plant) -> tuple[Floats, Floats, Floats, Floats]:
    """Twists of links over the coordinates, their stiffness and damping; viscous friction."""
    n, _, links, *_ = plant.size
    rows = np.zeros((links, n))
    for end, factor in ((0, np.ones(links)), (1, -plant.link_values[:, 0])):
        bodies = plant.link_body[:, end]
        at = np.arange(links), plant.body_coordinate[bodies]
        np.add.at(rows, at, factor * plant.body_ratio[bodies])
    # flanks that damp by depth do not where contact begins
    dampers = np.where(plant.link_gap == ELASTIC_IMPACT, 0.0, plant.link_values[:, 2])
    slopes = plant.body_ratio**2 * 0.5 * (plant.law[:, 3] + plant.law[:, 7])
    viscous = np.bincount(plant.body_coordinate, slopes, n).astype(float)
    return rows, plant.link_values[:, 1], dampers, viscous


def linear_train(model: RigModel, position: Mapping[str, float] | None = None) -> GearTrain:
    """Return masses, springs and dampers of a rig in contact, see :func:`linear_rig`."""
    check_physical(model)
    plant, layout = model.plant(), model.layout
    unit = np.eye(layout.coordinates)
    turn = {b: layout.ratio[b] * unit[layout.coordinate[b]] for b in layout.bodies}
    ground, lossy = _slopes(model, position)
    rows, springs, dampers, viscous = _links(plant)
    for effect in model.effects:
        if effect.name == "viscous_friction":
            lossy += turn[effect.on] ** 2 * effect.values["coefficient"]
    joined = zip(layout.links, rows, springs.tolist(), dampers.tolist(), strict=True)
    pushed = [turn[layout.input_body[name]] for name in layout.inputs]
    kinds = {"position": "q", "speed": "v"}
    return GearTrain(
        name=model.rig.name.replace(" ", "_").replace(".", "_"),
        bodies=tuple(_leads(model)),
        inertia=plant.inertia,
        viscous=viscous + lossy,
        joints=tuple(Joint(*link) for link in joined),
        drives=np.transpose(pushed) * plant.input_values[:, 0],
        torque_per_volt=1.0,
        readouts={},
        ground=ground,
        lags=plant.input_values[:, 2],
        labels=layout.inputs,
        motion=("q", "v"),
        sensors={
            s.name: (kinds[s.measures], turn[layout.sensor_body[s.name]]) for s in model.rig.sensors
        },
        base=0,
    )


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
    sensors = [s.name for s in model.rig.sensors]
    chosen = sensors if outputs is None else list(outputs)
    for name in chosen:
        if name not in sensors:
            raise ValueError(f"no sensor {name!r} in {model.rig.name}; it has {', '.join(sensors)}")
    return linear_train(model, position).to_ss(outputs=chosen)


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
        train = linear_train(model)
    except ValueError as error:
        return f"modes: not computed; {error.args[0]}"
    except (KeyError, ZeroDivisionError) as error:
        raise LogError(f"{rig.source}: {error.args[0]}") from None
    squares, grounded = _squares(train), np.asarray(train.ground)
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
    return np.sqrt(np.maximum(_squares(linear_train(model, position)), 0.0)) / (2 * np.pi)


def _squares(train: GearTrain) -> Floats:
    """Squares of the undamped frequencies [rad²/s²], ascending."""
    from scipy.linalg import eigh

    return eigh(train.stiffness, train.mass, eigvals_only=True)
