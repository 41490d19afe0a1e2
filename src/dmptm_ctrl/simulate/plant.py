"""A drive as parts and numbers: what the generated step, blocks and reference are made from.

A coordinate is what a rigid group of bodies shares; body b turns by ratio · coordinate.
A link's twist is z = q_first − ratio · q_second; its torque acts −τ on the first body and
+ratio · τ on the second.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.presliding import bristle_lag
from dmptm_ctrl.effects.stribeck import Stribeck, stribeck_law

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Flags = NDArray[np.uint8]

LINEAR, GAP, TWO_STATES, ELASTIC_IMPACT = 0, 1, 2, 3  # contact laws of a link
GAP_LAWS = {"eq21": GAP, "two_state": TWO_STATES, "impact": ELASTIC_IMPACT}  # of `Link.contact`
DECLARED, BY_EFFECT = 1, 2  # lags of an input
# sites whose kernels the step calls; those of the others become numbers of the plant
CALLED = ("amplifier", "lag", "motor", "mesh", "friction", "dwell", "load", "sensor")
LAW_FIELDS = Stribeck._fields
NO_LAW = Stribeck._make([*[0.0] * 8, 1.0, 1.0, 1.0])
NO_EFFECTS = np.zeros(0)
NO_ROWS = np.zeros((0, 0))
NO_FLAGS = np.zeros(0, np.uint8)


class Place(NamedTuple):
    """An effect at a place of a plant."""

    effect: Effect
    part: int  # number of the input, body, link or sensor where it acts
    side: int  # side or body that the kernel takes
    # where its flag and first number stand in `Plant.on`, `.values`; who shares them is tied
    flag: int
    first: int


class Plant(NamedTuple):
    """Parts and numbers of a drive; the index of a part is the first axis."""

    inertia: Floats  # (n,) kg·m² or kg, of the whole group
    body_coordinate: Ints  # (bodies,)
    body_ratio: Floats  # (bodies,)
    law: Floats  # (bodies, 9) arguments of `stribeck_law`
    rubs: Flags  # (bodies,) whether a friction law is declared
    bristles: Floats  # (bodies, 3) relaxation distance, share at once, damping ratio
    link_body: Ints  # (links, 2)
    link_values: Floats  # (links, 5) ratio, stiffness, damping, gap damping, half-gap
    link_gap: Ints  # (links,) contact law
    link_load: Flags  # (links,) whether its torque presses on the bearings of its bodies
    input_body: Ints  # (inputs,)
    input_values: Floats  # (inputs, 4) gain, dead time, lag, limit (0 is none)
    sensor_body: Ints  # (sensors,)
    sensor_speed: Flags  # (sensors,) 1 where it measures speed
    sensor_delay: Floats  # (sensors,) s
    places: tuple[Place, ...] = ()
    on: Flags = NO_FLAGS
    values: Floats = NO_EFFECTS
    given: tuple[int, ...] = ()  # coordinates whose motion is prescribed

    @property
    def size(self) -> tuple[int, int, int, int, int]:
        """Numbers of coordinates, bodies, links, inputs and sensors."""
        return (
            self.inertia.size,
            self.body_coordinate.size,
            self.link_gap.size,
            self.input_body.size,
            self.sensor_body.size,
        )


def link_matrices(plant: Plant) -> tuple[Floats, Floats, Floats, Floats]:
    """Twists of links over the coordinates, their stiffness and damping; viscous friction."""
    n = plant.inertia.size
    ends, ratio = plant.link_body, plant.link_values[:, 0]
    rows = _twists(ends, ratio, plant.body_coordinate, plant.body_ratio, n)
    # a law that damps by depth does not where contact begins
    dampers = np.where(plant.link_gap == ELASTIC_IMPACT, 0.0, plant.link_values[:, 2])
    damping = plant.body_ratio**2 * 0.5 * (plant.law[:, 3] + plant.law[:, 7])
    viscous = np.bincount(plant.body_coordinate, damping, n).astype(float)
    return rows, plant.link_values[:, 1], dampers, viscous


def untwisted(plant: Plant, first: int = 0) -> Floats:
    """Motion of each coordinate per motion of one, no link twisted, (n,)."""
    links = plant.link_body.tobytes(), np.ascontiguousarray(plant.link_values[:, 0]).tobytes()
    bodies = plant.body_coordinate.tobytes(), plant.body_ratio.tobytes()
    return np.frombuffer(_untwisted(*links, *bodies, plant.inertia.size, first))


@lru_cache(64)
def _untwisted(
    link_body: bytes, link_ratio: bytes, coordinate: bytes, body_ratio: bytes, n: int, first: int
) -> bytes:
    """The same; fits ask again and again, while they move other numbers."""
    ends = np.frombuffer(link_body, np.int64).reshape(-1, 2)
    ratio, turns = np.frombuffer(link_ratio), np.frombuffer(body_ratio)
    rows = np.vstack(
        [np.eye(1, n, first), _twists(ends, ratio, np.frombuffer(coordinate, np.int64), turns, n)]
    )
    return np.linalg.solve(rows, np.eye(len(rows))[0]).tobytes()


def _twists(ends: Ints, ratio: Floats, coordinate: Ints, turns: Floats, n: int) -> Floats:
    """Twists of links over the coordinates, (links, n)."""
    rows = np.zeros((len(ends), n))
    for end, factor in ((0, np.ones(len(ends))), (1, -ratio)):
        bodies = ends[:, end]
        np.add.at(rows, (np.arange(len(ends)), coordinate[bodies]), factor * turns[bodies])
    return rows


class Structure(NamedTuple):
    """What the text of a step depends on; numbers are none of it."""

    switched: bool  # places are there to be switched on by a flag; else all of them act
    coordinates: int
    # coordinate; sign of the ratio, 0 for a ratio of 1; law: 0 none, 1 one, 2 one with an exponent
    bodies: tuple[tuple[int, int, int], ...]
    # first and second body, contact law, whether it loads bearings
    links: tuple[tuple[int, int, int, bool], ...]
    # body, limited; 0 for no lag, else `DECLARED` or `BY_EFFECT`
    inputs: tuple[tuple[int, bool, int], ...]
    sensors: tuple[tuple[int, bool, bool], ...]  # body, measures speed, may be late
    bristles: tuple[int, ...]  # bodies with presliding
    places: tuple[Place, ...]
    # What may be absent by its numbers is there, behind conditions: lags of all inputs, delays of
    # all sensors, presliding and given motion of all coordinates. Effects change what they do by
    # functions of their own. One structure, compiled once, serves what would be many.
    either: bool = False

    def at(self, site: str, part: int) -> list[Place]:
        """Places of a site at one part."""
        return [p for p in self.places if p.effect.site == site and p.part == part]

    def body_names(self, coordinate: int) -> list[int]:
        """Bodies of a coordinate."""
        return [b for b, part in enumerate(self.bodies) if part[0] == coordinate]


_KNOWN: dict[tuple[Any, ...], "Structure"] = {}


def structure_of(plant: Plant, *, switched: bool, either: bool = False) -> Structure:
    """Return the structure of a plant: with all its places behind flags, or those that act.

    The same object each time: a fit asks often, and effects are long to compare.
    """
    bodies = tuple(
        (int(g), 0 if r == 1.0 else 1 if r > 0.0 else -1, _law_kind(plant, b))
        for b, (g, r) in enumerate(
            zip(plant.body_coordinate.tolist(), plant.body_ratio.tolist(), strict=True)
        )
    )
    lags = {p.part for p in plant.places if p.effect.site == "lag" and plant.on[p.flag]}
    inputs = tuple(
        (
            b, row[3] > 0.0,
            DECLARED if row[2] > 0.0 or either else BY_EFFECT if switched or j in lags else 0,
        )
        for j, (b, row) in enumerate(
            zip(plant.input_body.tolist(), plant.input_values.tolist(), strict=True)
        )
    )  # fmt: skip
    sensors = zip(
        plant.sensor_body.tolist(),
        (plant.sensor_speed > 0).tolist(),
        ((plant.sensor_delay > 0.0) | either).tolist(),
        strict=True,
    )
    links = zip(
        *plant.link_body.T.tolist(),
        plant.link_gap.tolist(),
        (plant.link_load > 0).tolist(),
        strict=True,
    )
    on = b"" if switched else plant.on.tobytes()
    rest = (
        plant.inertia.size, bodies, tuple(links), inputs, tuple(sensors),
        () if either else tuple(np.flatnonzero(plant.bristles[:, 0] > 0.0).tolist()),
    )  # fmt: skip
    key = switched, either, id(plant.places), on, *rest
    if key not in _KNOWN:
        places = [p for p in plant.places if p.effect.site in CALLED]
        if not switched:
            places = [p for p in places if plant.on[p.flag]]
        found = Structure(switched, *rest, tuple(places), either)
        _ALIVE.append(plant.places)  # or another may get its identity
        _KNOWN[key] = _SAME.setdefault(found, found)
    return _KNOWN[key]


_ALIVE: list[tuple[Place, ...]] = []
_SAME: dict[Structure, Structure] = {}


def _law_kind(plant: Plant, body: int) -> int:
    if not plant.rubs[body]:
        return 0
    return 2 if plant.law[body, 8] != 1.0 else 1


def number_names(structure: Structure, *, values: bool) -> list[str]:
    """Names of the numbers of a step, in the order of :func:`numbers`.

    With `values` those of effects are among them.
    """
    names = [f"m{g}" for g in range(structure.coordinates)]
    names += [f"r{b}" for b, (_, sign, _) in enumerate(structure.bodies) if sign]
    for b, (_, _, law) in enumerate(structure.bodies):
        if law:
            names += [f"w{b}_{field}" for field in LAW_FIELDS]
    for k, (_, _, gap, _) in enumerate(structure.links):
        names += [f"n{k}", f"k{k}", f"c{k}"]
        if gap:
            names += [f"f{k}", f"g{k}"]
    for j, (_, limited, lags) in enumerate(structure.inputs):
        names += [f"gain{j}", *([f"lim{j}"] if limited else []), *([f"tau{j}"] if lags else [])]
    for b in structure.bristles:
        names += [f"bd{b}", f"bs{b}", f"bl{b}"]
    for g in range(structure.coordinates if structure.either else 0):
        names += [f"{x}{g}" for x in ("is", "by", "share", "lag")] + [
            f"of{g}_{x}" for x in LAW_FIELDS
        ]
    if values:
        for p in structure.places:
            names += [f"e{p.first + j}" for j in range(len(p.effect.parameters))]
    return list(dict.fromkeys(names))


def numbers(plant: Plant, names: Sequence[str], h: float) -> Floats:
    """Return the numbers of a step of `h` seconds by their names."""
    found: dict[str, float] = {}
    for g, inertia in enumerate(plant.inertia.tolist()):
        found[f"m{g}"] = h / inertia
    ratios = plant.body_ratio.tolist()
    for b, row in enumerate(plant.law.tolist()):
        found[f"r{b}"] = ratios[b]
        if plant.rubs[b]:
            law = stribeck_law(*row)
            found |= {f"w{b}_{name}": x for name, x in zip(LAW_FIELDS, law, strict=True)}
    for k, (n, stiffness, damping, gap_damping, gap) in enumerate(plant.link_values.tolist()):
        found[f"n{k}"], found[f"k{k}"], found[f"c{k}"] = n, stiffness, damping
        found[f"f{k}"], found[f"g{k}"] = gap_damping, gap
    for j, (gain, _, lag, limit) in enumerate(plant.input_values.tolist()):
        found[f"gain{j}"], found[f"lim{j}"], found[f"tau{j}"] = gain, limit, lag
    found |= {f"is{g}": 1.0 for g in plant.given}
    bodies = plant.body_coordinate.tolist()
    for b, (distance, share, damping) in reversed(list(enumerate(plant.bristles.tolist()))):
        g = bodies[b]
        if distance > 0.0:
            law = stribeck_law(*plant.law[b].tolist())
            inertia = float(plant.inertia[plant.body_coordinate[b]]) / ratios[b] ** 2
            lag = bristle_lag(distance, damping, inertia, law)
            # so short a distance that a step cannot follow the body on it: no more than it takes
            most = bristle_lag(distance, 0.5, inertia, law) ** 2 / h
            found |= {f"bd{b}": distance, f"bs{b}": share, f"bl{b}": min(lag, most)}
            # one body's bristles carry what rubs on all that are tied to it: the first's
            own = distance / abs(ratios[b]), share, min(lag, most)
            found |= zip((f"by{g}", f"share{g}", f"lag{g}"), own, strict=True)
            found |= {
                f"of{g}_{name}": x
                for name, x in zip(LAW_FIELDS, law if plant.rubs[b] else NO_LAW, strict=True)
            }
    values = plant.values
    return np.array(
        [found[n] if n in found else values[int(n[1:])] if n[0] == "e" else 0.0 for n in names]
    )
