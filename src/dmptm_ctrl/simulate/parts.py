"""The parts of a plant in plain Python, one by one: for the blocks and the reference.

They call the same kernels as the generated step, and share no other code with it.
"""

from collections.abc import Callable, Mapping
from typing import Any

from dmptm_ctrl.effects import backlash, presliding, stribeck
from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.effects.stribeck import stribeck_law
from dmptm_ctrl.simulate.plant import CALLED, ELASTIC_IMPACT, GAP, LINEAR, TWO_STATES, Plant

TINY = 1e-300  # a speed that has a direction and no size


def uncompiled(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return the plain Python function of a numba kernel."""
    return getattr(kernel, "py_func", kernel)


mesh_region, mesh_torque = backlash.mesh_region, backlash.mesh_torque
region_torque = uncompiled(backlash.region_torque)
_breakaway = uncompiled(stribeck.breakaway_torque)
_sliding = uncompiled(stribeck.sliding_torque)
_viscous = uncompiled(stribeck.viscous_torque)
_build_up_distance = uncompiled(presliding.build_up_distance)
_fading = uncompiled(presliding.fading)


class Parts:
    """What the kernels say about each part of a plant."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant
        self.laws = [stribeck_law(*row) for row in plant.law.tolist()]
        self.ratio = plant.body_ratio.tolist()
        self.group = plant.body_coordinate.tolist()
        self.inertia = plant.inertia.tolist()
        self.links = [tuple(row) for row in plant.link_values.tolist()]
        self.ends = [tuple(row) for row in plant.link_body.tolist()]
        self.laws_of_links = plant.link_gap.tolist()
        # links at each body, and which of their ends it is
        self.ends_of = [
            [(k, end) for k, ends in enumerate(self.ends) for end in (0, 1) if ends[end] == b]
            for b in range(len(self.group))
        ]
        self.inputs = [tuple(row) for row in plant.input_values.tolist()]
        self.driven = plant.input_body.tolist()
        self.inputs_of = [
            [j for j, b in enumerate(self.driven) if b == body] for body in range(len(self.group))
        ]
        self.bodies = [
            [b for b, own in enumerate(self.group) if own == g] for g in range(plant.inertia.size)
        ]
        self._acting: dict[tuple[str, int], list[tuple[Callable[..., Any], int, Any]]] = {}
        for place in plant.places:
            if place.effect.site in CALLED and plant.on[place.flag]:
                count = len(place.effect.parameters)
                row = plant.values[place.first : place.first + count].tolist()
                found = self._acting.setdefault((place.effect.site, place.part), [])
                values = place.effect.values(*row)
                found.append((uncompiled(place.effect.kernel), place.side, values))
        self.rubbing = [[b for b in own if self.rubs(b)] for own in self.bodies]
        self.elastic = [
            next((b for b in own if plant.bristles[b, 0] > 0.0), None) for own in self.bodies
        ]

    def at(self, site: str, index: int) -> list[tuple[Callable[..., Any], int, Any]]:
        """Kernel, its side and its parameters, of the effects at a place."""
        return self._acting.get((site, index), [])

    def signal(self, j: int, u: float, t: float) -> float:
        """Signal of an input after the effects on it and its limit."""
        for kernel, side, p in self.at("amplifier", j):
            u = kernel(u, t, side, p)
        limit = self.inputs[j][3]
        return min(limit, max(-limit, u)) if limit > 0.0 else u

    def lag(self, j: int, u: float) -> tuple[float, float]:
        """Where the acting signal of an input relaxes to, and its time constant [s]."""
        tau = self.inputs[j][2]
        for kernel, side, p in self.at("lag", j):
            u, more = kernel(u, side, p)
            tau += more
        return u, tau

    def twist(self, k: int, q1: float, v1: float, q2: float, v2: float):
        """Twist of a link, its rate and its :class:`Backlash`, by the motion of its bodies."""
        ratio, stiffness, damping, gap_damping, half_gap = self.links[k]
        z, rate = q1 - ratio * q2, v1 - ratio * v2
        for kernel, side, p in self.at("mesh", k):
            shift = kernel(q1, v1, q2, v2, side, p)
            z, rate = z + shift[0], rate + shift[1]
            half_gap, stiffness = half_gap + shift[2], stiffness + shift[3]
        return z, rate, Backlash(stiffness, damping, gap_damping, max(half_gap, 0.0))

    def link_torque(self, k: int, z: float, rate: float, law: Backlash, inside: float = 0.0):
        """Torque of a link at its first body [N·m]; `inside` is its place in the gap."""
        kind = self.laws_of_links[k]
        if kind == LINEAR:
            return law.stiffness * z + law.damping * rate
        if kind == GAP:
            return mesh_torque(z, rate, law)
        if kind == TWO_STATES:
            return backlash.twist_torque(inside, z, rate, law)
        assert kind == ELASTIC_IMPACT
        return backlash.impact_torque(z, rate, law)

    def torque(self, b: int, volts: float, theta: float, omega: float, t: float) -> float:
        """Torque that effects add on a body [N·m]."""
        added = 0.0
        for kernel, side, p in self.at("motor", b):
            added += kernel(volts, theta, omega, t, side, p)
        for kernel, _, p in self.at("load", b):
            added += kernel(theta, omega, t, p)
        return added

    def reading(self, i: int, position: float, speed: float, t: float) -> float:
        """What a sensor reads of the motion of its body, without its dead time."""
        for kernel, _, p in self.at("sensor", i):
            position, speed = kernel(position, speed, t, p)
        return speed if self.plant.sensor_speed[i] else position

    def rubs(self, b: int) -> bool:
        """Whether a body has any friction."""
        kinds = (self.at(site, b) for site in ("friction", "dwell"))
        return bool(self.plant.rubs[b]) or any(kinds)

    def dwell(self, b: int, age: float) -> tuple[float, float]:
        """Coulomb torque added at the age of a contact [N·m], slip that makes it new [rad]."""
        added, slip = 0.0, 0.0
        for kernel, side, p in self.at("dwell", b):
            torque, distance = kernel(age, side, p)
            added, slip = added + torque, max(slip, distance)
        return added, slip

    def level(self, b: int, theta: float, omega: float, t: float, load: float, age: float):
        """Factor on the friction law of a body, and Coulomb torque beside it [N·m].

        The factor acts on what other effects add as well: a warm bearing has less of all friction.
        """
        scale, added = 1.0, self.dwell(b, age)[0]
        for kernel, side, p in self.at("friction", b):
            factor, more = kernel(theta, omega, t, load, side, p)
            scale, added = scale * factor, added + more
        return scale, scale * added

    def holding(self, b: int, way: float, theta: float, t: float, load: float, age: float) -> float:
        """Largest friction of a body at rest against motion in a direction [N·m]."""
        scale, added = self.level(b, theta, way * TINY, t, load, age)
        law = _breakaway(way, self.laws[b]) if self.plant.rubs[b] else 0.0
        return max(scale * law + added, 0.0)

    def sliding(
        self, b: int, way: float, theta: float, omega: float, t: float, load: float, age: float
    ) -> tuple[float, float]:
        """Magnitude of friction of a body in motion, and its viscous part [N·m]."""
        scale, added = self.level(b, theta, way * max(omega * way, TINY), t, load, age)
        if not self.plant.rubs[b]:
            return max(added, 0.0), 0.0
        law = self.laws[b]
        return (
            max(scale * _sliding(omega, way, law) + added, 0.0),
            scale * _viscous(omega, way, law),
        )

    def bristle(self, b: int) -> tuple[float, float, float]:
        """Relaxation distance [rad], share of viscous friction at once, lag [s] of a body."""
        distance, share, damping = self.plant.bristles[b].tolist()
        inertia = self.inertia[self.group[b]] / self.ratio[b] ** 2
        return distance, share, presliding.bristle_lag(distance, damping, inertia, self.law(b))

    def law(self, b: int) -> stribeck.Stribeck:
        """Friction law of a body; one without friction where none is declared."""
        if self.plant.rubs[b]:
            return self.laws[b]
        return stribeck_law(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)

    def force(
        self, g: int, q: float, v: float, t: float, acting: Mapping[int, float],
        torques: Mapping[int, float],
    ) -> float:  # fmt: skip
        """Net torque on a coordinate without friction.

        `acting` are signals by input, `torques` those of links at their first bodies.
        """
        net = 0.0
        for b in self.bodies[g]:
            r = self.ratio[b]
            own = self.inputs_of[b]
            for j in own:
                net += r * self.inputs[j][0] * acting[j]
            for k, end in self.ends_of[b]:
                net += r * (self.links[k][0] * torques[k] if end else -torques[k])
            net += r * self.torque(b, acting[own[0]] if own else 0.0, r * q, r * v, t)
        return net

    def load(self, b: int, torques: Mapping[int, float]) -> float:
        """What the links given carry, which presses on the bearings of a body [N·m]."""
        return sum(
            abs(self.links[k][0] * torques[k] if end else torques[k])
            for k, end in self.ends_of[b]
            if k in torques and self.plant.link_load[k]
        )

    def friction(
        self, g: int, way: float, q: float, v: float, t: float, torques: Mapping[int, float],
        ages: Mapping[int, float], *, moving: bool,
    ) -> tuple[float, float]:  # fmt: skip
        """Magnitude of friction on a coordinate, and its part that presliding lets act at once."""
        whole, viscous = 0.0, 0.0
        for b in self.rubbing[g]:
            r = self.ratio[b]
            given = way if r > 0.0 else -way, r * q
            rest = t, self.load(b, torques), ages.get(b, 0.0)
            if moving:
                level, own = self.sliding(b, *given, r * v, *rest)
                whole += abs(r) * level
                viscous += abs(r) * own
            else:
                whole += abs(r) * self.holding(b, *given, *rest)
        return whole, viscous

    def presliding(
        self, g: int, way: float, v: float, friction: tuple[float, float], bristle: float
    ) -> tuple[float, float]:
        """Friction of a coordinate with bristles, and the rate at which they build up.

        `friction` is that of sliding, as :meth:`friction` gives it.
        """
        b = self.elastic[g]
        assert b is not None
        distance, share, lag = self.bristle(b)
        law, at_once = self.law(b), way * share * friction[1]
        level = way * friction[0] - at_once
        span = _build_up_distance(distance / abs(self.ratio[b]), level, law)
        rate = abs(v) * (level - bristle) / span
        return bristle + at_once + lag * _fading(v, way, law) * rate, rate

    def ageing_rate(self, b: int, v: float, age: float) -> float:
        """Rate of the age of a contact [s/s] at the speed of its coordinate."""
        slip = self.dwell(b, age)[1]
        return 1.0 - abs(self.ratio[b] * v) / slip * age if slip > 0.0 else 0.0
