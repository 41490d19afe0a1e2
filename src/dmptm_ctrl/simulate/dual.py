"""The dual-motor drive as a plant: two chains of motor and pinion on one ring gear.

Coordinates: left and right pinion, ring gear, and behind compliant reducers the motors, seen
at the pinion. Bodies: pinions, ring gear, motors.
"""

from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.stiffness_variation import STIFFNESS_VARIATION
from dmptm_ctrl.simulate.along import Acting
from dmptm_ctrl.simulate.base import BASE, Arrays, layout, per_catalogue
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.plant import GAP, LINEAR, Flags, Floats, Place, Plant
from dmptm_ctrl.simulate.run import compiled_controller

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model

MIN_COMPLIANCE = 1e-6  # rad/(N·m); below, the reducer's own mode is beyond the step and rigid
PINIONS, RING, MOTORS = (0, 1), 2, (3, 4)  # bodies
# site -> parts where it acts, and the side or body that the kernel is told
_PLACES: dict[str, tuple[tuple[int, int], ...]] = {
    "drive": ((0, 0), (1, 1)),
    "lag": ((0, 0), (1, 1)),
    "motor": ((3, 0), (4, 1)),
    "mesh": ((0, 0), (1, 1)),
    "friction": ((0, 0), (1, 1), (2, 2)),
    "ageing": ((0, 0), (1, 1), (2, 2)),
    "load": ((RING, 0),),
    "sensor": ((0, 0), (1, 0)),
}
_LINKS = np.array([[0, 2], [1, 2], [3, 0], [4, 1]])
_SENSORS = np.array([2, 2, 3, 4]), np.array([0, 1, 0, 0], np.uint8)


class _Catalogue(NamedTuple):
    places: tuple[Place, ...]
    numbered: dict[str, list[tuple[Effect, int, int]]]  # site -> effect, flag, first number
    flagged: list[list[Place]]


@per_catalogue
def _catalogue(effects: tuple[Effect, ...]) -> _Catalogue:
    """Every effect where it acts; both sides share its numbers."""
    places: list[Place] = []
    numbered: dict[str, list[tuple[Effect, int, int]]] = {}
    slots = layout()
    for effect in effects:
        flag, first = slots[effect.name]
        numbered.setdefault(effect.site, []).append((effect, flag, first))
        for index, told in _PLACES.get(effect.site, ()):
            places.append(Place(effect, index, told, flag, first))
    end = sum(len(effect.parameters) for effect in effects)
    for side in (0, 1):
        places.append(Place(STIFFNESS_VARIATION, side, side, len(effects), end))
    flagged = [[p for p in places if p.flag == flag] for flag in range(len(effects) + 1)]
    return _Catalogue(tuple(places), numbered, flagged)


def acting(on: Flags, values: Floats) -> dict[tuple[str, int], list[Acting]]:
    """Return the effects in use by site and part of the plant; the sites that kernels act at."""
    found: dict[tuple[str, int], list[Acting]] = {}
    known = _catalogue().flagged
    for flag in np.flatnonzero(on).tolist():
        for effect, part, told, _, first in known[flag]:
            row = values[first : first + len(effect.parameters)]
            found.setdefault((effect.site, part), []).append(Acting(effect, told, row))
    return found


def called(on: Flags, values: Floats, site: str, *arguments: float) -> list:
    """Return what the kernels in use at a site say whose results are numbers of the plant."""
    found = []
    for effect, flag, first in _catalogue().numbered.get(site, ()):
        if on[flag]:
            p = effect.values(*values[first : first + len(effect.parameters)].tolist())
            found.append(effect.kernel(*arguments, p))
    return found


def bristles(on: Flags, values: Floats, body: int) -> tuple[float, float, float]:
    """Relaxation distance [rad] of a body's friction, share at once, damping ratio."""
    found = called(on, values, "presliding", body)
    if not found:
        return 0.0, 0.0, 0.0
    distance, share, ratio = zip(*found, strict=True)
    return sum(distance), max(share), max(ratio)


def dual_plant(arrays: Arrays) -> Plant:
    """Return the plant of a drive's numbers, as `Model.arrays` gives them."""
    base, on, values = arrays
    d = dict(zip(BASE, base.tolist(), strict=True))
    n1, motor = d["N_1"], d["N_1"] ** 2 * d["J_m"]
    compliance, damping = 0.0, 0.0
    for found in called(on, values, "shaft", motor * d["J_2"] / (motor + d["J_2"])):
        compliance, damping = found
    elastic = compliance > MIN_COMPLIANCE
    chain = d["J_2"] + (0.0 if elastic else motor)
    inertia = [chain, chain, d["J_L"], *([motor, motor] if elastic else [])]
    mesh = [[d["N_2"], d["k_m"], d["c"], d["c_f"], d[gap]] for gap in ("gap_l", "gap_r")]
    shaft = [[n1, 1.0 / (compliance * n1**2), damping / n1**2, 0.0, 0.0]] * 2 if elastic else []
    first = BASE.index("T3s_plus")
    laws = np.zeros((5, 9))
    laws[:, [2, 6, 8]] = 1.0
    laws[:2], laws[RING] = base[first : first + 9], base[first + 9 : first + 18]
    slow = np.zeros((5, 3))
    slow[: RING + 1] = [bristles(on, values, body) for body in (*PINIONS, RING)]
    gain = d["K_d"] * d["K_M"]
    delay = [sum(called(on, values, "delay", side)) for side in (0, 1)]
    return Plant(
        np.array(inertia),
        np.array([0, 1, 2, 3, 4] if elastic else [0, 1, 2, 0, 1]),
        np.array([1.0, 1.0, 1.0, n1, n1]),
        laws,
        np.array([1, 1, 1, 0, 0], np.uint8),
        slow,
        _LINKS[: 4 if elastic else 2],
        np.array([*mesh, *shaft]),
        np.array([GAP, GAP, *([LINEAR] * len(shaft))]),
        np.array([1, 1, *([0] * len(shaft))], np.uint8),
        np.array(MOTORS),
        np.array([[gain, late, 0.0, 0.0] for late in delay]),
        *_SENSORS,
        np.array([0.0, sum(called(on, values, "sensor_delay")), 0.0, 0.0]),
        _catalogue().places,
        np.append(on, np.uint8(d["k_a"] != 0.0)),
        np.concatenate([values, [d["k_a"], d["z_3"], d["phi_r"]]]),
    )


def parts_of(model: "Model") -> Parts:
    """Return what the kernels say about each part of a drive."""
    return Parts(dual_plant(model.arrays()))


def start(plant: Plant, x0: Floats) -> tuple[Floats, Floats]:
    """Return coordinates and speeds of a state θ3l, θ3r, θL and their speeds."""
    more = plant.inertia.size - 3
    return np.append(x0[:3], x0[:more]), np.append(x0[3:6], x0[3 : 3 + more])


def columns(plant: Plant, meshes: bool) -> int:
    """How many of a run's columns hold the outputs, :data:`~.compiled.OUTPUTS` or the first 4."""
    return 4 + 2 * plant.link_gap.size if meshes else 4


def columns_seen(plant: Plant) -> list[int]:
    """Where :data:`~.batch.BATCH_OUTPUTS` are among what lanes see of a drive."""
    links = plant.link_gap.size
    last = 4 + 2 * links
    return [*range(6), 4 + links, 5 + links, last, last + 1]


def outputs(plant: Plant, rows: Floats, meshes: bool = True) -> Floats:
    """Return a run's columns as :data:`~.compiled.OUTPUTS`."""
    links = plant.link_gap.size
    if not meshes or links == 2:
        return rows
    return rows[:, [*range(6), 4 + links, 5 + links]]


@partial(compiled_controller, cache=True)
def pi_loop(i, t, dt, target, noise, y, rule, memory, u):
    """Drive both motors by the error of the speed; rule: kp, ki, limit, biases."""
    error = target - (y[1] + noise)
    memory[0] += error * dt
    common = rule[0] * error + rule[1] * memory[0]
    if abs(common) > rule[2]:
        common = rule[2] if common > 0.0 else -rule[2]
    u[0] = common + rule[3]
    u[1] = common + rule[4]
