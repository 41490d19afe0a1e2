"""What the effects of a dual-motor drive do along a measured motion."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache, partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.identify.measured_motion import recent
from dmptm_ctrl.simulate.along import (
    Acting,
    acting_in,
    delayed_along,
    friction_along,
    lag_along,
    lagged_along,
    law_along,
    shift_along,
    signal_along,
    torque_along,
)
from dmptm_ctrl.simulate.dual import MOTORS, RING
from dmptm_ctrl.simulate.plant import Floats, Plant

# Friction that takes a tenth of the torque is met to a ten-thousandth of it by the third.
PASSES = 3
RECENT = 24  # rows kept
Rows = list[Floats | None]  # None: nothing acts there
Places = dict[tuple[str, int], list[Acting]]


@dataclass(eq=False)
class Course:
    """Motions in rows, one after another.

    Attributes
    ----------
    dt : float
        Sample time [s].
    begins : list of int
        First sample of each motion, and the end of the last.
    time : (n,) array
        Mid of each sample, from the start of its motion [s].
    u, motors : (2, n) arrays [V, rad]
    ring, speed : (n,) arrays [rad, rad/s]
        Of the ring gear, with which the pinions turn.
    flank : (2, n) array
        Sign of z.
    """

    dt: float
    begins: list[int]
    time: Floats
    u: Floats
    motors: Floats
    ring: Floats
    speed: Floats
    flank: Floats

    def __post_init__(self) -> None:
        self.sliding = lru_cache(RECENT)(self._sliding)
        self.known: dict[Any, Any] = {}

    @cached_property
    def parts(self) -> list[slice]:
        """Samples of each motion."""
        return [slice(a, b) for a, b in pairwise(self.begins)]

    @cached_property
    def direction(self) -> Floats:
        """Sign of the speed, (n,)."""
        return np.sign(self.speed)

    def kept(self, key: Any, make: Callable[[], Floats | None]) -> Floats | None:
        """Row of what a key says it depends on: fits ask for it while they move other numbers."""
        row: Floats | None = recent(self.known, key, make, RECENT)
        return row

    def _sliding(self, lever: float, law: bytes) -> Floats:
        """Magnitude of a law's friction at a multiple of the ring gear's speed, (n,) [N·m]."""
        return np.abs(law_along(lever * self.speed, np.frombuffer(law)))


def course(volts: Sequence[Floats], runs: Sequence[Floats], dt: float) -> Course:
    """Put voltages (2, n) and motions (n, 8), in the columns of `compiled.OUTPUTS`, into rows."""
    run = np.ascontiguousarray(np.concatenate(runs).T)
    time = np.concatenate([(np.arange(len(one)) + 0.5) * dt for one in runs])
    begins = np.cumsum([0, *map(len, runs)]).tolist()
    flank = np.where(run[6:8] > 0.0, 1.0, -1.0)
    u = np.ascontiguousarray(np.concatenate(volts, axis=1))
    return Course(dt, begins, time, u, run[2:4], run[0], run[1], flank)


class Disturbance(NamedTuple):
    """What effects do along a motion.

    Attributes
    ----------
    torque : list of 3 rows
        On both pinions and the ring gear [N·m].
    shift : list of 2 rows
        Of z on both sides [rad].
    pull : list of 2 rows
        What of the torque on the pinions comes from the motors [N·m].
    """

    torque: Rows
    shift: Rows
    pull: Rows


def disturbance(way: Course, plant: Plant, load: Floats | None = None) -> Disturbance:
    """Return what the effects in use do.

    `load` (2, n) is the torque of the meshes without the effects. They carry what friction
    leaves, which may depend on what they carry: it is asked :data:`PASSES` times more.
    A wider gap is a shift of z away from the flank it is nearest to.
    """
    n1, n2 = plant.body_ratio[MOTORS[0]], plant.link_values[0, 0]
    effects = acting_in(plant)
    torque, shift, pull = rows = Disturbance([None] * 3, [None] * 2, [None] * 2)
    ring, turning = (way.ring, way.speed), n2 * way.speed
    carried = nothing = np.zeros(way.speed.size)
    for side in (0, 1):
        pinion, ratios = (way.motors[side] / n1, turning), (n1, n2)
        parts = ("amplifier", side), ("lag", side), ("motor", MOTORS[side])
        drive = side, ratios, plant.input_values[side].tobytes(), numbers_of(effects, *parts)
        torque[side] = pull[side] = way.kept(drive, partial(driven, way, effects, plant, side))
        rubs = effects.get(("friction", side))
        if rubs:
            law = n2, plant.law[side].tobytes()
            passes, mesh = (0, nothing) if load is None else (PASSES, load[side])
            given = (ratios, *numbers_of(effects, ("friction", side))) if load is None else ()
            torque[side], mesh = braked(rubs, way, pinion, law, pull[side], mesh, passes, given)
            carried = carried + np.abs(mesh)
        if teeth := effects.get(("mesh", side)):
            key = side, ratios, numbers_of(effects, ("mesh", side))
            shift[side] = way.kept(key, partial(moved_by, teeth, way, side, pinion))
    if pushes := effects.get(("load", RING)):
        push = partial(torque_along, pushes, nothing, *ring, way.time)
        torque[RING] = way.kept(numbers_of(effects, ("load", RING)), push)
    if rubs := effects.get(("friction", RING)):
        law = 1.0, plant.law[RING].tobytes()
        given = numbers_of(effects, ("friction", RING)) if load is None else ()
        torque[RING], _ = braked(rubs, way, ring, law, torque[RING], carried, given=given)
    return rows


def numbers_of(effects: Places, *parts: tuple[str, int]) -> tuple[Any, ...]:
    """What effects at some parts do, as a key."""
    acting = [(part, one) for part in parts for one in effects.get(part, ())]
    return tuple((part, id(one.effect), one.values.tobytes()) for part, one in acting)


def moved_by(
    teeth: Sequence[Acting], way: Course, side: int, pinion: tuple[Floats, Floats]
) -> Floats:
    """Shift of z of one side by effects on its mesh."""
    moved, wider = shift_along(teeth, pinion, (way.ring, way.speed))
    return np.asarray(moved - way.flank[side] * wider)


def driven(way: Course, effects: Places, plant: Plant, side: int) -> Floats | None:
    """Torque that effects add to a motor's, at the pinion."""
    n1, n2 = plant.body_ratio[MOTORS[side]], plant.link_values[side, 0]
    gain, dead = plant.input_values[side, :2]
    u = volts = way.u[side]
    if dead > 0.0:
        volts = np.concatenate([delayed_along(u[p], dead / way.dt, 0.0) for p in way.parts])
    volts = signal_along(effects.get(("amplifier", side), ()), volts, way.time)
    if lags := effects.get(("lag", side)):
        aim, tau = lag_along(lags, volts)
        volts = np.concatenate([lagged_along(aim[p], tau[p], way.dt, 0.0) for p in way.parts])
    pull = None if volts is u else n1 * gain * (volts - u)
    if motor := effects.get(("motor", MOTORS[side])):
        spin = n1 * n2 * way.speed
        more = n1 * torque_along(motor, volts, way.motors[side], spin, way.time)
        pull = more if pull is None else pull + more
    return pull


def braked(
    effects: Sequence[Acting],
    way: Course,
    moves: tuple[Floats, Floats],
    law: tuple[float, bytes],
    push: Floats | None,
    load: Floats,
    passes: int = 0,
    given: tuple[Any, ...] = (),
) -> tuple[Floats | None, Floats]:
    """Torque that friction other than the declared leaves of a push, and what the body carries.

    `law` is of the body: its speed per speed of the ring gear, and the declared friction; `given`
    what else it depends on where that is not the load, or nothing.
    """
    left, carries = push, load
    for again in range(passes + 1):
        if again and left is not None:
            carries = load + left
        rub = partial(rubbed, effects, way, moves, law, carries)
        added = way.kept((given, law), rub) if given else rub()
        if added is not None:
            left = -added if push is None else push - added
        elif not again:
            return push, load if push is None or not passes else load + push
    return left, carries


def rubbed(
    effects: Sequence[Acting],
    way: Course,
    moves: tuple[Floats, Floats],
    law: tuple[float, bytes],
    load: Floats,
) -> Floats | None:
    """Friction beside the declared one, with the sign of the motion, or none."""
    factor, added = friction_along(effects, *moves, way.time, load)
    if (factor != 1.0).any():
        added *= factor
        factor -= 1.0
        factor *= way.sliding(*law)
        added += factor
    elif not added.any():
        return None
    added *= way.direction
    return added
