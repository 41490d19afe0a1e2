"""Chains and branched trains as python-control blocks, joined by their signal names.

No physics here: each block calls the functions of the compiled loop. Friction with real
sticking as in `blocks.py`: below :data:`REST_SPEED` it takes the value that balances the rest,
as long as breakaway allows.
"""

from collections.abc import Sequence

import control as ct
import numpy as np

from dmptm_ctrl.simulate.blocks import REST_SPEED
from dmptm_ctrl.simulate.chain_compose import engine
from dmptm_ctrl.simulate.chain_model import ChainModel

TINY = 1e-300  # a speed that has a direction and no size


def chain_blocks(model: ChainModel) -> ct.InterconnectedSystem:
    """Return a chain as one block per group of bodies, link, input and sensor.

    Parameters
    ----------
    model : ChainModel

    Returns
    -------
    InterconnectedSystem
        Inputs: those of the rig; outputs: its sensors, without their own dead times; states:
        position and speed of each group of rigidly joined bodies, and lags.

    Raises
    ------
    ValueError
        A dead time or presliding, which have no such block; `chain.march` simulates them.
    """
    plant, layout = model.plant(), model.layout
    if np.any(plant.input_values[:, 1] > 0) or np.any(plant.distance > 0):
        raise ValueError("dead time and presliding have no block here; simulate with chain.march")
    blocks: list[ct.NonlinearIOSystem] = []
    torques: list[list[str]] = [[] for _ in range(layout.coordinates)]
    loads: list[list[str]] = [[] for _ in layout.bodies]
    for j, name in enumerate(layout.inputs):
        body = int(plant.input_body[j])
        blocks.append(_input_block(model, j))
        torques[plant.body_coordinate[body]].append(f"{name}_torque")
        loads[body].append(f"{name}_load")
    for k, name in enumerate(layout.links):
        blocks.append(_link_block(model, k))
        for end, body in enumerate(plant.link_body[k]):
            torques[plant.body_coordinate[body]].append(f"{name}_torque{end + 1}")
            loads[body].append(f"{name}_load{end + 1}")
    blocks += [_body_block(model, g, torques[g], loads) for g in range(layout.coordinates)]
    blocks += [_sensor_block(model, s.name) for s in model.rig.sensors]
    return ct.interconnect(
        blocks,
        inputs=list(layout.inputs),
        outputs=[s.name for s in model.rig.sensors],
        name=model.rig.name.replace(" ", "_"),
    )


def _input_block(model: ChainModel, j: int) -> ct.NonlinearIOSystem:
    """One motor: effects of the drive, limit, lag, gain."""
    plant, name = model.plant(), model.layout.inputs[j]
    gain, _, lag, limit = plant.input_values[j]
    ratio = plant.body_ratio[plant.input_body[j]]
    loop = engine()

    def signal(t, u):
        value = float(u[0])
        for place, values in zip(plant.drive_place, plant.drive_values, strict=True):
            if place[1] == j:
                value = loop.drive_signal(place[0], value, t, values)
        return min(limit, max(-limit, value)) if limit > 0 else value

    def update(t, x, u, params):
        return [(signal(t, u) - x[0]) / lag] if lag > 0 else []

    def output(t, x, u, params):
        torque = gain * (x[0] if lag > 0 else signal(t, u))
        return [ratio * torque, abs(torque)]

    return ct.NonlinearIOSystem(
        update, output, inputs=[name], outputs=[f"{name}_torque", f"{name}_load"],
        states=["lag"] if lag > 0 else 0, name=f"input_{name}",
    )  # fmt: skip


def _link_block(model: ChainModel, k: int) -> ct.NonlinearIOSystem:
    """One shaft or mesh, without states."""
    plant, name = model.plant(), model.layout.links[k]
    row = plant.link_values[k]
    ends = [int(b) for b in plant.link_body[k]]
    lever = plant.body_ratio[ends[0]], row[0] * plant.body_ratio[ends[1]]
    groups = [int(plant.body_coordinate[b]) for b in ends]
    loop = engine()

    def output(t, x, u, params):
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
    model: ChainModel, group: int, torques: Sequence[str], loads: Sequence[Sequence[str]]
) -> ct.NonlinearIOSystem:
    """One group of rigidly joined bodies: inertia, friction, load torques."""
    plant = model.plant()
    own = [b for b in range(len(loads)) if plant.body_coordinate[b] == group]
    names = [*torques, *(name for b in own for name in loads[b])]
    loop = engine()

    def update(t, x, u, params):
        q, v = float(x[0]), float(x[1])
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
        moving = v if abs(v) >= REST_SPEED else force
        way = 1.0 if moving > 0 else -1.0
        if abs(v) < REST_SPEED:
            level = loop.friction_of(group, q, 0.0, way, True, t, load, plant)
            if abs(force) <= level:
                return [0.0, 0.0]
        level = loop.friction_of(group, q, max(abs(v), TINY), way, False, t, load, plant)
        return [v, (force - way * level) / plant.inertia[group]]

    return ct.NonlinearIOSystem(
        update, lambda t, x, u, params: x, inputs=names, outputs=[f"q_{group}", f"v_{group}"],
        states=[f"q_{group}", f"v_{group}"], name=f"group_{group}",
    )  # fmt: skip


def _sensor_block(model: ChainModel, name: str) -> ct.NonlinearIOSystem:
    layout = model.layout
    sensor = next(s for s in model.rig.sensors if s.name == name)
    body = layout.sensor_body[name]
    ratio = layout.ratio[body]
    signal = "q" if sensor.measures == "position" else "v"
    return ct.NonlinearIOSystem(
        None, lambda t, x, u, params: ratio * u,
        inputs=[f"{signal}_{layout.coordinate[body]}"], outputs=[name], name=f"sensor_{name}",
    )  # fmt: skip
