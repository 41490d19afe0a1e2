"""What the effects of a dual-motor drive do along a measured motion."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

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
RECENT = 4  # rows of friction kept
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

    @cached_property
    def parts(self) -> list[slice]:
        """Samples of each motion."""
        return [slice(a, b) for a, b in pairwise(self.begins)]

    @cached_property
    def direction(self) -> Floats:
        """Sign of the speed, (n,)."""
        return np.sign(self.speed)

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
        pinion = way.motors[side] / n1, turning
        torque[side] = pull[side] = driven(way, effects, plant, side)
        rubs = effects.get(("friction", side))
        if rubs:
            law = n2, plant.law[side].tobytes()
            passes, mesh = (0, nothing) if load is None else (PASSES, load[side])
            torque[side], mesh = braked(rubs, way, pinion, law, pull[side], mesh, passes)
            carried = carried + np.abs(mesh)
        if teeth := effects.get(("mesh", side)):
            moved, wider = shift_along(teeth, pinion, ring)
            shift[side] = moved - way.flank[side] * wider
    if pushes := effects.get(("load", RING)):
        torque[RING] = torque_along(pushes, nothing, *ring, way.time)
    if rubs := effects.get(("friction", RING)):
        law = 1.0, plant.law[RING].tobytes()
        torque[RING], _ = braked(rubs, way, ring, law, torque[RING], carried)
    return rows


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
) -> tuple[Floats | None, Floats]:
    """Torque that friction other than the declared leaves of a push, and what the body carries.

    `law` is of the body: its speed per speed of the ring gear, and the declared friction.
    """
    left, carries = push, load
    for again in range(passes + 1):
        if again and left is not None:
            carries = load + left
        factor, added = friction_along(effects, *moves, way.time, carries)
        if (factor != 1.0).any():
            added *= factor
            factor -= 1.0
            factor *= way.sliding(*law)
            added += factor
        elif not again and not added.any():
            return push, load if push is None or not passes else load + push
        added *= way.direction
        left = -added if push is None else push - added
    return left, carries
