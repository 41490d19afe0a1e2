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
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import Plant
from dmptm_ctrl.simulate.rig_model import RigModel, check_physical


def rig_blocks(model: RigModel, *, others: Sequence[str] = ()) -> ct.InterconnectedSystem:
    """Return a chain as one block per group of bodies, link, input and sensor.

    Parameters
    ----------
    model : RigModel
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
    """The parts of a model, with declared quantities replaced by the `params` of a simulation."""

    def __init__(self, model: RigModel, others: Sequence[str]) -> None:
        self.model, self.layout, self.others = model, model.layout, others
        self._parts: dict[tuple[tuple[str, float], ...], Parts] = {(): Parts(model.plant())}
        self._refuse(model.plant())

    def parts(self, params: Mapping[str, float]) -> Parts:
        key = tuple(sorted(params.items())) if params else ()
        if key not in self._parts:
            refuse_unknown(params, list(self.model.quantities), self.others)
            own = {k: v for k, v in params.items() if k in self.model.quantities}
            model = self.model.with_values(own)
            check_physical(model)
            self._refuse(model.plant())
            self._parts[key] = Parts(model.plant())
        return self._parts[key]

    def _refuse(self, plant: Plant) -> None:
        if np.any(plant.input_values[:, 1] > 0) or np.any(plant.distance > 0):
            raise ValueError(
                "dead time and presliding have no block here; simulate with chain.march"
            )
        if np.any((plant.input_values[:, 2] > 0) != (self._parts[()].plant.input_values[:, 2] > 0)):
            raise ValueError("params: a lag cannot come or go; build the blocks of another model")


def _input_block(given: _Given, j: int) -> ct.NonlinearIOSystem:
    """One motor: effects of the drive, limit, lag, gain."""
    name, body = given.layout.inputs[j], given.parts({}).driven[j]
    lagging = given.parts({}).inputs[j][2] > 0

    def update(t, x, u, params):
        parts = given.parts(params)
        return [(parts.signal(j, float(u[0]), t) - x[0]) / parts.inputs[j][2]] if lagging else []

    def output(t, x, u, params):
        parts = given.parts(params)
        acting = float(x[0]) if lagging else parts.signal(j, float(u[0]), t)
        return [parts.ratio[body] * parts.inputs[j][0] * acting, acting]

    return ct.NonlinearIOSystem(
        update, output, inputs=[name], outputs=[f"{name}_torque", f"{name}_acting"],
        states=["lag"] if lagging else 0, name=f"input_{name}",
    )  # fmt: skip


def _link_block(given: _Given, k: int) -> ct.NonlinearIOSystem:
    """One shaft or mesh, without states."""
    name = given.layout.links[k]
    ends = given.parts({}).ends[k]
    groups = [given.parts({}).group[b] for b in ends]

    def output(t, x, u, params):
        parts = given.parts(params)
        r1, r2 = (parts.ratio[b] for b in ends)
        q1, v1, q2, v2 = u.tolist()
        torque = parts.link_torque(k, *parts.twist(k, r1 * q1, r1 * v1, r2 * q2, r2 * v2))
        ratio = parts.links[k][0]
        return [-r1 * torque, ratio * r2 * torque, abs(torque), abs(ratio * torque)]

    return ct.NonlinearIOSystem(
        None, output, inputs=[f"{s}_{g}" for g in groups for s in ("q", "v")],
        outputs=[f"{name}_{s}" for s in ("torque1", "torque2", "load1", "load2")],
        name=f"link_{name}",
    )  # fmt: skip


def _body_block(
    given: _Given, group: int, torques: Sequence[str], loads: Sequence[Sequence[str]]
) -> ct.NonlinearIOSystem:
    """One group of rigidly joined bodies: inertia, friction, load torques."""
    parts = given.parts({})
    own = [b for b in range(len(loads)) if parts.group[b] == group]
    volts = {b: next((j for j, at in enumerate(parts.driven) if at == b), None) for b in own}
    signals = [f"{given.layout.inputs[j]}_acting" for j in volts.values() if j is not None]
    names = [*torques, *(name for b in own for name in loads[b]), *signals]

    def update(t, x, u, params):
        parts, q, v = given.parts(params), float(x[0]), float(x[1])
        force = float(np.sum(u[: len(torques)]))
        load, at = {}, len(torques)
        for b in own:
            load[b] = float(np.sum(u[at : at + len(loads[b])]))
            at += len(loads[b])
        for b in own:
            acting = 0.0
            if volts[b] is not None:
                acting, at = float(u[at]), at + 1
            r = parts.ratio[b]
            force += r * parts.torque(b, acting, r * q, r * v, t)
        way = 1.0 if v > 0 else -1.0
        if abs(v) < REST_SPEED:
            push = 1.0 if force > 0 else -1.0
            level = rub(parts, push, q, 0.0, t, load, False)
            if level > 0.0:
                if abs(force) <= level:
                    return [0.0, 0.0]
                way = push
        level = rub(parts, way, q, v, t, load, True)
        return [v, (force - way * level) / parts.inertia[group]]

    def rub(parts, way, q, v, t, load, moving):
        whole = 0.0
        for b in (b for b in own if parts.rubs(b)):
            r = parts.ratio[b]
            own_way = way if r > 0.0 else -way
            if moving:
                level = parts.sliding(b, own_way, r * q, r * v, t, load[b], 0.0)[0]
            else:
                level = parts.holding(b, own_way, r * q, t, load[b], 0.0)
            whole += abs(r) * level
        return whole

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
        None, lambda t, x, u, params: given.parts(params).ratio[index] * u,
        inputs=[f"{signal}_{layout.coordinate[body]}"], outputs=[name], name=f"sensor_{name}",
    )  # fmt: skip
