"""Balance of torques: what the drives gave against what the motion must have taken.

For each coordinate whose motion is measured,

    Σ gain · u − (J a + friction + load torques + torques of links) = residual,

all low-passed alike. Coordinates that are not measured are simulated between the measured
ones, driven by the same signals.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.identify.following import followed, loaded, loads_of
from dmptm_ctrl.identify.measured_motion import (
    HELD_POSITION,
    HELD_SPEED,
    Floats,
    Motion,
    Sight,
    acceleration_bandwidth,
    at_samples,
    coordinates_of,
    derivative,
    prepare,
)
from dmptm_ctrl.identify.reading_noise import spectrum
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.along import (
    acting_of,
    built_up_along,
    delayed_along,
    friction_along,
    lagged_along,
    law_along,
    signal_along,
    torque_along,
)
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import RigRun, march, substeps_for

TINY = 1e-300  # a speed that has a direction and no size
LEAST_DRIVE = 0.05  # of the logged signal gets through to a motor at least
TAIL = 0.005  # of the twists, beyond the ends of the gap and its wind-up
LOADED = 3  # times that friction under load is taken from the load that it leaves
RECENT = 16  # frictions of bodies that are kept
SUBSTEPS = 40  # of hidden coordinates; faster ones are far above the bandwidth


@dataclass(frozen=True)
class Point:
    """A place that sensors see: one encoder's position and speed belong together.

    Attributes
    ----------
    name : str
        Of the sensor that gives the acceleration.
    """

    name: str
    body: str
    sight: Sight
    sensors: tuple[str, ...]


def points_of(rig: Rig, logs: Sequence[Log]) -> tuple[Point, ...]:
    """Group the sensors of a rig into points, those of the driven body first.

    A second position (or speed) sensor on a body is a point of its own: a shaft may lie
    between the two.
    """
    found: list[Point] = []
    reach = {s.name: acceleration_bandwidth(s, logs) for s in rig.sensors}
    for body in rig.bodies:
        groups: list[list[Sensor]] = []
        for sensor in (s for s in rig.sensors if s.body == body.name):
            for group in groups:
                if all(s.measures != sensor.measures for s in group):
                    group.append(sensor)
                    break
            else:
                groups.append([sensor])
        for group in groups:
            best = max(group, key=lambda s: reach[s.name][0])
            angle = next((s for s in group if s.measures == "position"), None)
            sight = Sight(best, angle, *reach[best.name])
            found.append(Point(best.name, body.name, sight, tuple(s.name for s in group)))
    driven = [i.body for i in rig.inputs]
    return tuple(sorted(found, key=lambda p: p.body not in driven))


@dataclass(frozen=True)
class Balance:
    """Logs of a rig, ready to be balanced.

    Attributes
    ----------
    bandwidth : float
        Of the balance [Hz].
    motions : tuple of Motion
        One per log, keyed by the points' names.
    closed : frozenset of str
        Links beyond which hidden bodies follow the measured ones, see :mod:`.following`.
    """

    rig: Rig
    points: tuple[Point, ...]
    bandwidth: float
    motions: tuple[Motion, ...]
    closed: frozenset[str] = frozenset()
    known: dict[Any, Floats] = field(default_factory=dict)  # twists that were asked for

    @cached_property
    def push(self) -> list[Floats]:
        """Driving torque per log as commanded, a gain that is unknown counted as 1, (n,) each."""
        gains = {i.name: i.gain.value if isfinite(i.gain.value) else 1.0 for i in self.rig.inputs}
        return [np.sum([gains[k] * u for k, u in m.u.items()], axis=0) for m in self.motions]

    @cached_property
    def heft(self) -> float:
        """Torque per acceleration in the logs: turns accelerations into torques of their size.

        No fitted inertia does: the smaller it got, the less would seem to be left.
        """
        first = self.points[0].name
        moved = [m.a[first] for m in self.motions]
        force, acceleration = (
            float(np.sqrt(np.mean(np.concatenate(x) ** 2))) for x in (self.push, moved)
        )
        return force / acceleration if acceleration > 0 else 1.0

    @cached_property
    def noise_spectrum(self) -> tuple[NDArray[np.complex128], Floats]:
        """Noise of readings in the band of the balance; see :func:`.reading_noise.spectrum`."""
        return spectrum(self)

    def twists(self, factors: tuple[tuple[str, float], ...]) -> Floats:
        """Sizes of a twist from the middle of its range, sorted; by points and their factors."""
        if factors not in self.known:
            sizes = []
            for m in self.motions:
                z = sum(factor * m.q[name] for name, factor in factors)
                sizes.append(np.abs(z - 0.5 * np.quantile(z, [TAIL, 1.0 - TAIL]).sum()))
            self.known[factors] = np.sort(np.concatenate(sizes))
        return self.known[factors]

    def only(self, names: Sequence[str]) -> "Balance":
        """Return the balance of some of the logs."""
        kept = tuple(m for m in self.motions if m.name in names)
        return Balance(self.rig, self.points, self.bandwidth, kept, self.closed)

    def part(self, part: str) -> "Balance":
        """Return the balance of the "fit" or "held-out" stretches of every log."""
        cut = tuple(replace(m, part=part) for m in self.motions)
        return Balance(self.rig, self.points, self.bandwidth, cut, self.closed)


def balance_of(rig: Rig, logs: Sequence[Log], *, bandwidth: float | None = None) -> Balance:
    """Filter logs into motions, at the bandwidth that the poorest point allows.

    And up to which hidden bodies follow the measured ones.
    """
    points = points_of(rig, logs)
    closed, follows = followed(rig, (p.name for p in points))
    if bandwidth is None:
        bandwidth = min(follows, *(p.sight.bandwidth for p in points))
    sights = {p.name: p.sight for p in points}
    motions = tuple(prepare(log, rig, sights, bandwidth) for log in logs)
    return Balance(rig, points, bandwidth, motions, closed)


@dataclass(frozen=True)
class Nuisance:
    """What belongs to a log and not to the rig.

    Attributes
    ----------
    zero : dict of effect key to float
        Added to the measured angle for an effect that depends on it [rad]: an incremental
        encoder starts anywhere.
    twist : dict of link to float
        Twist that the sensors on both sides show without torque [rad].
    """

    zero: Mapping[str, float] = field(default_factory=dict)
    twist: Mapping[str, float] = field(default_factory=dict)


NONE = Nuisance()
Moves = dict[int, tuple[Floats, Floats, Floats]]  # coordinate -> position, speed, acceleration


def residual(
    model: RigModel, balance: Balance, motion: Motion, nuisance: Nuisance = NONE
) -> tuple[Floats, Floats]:
    """Return what the model leaves, and the driving torque.

    Returns
    -------
    left : (equations, rows) array
        One per point. First the balance of all measured coordinates together, seen at the
        driven one; then what each further point accelerates otherwise than the model says, as
        the torque that takes as much acceleration in these logs: by the torques on
        its own coordinate, or, where a point before it shows that coordinate, than that one.
    drive : (rows,) array
        Driving torque or force of the first equation.
    """
    layout, plant = model.layout, model.plant()
    measured, _ = measured_motion(model, balance, motion, nuisance)
    runs = _links(model, motion, measured, nuisance) if layout.links else None
    load = {b: np.zeros(motion.time.size) for b in layout.bodies}
    pushes, volts = [], {}
    for j, name in enumerate(layout.inputs):
        body = layout.input_body[name]
        volts[body] = effective_input(model, motion, name)
        pushes.append((body, plant.input_values[j, 0] * volts[body]))
    if runs is not None:
        for k, name in enumerate(layout.links):
            first, second = (layout.bodies[i] for i in plant.link_body[k])
            load[first] += np.abs(runs[name])
            load[second] += np.abs(plant.link_values[k, 0] * runs[name])

    def braked(body: str) -> Floats:
        group = layout.coordinate[body]
        q, v, _ = measured[group]
        rubs, other = _friction(model, motion, group, q, v, load, volts, nuisance, body)
        return (rubs + other) / layout.ratio[body]

    for _ in range(LOADED if model.closed and loaded(model) else 0):
        load |= loads_of(model, measured, dict(pushes), braked)
    reach = untwisted(plant)
    total, push = np.zeros_like(motion.time), np.zeros_like(motion.time)
    single = []
    for group, (q, v, a) in measured.items():
        friction, other = _friction(model, motion, group, q, v, load, volts, nuisance)
        need = plant.inertia[group] * a + other
        own = np.zeros_like(need)
        for body, torque in pushes:
            if layout.coordinate[body] == group:
                own = own + layout.ratio[body] * torque
        for k, name in enumerate(layout.links):
            assert runs is not None
            first, second = (layout.bodies[i] for i in plant.link_body[k])
            if layout.coordinate[first] == group:
                need = need + layout.ratio[first] * runs[name]
            if layout.coordinate[second] == group:
                need = need - layout.ratio[second] * plant.link_values[k, 0] * runs[name]
        need = need + _at_rest(friction, own - need, v, motion.rest_share)
        total += reach[group] * need
        push += reach[group] * own
        # as acceleration: as a torque, no inertia and no spring would leave nothing
        single.append((own - need) * balance.heft / (reach[group] * plant.inertia[group]))
    if len(layout.inputs) == 1:
        total = _ahead(total, motion, *plant.input_values[0, 1:3])
    logged = sum(
        reach[layout.coordinate[b]] * layout.ratio[b] * plant.input_values[j, 0] * motion.u[name]
        for j, (name, b) in enumerate(layout.input_body.items())
        if layout.coordinate[b] in measured
    )
    # A drive that clips or drops part of its signal must not look better for it.
    size = float(np.std(push))
    sent = float(np.std(logged))
    if sent > 0 and size < LEAST_DRIVE * sent:
        raise ArithmeticError("hardly anything of the drive's signal would get through")
    fair = sent / size if sent > 0 else 1.0
    alone = dict(zip(measured, single, strict=True))
    equations = [fair * (push - total)]
    seen = coordinates_of(layout, [p.name for p in balance.points])
    for k, point in enumerate(balance.points):
        group, r = seen[k], layout.ratio[layout.sensor_body[point.name]]
        if group in seen[:k]:
            # rigidly tied to a point before it: as fast, whatever moves them
            apart = motion.a[point.name] / r - measured[group][2]
            equations.append(apart * balance.heft / reach[group])
        elif k > 0:
            equations.append(alone[group])
    return np.array([motion.reduce(e) for e in equations]), motion.reduce(fair * push)


def _ahead(need: Floats, motion: Motion, dead: float, tau: float) -> Floats:
    """What the drive must be told for `need`, its dead time and lag undone."""
    if tau > 0:
        need = need + tau * derivative(need, motion.dt)
    if dead > 0:
        need = np.interp(motion.time + dead, motion.time, need)
    return need


def measured_motion(
    model: RigModel, balance: Balance, motion: Motion, nuisance: Nuisance = NONE
) -> tuple[Moves, dict[int, str]]:
    """Return the motion of each measured coordinate, and the body that it was measured at.

    Where the driven coordinate has no sensor and a spring leads to one that has, its motion
    follows from the torque that the measured one takes.
    """
    layout = model.layout
    found: Moves = {}
    bodies: dict[int, str] = {}
    for point in balance.points:
        body = layout.sensor_body[point.name]
        group, r = layout.coordinate[body], layout.ratio[body]
        if group not in found:
            found[group] = motion.at(point.name, r)
            bodies[group] = body
    if 0 not in found:
        driven = _through_spring(model, motion, found, nuisance)
        if driven is not None:
            at = layout.input_body[layout.inputs[0]]
            return {0: driven, **found}, {0: at, **bodies}
    return found, bodies


def _through_spring(
    model: RigModel, motion: Motion, found: Moves, nuisance: Nuisance
) -> tuple[Floats, Floats, Floats] | None:
    """Motion of the driven coordinate from that at the other end of its spring."""
    layout, plant = model.layout, model.plant()
    for k in range(len(layout.links)):
        ends = [layout.bodies[i] for i in plant.link_body[k]]
        groups = [layout.coordinate[b] for b in ends]
        ratio, stiffness, damping = plant.link_values[k, :3]
        if plant.link_gap[k] or 0 not in groups or not {*groups} & {*found}:
            continue
        other = groups[1] if groups[0] == 0 else groups[0]
        q, v, a = found[other]
        nothing = {b: np.zeros_like(q) for b in layout.bodies}
        need = plant.inertia[other] * a
        need = need + sum(_friction(model, motion, other, q, v, nothing, {}, nuisance))
        # lever of each end on the twist z = r1 q1 − ratio r2 q2
        lever = [layout.ratio[ends[0]], -ratio * layout.ratio[ends[1]]]
        here, there = (0, 1) if groups[0] == 0 else (1, 0)
        torque = -need / lever[there]
        # k z + c ż = torque; c/k is short
        z = (torque - damping / stiffness * derivative(torque, motion.dt)) / stiffness
        rate = derivative(z, motion.dt)
        change = derivative(rate, motion.dt)
        return tuple(
            (part - lever[there] * far) / lever[here]
            for part, far in ((z, q), (rate, v), (change, a))
        )
    return None


def _links(
    model: RigModel, motion: Motion, measured: Moves, nuisance: Nuisance
) -> dict[str, Floats]:
    """Torque of every link along the log; coordinates without sensors are simulated."""
    run = hidden_run(model, motion, measured, nuisance)
    return {name: run.link(name) for name in model.layout.links}


def hidden_run(model: RigModel, motion: Motion, measured: Moves, nuisance: Nuisance) -> RigRun:
    """Run the coordinates that nothing measures along the measured ones."""
    layout = model.layout
    reach = untwisted(model.plant())
    given, position, speed = {}, {}, {}
    base_group = next(iter(measured))
    q0, v0 = measured[base_group][0][0], measured[base_group][1][0]
    for body in layout.bodies:
        group, r = layout.coordinate[body], layout.ratio[body]
        if group in measured:
            q, v, _ = measured[group]
            twist = sum(
                value for link, value in nuisance.twist.items()
                if link in layout.links and _second(model, link) == body
            )  # fmt: skip
            given[body] = r * q + twist, r * v
        else:
            # in step with the measured ones at the start
            position[body] = r * q0 * reach[group] / reach[base_group]
            speed[body] = r * v0 * reach[group] / reach[base_group]
    shared = {layout.coordinate[b]: b for b in given}
    u = np.array([motion.u[name] for name in layout.inputs])
    everything = len(measured) == layout.coordinates
    return march(
        model.shifted(nuisance.zero) if nuisance.zero else model,
        u,
        motion.dt,
        position=position,
        speed=speed,
        given={b: given[b] for b in shared.values()},
        substeps=1 if everything else min(substeps_for(model.plant(), motion.dt), SUBSTEPS),
    )


def _second(model: RigModel, link: str) -> str:
    plant, layout = model.plant(), model.layout
    return layout.bodies[plant.link_body[layout.links.index(link), 1]]


def _friction(
    model: RigModel,
    motion: Motion,
    group: int,
    q: Floats,
    v: Floats,
    load: Mapping[str, Floats],
    volts: Mapping[str, Floats],
    nuisance: Nuisance,
    only: str = "",
) -> tuple[Floats, Floats]:
    """Friction, and load torques, of a coordinate, signed against the motion (to be overcome).

    Of all its bodies, or of one.
    """
    layout, plant = model.layout, model.plant()
    friction, other, none = np.zeros_like(v), np.zeros_like(v), np.zeros_like(v)
    for k, body in enumerate(layout.bodies):
        if layout.coordinate[body] != group or only not in ("", body):
            continue
        r, level = layout.ratio[body], _sliding(motion, v, layout.ratio[body], plant.law[k])
        acting = [e for e in model.effects if e.on == body]
        angle, omega = (r * q, r * _nowhere_still(v)) if acting else (q, v)
        factor: Floats | float = 1.0
        more: Floats | float = 0.0
        for effect in acting:
            chain = PLACED_CATALOGUE[effect.name]
            theta = angle + nuisance.zero.get(effect.key, 0.0)
            if chain.site == "friction":
                moves = theta, omega, motion.time, load[body]
                scale, added = friction_along([acting_of(effect)], *moves)
                factor = factor * scale
                more = more + np.sign(omega) * added
            elif chain.site in ("motor", "load"):
                moves = volts.get(body, none), theta, omega, motion.time
                other -= r * torque_along([acting_of(effect)], *moves)
        friction += factor * (level + r * more)
    for k in np.flatnonzero(plant.bristles[:, 0]).tolist():
        if plant.body_coordinate[k] == group:
            bristles = plant.bristles[k, 0] / abs(plant.body_ratio[k]), plant.bristles[k, 1]
            begins, travel = np.zeros(1, np.int64), np.gradient(q)
            friction = built_up_along(
                friction, _nowhere_still(v), travel, begins, bristles, plant.law[k]
            )
            break  # one body's bristles carry what rubs on all that are tied to it
    return friction, other


def _nowhere_still(v: Floats) -> Floats:
    """Speed with a direction everywhere: friction at rest has a size, if no direction."""
    return np.where(v == 0.0, TINY, v)


def _sliding(motion: Motion, v: Floats, ratio: float, law: Floats) -> Floats | float:
    """Friction of a body at its coordinate; kept along measured motion, for fits ask again."""
    if not np.any(law[[0, 1, 3, 4, 5, 7]]):
        return 0.0
    kept, key = motion.known.get(id(v), {}), (ratio, law.tobytes())
    found: Floats | None = kept.get(key)
    if found is None:
        found = ratio * law_along(ratio * _nowhere_still(v), law)
        for old in list(kept)[: max(len(kept) - RECENT, 0)]:
            kept.pop(old, None)
        kept[key] = found
    return found


def _at_rest(friction: Floats, needed: Floats, v: Floats, share: float) -> Floats:
    """Friction with the set-valued part at rest: whatever holds the body, up to its level."""
    level = np.abs(friction)
    return np.where(resting(v, share), np.clip(needed, -level, level), friction)


def resting(v: Floats, share: float) -> NDArray[np.bool_]:
    """Where a body counts as at rest: friction there is whatever holds it."""
    return np.asarray(np.abs(v) < share * np.abs(v).max(initial=0.0))


def effective_input(model: RigModel, motion: Motion, name: str) -> Floats:
    """Signal of an input as it acts, at the samples, (n,): effects and limit applied.

    The logged signal is held from each sample to the next. Dead time and lag are undone on the
    other side of the balance where there is one input (`_ahead`), and applied here where there
    are several.
    """
    signal = motion.u[name]
    for effect in model.effects:
        if effect.on == name and PLACED_CATALOGUE[effect.name].site == "drive":
            signal = signal_along([acting_of(effect)], signal, motion.time)
    j = model.layout.inputs.index(name)
    _, dead, tau, limit = model.plant().input_values[j]
    if limit > 0:
        signal = np.clip(signal, -limit, limit)
    if len(model.layout.inputs) > 1 and dead + tau > 0:
        before = float(signal[0])
        signal = delayed_along(signal, dead / motion.dt, before)
        signal = lagged_along(signal, np.full_like(signal, tau), motion.dt, before)
    return at_samples(signal, HELD_SPEED if motion.by_speed else HELD_POSITION)
