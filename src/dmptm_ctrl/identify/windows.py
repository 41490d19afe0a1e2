"""What recorded motions give the balances: window means of forces and twists.

A fit asks for the same friction and the same disturbance many times over, while it moves
another parameter; what was computed lately is kept.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from typing import Any

import numpy as np

from dmptm_ctrl.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from dmptm_ctrl.effects.reducer_compliance import REDUCER_COMPLIANCE
from dmptm_ctrl.identify.disturbance import Course, Rows, course, disturbance
from dmptm_ctrl.identify.measured_motion import recent
from dmptm_ctrl.identify.motion import Motion, averaged, odd_span, second_difference, smooth
from dmptm_ctrl.simulate.along import Acting, built_up_along, law_along, reading_along
from dmptm_ctrl.simulate.dual import MOTORS, RING
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.plant import Plant

# of all bodies at the ring gear; expresses an acceleration as a torque
INERTIA = 36.5  # kg·m², Table 1
STIFFNESS = 3.6e4  # N·m/rad, Table 1: expresses a twist as a torque, whatever k_m is fitted
SEEN_SECONDS = 0.01  # passes what the multisine excites, keeps the encoders' noise small
CARRIED_SECONDS = 0.02  # span over which the mesh torque is smoothed
ENCODER_UNIT = 1e-4  # rad, at which the encoder's error is read off its kernel
RECENT = 16  # results kept
NOTHING = np.zeros((2, 1))


class Keyed:
    """A plant by those of its numbers that what is asked of it depends on."""

    def __init__(self, plant: Plant, *key: Any) -> None:
        self.plant, self.key = plant, key

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Keyed) and self.key == other.key


@dataclass(eq=False)
class Windowed:
    """The balances of some motions, one after another.

    All have the same sample time, and all have motor encoders, or none.
    """

    motions: Sequence[Motion]

    def __post_init__(self) -> None:
        self.friction = lru_cache(RECENT)(self._friction)
        self.even_friction = lru_cache(RECENT)(self._even_friction)
        self.disturbed = lru_cache(RECENT)(self._disturbed)
        self.known: dict[tuple[int, bool], tuple[Floats, Floats]] = {}

    @cached_property
    def course(self) -> Course:
        """What effects act along."""
        volts, runs = [mo.rec.u for mo in self.motions], [mo.run for mo in self.motions]
        return course(volts, runs, self.motions[0].rec.dt)

    @property
    def seconds(self) -> float:
        """Length of each motion."""
        return self.motions[0].rec.seconds

    @cached_property
    def twisted(self) -> bool:
        """Whether the twist is measured."""
        return all(mo.rec.twist is not None for mo in self.motions)

    def all(self, row: Callable[[Motion], Floats]) -> Floats:
        """Put rows (..., n or w) of all motions one after another."""
        return np.concatenate([row(mo) for mo in self.motions], axis=-1)

    def mean(self, rows: Floats, *, held: bool = True) -> Floats:
        """Window means, (..., n) → (..., w), as :meth:`Motion.mean`."""
        return averaged(rows, self.motions, held=held)

    @cached_property
    def volts(self) -> Floats:
        """Window means of both voltages, (2, w) [V]."""
        return self.mean(self.course.u)

    @cached_property
    def ring(self) -> Floats:
        """Acceleration of the ring gear, (w,) [rad/s²]."""
        return self.all(lambda mo: mo.ring)

    @cached_property
    def pinions(self) -> Floats:
        """Accelerations of the pinions, (2, w) [rad/s²]."""
        return self.all(lambda mo: mo.pinions.T)

    @cached_property
    def speeds(self) -> list[Floats]:
        """Speeds of both pinions and of the ring gear, three of (n,) [rad/s]."""
        return [*self.all(lambda mo: np.array([speed_of(mo, body) for body in range(3)]))]

    @cached_property
    def angles(self) -> list[Floats]:
        """Angles of both pinions and of the ring gear, three of (n,) [rad]."""
        n1 = self.motions[0].declared.plant().body_ratio[MOTORS[0]]
        return [*(self.course.motors / n1), self.course.ring]

    @cached_property
    def twist(self) -> Floats:
        """Window means of z, (2, w) [rad]."""
        return self.mean(self.all(lambda mo: mo.run[:, 6:8].T), held=False)

    @cached_property
    def flank(self) -> Floats:
        """Window means of which flank is near, 1 or −1, (2, w)."""
        return self.mean(self.all(lambda mo: mo.flank.T), held=False)

    def rate(self, n2: float) -> Floats:
        """Window means of dz/dt, (2, w) [rad/s]."""
        return self.rates[:2] - n2 * self.rates[2]

    @cached_property
    def rates(self) -> Floats:
        """Window means of the speeds of both pinions and of the ring gear, (3, w)."""
        return self.mean(np.array(self.speeds), held=False)

    @cached_property
    def waves(self) -> Floats:
        """Window means of the ring encoder's error per unit cosine and sine, (2, w)."""

        def wave(mo: Motion, k: int) -> Floats:
            unit = Acting(ENCODER_ECCENTRICITY, 0, ENCODER_UNIT * np.eye(2)[k])
            angle, turned = np.ascontiguousarray(mo.run[:, :2].T)
            time = mo.rec.dt * np.arange(angle.size)
            return (reading_along([unit], angle, turned, time)[0] - angle) / ENCODER_UNIT

        return self.mean(self.all(lambda mo: np.array([wave(mo, 0), wave(mo, 1)])), held=False)

    def encoder_error(self, model: Model) -> Floats:
        """Error of the ring encoder [rad], (w,), beyond what was taken off the readings."""
        now, then = (
            np.array([one.effects.get(ENCODER_ECCENTRICITY.name, {}).get(name, 0.0)
                      for name in ENCODER_ECCENTRICITY.amplitudes])
            for one in (model, self.motions[0].declared)
        )  # fmt: skip
        if np.array_equal(now, then):
            return np.zeros(1)
        return np.asarray((now - then) @ self.waves)

    def _friction(
        self, body: int, law: bytes, distance: float, share: float
    ) -> tuple[Floats, Floats]:
        """Friction on a body, (n,) and window means (w,) [N·m]; `law` as in the plant."""
        given, omega = np.frombuffer(law), self.speeds[body]
        level = law_along(omega, given)
        if distance > 0.0:
            begins = np.array(self.course.begins[:-1])
            travel = np.diff(self.angles[body], prepend=0.0)
            level = built_up_along(level, omega, travel, begins, (distance, share), given)
        row = -level
        return row, self.mean(row, held=False)

    def _even_friction(self, *law: Any) -> Floats:
        """Friction on a body, smoothed over what the mesh torque is taken from."""
        return self.even(self.friction(*law)[0])

    def even(self, rows: Floats) -> Floats:
        """Rows (..., n) smoothed over what the mesh torque is taken from."""
        seconds = SEEN_SECONDS if self.twisted else CARRIED_SECONDS
        dt, parts = self.course.dt, self.course.parts
        return np.concatenate([evened(rows[..., p], dt, seconds) for p in parts], -1)

    @cached_property
    def even_volts(self) -> Floats:
        """Voltages, smoothed, (2, n) [V]."""
        # a second difference weighs the voltages before and after its sample alike
        volts = self.all(lambda mo: halfway(mo.rec.u) if self.twisted else mo.rec.u)
        return self.even(volts)

    @cached_property
    def even_accelerations(self) -> Floats:
        """Accelerations of the motors, smoothed, (2, n) [rad/s²]."""
        return self.even(
            self.all(lambda mo: np.array([second_difference(x, mo.rec.dt) for x in mo.run.T[2:4]]))
        )

    def load(self, plant: Plant) -> Floats:
        """Torque that each mesh carries without what depends on it, (2, n) [N·m].

        The readings are smoothed, not what follows from them: it is linear in each.
        """
        friction = [self.even_friction(*law) for law in laws(plant)]
        if not self.twisted:
            return carried(plant, self.even_volts, friction)
        drive = pull_of(plant) * self.even_volts + np.array(friction[:2])
        n1 = plant.body_ratio[MOTORS[0]]
        return np.asarray(drive - inertias(plant)[0] * self.even_accelerations / n1)

    def _disturbed(self, given: Keyed) -> tuple[Floats, Floats, Floats, Floats]:
        """Window means of what a model's effects do, (3, w) [N·m] and (2, w) [rad].

        Torques on pinions and ring gear, and shifts of z. Where the twist is not measured, the
        shifts also as accelerations, (2, w) [rad/s²]. Last what motors give where the reducers
        are soft, (2, w) [N·m].
        """
        plant, (soft, loaded, *_) = given.plant, given.key
        torque, moved, pull = disturbance(self.course, plant, self.load(plant) if loaded else None)
        shifts = self.means(moved, held=False)
        shaken = np.zeros_like(shifts)
        if not self.twisted:
            dt = self.course.dt
            for row, out in zip(moved, shaken, strict=True):
                if row is not None:
                    parts = [second_difference(row[part], dt) for part in self.course.parts]
                    out[:] = self.mean(np.concatenate(parts), held=False)
        return self.means(torque), shifts, shaken, self.means(pull) if soft else NOTHING

    def means(self, rows: Rows, *, held: bool = True) -> Floats:
        """Window means of rows, those that are none zero."""
        out = np.zeros((len(rows), self.ring.size))
        for k, row in enumerate(rows):
            if row is not None:
                make = partial(self.mean_of, row, held)
                out[k] = recent(self.known, (id(row), held), make, RECENT)[1]
        return out

    def mean_of(self, row: Floats, held: bool) -> tuple[Floats, Floats]:
        """Row with its window means: another in its place in memory is not taken for it."""
        return row, self.mean(row, held=held)

    def missing(self, model: Model) -> Floats:
        """All balances on all windows, (3, w) [N·m]."""
        plant = model.plant()
        n2, stiffness, damping = plant.link_values[0, :3]
        j3, jl = inertias(plant)
        compliance = model.effects.get(REDUCER_COMPLIANCE.name, {}).get("compliance", 0.0)
        force = np.array([self.friction(*law)[1] for law in laws(plant)])
        shift = n2 * self.encoder_error(model) * np.ones((2, 1))
        pull = NOTHING
        if plant.on.any():
            torque, moved, shaken, pull = self.disturbed(needed(plant, compliance > 0.0))
            force += torque
            # the flanks push the pinions, whose motion is not measured, out of their way
            force[:2] += j3 * shaken
            shift = shift + moved
        drive = pull_of(plant) * self.volts
        force[:2] += drive
        if compliance > 0.0:
            drive = drive + pull
        out = np.empty_like(force)
        # As an acceleration: the sensors' noise is one, and must not favour a small inertia.
        out[0] = jl * self.ring + n2 * j3 * self.pinions.sum(0) - n2 * force[:2].sum(0) - force[2]
        out[0] *= INERTIA / (jl + 2.0 * n2 * n2 * j3)
        if self.twisted:
            gaps = plant.link_values[:2, 4:]
            twist = self.twist + shift - gaps * self.flank + damping / stiffness * self.rate(n2)
            carried = force[:2] - j3 * self.pinions
            # In the twist, not in the torque: the twist's noise must not bias the stiffness.
            # A soft reducer adds its own, for z is seen at the motor; it carries what the motor
            # gives, before the friction on the pinion.
            motor = model.drive["N_1"] ** 2 * model.drive["J_m"]
            shaft = drive - motor * self.pinions
            out[1:] = STIFFNESS * (twist - carried / stiffness - compliance * shaft)
        return out


def inertias(plant: Plant) -> tuple[float, float]:
    """Inertia of a side at its pinion, motor included, and of the ring gear [kg·m²]."""
    behind = plant.inertia[3] if plant.inertia.size > 3 else 0.0
    return plant.inertia[0] + behind, plant.inertia[RING]


def speed_of(mo: Motion, body: int) -> Floats:
    """Speed [rad/s] of a pinion, or of the ring gear."""
    return np.ascontiguousarray(mo.run[:, 1] if body == 2 else mo.pinion_speed[:, body])


def pull_of(plant: Plant) -> float:
    """Torque of a motor at its pinion per unit of its signal [N·m/V]."""
    return float(plant.body_ratio[MOTORS[0]] * plant.input_values[0, 0])


def laws(plant: Plant) -> list[tuple[int, bytes, float, float]]:
    """Friction of each body: which, law, distance and what is at once of pre-sliding."""
    return [
        (body, plant.law[body].tobytes(), *plant.bristles[body, :2].tolist())
        for body in range(RING + 1)
    ]


def needed(plant: Plant, soft: bool) -> Keyed:
    """Return a plant by what the disturbance by its effects in use depends on."""
    rubs = [p.effect for p in plant.places if plant.on[p.flag] and p.effect.site == "friction"]
    loaded = any("mesh_torque" in effect.depends_on for effect in rubs)
    ratios = plant.body_ratio.tobytes(), plant.link_values[:2, 0].tobytes()
    own = plant.input_values.tobytes(), plant.on.tobytes(), plant.values.tobytes()
    laws = plant.law.tobytes() + plant.bristles.tobytes() if rubs else b""
    masses = plant.inertia.tobytes() if loaded else b""
    return Keyed(plant, soft, loaded, laws, masses, *ratios, *own)


def frictions(mo: Motion, plant: Plant) -> Floats:
    """Friction on pinions and ring gear along a motion, (3, n) [N·m], negative when forward."""
    return -np.array([law_along(speed_of(mo, b), plant.law[b]) for b in range(RING + 1)])


def evened(rows: Floats, dt: float, seconds: float) -> Floats:
    """Rows (..., n) smoothed over a span."""
    return smooth(rows, odd_span(seconds, dt))


def halfway(held: Floats) -> Floats:
    """Mean of what is held before and after each sample, (2, n)."""
    return 0.5 * (held + np.concatenate([held[:, :1], held[:, :-1]], axis=1))


def carried(plant: Plant, volts: Floats, friction: Sequence[Floats] | Floats) -> Floats:
    """Torque that each mesh carries [N·m], (2, n), by what drives and brakes.

    From the voltages, not from the measured acceleration: without motor encoders its noise
    would pass for friction that grows with the load.
    """
    n2, (j3, jl) = plant.link_values[0, 0], inertias(plant)
    drive = pull_of(plant) * volts + np.array(friction[:2])
    force = n2 * drive.sum(0) + friction[2]
    return np.asarray(drive - j3 * n2 * force / (jl + 2.0 * n2 * n2 * j3))
