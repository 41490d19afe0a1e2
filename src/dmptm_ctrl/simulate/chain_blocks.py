"""Chains and branched trains as python-control blocks, joined by their signal names.

No physics here: each block calls the functions of the compiled loop. Friction with real
sticking as in `blocks.py`: below :data:`REST_SPEED` it takes the value that balances the rest,
as long as breakaway allows. A body without dry friction never rests.

`params` of a simulation replace declared quantities by their keys, such as
``{"body.load.inertia": 0.02}``; other names are refused.
"""

from collections.abc import Mapping, Sequence

import control as ct
import numpy as np

from dmptm_ctrl.simulate.block_params import refuse_unknown
from dmptm_ctrl.simulate.blocks import REST_SPEED
from dmptm_ctrl.simulate.chain_compose import engine
from dmptm_ctrl.simulate.chain_model import ChainModel, check_physical
from dmptm_ctrl.simulate.chain_plant import Plant

TINY = 1e-300  # a speed that has a direction and no size


def chain_blocks(model: ChainModel, *, others: Sequence[str] = ()) -> ct.InterconnectedSystem:
    """Return a chain as one block per group of bodies, link, input and sensor.

    Parameters
    ----------
    model : ChainModel
    others : sequence of str
        Names of `params` that belong to blocks of your own beside these.

    Returns
    -------
    InterconnectedSystem
        Inputs: those of the rig; outputs: its sensors, without their own dead times; states:
        position and speed of each group of rigidly joined bodies, and lags.

    Raises
    ------
    ValueError
        A dead time or presliding, which have no such block; `chain.march` simulates them. An
        inertia that is not positive, a negative stiffness, a value that is not finite.
    """
    check_physical(model)
    given, plant, layout = _Given(model, others), model.plant(), model.layout
    blocks: list[ct.NonlinearIOSystem] = []
    torques: list[list[str]] = [[] for _ in range(layout.coordinates)]
    loads: list[list[str]] = [[] for _ in layout.bodies]
    for j, name in enumerate(layout.inputs):
        body = int(plant.input_body[j])
        blocks.append(_input_block(given, j))
        torques[plant.body_coordinate[body]].append(f"{name}_torque")
        loads[body].append(f"{name}_load")
    for k, name in enumerate(layout.links):
        blocks.append(_link_block(given, k))
        for end, body in enumerate(plant.link_body[k]):
            torques[plant.body_coordinate[body]].append(f"{name}_torque{end + 1}")
            loads[body].append(f"{name}_load{end + 1}")
    blocks += [_body_block(given, g, torques[g], loads) for g in range(layout.coordinates)]
    blocks += [_sensor_block(given, s.name) for s in model.rig.sensors]
    return ct.interconnect(
        blocks,
        inputs=list(layout.inputs),
        outputs=[s.name for s in model.rig.sensors],
        name=model.rig.name.replace(" ", "_"),
    )


class _Given:
    """The plant of a model, with declared quantities replaced by the `params` of a simulation."""

    def __init__(self, model: ChainModel, others: Sequence[str]) -> None:
        self.model, self.layout, self.others = model, model.layout, others
        self._plants: dict[tuple[tuple[str, float], ...], Plant] = {(): model.plant()}
        self._refuse(self._plants[()])

    def plant(self, params: Mapping[str, float]) -> Plant:
        key = tuple(sorted(params.items())) if params else ()
        if key not in self._plants:
            refuse_unknown(params, list(self.model.quantities), self.others)
            own = {k: v for k, v in params.items() if k in self.model.quantities}
            model = self.model.with_values(own)
            check_physical(model)
            self._refuse(model.plant())
            self._plants[key] = model.plant()
        return self._plants[key]

    def _refuse(self, plant: Plant) -> None:
        if np.any(plant.input_values[:, 1] > 0) or np.any(plant.distance > 0):
            raise ValueError(
                "dead time and presliding have no block here; simulate with chain.march"
            )
        if np.any((plant.input_values[:, 2] > 0) != (self._plants[()].input_values[:, 2] > 0)):
            raise ValueError("params: a lag cannot come or go; build the blocks of another model")


def _input_block(given: _Given, j: int) -> ct.NonlinearIOSystem:
    """One motor: effects of the drive, limit, lag, gain."""
    name = given.layout.inputs[j]
    lagging = given.plant({}).input_values[j, 2] > 0
    loop = engine()

    def signal(plant, t, u):
        value, limit = float(u[0]), plant.input_values[j, 3]
        for place, values in zip(plant.drive_place, plant.drive_values, strict=True):
            if place[1] == j:
                value = loop.drive_signal(place[0], value, t, values)
        return min(limit, max(-limit, value)) if limit > 0 else value

    def update(t, x, u, params):
        plant = given.plant(params)
        return [(signal(plant, t, u) - x[0]) / plant.input_values[j, 2]] if lagging else []

    def output(t, x, u, params):
        plant = given.plant(params)
        torque = plant.input_values[j, 0] * (x[0] if lagging else signal(plant, t, u))
        return [plant.body_ratio[plant.input_body[j]] * torque, abs(torque)]

    return ct.NonlinearIOSystem(
        update, output, inputs=[name], outputs=[f"{name}_torque", f"{name}_load"],
        states=["lag"] if lagging else 0, name=f"input_{name}",
    )  # fmt: skip


def _link_block(given: _Given, k: int) -> ct.NonlinearIOSystem:
    """One shaft or mesh, without states."""
    name = given.layout.links[k]
    ends = [int(b) for b in given.plant({}).link_body[k]]
    groups = [int(given.plant({}).body_coordinate[b]) for b in ends]
    loop = engine()

    def output(t, x, u, params):
        plant = given.plant(params)
        row = plant.link_values[k]
        lever = plant.body_ratio[ends[0]], row[0] * plant.body_ratio[ends[1]]
        q1, v1, q2, v2 = u.tolist()
        z, rate = lever[0] * q1 - lever[1] * q2, lever[0] * v1 - lever[1] * v2
        torque = loop.link_torque(z, rate, row, plant.link_gap[k])
        return [-lever[0] * torque, lever[1] * torque, abs(torque), abs(row[0] * torque)]

    return ct.NonlinearIOSystem(
        None, output, inputs=[f"{s}_{g}" for g in groups for s in ("q", "v")],
        outputs=[f"{name}_{s}" for s in ("torque1", "torque2", "load1", "load2")],
        name=f"link_{name}",
    )  # fmt: skip


def _body_block(
    given: _Given, group: int, torques: Sequence[str], loads: Sequence[Sequence[str]]
) -> ct.NonlinearIOSystem:
    """One group of rigidly joined bodies: inertia, friction, load torques."""
    own = [b for b in range(len(loads)) if given.plant({}).body_coordinate[b] == group]
    names = [*torques, *(name for b in own for name in loads[b])]
    loop = engine()

    def update(t, x, u, params):
        plant, q, v = given.plant(params), float(x[0]), float(x[1])
        force = float(np.sum(u[: len(torques)]))
        load, at = np.zeros(len(loads)), len(torques)
        for b in own:
            load[b] = np.sum(u[at : at + len(loads[b])])
            at += len(loads[b])
        for place, values in zip(plant.torque_place, plant.torque_values, strict=True):
            b = place[1]
            if b in own:
                r = plant.body_ratio[b]
                force += r * loop.effect_torque(place[0], r * q, r * v, t, values)
        way = 1.0 if v > 0 else -1.0
        if abs(v) < REST_SPEED:
            push = 1.0 if force > 0 else -1.0
            level = loop.friction_of(group, q, 0.0, push, True, t, load, plant)
            if level > 0.0:
                if abs(force) <= level:
                    return [0.0, 0.0]
                way = push
        level = loop.friction_of(group, q, max(abs(v), TINY), way, False, t, load, plant)
        return [v, (force - way * level) / plant.inertia[group]]

    return ct.NonlinearIOSystem(
        update, lambda t, x, u, params: x, inputs=names, outputs=[f"q_{group}", f"v_{group}"],
        states=[f"q_{group}", f"v_{group}"], name=f"group_{group}",
    )  # fmt: skip


def _sensor_block(given: _Given, name: str) -> ct.NonlinearIOSystem:
    layout = given.layout
    sensor = next(s for s in given.model.rig.sensors if s.name == name)
    body = layout.sensor_body[name]
    index = layout.bodies.index(body)
    signal = "q" if sensor.measures == "position" else "v"
    return ct.NonlinearIOSystem(
        None, lambda t, x, u, params: given.plant(params).body_ratio[index] * u,
        inputs=[f"{signal}_{layout.coordinate[body]}"], outputs=[name], name=f"sensor_{name}",
    )  # fmt: skip
