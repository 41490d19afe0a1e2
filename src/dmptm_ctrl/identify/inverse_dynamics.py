"""Balance of torques: what the drives gave against what the motion must have taken.

For each coordinate whose motion is measured,

    Σ gain · u − (J a + friction + load torques + torques of links) = residual,

all low-passed alike. Coordinates that are not measured are simulated between the measured
ones, driven by the same signals.
"""

from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain
from math import inf, isfinite
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.identify.following import followed
from dmptm_ctrl.identify.forces import Forces, forces_of
from dmptm_ctrl.identify.measured_motion import (
    NONE,
    Motion,
    Nuisance,
    Sight,
    acceleration_bandwidth,
    coordinates_of,
    order_of,
    prepare,
)
from dmptm_ctrl.identify.reading_noise import spectrum
from dmptm_ctrl.identify.teeth import missing, toothed
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Layout, RigModel

LEAST_DRIVE = 0.05  # of the logged signal gets through to a motor at least
TAIL = 0.005  # of the twists, beyond the ends of the gap and its wind-up


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

    def clear(sensor: Sensor) -> tuple[float, float]:
        """How far a sensor gives acceleration; of two that reach as far, with how little noise."""
        band, noise = reach[sensor.name]
        return band, -noise * (2.0 * np.pi * band) ** (2 * order_of(sensor))

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
            best = max(group, key=clear)
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
        One per log, or per piece of a long one, keyed by the points' names.
    closed : frozenset of str
        Links beyond which hidden bodies follow the measured ones, see :mod:`.following`.
    teeth : mapping of link to int
        Links with a gap that is measured, and the equation that each takes; see :mod:`.teeth`.
    """

    rig: Rig
    points: tuple[Point, ...]
    bandwidth: float
    motions: tuple[Motion, ...]
    closed: frozenset[str] = frozenset()
    teeth: Mapping[str, int] = field(default_factory=dict)
    known: dict[Any, Floats] = field(default_factory=dict)  # twists that were asked for
    noises: dict[Any, list[Floats]] = field(default_factory=dict)  # of models asked for lately

    @property
    def logs(self) -> tuple[str, ...]:
        """Names of the logs; the pieces of a long one have one name."""
        return tuple(dict.fromkeys(m.name for m in self.motions))

    @cached_property
    def log_of(self) -> tuple[int, ...]:
        """Log of each motion, by its place in `logs`."""
        return tuple(self.logs.index(m.name) for m in self.motions)

    @cached_property
    def longest(self) -> float:
        """Time at which the longest log ends [s]."""
        return max(float(m.time[-1]) for m in self.motions)

    @cached_property
    def link_of(self) -> dict[int, str]:
        """Toothed link of each equation that is one's."""
        return {k: name for name, k in self.teeth.items()}

    def seen(self, layout: Layout) -> list[int]:
        """Coordinate that each point shows."""
        return coordinates_of(layout, [p.name for p in self.points])

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

    @property
    def bursts(self) -> tuple[bool, ...]:
        """Whether what is left of each equation comes in bursts: impacts that nothing measures.

        So does the twist of teeth that chatter; the balance of all measured bodies holds.
        """
        heavy = {*self.teeth.values()}
        return tuple(bool(self.closed) or k in heavy for k in range(len(self.points)))

    def simulates(self, model: RigModel) -> bool:
        """Whether there are links beside the toothed ones."""
        return bool({*model.layout.links} - {*self.teeth})

    def bends(self, model: RigModel) -> bool:
        """Whether such a link has a gap: derivatives then change from one state to the next."""
        gaps = zip(model.layout.links, model.plant().link_gap, strict=True)
        return any(gap > 0 and name not in self.teeth for name, gap in gaps)

    @cached_property
    def counted(self) -> list[NDArray[np.bool_]]:
        """Rows of each equation that count, per log, (equations, rows)."""
        teeth = self.link_of
        return [
            np.array(
                [m.pushing(teeth[k]) if k in teeth else m.moving for k in range(len(self.points))]
            )
            for m in self.motions
        ]

    @cached_property
    def places(self) -> list[list[NDArray[np.int64]]]:
        """The same as row numbers, per equation and motion."""
        return [[np.flatnonzero(use[e]) for use in self.counted] for e in range(len(self.points))]

    @cached_property
    def noise_spectrum(self) -> tuple[NDArray[np.complex128], Floats]:
        """Noise of readings in the band of the balance; see :func:`.reading_noise.spectrum`."""
        return spectrum(self)

    @cached_property
    def calm(self) -> dict[str, float]:
        """What the twist of each toothed link counts where it pushes, root mean square."""
        found = {}
        for link, k in self.teeth.items():
            pairs = zip(self.motions, self.counted, strict=True)
            rows = [m.reduce(m.calm[link])[use[k]] for m, use in pairs if link in m.calm]
            whole = np.concatenate(rows) if rows else np.ones(1)
            found[link] = float(np.sqrt(np.mean(whole**2))) if whole.size else 1.0
        return found

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
        return replace(self, motions=kept, known={}, noises={})

    def part(self, part: str) -> "Balance":
        """Return the balance of the "fit" or "held-out" stretches of every log."""
        cut = tuple(replace(m, part=part) for m in self.motions if m.of(part))
        return replace(self, motions=cut, known={}, noises={})

    def at_most(self, samples: int) -> "Balance":
        """Return the balance of pieces of the longest logs, as many samples together."""
        sizes, left, most = sorted(m.time.size for m in self.motions), samples, 0
        for k, size in enumerate(sizes):  # what short logs do not need is for the others
            most = left // (len(sizes) - k)
            left -= min(size, most)
        pieces = (m.pieces(most) if m.time.size > most else (m,) for m in self.motions)
        return replace(self, motions=tuple(chain.from_iterable(pieces)), known={}, noises={})


def balance_of(
    rig: Rig, logs: Sequence[Log], *, bandwidth: float | None = None, most: float = inf
) -> Balance:
    """Filter logs into motions, at the bandwidth that the poorest point allows, and `most` [Hz].

    And up to which hidden bodies follow the measured ones. A given `bandwidth` is taken as it is.
    """
    points = points_of(rig, logs)
    closed, follows = followed(rig, (p.name for p in points))
    if bandwidth is None:
        bandwidth = min(follows, most, *(p.sight.bandwidth for p in points))
    sights = {p.name: p.sight for p in points}
    motions = tuple(prepare(log, rig, sights, bandwidth) for log in logs)
    return Balance(rig, points, bandwidth, motions, closed, toothed(rig, points))


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
    forces = forces_of(model, balance, motion, nuisance)
    measured, reach = forces.measured, untwisted(plant)
    total, push = np.zeros_like(motion.time), pushing(model, forces)
    alone = {}
    for group, need in forces.need.items():
        total += reach[group] * need
        # as acceleration: as a torque, no inertia and no spring would leave nothing
        left = forces.left[group]
        alone[group] = left * balance.heft / (reach[group] * plant.inertia[group])
    fair = 1.0 / passed(push, pushed(model, motion.u, measured))
    equations = [fair * (push - total)]
    seen, teeth = balance.seen(layout), balance.link_of
    for k, point in enumerate(balance.points):
        group, r = seen[k], layout.ratio[layout.sensor_body[point.name]]
        if k in teeth:
            name = teeth[k]
            twist, torque = forces.twists[name], forces.carried[name]
            equations.append(missing(model, balance, name, motion, twist, torque))
        elif group in seen[:k]:
            # rigidly tied to a point before it: as fast, whatever moves them
            difference = motion.a[point.name] / r - measured[group][2]
            equations.append(difference * balance.heft / reach[group])
        elif k > 0:
            equations.append(alone[group])
    rows = motion.reduce(np.array([*equations, fair * push]))
    return rows[:-1], rows[-1]


def pushing(model: RigModel, forces: Forces) -> Floats:
    """Torque at the driven coordinate by drives as they act, (n,)."""
    reach = untwisted(model.plant())
    return np.asarray(sum(reach[group] * own for group, own in forces.own.items()))


def pushed(model: RigModel, signals: Mapping[str, Floats], groups: Container[int]) -> Floats:
    """Torque at the driven coordinate by signals of the inputs on these coordinates, (n,)."""
    layout, plant, reach = model.layout, model.plant(), untwisted(model.plant())
    out = np.zeros_like(next(iter(signals.values())))
    for j, (name, body) in enumerate(layout.input_body.items()):
        if (group := layout.coordinate[body]) in groups:
            out += reach[group] * layout.ratio[body] * plant.input_values[j, 0] * signals[name]
    return out


def passed(push: Floats, logged: Floats) -> float:
    """Share of the logged torque that drives let through: a clipped one must not look better.

    Raises
    ------
    ArithmeticError
        Where hardly anything gets through.
    """
    # A mean is rounded, so that the deviation of what is constant need not be exactly 0.
    size, sent = (float(np.std(x)) if np.ptp(x) > 0 else 0.0 for x in (push, logged))
    if sent > 0 and size < LEAST_DRIVE * sent:
        raise ArithmeticError("hardly anything of the drive's signal would get through")
    return size / sent if sent > 0 else 1.0
