"""A rig of any shape with effects added to it: what is simulated, fitted and saved."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import cos, isfinite, isnan, sin
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dmptm_ctrl.drive.parameters import Quantity, physical
from dmptm_ctrl.drive.rig import DeclaredEffect, Rig
from dmptm_ctrl.effects.shaft_compliance import ShaftCompliance, spring
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE, all_places, place_of
from dmptm_ctrl.simulate.plant import GAP, GAP_LAWS, LINEAR, Flags, Floats, Place, Plant

if TYPE_CHECKING:
    import control

LARGE_SPEED = 1e12  # rad/s or m/s, Stribeck speed of a law without Stribeck friction
FAR = "_far"  # suffix of the body behind a compliance that splits a declared one


class Placed(NamedTuple):
    """An effect at a place of a rig."""

    name: str  # in the catalogue
    on: str  # body, link, input or sensor, by its name in the rig
    values: Mapping[str, float] = {}  # parameter name → value, SI
    far: tuple[str, ...] = ()  # of a shaft compliance: inputs and sensors behind the spring
    like: str = ""  # place of the same effect whose numbers it shares, signs and phases apart

    @property
    def key(self) -> str:
        """Name and place, unique in a model."""
        return f"{self.name}@{self.on}"

    @property
    def first(self) -> str:
        """Key of the effect whose numbers it shares."""
        return f"{self.name}@{self.like or self.on}"


def placed_at(name: str, places: Sequence[str], values: Mapping[str, float]) -> tuple[Placed, ...]:
    """Return an effect at places of one make; those after the first share its numbers."""
    first, *others = places
    return Placed(name, first, values), *(Placed(name, on, values, like=first) for on in others)


class _Joint(NamedTuple):
    name: str
    first: str
    second: str
    ratio: float
    row: tuple[float, ...] | None  # stiffness, damping, gap damping, half-gap; None is rigid
    law: int  # of contact


def declared(rig: Rig) -> dict[str, Quantity]:
    """Return every declared quantity of a rig that a fit may move, by its key.

    Keys are ``body.NAME.inertia``, ``body.NAME.viscous``, ``link.NAME.stiffness``,
    ``input.NAME.gain`` and so on.
    """
    found: dict[str, Quantity] = {}
    for body in rig.bodies:
        found[f"body.{body.name}.inertia"] = body.inertia
        for key, quantity in body.friction.items():
            found[f"body.{body.name}.{key}"] = quantity
    of_link = ("ratio", "stiffness", "damping", "half_gap", "gap_damping")
    of_input = ("gain", "delay", "time_constant", "limit")
    for kind, parts, keys in (("link", rig.links, of_link), ("input", rig.inputs, of_input)):
        for part in parts:
            given = {key: getattr(part, key) for key in keys}
            found |= {f"{kind}.{part.name}.{k}": q for k, q in given.items() if q is not None}
    return found


def declared_effects(rig: Rig) -> list[Placed]:
    """Return the effects that a rig file declares, as models have them; RigError for wrong ones."""
    return [
        Placed(e.name, place_of(rig, e), {k: q.value for k, q in e.values.items()})
        for e in rig.effects
    ]


@dataclass(frozen=True)
class RigModel:
    """A rig, values of its declared quantities, and effects added to it.

    KeyError for an effect, a parameter, a place or a quantity that there is not.
    """

    rig: Rig
    effects: tuple[Placed, ...] = None  # type: ignore[assignment]  # those that the rig declares
    # by the keys of `declared`; what is left out has the declared value
    values: Mapping[str, float] = field(default_factory=dict)
    # shift of the encoder's zero in each log of the fit [rad or m], by effect key
    zeros: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    # links that count as rigid: a view for balances, in which no gap and no twist stands
    closed: frozenset[str] = frozenset()
    ranged: bool = False  # whether a fit keeps values inside their declared ranges

    def __post_init__(self) -> None:
        if self.effects is None:
            object.__setattr__(self, "effects", tuple(declared_effects(self.rig)))
        for effect in self.effects:
            if effect.name not in PLACED_CATALOGUE:
                known = ", ".join(PLACED_CATALOGUE)
                raise KeyError(f"no effect {effect.name!r} for a rig; there are {known}")
            has = [p.name for p in PLACED_CATALOGUE[effect.name].keep]
            wrong = [key for key in effect.values if key not in has]
            if wrong:
                raise KeyError(f"{effect.name} has no parameter {wrong[0]!r}; it has {has}")
        for key in self.values:
            self._known(key)

    def __str__(self) -> str:
        return ", ".join([f"{self.rig.name}: declared", *(e.key for e in self.effects)])

    @cached_property
    def quantities(self) -> dict[str, Quantity]:
        """Declared quantities by key, without those that are tied to another's."""
        ties = self.rig.ties
        return {k: q for k, q in declared(self.rig).items() if k not in ties}

    def quantity(self, key: str) -> Quantity:
        """Declared quantity by its key, or by that of one tied to it."""
        return self._known(self.rig.ties.get(key, key))

    def _known(self, key: str) -> Quantity:
        if key not in self.quantities:
            raise KeyError(f"the rig has no {key!r}; it has {', '.join(self.quantities)}")
        return self.quantities[key]

    def declared(self, wanted: Callable[[str], bool]) -> dict[str, float]:
        """Declared values of quantities by key, of those wanted that are known."""
        pairs = ((key, q.value) for key, q in self.quantities.items() if wanted(key))
        return {key: value for key, value in pairs if isfinite(value)}

    def value(self, key: str) -> float:
        """Value of a declared quantity; ValueError where it is unknown and not yet fitted."""
        value = self.values.get(self.rig.ties.get(key, key), self.quantity(key).value)
        if not isfinite(value):
            raise ValueError(f"{key} is declared unknown; fit the model first, or set a value")
        return value

    def effect(self, key: str) -> Placed:
        """Return the effect of a key."""
        return next(e for e in self.effects if e.key == key)

    def with_effect(self, effect: Placed | str, on: str = "", **values: float) -> "RigModel":
        """Return the model with an effect added, or replaced at its place.

        By name it takes what `[effect.NAME]` of a rig file takes: `on`, and parameters in SI.
        """
        if isinstance(effect, str):
            given = {key: Quantity(value, "", 0.0, "given") for key, value in values.items()}
            effect = Placed(effect, place_of(self.rig, DeclaredEffect(effect, on, given)), values)
        others = tuple(e for e in self.effects if e.key != effect.key)
        return replace(self, effects=(*others, effect))

    def without(self, keys: Iterable[str]) -> "RigModel":
        """Return the model without the effects of these keys."""
        gone = set(keys)
        return replace(self, effects=tuple(e for e in self.effects if e.key not in gone))

    def with_values(self, values: Mapping[str, float]) -> "RigModel":
        """Return the model with values of declared quantities replaced."""
        ties = self.rig.ties
        return replace(
            self, values={**self.values, **{ties.get(k, k): v for k, v in values.items()}}
        )

    @property
    def opened(self) -> "RigModel":
        """The model with all its gaps, as it runs."""
        return replace(self, closed=frozenset()) if self.closed else self

    def check(self) -> None:
        """Refuse declared values and effects that no machine has, as a ValueError.

        These are an inertia that is not positive, a stiffness, damping or time that is negative,
        an unknown or any other value that is not finite.
        """
        for key, quantity in self.quantities.items():
            kind = key.rpartition(".")[2]
            if kind == "gain" and key not in self.values:  # an unknown one counts as 1
                continue
            value = self.value(key)
            if kind in ("ratio", "gain"):
                if value == 0.0:
                    raise ValueError(f"{self.rig.name}: {key} is 0; it must be another number")
            else:
                positive = kind == "inertia" or kind.startswith("stribeck_speed")
                physical(f"{self.rig.name}: {key}", value, quantity.unit, zero=not positive)
        for effect in self.effects:
            for parameter in PLACED_CATALOGUE[effect.name].keep:
                value = effect.values.get(parameter.name, 0.0)
                what = f"{self.rig.name}: {parameter.name} of {effect.key}"
                if isnan(value):
                    raise ValueError(f"{what} is no number; fit the model first, or set a value")
                if parameter.low == 0.0 > value:  # a magnitude
                    raise ValueError(f"{what} is {value:g}; it must be zero or more")

    def to_blocks(self, **options: Any) -> "control.InterconnectedSystem":
        """Return the model as python-control blocks joined by name.

        Options as of :meth:`~dmptm_ctrl.simulate.model.Model.to_blocks`. Inputs and outputs are
        those of the rig, and its sensors, by name in SI.
        """
        from dmptm_ctrl.simulate.blocks import to_blocks

        return to_blocks(self, **options)

    def shifted(self, zeros: Mapping[str, float]) -> "RigModel":
        """Return the model with harmonics of the angle counted from another zero.

        `zeros`, by effect key, are added to the angle [rad or m]; C cos n(θ + z) + S sin n(θ + z).
        """
        moved = []
        for effect in self.effects:
            angle = effect.values.get("order", 1.0) * zeros.get(effect.key, 0.0)
            c, s = effect.values.get("cosine", 0.0), effect.values.get("sine", 0.0)
            if angle and (c or s):
                turned = {
                    "cosine": c * cos(angle) + s * sin(angle),
                    "sine": s * cos(angle) - c * sin(angle),
                }
                effect = effect._replace(values={**effect.values, **turned})
            moved.append(effect)
        return replace(self, effects=tuple(moved))

    @property
    def layout(self) -> "Layout":
        """Names of bodies, coordinates, links and inputs in the order of the plant's arrays."""
        return self._built[1]

    def plant(self) -> Plant:
        """Return the arrays of the compiled loop."""
        return self._built[0]

    @cached_property
    def _built(self) -> tuple[Plant, "Layout"]:
        return _build(self)


class Layout(NamedTuple):
    """What stands where in the arrays of a plant."""

    bodies: tuple[str, ...]
    links: tuple[str, ...]
    inputs: tuple[str, ...]
    coordinate: dict[str, int]  # of each body, by its index
    ratio: dict[str, float]  # of each body's angle over the coordinate
    sensor_body: dict[str, str]  # body of each sensor, a far one behind a compliance included
    input_body: dict[str, str]

    @property
    def coordinates(self) -> int:
        """Number of coordinates."""
        return len(set(self.coordinate.values()))


def _build(model: RigModel) -> tuple[Plant, Layout]:
    rig = model.rig
    inertia = {b.name: model.value(f"body.{b.name}.inertia") for b in rig.bodies}
    joints = [_joint(model, link.name) for link in rig.links]
    sensor_body = {s.name: s.body for s in rig.sensors}
    input_body = {i.name: i.body for i in rig.inputs}
    for effect in (e for e in model.effects if e.name == "shaft_compliance"):
        joints = _soften(effect, inertia, joints, sensor_body, input_body)
    for effect in (e for e in model.effects if PLACED_CATALOGUE[e.name].place == "link"):
        if effect.on not in model.closed:
            joints = [_with_effect(j, effect) if j.name == effect.on else j for j in joints]
    bodies = tuple(inertia)
    root = input_body[rig.inputs[0].name]
    coordinate, ratio = _coordinates(bodies, joints, root)
    soft = [j for j in joints if j.row is not None]
    links, inputs = tuple(j.name for j in soft), tuple(i.name for i in rig.inputs)
    layout = Layout(bodies, links, inputs, coordinate, ratio, sensor_body, input_body)
    masses = np.zeros(layout.coordinates)
    for name in bodies:
        masses[coordinate[name]] += ratio[name] ** 2 * inertia[name]
    for group, mass in enumerate(masses):
        if not mass > 0:
            tied = ", ".join(name for name in bodies if coordinate[name] == group)
            raise ValueError(f"{rig.name}: inertia of {tied} is {mass:g}; it must be positive")
    index = {name: k for k, name in enumerate(bodies)}
    bristles, lates = np.zeros((len(bodies), 3)), np.zeros(len(rig.sensors))
    names = [s.name for s in rig.sensors]
    for effect in model.effects:
        if effect.name == "presliding":
            bristles[index[effect.on], 0] = effect.values.get("distance", 0.0)
        if effect.name == "sensor_delay":
            lates[names.index(effect.on)] += effect.values.get("delay", 0.0)
    plant = Plant(
        masses,
        np.array([coordinate[b] for b in bodies], np.int64),
        np.array([ratio[b] for b in bodies]),
        np.array([_law(model, b) for b in bodies]),
        np.array([_rubs(rig, b) for b in bodies], np.uint8),
        bristles,
        np.array([[index[j.first], index[j.second]] for j in soft], np.int64).reshape(-1, 2),
        np.array([[j.ratio, *(j.row or ())] for j in soft]).reshape(-1, 5),
        np.array([j.law for j in soft], np.int64),
        np.ones(len(soft), np.uint8),
        np.array([index[input_body[i.name]] for i in rig.inputs], np.int64),
        np.array([_input_row(model, i.name) for i in rig.inputs]),
        np.array([index[sensor_body[s.name]] for s in rig.sensors], np.int64),
        np.array([s.measures == "speed" for s in rig.sensors], np.uint8),
        lates,
        *_placed(model, layout),
    )
    return plant, layout


def _rubs(rig: Rig, body: str) -> bool:
    """Whether a body has a friction law: declared, or a motor's back-EMF."""
    own = next((b for b in rig.bodies if b.name == body), None)
    return (
        own is None or bool(own.friction) or any(i.back_emf for i in rig.inputs if i.body == body)
    )


def _joint(model: RigModel, name: str) -> _Joint:
    link, row, law = model.rig.link(name), None, LINEAR
    if not link.rigid and name not in model.closed:
        row = tuple(
            model.value(f"link.{name}.{key}") if getattr(link, key) is not None else 0.0
            for key in ("stiffness", "damping", "gap_damping", "half_gap")
        )
        law = LINEAR if link.half_gap is None else GAP_LAWS[link.contact]
        if link.contact == "two_state" and row[1] + row[2] <= 0.0:
            raise ValueError(f"{name}: the two-state contact needs damping or gap_damping")
    return _Joint(name, link.first, link.second, model.value(f"link.{name}.ratio"), row, law)


def _soften(
    effect: Placed,
    inertia: dict[str, float],
    joints: list[_Joint],
    sensor_body: dict[str, str],
    input_body: dict[str, str],
) -> list[_Joint]:
    """Put a spring into a rigid link, or split a body in two."""
    share = effect.values["share"]
    shape = effect.values["antiresonance"], effect.values["damping_ratio"]
    if any(effect.on == j.name for j in joints):
        soft = next(j for j in joints if j.name == effect.on)
        rest = [j for j in joints if j.name != effect.on and j.row is None]
        _, near_ratio = _coordinates((), rest, soft.first)
        _, far_ratio = _coordinates((), rest, soft.second)
        near = sum(r**2 * inertia[b] for b, r in near_ratio.items())
        far = sum(r**2 * inertia[b] for b, r in far_ratio.items()) / soft.ratio**2
        compliance, damping = spring(near + far, ShaftCompliance(far / (near + far), *shape))
        new = soft._replace(row=(1.0 / compliance, damping, 0.0, 0.0))
        return [new if j.name == effect.on else j for j in joints]
    whole = inertia[effect.on]
    compliance, damping = spring(whole, ShaftCompliance(share, *shape))
    far_body = effect.on + FAR
    inertia[effect.on] = (1.0 - share) * whole
    inertia[far_body] = share * whole
    for places in (sensor_body, input_body):
        for name in effect.far:
            if places.get(name) == effect.on:
                places[name] = far_body
    row = (1.0 / compliance, damping, 0.0, 0.0)
    return [*joints, _Joint(effect.key, effect.on, far_body, 1.0, row, LINEAR)]


def link_sides(model: RigModel, link: str) -> tuple[dict[str, float], dict[str, float]]:
    """Bodies rigidly tied to each end of a link, with their motion per motion of that end."""
    rest = [
        j for j in (_joint(model, k.name) for k in model.rig.links if k.name != link)
        if j.row is None
    ]  # fmt: skip
    own = model.rig.link(link)
    near, far = (_coordinates((), rest, end)[1] for end in (own.first, own.second))
    return near, far


def link_inertias(model: RigModel, link: str) -> tuple[float, float]:
    """Inertias rigidly tied to each end of a link, as its first body sees them."""
    near, far = (
        sum(r**2 * model.value(f"body.{b}.inertia") for b, r in side.items())
        for side in link_sides(model, link)
    )
    return near, far / model.value(f"link.{link}.ratio") ** 2


def angle_body(model: RigModel, effect: Placed) -> str:
    """Body whose angle an effect goes with: in a mesh the pinion comes first, the gear second."""
    entry, name = PLACED_CATALOGUE[effect.name], effect.on
    for link in (k for k in model.rig.links if entry.place == "link" and k.name == name):
        return link.second if "theta_L" in entry.effect.depends_on else link.first
    return name


def _with_effect(joint: _Joint, effect: Placed) -> _Joint:
    if joint.row is None:
        raise ValueError(f"{effect.name} on {joint.name}, which is rigid; give it a stiffness")
    if effect.name != "backlash":
        return joint
    half_gap = joint.row[3] + effect.values.get("half_gap", 0.0)
    return joint._replace(row=(*joint.row[:3], half_gap), law=joint.law or GAP)


def _coordinates(
    bodies: Iterable[str], joints: list[_Joint], root: str
) -> tuple[dict[str, int], dict[str, float]]:
    """Index of each body's coordinate and its ratio; the root's group comes first.

    Without `bodies` those of that group alone.
    """
    coordinate: dict[str, int] = {}
    ratio: dict[str, float] = {}
    count = 0
    for start in (root, *bodies):
        if start in coordinate:
            continue
        coordinate[start], ratio[start] = count, 1.0
        waiting = [start]
        while waiting:
            here = waiting.pop()
            for j in joints:
                if j.row is not None:
                    continue
                # rigid: q_first = ratio · q_second
                step = {j.first: (j.second, 1.0 / j.ratio), j.second: (j.first, j.ratio)}
                if here in step and step[here][0] not in coordinate:
                    other, factor = step[here]
                    coordinate[other], ratio[other] = count, ratio[here] * factor
                    waiting.append(other)
        count += 1
    return coordinate, ratio


def _law(model: RigModel, body: str) -> list[float]:
    """Fields of Stribeck for a body; back-EMF of its motors included."""
    if body.endswith(FAR) and all(b.name != body for b in model.rig.bodies):
        splits = (e for e in model.effects if e.name == "shaft_compliance" and e.on + FAR == body)
        viscous = next(splits).values.get("far_viscous", 0.0)
        return [0.0, 0.0, LARGE_SPEED, viscous, 0.0, 0.0, LARGE_SPEED, viscous, 1.0]
    friction = model.rig.body(body).friction

    def get(key: str, side: str, default: float) -> float:
        name = key if key in friction else f"{key}_{side}"
        return model.value(f"body.{body}.{name}") if name in friction else default

    emf = sum(i.back_emf for i in model.rig.inputs if i.body == body)
    row: list[float] = []
    for side in ("plus", "minus"):
        coulomb = get("coulomb", side, 0.0)
        row += [
            get("static", side, coulomb),
            coulomb,
            get("stribeck_speed", side, LARGE_SPEED),
            get("viscous", side, 0.0) + emf,
        ]
    return [*row, get("stribeck_exponent", "", 1.0)]


def _input_row(model: RigModel, name: str) -> list[float]:
    """Gain, dead time, lag and limit of an input, effects included."""
    source = next(i for i in model.rig.inputs if i.name == name)
    gain = model.quantities[f"input.{name}.gain"].value
    gain = model.values.get(f"input.{name}.gain", gain if isfinite(gain) else 1.0)
    row = [gain]
    for key in ("delay", "time_constant", "limit"):
        row.append(model.value(f"input.{name}.{key}") if getattr(source, key) is not None else 0.0)
    for effect in model.effects:
        if effect.on == name and effect.name == "drive_delay":
            row[1] += effect.values.get("delay", 0.0)
        if effect.on == name and effect.name == "current_lag":
            row[2] += effect.values.get("time_constant", 0.0)
    return row


def _placed(model: RigModel, layout: Layout) -> tuple[tuple[Place, ...], Flags, Floats]:
    """Every effect at every place where it may act; which of them do, and the numbers of all."""
    sensors = tuple(s.name for s in model.rig.sensors)
    catalogue = tuple(PLACED_CATALOGUE.values())
    parts = layout.inputs, layout.bodies, layout.links, sensors
    places, index, absent = all_places(tuple(map(id, catalogue)), parts)
    on, values = np.zeros(len(index), np.uint8), absent.copy()
    for effect in model.effects:
        if effect.key in index:
            flag, first = index[effect.key]
            row = value_row(effect)
            on[flag], values[first : first + row.size] = 1, row
    return places, on, values


def value_row(effect: Placed) -> Floats:
    """Parameters of an effect as its kernel takes them; what is left out is absent."""
    entry = PLACED_CATALOGUE[effect.name]
    named = zip(entry.keep, entry.defaults, strict=True)
    row = [effect.values.get(p.name, default) for p, default in named]
    return np.array([row[f] if isinstance(f, int) else f for f in entry.fields], float)
