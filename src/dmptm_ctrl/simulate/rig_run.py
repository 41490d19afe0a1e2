"""Simulate rigs of any shape: compiled, linear, and as python-control blocks."""

from collections.abc import Collection, Mapping
from inspect import signature
from math import ceil
from typing import Any

import control
import numpy as np

from dmptm_ctrl.drive.rig import Controller, Rig
from dmptm_ctrl.simulate.control import Law, controller_of, sampled
from dmptm_ctrl.simulate.observer import Observer
from dmptm_ctrl.simulate.plant import NO_ROWS, Floats, Plant, link_matrices
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.run import Controller as RunController
from dmptm_ctrl.simulate.run import Motion, State, advance, advance_by, start_state, structure_for

STEPS_PER_RADIAN = 8.0  # of the fastest mode, and of the fastest decay
MAX_SUBSTEPS = 400  # per millisecond, and per sample that is shorter


def as_rig_model(model: Rig | RigModel, name: str) -> RigModel:
    """Return a rig as a model; anything else is refused in the name of a function."""
    if isinstance(model, Rig):
        return RigModel(model)
    if not isinstance(model, RigModel):
        given = type(model).__name__
        makes = "Model(drive) or read_model(file) makes one"
        raise TypeError(f"{name} takes a model first, not a {given}; {makes}")
    return model


def _check_name(rig: Rig, kind: str, name: str, names: Collection[str]) -> None:
    if name not in names:
        raise ValueError(f"no {kind} {name!r} in {rig.name}; it has {', '.join(names)}")


class RigRun:
    """Motion of a rig on a clock; another run continues from its `state`.

    `u` (inputs, n) are as the controller gave them where a loop was closed.
    """

    def __init__(self, model: RigModel, time: Floats, motion: Motion) -> None:
        self.model, self.time, self.u = model, time, motion.u
        self.state = motion.state
        self._motion = motion

    def position(self, body: str) -> Floats:
        """Angle [rad] or position [m] of a body, (n,)."""
        return self._of_body(body, self._motion.q)

    def speed(self, body: str) -> Floats:
        """Speed of a body [rad/s or m/s], (n,)."""
        return self._of_body(body, self._motion.v)

    def link(self, name: str) -> Floats:
        """Torque [N·m] or force of a link at its first body, (n,)."""
        links = self.model.layout.links
        _check_name(self.model.rig, "soft link", name, links)
        return self._motion.links[:, links.index(name)]

    def reading(self, sensor: str) -> Floats:
        """What a sensor would read, without noise and quantisation, (n,), SI."""
        names = [s.name for s in self.model.rig.sensors]
        _check_name(self.model.rig, "sensor", sensor, names)
        return self._motion.readings[:, names.index(sensor)]

    def _of_body(self, body: str, motion: Floats) -> Floats:
        layout = self.model.layout
        _check_name(self.model.rig, "body", body, layout.bodies)
        return layout.ratio[body] * motion[:, layout.coordinate[body]]


def substeps_for(plant: Plant, dt: float, per_radian: float = STEPS_PER_RADIAN) -> int:
    """Substeps per sample that resolve the fastest mode and the fastest decay of a plant."""
    rows, springs, dampers, viscous = link_matrices(plant)
    inverse = 1.0 / plant.inertia[:, None]
    stiffness, damping = ((rows.T * values) @ rows for values in (springs, dampers))
    damping += np.diag(viscous)
    fast = float(np.sqrt(np.abs(np.linalg.eigvals(inverse * stiffness)).max(initial=0.0)))
    decay = float(np.abs(np.linalg.eigvals(inverse * damping)).max(initial=0.0))
    steps = dt * per_radian * max(fast, decay)
    return int(min(max(ceil(steps), 1), most_substeps(dt)))


def most_substeps(dt: float) -> int:
    """Most substeps in a sample; a sample of many milliseconds needs as many for each."""
    return MAX_SUBSTEPS * max(ceil(1e3 * dt), 1)


def march(
    model: Rig | RigModel,
    u: Floats,
    dt: float,
    *,
    position: Mapping[str, float] | None = None,
    speed: Mapping[str, float] | None = None,
    substeps: int | None = None,
    given: Mapping[str, tuple[Floats, Floats]] | None = None,
    controller: Controller | RunController | Law | control.LTI | None = None,
    reference: Floats | None = None,
    added: Floats | None = None,
    before: Floats | None = None,
    push: Mapping[str, Floats] | None = None,
    state: State | None = None,
    observer: Observer | None = None,
    measured: Floats | None = None,
) -> RigRun:
    """Run a rig.

    Parameters
    ----------
    model : Rig or RigModel
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
        Closes the loop, with (n,) and (n,) arrays: a rig's controller, on whose output `added`
        is put; a :class:`~.run.Controller`, which the compiled loop calls; a Python
        ``law(t, target, y)`` that returns the signals of the inputs, a hundred times slower, where
        `y` are the readings [SI] in the order of the file; or a discrete system, see
        :func:`~.control.sampled`.
    before : (inputs,) array, optional
        Signals before the first sample, which dead times make act in the run; 0.
    push : mapping of body to (n,) array, optional
        Torques [N·m] or forces added on bodies.
    state : State, optional
        Of an earlier run of the same model; this one continues from there.
    observer, measured : Observer and (m, n) array, optional
        Corrects the run by what its sensors measured.

    Raises
    ------
    ValueError
        Signals of another shape, or a body that the rig does not have.
    """
    model = as_rig_model(model, "march")
    plant, layout = model.plant(), model.layout
    if u.ndim != 2 or u.shape[0] != len(layout.inputs):
        need = f"({len(layout.inputs)}, n)"
        raise ValueError(f"u has shape {u.shape}; needs {need}: inputs by samples")
    for bodies in (position, speed, given, push):
        for body in bodies or ():
            _check_name(model.rig, "body", body, layout.bodies)
    n = u.shape[1]
    motion = NO_ROWS, NO_ROWS
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
    if isinstance(controller, control.LTI):
        controller = sampled(controller)
    if callable(controller):
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


MARCH_OPTIONS = [p.name for p in signature(march).parameters.values() if p.kind is p.KEYWORD_ONLY]


def march_readings(model: RigModel, u: Floats, _: None, dt: float, **options: Any) -> Floats:
    """Run a rig, see :func:`march`: (n, sensors) array; `u` gets what a controller gave."""
    run = march(model, u, dt, **options)
    u[:] = run.u
    return run._motion.readings
