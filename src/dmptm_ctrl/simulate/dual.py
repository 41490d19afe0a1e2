"""The dual-motor drive as a plant: two sides of motor and pinion on one ring gear.

Coordinates: left and right pinion, ring gear, and behind compliant reducers the motors, seen
at the pinion. Bodies: pinions, ring gear, motors.
"""

from functools import cache, partial
from math import cos, sin
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.stiffness_variation import STIFFNESS_VARIATION
from dmptm_ctrl.simulate.loading import LOADING
from dmptm_ctrl.simulate.plant import GAP, LINEAR, TWO_STATES, Floats, Place, Plant
from dmptm_ctrl.simulate.run import compiled_controller

if TYPE_CHECKING:
    from dmptm_ctrl.simulate.model import Model

CONTACTS = ("eq21", "two_state")  # laws of the meshes: paper Eq. 21, and what it stands for

MIN_COMPLIANCE = 1e-6  # rad/(N·m); below, the reducer's own mode is beyond the step and rigid
PINIONS, RING, MOTORS = (0, 1), 2, (3, 4)  # bodies
# site -> parts where it acts, and the side or body that the kernel takes
_PLACES: dict[str, tuple[tuple[int, int], ...]] = {
    "amplifier": ((0, 0), (1, 1)),
    "lag": ((0, 0), (1, 1)),
    "motor": ((3, 0), (4, 1)),
    "mesh": ((0, 0), (1, 1)),
    "friction": ((0, 0), (1, 1), (2, 2)),
    "dwell": ((0, 0), (1, 1), (2, 2)),
    "load": ((RING, 0),),
    "sensor": ((0, 0), (1, 0)),
}
LAWS = [  # names of the arguments of `stribeck_law`, by body
    [*(f"{x}_{way}" for way in ("plus", "minus") for x in (f"T{b}s", f"T{b}c", f"W{b}", f"B{b}")),
     f"delta{b}"]
    for b in "33L"
]  # fmt: skip
_LINKS = np.array([[0, 2], [1, 2], [3, 0], [4, 1]])
_SENSORS = np.array([2, 2, 3, 4]), np.array([0, 1, 0, 0], np.uint8)


class Catalogue(NamedTuple):
    """Where the effects of the catalogue act; both sides share an effect's numbers."""

    places: tuple[Place, ...]
    slots: dict[str, tuple[int, int]]  # effect -> its flag, its first number
    absent: Floats  # numbers of effects that are not in use
    effects: tuple[Effect, ...]  # kept, or another may get an identity


def catalogue() -> Catalogue:
    """Return the places of the catalogue as it is now, the same ones for the same effects.

    A fit asks hundred thousands of times. Effects are compared by identity, for to compare all
    their numbers takes longer than what is asked for. Threads that ask at once get one answer.
    """
    with LOADING:
        return _catalogue(tuple(map(id, CATALOGUE.values())))


@cache
def _catalogue(_: tuple[int, ...]) -> Catalogue:
    effects = tuple(CATALOGUE.values())
    places: list[Place] = []
    slots: dict[str, tuple[int, int]] = {}
    absent: list[float] = []
    for flag, effect in enumerate(effects):
        slots[effect.name] = flag, len(absent)
        for index, side in _PLACES.get(effect.site, ()):
            places.append(Place(effect, index, side, *slots[effect.name]))
        absent += effect.defaults()
    for side in (0, 1):
        places.append(Place(STIFFNESS_VARIATION, side, side, len(effects), len(absent)))
    return Catalogue(tuple(places), slots, np.array(absent), effects)


def dual_plant(model: "Model") -> Plant:
    """Return the plant of a dual-motor drive."""
    d = {name: quantity.value for name, quantity in model.drive.quantities.items()}
    known = catalogue()
    on, values = np.zeros(len(known.slots), np.uint8), known.absent.copy()
    used: list[tuple[Effect, Any]] = []
    for name, given in model.effects.items():
        effect, (flag, first) = CATALOGUE[name], known.slots[name]
        row = [float(x) for x in {**effect.absent(), **given}.values()]
        values[first : first + len(row)] = row
        on[flag] = any(given.get(a, 0.0) != 0.0 for a in effect.amplitudes)
        if on[flag]:
            used.append((effect, effect.values(*row)))

    def said(site: str, *arguments: float) -> list:
        """What kernels say whose results are numbers of the plant."""
        return [effect.kernel(*arguments, p) for effect, p in used if effect.site == site]

    n1, motor = d["N_1"], d["N_1"] ** 2 * d["J_m"]
    compliance, damping = 0.0, 0.0
    for found in said("shaft", motor * d["J_2"] / (motor + d["J_2"])):
        compliance, damping = found
    elastic = compliance > MIN_COMPLIANCE
    side = d["J_2"] + (0.0 if elastic else motor)
    inertia = [side, side, d["J_L"], *([motor, motor] if elastic else [])]
    mesh = [[d["N_2"], d["k_m"], d["c"], d["c_f"], d[gap]] for gap in ("gap_l", "gap_r")]
    shaft = [[n1, 1.0 / (compliance * n1**2), damping / n1**2, 0.0, 0.0]] * 2 if elastic else []
    laws, slow = np.zeros((5, 9)), np.zeros((5, 3))
    laws[:, [2, 6, 8]] = 1.0
    laws[: RING + 1] = [[d[key] for key in names] for names in LAWS]
    if any(effect.site == "presliding" for effect, _ in used):
        for body in (*PINIONS, RING):
            distance, share, ratio = zip(*said("presliding", body), strict=True)
            slow[body] = sum(distance), max(share), max(ratio)
    gain, k_a, phase = d["K_d"] * d["K_M"], d["k_a"], d["phi_r"]
    delay = [sum(said("delay", side)) for side in (0, 1)]
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
        np.array([0.0, sum(said("sensor_delay")), 0.0, 0.0]),
        known.places,
        np.append(on, np.uint8(k_a != 0.0)),
        np.concatenate([values, [k_a * cos(phase), -k_a * sin(phase), d["z_3"]]]),
    )


def plant_with(model: "Model", contact: str) -> Plant:
    """Return the plant of a model whose meshes have a contact law, of :data:`CONTACTS`.

    ValueError for another law, or the two-state law without any damping.
    """
    if contact not in CONTACTS:
        raise ValueError(f"contact is {contact!r}; it must be one of {', '.join(CONTACTS)}")
    plant = model.plant()
    if contact == "eq21":
        return plant
    if model.drive["c"] + model.drive["c_f"] <= 0.0:
        raise ValueError("c + c_f is 0: an undamped tooth has no place in its gap")
    laws = np.where(plant.link_gap == GAP, TWO_STATES, plant.link_gap)
    return plant._replace(link_gap=laws)


def start(plant: Plant, x0: Floats) -> tuple[Floats, Floats]:
    """Return coordinates and speeds of a state θ3l, θ3r, θL and their speeds."""
    more = plant.inertia.size - 3
    return np.append(x0[:3], x0[:more]), np.append(x0[3:6], x0[3 : 3 + more])


def columns(plant: Plant, meshes: bool) -> int:
    """How many of a run's columns hold the outputs, :data:`~.compiled.OUTPUTS` or the first 4."""
    return 4 + 2 * plant.link_gap.size if meshes else 4


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
