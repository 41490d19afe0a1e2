"""What a recorded motion gives the balances: window means of forces and twists.

A fit asks for the same friction and the same disturbance many times over, while it moves
another parameter; what was computed lately is kept.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property, lru_cache
from math import exp
from typing import Any

import numpy as np
from numba import njit

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.presliding import build_up_distance
from dmptm_ctrl.effects.stribeck import Stribeck, sliding_torque, stribeck_law, viscous_torque
from dmptm_ctrl.identify.motion import Motion, odd_span, readings, second_difference, smooth
from dmptm_ctrl.simulate.compose import engine, layout
from dmptm_ctrl.simulate.model import BASE, Arrays, Floats

REDUCER, BEARING = BASE.index("T3s_plus"), BASE.index("TLs_plus")  # in the base array
LAW = 9  # parameters of a friction law there
INERTIA = (
    36.5  # kg·m², Table 1: of all bodies at the ring gear; expresses an acceleration as a torque
)
STIFFNESS = 3.6e4  # N·m/rad, Table 1: expresses a twist as a torque, whatever k_m is fitted
SEEN_SECONDS = 0.01  # passes what the multisine excites, keeps the encoders' noise small
CARRIED_SECONDS = 0.02  # span over which the mesh torque is smoothed
ENCODER_UNIT = 1e-4  # rad, at which the encoder's error is read off its kernel
# Friction that takes a tenth of the torque is met to a ten-thousandth of it by the third.
PASSES = 3
RECENT = 4  # results kept per motion
MOTOR_SITES = ("delay", "drive", "lag", "motor")


@njit(nogil=True)
def friction_along(speed: Floats, law: Stribeck, out: Floats) -> None:
    """Sliding friction along a recorded speed, negative when forward."""
    for i in range(speed.size):
        direction = 1.0 if speed[i] > 0.0 else -1.0
        out[i] = -direction * sliding_torque(speed[i], direction, law)


@njit(nogil=True)
def viscous_along(speed: Floats, law: Stribeck, out: Floats) -> None:
    """Viscous part of the same."""
    for i in range(speed.size):
        direction = 1.0 if speed[i] > 0.0 else -1.0
        out[i] = -direction * viscous_torque(speed[i], direction, law)


@njit(nogil=True)
def presliding_along(angle: Floats, distance: float, law: Stribeck, out: Floats) -> None:
    """Turn sliding friction into presliding along an angle, exact for its steps."""
    force = 0.0
    for i in range(1, angle.size):
        moved = angle[i] - angle[i - 1]
        if moved != 0.0:
            # where the speed has the other sign, there is nothing to slide against yet
            goal = out[i] if out[i] * moved < 0.0 else 0.0
            over = build_up_distance(distance, goal, law)
            force = goal + (force - goal) * exp(-abs(moved) / over)
        out[i] = force


@dataclass(eq=False)
class Windowed:
    """The balances of one motion.

    Parameters
    ----------
    motion : Motion
    """

    motion: Motion

    def __post_init__(self) -> None:
        self.friction = lru_cache(RECENT)(self._friction)
        self.disturbed = lru_cache(RECENT)(self._disturbed)

    @cached_property
    def volts(self) -> Floats:
        """Window means of both voltages, (2, w) [V]."""
        return self.motion.mean(self.motion.rec.u)

    @cached_property
    def twist(self) -> Floats:
        """Window means of z, (2, w) [rad]."""
        return self.motion.mean(self.motion.run[:, 6:8].T, held=False)

    @cached_property
    def flank(self) -> Floats:
        """Window means of which flank is near, 1 or −1, (2, w)."""
        return self.motion.mean(np.where(self.motion.run[:, 6:8].T > 0.0, 1.0, -1.0), held=False)

    def rate(self, n2: float) -> Floats:
        """Window means of dz/dt, (2, w) [rad/s]."""
        return self.rates[0] - n2 * self.rates[1]

    @cached_property
    def rates(self) -> tuple[Floats, Floats]:
        """Window means of the pinions' speeds, (2, w), and of the ring gear's, (w,)."""
        mo = self.motion
        return mo.mean(mo.pinion_speed.T, held=False), mo.mean(mo.run[:, 1], held=False)

    @cached_property
    def waves(self) -> Floats:
        """Window means of the ring encoder's error per unit cosine and sine, (2, w)."""
        mo = self.motion
        index, first = layout()["encoder_eccentricity"]
        _, on, values = mo.declared.arrays()
        waves = []
        for k in (0, 1):
            unit, flags = np.zeros_like(values), np.zeros_like(on)
            unit[first + k] = ENCODER_UNIT
            flags[index] = 1
            read, speed = np.empty(mo.run.shape[0]), np.empty(mo.run.shape[0])
            sensor = engine().sensor_reading
            readings(sensor, mo.run[:, 0], mo.run[:, 1], mo.rec.dt, flags, unit, read, speed)
            waves.append((read - mo.run[:, 0]) / ENCODER_UNIT)
        return mo.mean(np.array(waves), held=False)

    def encoder_error(self, on: Any, values: Floats) -> Floats:
        """Error of the ring encoder [rad], (w,), beyond what was taken off the readings."""
        _, on_before, before = self.motion.declared.arrays()
        index, first = layout()["encoder_eccentricity"]
        now = values[first : first + 2] * on[index]
        then = before[first : first + 2] * on_before[index]
        if np.array_equal(now, then):
            return np.zeros(1)
        return np.asarray((now - then) @ self.waves)

    def _friction(
        self, body: int, law: bytes, distance: float, share: float
    ) -> tuple[Floats, Floats]:
        """Friction on a body, (n,) and window means (w,) [N·m]; `law` as in the base array."""
        mo = self.motion
        n1 = mo.declared.drive["N_1"]
        row = np.empty(mo.run.shape[0])
        given = speed_of(mo, body), stribeck_law(*np.frombuffer(law))
        friction_along(*given, row)
        if distance > 0.0:
            at_once = np.empty_like(row)
            viscous_along(*given, at_once)
            at_once *= share
            row -= at_once
            angle = mo.run[:, 0] if body == 2 else mo.run[:, 2 + body] / n1
            presliding_along(np.ascontiguousarray(angle), distance, given[1], row)
            row += at_once
        return row, mo.mean(row, held=False)

    def _disturbed(self, arrays: tuple[bytes, bytes, bytes]) -> tuple[Floats, Floats, Floats]:
        """Window means of :func:`disturbance`, (3, w) [N·m] and (2, w) [rad].

        Where the twist is not measured, the shifts also as accelerations, (2, w) [rad/s²].
        """
        base, values = (np.frombuffer(arrays[i]).copy() for i in (0, 2))
        on = np.frombuffer(arrays[1], np.uint8).copy()
        rows = self.frictions(base, on, values)[0] if loads(on) else None
        torque, moved = disturbance(self.motion, (base, on, values), rows)
        mo = self.motion
        shaken = np.zeros((2, mo.starts.size))
        if mo.rec.twist is None and moved.any():
            pushed = np.array([second_difference(row, mo.rec.dt) for row in moved])
            shaken = mo.mean(pushed, held=False)
        return mo.mean(torque), mo.mean(moved, held=False), shaken

    def frictions(self, base: Floats, on: Any, values: Floats) -> tuple[list[Floats], Floats]:
        """Friction on pinions and ring gear, three of (n,) and window means (3, w) [N·m]."""
        bristles = engine().presliding_law
        found = [
            self.friction(body, law, *bristles(body, on, values)[:2])
            for body, law in enumerate(laws(base))
        ]
        return [row for row, _ in found], np.array([mean for _, mean in found])

    def missing(self, arrays: Arrays, compliance: float) -> Floats:
        """All balances on all windows, (3, w) [N·m]."""
        base, on, values = arrays
        mo = self.motion
        n1, n2 = base[5], base[6]
        j3, jl = n1 * n1 * base[2] + base[3], base[4]
        _, force = self.frictions(base, on, values)
        shift = n2 * self.encoder_error(on, values) * np.ones((2, 1))
        if on.any():
            needed = base.copy()
            needed[unneeded(on)] = 0.0  # so that a result lately kept is found again
            given = needed.tobytes(), on.tobytes(), values.tobytes()
            torque, moved, shaken = self.disturbed(given)
            force += torque
            # the flanks push the pinions, whose motion is not measured, out of their way
            force[:2] += j3 * shaken
            shift = shift + moved
        drive = n1 * base[0] * base[1] * self.volts
        force[:2] += drive
        motors = at_motors(on) if compliance > 0.0 else None
        if motors is not None and motors.any():
            given = base.tobytes(), motors.tobytes(), values.tobytes()
            drive = drive + self.disturbed(given)[0][:2]
        out = np.empty((3, mo.starts.size))
        # As an acceleration: the sensors' noise is one, and must not favour a small inertia.
        out[0] = jl * mo.ring + n2 * j3 * mo.pinions.sum(1) - n2 * force[:2].sum(0) - force[2]
        out[0] *= INERTIA / (jl + 2.0 * n2 * n2 * j3)
        if mo.rec.twist is not None:
            gaps = base[13:15, None]
            twist = self.twist + shift - gaps * self.flank + base[11] / base[8] * self.rate(n2)
            carried = force[:2] - j3 * mo.pinions.T
            # In the twist, not in the torque: the twist's noise must not bias the stiffness.
            # A soft reducer adds its own, for z is seen at the motor; it carries what the motor
            # gives, before the friction on the pinion.
            shaft = drive - n1 * n1 * base[2] * mo.pinions.T
            out[1:] = STIFFNESS * (twist - carried / base[8] - compliance * shaft)
        return out


def speed_of(mo: Motion, body: int) -> Floats:
    """Speed [rad/s] of a pinion, or of the ring gear."""
    return np.ascontiguousarray(mo.run[:, 1] if body == 2 else mo.pinion_speed[:, body])


def laws(base: Floats) -> tuple[bytes, bytes, bytes]:
    """Friction law of each body in the base array."""
    reducer = base[REDUCER : REDUCER + LAW].tobytes()
    return reducer, reducer, base[BEARING : BEARING + LAW].tobytes()


def unneeded(on: Any) -> list[int]:
    """Places in the base array that the disturbance by effects in use does not depend on."""
    return _unneeded(tuple(CATALOGUE), on.tobytes())


@cache
def _unneeded(names: tuple[str, ...], on: bytes) -> list[int]:
    if _loads(names, on):
        return []
    gain, ratios = [0, 1], [5, 6]
    acts = any(used and CATALOGUE[n].site == "friction" for n, used in zip(names, on, strict=True))
    friction = list(range(REDUCER, BEARING + LAW)) if acts else []
    return [i for i in range(len(BASE)) if i not in {*gain, *ratios, *friction}]


def at_motors(on: Any) -> Any:
    """Which of the effects in use act on what a motor gives its shaft."""
    return on & _at_motors(tuple(CATALOGUE))


@cache
def _at_motors(names: tuple[str, ...]) -> Any:
    return np.array([CATALOGUE[n].site in MOTOR_SITES for n in names], np.uint8)


def loads(on: Any) -> bool:
    """Whether an effect in use depends on the torque of the meshes."""
    return _loads(tuple(CATALOGUE), on.tobytes())


@cache
def _loads(names: tuple[str, ...], on: bytes) -> bool:
    effects = [CATALOGUE[name] for name, used in zip(names, on, strict=True) if used]
    return any(e.site == "friction" and "mesh_torque" in e.depends_on for e in effects)


def frictions(mo: Motion, base: Floats) -> Floats:
    """Friction on pinions and ring gear along a motion, (3, n) [N·m], negative when forward."""
    rows = np.empty((3, mo.run.shape[0]))
    for body, law in enumerate(laws(base)):
        friction_along(speed_of(mo, body), stribeck_law(*np.frombuffer(law)), rows[body])
    return rows


def carried(mo: Motion, base: Floats, friction: Sequence[Floats]) -> Floats:
    """Torque that each mesh carries [N·m], (2, n), by what drives and brakes; smoothed.

    From the voltages, not from the measured acceleration: without motor encoders its noise
    would pass for friction that grows with the load.
    """
    n2 = base[6]
    j3 = base[5] * base[5] * base[2] + base[3]
    drive = base[5] * base[0] * base[1] * mo.rec.u + np.array(friction[:2])
    force = n2 * drive.sum(0) + friction[2]
    rest = drive - j3 * n2 * force / (base[4] + 2.0 * n2 * n2 * j3)
    return np.array([smooth(row, odd_span(CARRIED_SECONDS, mo.rec.dt)) for row in rest])


def seen(mo: Motion, base: Floats, friction: Sequence[Floats]) -> Floats:
    """Torque that each mesh carries [N·m], (2, n), with the motors' measured acceleration."""
    gain, j3 = base[5] * base[0] * base[1], base[5] * base[5] * base[2] + base[3]
    u = mo.rec.u
    # a second difference weighs the voltages before and after its sample alike
    held = 0.5 * (u + np.concatenate([u[:, :1], u[:, :-1]], axis=1))
    rows = gain * held + np.array(friction[:2])
    for s in (0, 1):
        rows[s] -= j3 * second_difference(mo.run[:, 2 + s] / base[5], mo.rec.dt)
    return np.array([smooth(row, odd_span(SEEN_SECONDS, mo.rec.dt)) for row in rows])


def disturbance(
    mo: Motion, arrays: Arrays, friction: Sequence[Floats] | None
) -> tuple[Floats, Floats]:
    """Torques (3, n) on pinions and ring gear, and shifts (2, n) of z, of a model's effects.

    Parameters
    ----------
    friction : three arrays (n,), optional
        Of pinions and ring gear; needed for effects that depend on the mesh torques.
    """
    base, on, values = arrays
    n = mo.run.shape[0]
    torque, moved = np.empty((n, 3)), np.empty((n, 2))
    run = mo.run
    if friction is not None:
        run = run.copy()
        run[:, 4:6] = (carried if mo.rec.twist is None else seen)(mo, base, friction).T
    engine().along(mo.rec.u, run, mo.rec.dt, base, on, values, torque, moved)
    if friction is not None:
        # The mesh carries what friction leaves, which depends on what it carries.
        without = run[:, 4:6].copy()
        for _ in range(PASSES):
            run[:, 4:6] = without + torque[:, :2]
            engine().along(mo.rec.u, run, mo.rec.dt, base, on, values, torque, moved)
    return torque.T, moved.T
