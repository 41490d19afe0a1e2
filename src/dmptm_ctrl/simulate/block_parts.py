"""A drive as python-control blocks, one per part, joined by their signal names.

Bodies, friction, meshes, drives and sensors are blocks of their own, as in the paper's Fig. 13.
No physics here: each block calls the kernels through :class:`~.parts.Parts`. Blocks are pure
functions of (t, x, u, params), finite at zero, without memory besides their states. Of `params`
they take declared values and those of the loop by name, and refuse other names.

Friction with real sticking inside an ODE (Karnopp, J. Dyn. Sys. 107 (1985) 100): below
:data:`REST_SPEED` a body counts as resting; its friction then takes the value that balances
the net torque, as long as the breakaway torque allows, and its block says that it holds. The
body then does not move: angle and speed keep their values. There is no smoothed sign, so
nothing creeps. What the band costs is a residual speed below REST_SPEED. A body without dry
friction never rests, so that ``control.linearize`` at rest finds its viscous friction.

A dead time in an ODE is a Padé approximation (order :data:`PADE_ORDER`); the compiled
simulator and the reference have it exactly.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import control as ct
import numpy as np

from dmptm_ctrl.effects.backlash import gap_rate
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import TWO_STATES, Floats, Plant

REST_SPEED = 1e-5  # rad/s; a hundredth of the gyro's noise, far above a solver's tolerance
PADE_ORDER = 4  # phase error below 1° up to ω T_d = 4.5 rad


class Delay:
    """A dead time as Padé states; a plain wire without delay."""

    def __init__(self, delay: float, order: int) -> None:
        self.order = order if delay > 0.0 else 0
        if self.order:  # realised for unit delay, so that the realisation is well scaled
            unit = ct.ss(ct.tf(*ct.pade(1.0, order)))
            self.A, self.B = unit.A / delay, unit.B[:, 0] / delay
            self.C, self.D = unit.C[0], float(unit.D[0, 0])
        self.states = [f"delay_{i}" for i in range(self.order)]

    def rate(self, x, u: float) -> Floats:
        return self.A @ x + self.B * u if self.order else np.zeros(0)

    def output(self, x, u: float) -> float:
        return float(self.C @ x) + self.D * u if self.order else float(u)

    def system(self) -> ct.StateSpace:
        """Return the dead time as a linear system."""
        if not self.order:
            return ct.ss([], [], [], 1.0)
        return ct.ss(self.A, self.B[:, None], self.C[None, :], self.D)

    def settled(self, u: float) -> Floats:
        """States after `u` was held for long."""
        return np.linalg.solve(self.A, -self.B * u) if self.order else np.zeros(0)


class Given:
    """The parts of a drive and its loop, with values replaced by the `params` of a simulation."""

    def __init__(
        self,
        plant_of: Callable[[Mapping[str, float]], Plant],
        known: Sequence[str],
        *,
        others: Sequence[str] = (),
        loop: Loop | None = None,
        pade_order: int = PADE_ORDER,
        values: Mapping[str, float] | None = None,
    ) -> None:
        self._of = plant_of, known, others, pade_order
        self.loop, self.parts = loop, Parts(plant_of(values or {}))
        plant = self.parts.plant
        self.dead = [Delay(x, pade_order) for x in plant.input_values[:, 1].tolist()]
        self.late = [Delay(x, pade_order) for x in plant.sensor_delay.tolist()]
        self.lags = [self.parts.lag(j, 0.0)[1] > 0.0 for j in range(len(self.dead))]
        orders = tuple(delay.order for delay in (*self.dead, *self.late))
        rubbing = tuple(map(tuple, self.parts.rubbing))
        self.shape = orders, tuple(self.lags), tuple(self.parts.elastic), rubbing
        self._varied: dict[tuple[tuple[str, float], ...], Given] = {}

    def at(self, params: Mapping[str, float]) -> "Given":
        """Return it with the values of `params`; ValueError for a wrong name or value.

        python-control hands the params of every block to all blocks of a system.
        """
        if not params:
            return self
        key = tuple(sorted(params.items()))
        if key not in self._varied:
            (plant_of, known, others, order), loop = self._of, self.loop
            gains = () if loop is None else Loop._fields
            for name in params:
                if name not in (*known, *gains, *others):
                    raise ValueError(
                        f"params: the blocks have no {name!r}; they have "
                        f"{', '.join((*known, *gains))}; an effect belongs to "
                        "model.with_effect(…); if it is of a block of your own, build ours "
                        f"with others=({name!r},)"
                    )
            if loop is not None:
                loop = loop._replace(**{k: v for k, v in key if k in gains})
            found = Given(
                plant_of, known, others=others, loop=loop, pade_order=order,
                values={k: v for k, v in key if k in known},
            )  # fmt: skip
            if found.shape != self.shape:
                raise ValueError(
                    "params: a lag, a dead time, friction or presliding cannot come or go; "
                    "build the blocks of another model"
                )
            self._varied[key] = found
        return self._varied[key]


class Names(NamedTuple):
    """What blocks and signals of a drive are called, part by part."""

    inputs: Sequence[tuple[str, str, str]]  # block, command, what acts on the motor
    groups: Sequence[str]  # block of each coordinate
    friction: Sequence[str]  # of each coordinate, what its friction's block and signals end in
    motion: tuple[str, str]  # position and speed, states of a coordinate
    bodies: Sequence[tuple[str, str]]  # position, speed
    links: Sequence[tuple[str, str, str]]  # block, torque, twist
    sensors: Mapping[str, Mapping[int, str]]  # block -> {number of a sensor: its reading}


def _input_block(given: Given, names: Names, j: int) -> ct.NonlinearIOSystem:
    """One motor's drive: dead time, effects, limit, lag."""
    block, command, acting = names.inputs[j]
    order, lagged = given.dead[j].order, given.lags[j]

    def aim(given, t, x, u):
        signal = given.parts.signal(j, given.dead[j].output(x[:order], float(u[0])), t)
        return given.parts.lag(j, signal)

    def update(t, x, u, params):
        own = given.at(params)
        rate = own.dead[j].rate(x[:order], u[0])
        if lagged:
            goal, tau = aim(own, t, x, u)
            rate = np.append(rate, (goal - x[order]) / tau)
        return rate

    def output(t, x, u, params):
        return [x[order] if lagged else aim(given.at(params), t, x, u)[0]]

    return ct.NonlinearIOSystem(
        update, output, inputs=[command], outputs=[acting],
        states=given.dead[j].states + ["lag"] * lagged, name=block,
    )  # fmt: skip


def _link_block(given: Given, names: Names, k: int) -> ct.NonlinearIOSystem:
    """One shaft or mesh: its torque at the first body, positive drives the second; its twist.

    Where the contact law has it, the position in the gap [rad] is a state.
    """
    block, *outputs = names.links[k]
    stateful = given.parts.laws_of_links[k] == TWO_STATES

    def placed(own, x, u):
        z, rate, law = own.parts.twist(k, *u.tolist())
        inside = min(max(float(x[0]), -law.half_gap), law.half_gap) if stateful else 0.0
        return inside, z, rate, law

    def output(t, x, u, params):
        own = given.at(params)
        inside, z, rate, law = placed(own, x, u)
        turned = u[0] - own.parts.links[k][0] * u[2]
        return [own.parts.link_torque(k, z, rate, law, inside), turned]

    return ct.NonlinearIOSystem(
        (lambda t, x, u, params: [gap_rate(*placed(given.at(params), x, u))]) if stateful else None,
        output,
        inputs=[name for b in given.parts.ends[k] for name in names.bodies[b]],
        outputs=outputs,
        states=["position"] if stateful else None,
        name=block,
    )


def _body_block(given: Given, names: Names, g: int) -> ct.NonlinearIOSystem:
    """Bodies that turn together: what motors, links and effects bring, on their inertia.

    Its friction is a block of its own: the torque without it goes out, and comes back as
    friction and whether that holds.
    """
    bodies = given.parts.bodies[g]
    inputs = [j for j, b in enumerate(given.parts.driven) if b in bodies]
    links = _links_of(given, bodies)
    rubs, on = bool(given.parts.rubbing[g]), names.friction[g]

    def net(parts, t, x, u):
        q, v = x.tolist()
        acting = dict(zip(inputs, u.tolist(), strict=False))
        torques = dict(zip(links, u[len(inputs) :].tolist(), strict=False))
        return parts.force(g, q, v, t, acting, torques)

    def update(t, x, u, params):
        parts = given.at(params).parts
        if rubs and u[-1]:
            return [0.0, 0.0]
        return [x[1], (net(parts, t, x, u) - (u[-2] if rubs else 0.0)) / parts.inertia[g]]

    def output(t, x, u, params):
        parts = given.at(params).parts
        motion = [parts.ratio[b] * s for b in bodies for s in x]
        return [*motion, net(parts, t, x, u)] if rubs else motion

    torques = [*(names.inputs[j][2] for j in inputs), *(names.links[k][1] for k in links)]
    return ct.NonlinearIOSystem(
        update,
        output,
        inputs=torques + [f"friction_torque_{on}", f"held_{on}"] * rubs,
        outputs=[name for b in bodies for name in names.bodies[b]] + [f"net_{on}"] * rubs,
        states=list(names.motion),
        name=names.groups[g],
    )


def _friction_block(given: Given, names: Names, g: int) -> ct.NonlinearIOSystem:
    """Friction of bodies that turn together, by the kernels: sliding, sticking or presliding.

    In: the torque on them without friction, their motion, and where an effect makes friction
    depend on load the torques of links. Out: friction, and 1 where it holds them.
    """
    bodies, rubbing, on = given.parts.bodies[g], given.parts.rubbing[g], names.friction[g]
    links = _links_of(given, bodies) if any(given.parts.at("friction", b) for b in rubbing) else []
    aged = [b for b in rubbing if given.parts.dwell(b, 0.0)[1] > 0.0]
    elastic = given.parts.elastic[g] is not None

    def placed(parts, x, u):
        net, turned, rate = u[:3].tolist()
        ratio = parts.ratio[rubbing[0]]
        q, v = turned / ratio, rate / ratio
        torques = dict(zip(links, u[3:].tolist(), strict=True))
        return net, q, v, torques, dict(zip(aged, x[elastic:].tolist(), strict=True))

    def rub(parts, t, x, u):
        """Friction, whether it holds, and the rate of its bristles."""
        net, q, v, *rest = placed(parts, x, u)
        way = 1.0 if v >= 0.0 else -1.0
        if elastic:
            slides = parts.friction(g, way, q, v, t, *rest, moving=True)
            level, built_up = parts.presliding(g, way, v, slides, float(x[0]))
            return level, 0.0, built_up
        if abs(v) <= REST_SPEED:
            side = 1.0 if net > 0.0 else -1.0
            most = parts.friction(g, side, q, 0.0, t, *rest, moving=False)[0]
            if most > 0.0:
                held = abs(net) <= most
                return (net, 1.0, 0.0) if held else (side * most, 0.0, 0.0)
        return way * parts.friction(g, way, q, v, t, *rest, moving=True)[0], 0.0, 0.0

    def update(t, x, u, params):
        parts = given.at(params).parts
        _, _, v, _, ages = placed(parts, x, u)
        older = [parts.ageing_rate(b, v, age) for b, age in ages.items()]
        return [rub(parts, t, x, u)[2], *older] if elastic else older

    return ct.NonlinearIOSystem(
        update,
        lambda t, x, u, params: rub(given.at(params).parts, t, x, u)[:2],
        inputs=[f"net_{on}", *names.bodies[rubbing[0]], *(names.links[k][1] for k in links)],
        outputs=[f"friction_torque_{on}", f"held_{on}"],
        states=["bristle"] * elastic + (["age"] if len(aged) == 1 else [f"age_{b}" for b in aged]),
        name=f"friction_{on}",
    )


def _links_of(given: Given, bodies: Sequence[int]) -> list[int]:
    return sorted({k for b in bodies for k, _ in given.parts.ends_of[b]})


def _sensor_block(given: Given, names: Names, block: str) -> ct.NonlinearIOSystem:
    """Sensors of one body: its true motion in, the readings out."""
    readings = names.sensors[block]
    speeds = given.parts.plant.sensor_speed
    (body,) = {int(given.parts.plant.sensor_body[i]) for i in readings}
    states = [name for i in readings for name in given.late[i].states]

    def split(x):
        at = 0
        for i in readings:
            order = given.late[i].order
            yield i, int(speeds[i]), x[at : at + order]
            at += order

    def output(t, x, u, params):
        own, found = given.at(params), []
        for i, speed, stored in split(x):
            motion = u.tolist()
            motion[speed] = own.late[i].output(stored, motion[speed])
            found.append(own.parts.reading(i, motion[0], motion[1], t))
        return found

    def update(t, x, u, params):
        late = given.at(params).late
        return np.concatenate([late[i].rate(stored, u[speed]) for i, speed, stored in split(x)])

    return ct.NonlinearIOSystem(
        update, output, inputs=list(names.bodies[body]), outputs=list(readings.values()),
        states=states, name=block,
    )  # fmt: skip


def pi_block(given: Given) -> ct.NonlinearIOSystem:
    """Return the PI speed loop in continuous time, G_c = kp + ki/s, with clip and preload.

    Inputs ref, omega_L [rad/s], outputs u_left, u_right [V]; state ∫(ref − omega_L) dt.
    Source: paper section 4.3; sampled at 1 kHz in the rig, see `compiled.close_loop`.
    """

    def output(t, x, u, params):
        loop = given.at(params).loop
        assert loop is not None
        common = loop.kp * (u[0] - u[1]) + loop.ki * x[0]
        common = min(max(common, -loop.limit), loop.limit)
        return [common + loop.bias_l, common + loop.bias_r]

    return ct.NonlinearIOSystem(
        lambda t, x, u, params: [u[0] - u[1]],
        output,
        inputs=["ref", "omega_L"],
        outputs=["u_left", "u_right"],
        states=["integral"],
        name="pi",
    )


def part_blocks(given: Given, names: Names) -> list[ct.NonlinearIOSystem]:
    coordinates, _, links, inputs, _ = given.parts.plant.size
    return [
        *(_input_block(given, names, j) for j in range(inputs)),
        *(_body_block(given, names, g) for g in range(coordinates)),
        *(_friction_block(given, names, g) for g in range(coordinates) if given.parts.rubbing[g]),
        *(_link_block(given, names, k) for k in range(links)),
        *(_sensor_block(given, names, block) for block in names.sensors),
    ]
