"""Simulate chains and branched trains: compiled, linear, and as python-control blocks."""

from collections.abc import Mapping
from math import ceil
from typing import Any

import control
import numpy as np
from numpy.typing import ArrayLike

from dmptm_ctrl.drive.rig import Controller, Rig
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.chain_compose import engine
from dmptm_ctrl.simulate.chain_model import ChainModel, Placed
from dmptm_ctrl.simulate.chain_plant import Floats, Plant

STEPS_PER_RADIAN = 8.0  # of the fastest mode, and of the fastest decay
MAX_SUBSTEPS = 400
STILL = 1e-6  # of the fastest mode; slower is the rigid one
CONSERVATIVE = ("inertia", "stiffness", "ratio", "gain", "stribeck_speed", "stribeck_exponent")
_OPEN = np.zeros(7)
_NO_MOTION = np.zeros((1, 0))


class ChainRun:
    """Motion of a chain on a clock.

    Attributes
    ----------
    time : (n,) array [s]
    u : (inputs, n) array
        Signals of the inputs, as the controller gave them where a loop was closed.
    """

    def __init__(self, model: ChainModel, time: Floats, u: Floats, out: Floats) -> None:
        self.model, self.time, self.u = model, time, u
        self._out = out
        self._count = model.layout.coordinates

    def position(self, body: str) -> Floats:
        """Angle [rad] or position [m] of a body, (n,)."""
        layout = self.model.layout
        return layout.ratio[body] * self._out[:, layout.coordinate[body]]

    def speed(self, body: str) -> Floats:
        """Speed of a body [rad/s or m/s], (n,)."""
        layout = self.model.layout
        return layout.ratio[body] * self._out[:, self._count + layout.coordinate[body]]

    def link(self, name: str) -> Floats:
        """Torque [N·m] or force of a link at its first body, (n,)."""
        return self._out[:, 2 * self._count + self.model.layout.links.index(name)]

    def reading(self, sensor: str) -> Floats:
        """What a sensor would read, without noise and quantisation, (n,), SI."""
        item = next(s for s in self.model.rig.sensors if s.name == sensor)
        body = self.model.layout.sensor_body[sensor]
        values = self.position(body) if item.measures == "position" else self.speed(body)
        step = self.time[1] - self.time[0]
        for effect in self.model.effects:
            if effect.on != sensor:
                continue
            if effect.name == "sensor_delay":
                late = self.time - effect.values["delay"]
                values = np.interp(late, self.time, values)
            if effect.name == "sensor_gain":
                values = values * (1.0 + effect.values["error"])
            if effect.name == "encoder_eccentricity":
                angle = self.position(body)
                values = values + (
                    effect.values["cosine"] * np.cos(angle) + effect.values["sine"] * np.sin(angle)
                )
        del step
        return values


def substeps_for(plant: Plant, dt: float) -> int:
    """Substeps per sample that resolve the fastest mode and the fastest decay of a plant."""
    stiffness, damping = _matrices(plant)
    inverse = 1.0 / plant.inertia
    fast = float(np.sqrt(np.abs(np.linalg.eigvals(inverse[:, None] * stiffness)).max(initial=0.0)))
    decay = float(np.abs(np.linalg.eigvals(inverse[:, None] * damping)).max(initial=0.0))
    steps = dt * STEPS_PER_RADIAN * max(fast, decay)
    return int(min(max(ceil(steps), 1), MAX_SUBSTEPS))


def march(
    model: ChainModel,
    u: Floats,
    dt: float,
    *,
    position: Mapping[str, float] | None = None,
    speed: Mapping[str, float] | None = None,
    substeps: int | None = None,
    given: Mapping[str, tuple[Floats, Floats]] | None = None,
    controller: Controller | None = None,
    reference: Floats | None = None,
    added: Floats | None = None,
) -> ChainRun:
    """Run a chain.

    Parameters
    ----------
    model : ChainModel
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
    controller, reference, added : Controller, (n,) array, (n,) array, optional
        Closes the loop; `added` is put on the controller's output.

    Returns
    -------
    ChainRun
    """
    plant, layout = model.plant(), model.layout
    n = u.shape[1]
    q0, v0 = np.zeros(layout.coordinates), np.zeros(layout.coordinates)
    for start, into in ((position, q0), (speed, v0)):
        for body, value in (start or {}).items():
            into[layout.coordinate[body]] = value / layout.ratio[body]
    motion = _NO_MOTION, _NO_MOTION
    if given:
        flags = np.zeros(layout.coordinates, np.int64)
        motion = np.zeros((layout.coordinates, n)), np.zeros((layout.coordinates, n))
        for body, (q, v) in given.items():
            group = layout.coordinate[body]
            flags[group] = 1
            motion[0][group], motion[1][group] = q / layout.ratio[body], v / layout.ratio[body]
        plant = plant._replace(given=flags)
    control_row = _OPEN
    if controller is not None:
        control_row = _control_row(model, controller)
    zeros = np.zeros(n)
    out: Floats = np.empty((n, 2 * layout.coordinates + len(layout.links)))
    signal = np.array(u, np.float64, order="C")
    engine().march(
        plant, signal, dt, substeps or substeps_for(plant, dt), q0, v0, *motion, control_row,
        zeros if reference is None else np.array(reference, float),
        zeros if added is None else np.array(added, float), out,
    )  # fmt: skip
    time: Floats = dt * np.arange(n, dtype=np.float64)
    return ChainRun(model, time, signal, out)


def _control_row(model: ChainModel, controller: Controller) -> Floats:
    layout = model.layout
    body = layout.bodies.index(layout.sensor_body[controller.sensor])
    kind = {"pi_speed": 1.0, "cascade": 2.0}[controller.kind]
    gains = [controller.gains.get(k, 0.0) for k in ("kp", "ki", "kv")]
    source = layout.inputs.index(controller.input)
    return np.array([kind, source, body, *gains, controller.limit])


def simulate_chain(
    model: ChainModel, timepts: ArrayLike, inputs: ArrayLike, **options: Any
) -> control.TimeResponseData:
    """Simulate a chain from rest.

    Parameters
    ----------
    model : ChainModel
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
    """
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


def _matrices(plant: Plant) -> tuple[Floats, Floats]:
    """Stiffness and damping of the coordinates: each link adds a rank-one block k b bᵀ."""
    n = plant.inertia.size
    stiffness, damping = np.zeros((n, n)), np.zeros((n, n))
    for k in range(plant.link_gap.size):
        first, second = plant.link_body[k]
        ratio, spring, damper = plant.link_values[k, :3]
        b = np.zeros(n)
        b[plant.body_coordinate[first]] += plant.body_ratio[first]
        b[plant.body_coordinate[second]] -= ratio * plant.body_ratio[second]
        stiffness += spring * np.outer(b, b)
        damping += damper * np.outer(b, b)
    for b_index, group in enumerate(plant.body_coordinate):
        viscous = 0.5 * (plant.law[b_index, 3] + plant.law[b_index, 7])
        damping[group, group] += plant.body_ratio[b_index] ** 2 * viscous
    return stiffness, damping


def linear_chain(model: ChainModel) -> control.StateSpace:
    """Return the linear model of a chain in contact: springs, dampers, viscous friction.

    Coulomb friction, gaps, delays and saturation are not in it; current lags are.

    Returns
    -------
    StateSpace
        Inputs: those of the rig. Outputs: its sensors. States: coordinates, speeds, lags.
    """
    plant, layout = model.plant(), model.layout
    n, inputs = layout.coordinates, len(layout.inputs)
    stiffness, damping = _matrices(plant)
    for e in range(plant.friction_place.shape[0]):
        effect = [x for x in model.effects if _site(x.name) == "friction"][e]
        if effect.name == "viscous_friction":
            group, r = layout.coordinate[effect.on], layout.ratio[effect.on]
            damping[group, group] += r**2 * effect.values["coefficient"]
    push = np.zeros((n, inputs))
    for j, name in enumerate(layout.inputs):
        body = layout.input_body[name]
        push[layout.coordinate[body], j] = layout.ratio[body] * plant.input_values[j, 0]
    inverse = 1.0 / plant.inertia[:, None]
    lagging = [j for j in range(inputs) if plant.input_values[j, 2] > 0]
    size = 2 * n + len(lagging)
    a, b = np.zeros((size, size)), np.zeros((size, inputs))
    a[:n, n : 2 * n] = np.eye(n)
    a[n : 2 * n, :n] = -inverse * stiffness
    a[n : 2 * n, n : 2 * n] = -inverse * damping
    for j in range(inputs):
        if j in lagging:
            k = 2 * n + lagging.index(j)
            tau = plant.input_values[j, 2]
            a[n : 2 * n, k] = (inverse * push)[:, j]
            a[k, k], b[k, j] = -1.0 / tau, 1.0 / tau
        else:
            b[n : 2 * n, j] = (inverse * push)[:, j]
    c = np.zeros((len(model.rig.sensors), size))
    for row, sensor in enumerate(model.rig.sensors):
        body = layout.sensor_body[sensor.name]
        column = layout.coordinate[body] + (n if sensor.measures == "speed" else 0)
        c[row, column] = layout.ratio[body]
    return control.ss(
        a, b, c, np.zeros((c.shape[0], inputs)),
        inputs=list(layout.inputs), outputs=[s.name for s in model.rig.sensors],
        name=model.rig.name.replace(" ", "_"),
    )  # fmt: skip


def _site(name: str) -> str:
    from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE

    return CHAIN_CATALOGUE[name].site


def modes_text(rig: Rig) -> str:
    """Return the modes of a declared rig as a line of text; or what must be known for them."""
    try:
        model = ChainModel(rig, tuple(declared_effects(rig)))
        losses = [k for k in model.quantities if k.rpartition(".")[2] not in CONSERVATIVE]
        model = model.with_values(dict.fromkeys(losses, 0.0))
        modes = chain_modes(model)
    except ValueError as error:
        return f"modes: not computed; {error.args[0]}"
    except (KeyError, ZeroDivisionError) as error:
        raise LogError(f"{rig.source}: {error.args[0]}") from None
    least = STILL * modes.max(initial=0.0)
    return "modes: " + ", ".join(f"{f:.4g} Hz" if f > least else "0 (rigid body)" for f in modes)


def declared_effects(rig: Rig) -> list[Placed]:
    """Return the effects that a rig file declares, as models have them."""
    return [Placed(e.name, e.on, {k: q.value for k, q in e.values.items()}) for e in rig.effects]


def chain_modes(model: ChainModel) -> Floats:
    """Undamped natural frequencies of a chain in contact [Hz], ascending; 0 is the rigid one."""
    from scipy.linalg import eigh

    plant = model.plant()
    stiffness, _ = _matrices(plant)
    squares = eigh(stiffness, np.diag(plant.inertia), eigvals_only=True)
    return np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
