"""Effects that a drive of any shape can have, and how each kernel is placed there.

The kernels are those of `effects/`; this says what they act on (a body, a link, an input, a
sensor) and which of their parameters a single such place has. A user's own effect registers
with :func:`register`.
"""

import difflib
from collections.abc import Iterable
from functools import cache
from math import inf
from typing import Any, NamedTuple, NoReturn

import numpy as np

from dmptm_ctrl.contract import Effect, Parameter
from dmptm_ctrl.drive.rig import DeclaredEffect, Rig
from dmptm_ctrl.drive.rig_tables import TableReader
from dmptm_ctrl.drive.rig_units import unit_at
from dmptm_ctrl.effects import backlash, effect_of
from dmptm_ctrl.effects.load_dependent_friction import body_load_friction
from dmptm_ctrl.simulate.plant import CALLED, Floats, Place

# site of the contract -> where it acts
SITES = {
    "amplifier": "input",
    "delay": "input",
    "lag": "input",
    "motor": "body",
    "load": "body",
    "friction": "body",
    "dwell": "body",
    "presliding": "body",
    "shaft": "body",
    "mesh": "link",
    "gap": "link",
    "sensor": "sensor",
    "sensor_delay": "sensor",
}
RING = 2  # `body` of kernels that act on the ring gear alone

BACKLASH = Effect(
    name="backlash",
    site="gap",
    kernel=backlash.mesh_torque,
    parameters=(Parameter("half_gap", "rad", 0.0, 0.1, 1e-3),),
    values=backlash.Backlash,
    location="mesh",
    source="paper Eq. 21",
    depends_on=("mesh_torque",),
    reveals="reversals with small torque, at best with encoders on both sides of the gap",
    kink=0.005,
)


class PlacedEffect(NamedTuple):
    """An effect as one place of a drive has it."""

    effect: Effect  # owner of the kernel
    keep: tuple[Parameter, ...]  # those that one place has, in its own naming
    fields: tuple[int | float, ...]  # of the kernel's parameters: which of `keep`, or a constant
    side: int = RING  # side or body that the kernel takes

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.effect.name

    @property
    def site(self) -> str:
        """Site of the effect."""
        return self.effect.site

    @property
    def reveals(self) -> str:
        """Experiment that would show it."""
        return self.effect.reveals

    @property
    def place(self) -> str:
        """What it acts on: body, link, input or sensor."""
        return SITES[self.effect.site]

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names of the parameters that are zero when the effect is absent."""
        return tuple(p.name for p in self.keep if not p.bank)

    @property
    def defaults(self) -> tuple[float, ...]:
        """Parameters at which the effect is absent: zero amplitudes, mid-bank shapes."""
        return tuple(p.bank[len(p.bank) // 2] if p.bank else 0.0 for p in self.keep)

    @property
    def own(self) -> tuple[str, ...]:
        """Parameters that each of several places of one make has for itself: by sign or phase.

        A factor on what a body has is the same for all.
        """
        factor = self.place == "body" and not self.effect.wave
        signed = (p for p in self.keep if not p.bank and p.low < 0.0)
        return tuple(p.name for p in signed if p.unit or not factor)

    @property
    def of_make(self) -> bool:
        """Whether places of one make have it together; not what wear or chance put on one."""
        return self.effect.search != "places" and (self.effect.wave or not self.own)

    @property
    def by_load(self) -> bool:
        """Whether it is a friction that goes with what links carry."""
        return self.site == "friction" and "mesh_torque" in self.effect.depends_on

    @property
    def shapes(self) -> tuple[str, ...]:
        """Names of the parameters without meaning at zero effect."""
        return tuple(p.name for p in self.keep if p.bank)

    def stands_in(self, rig: Rig) -> bool:
        """Whether a rig has a place where it can be found."""
        if self.site == "mesh":
            return any(link.mesh and not link.rigid for link in rig.links)
        if self.name == "torque_constant_mismatch":  # of one input it is the scale of everything
            return len(rig.inputs) > 1
        return bool(rig.links) or not (self.place == "link" or self.by_load)


def whole(effect: Effect) -> PlacedEffect:
    """Return an effect whose parameters belong to one place as they are."""
    side = RING if effect.site in ("friction", "presliding", "dwell") else 0
    return PlacedEffect(effect, effect.parameters, tuple(range(len(effect.parameters))), side)


def _one_side(name: str, names: dict[str, str], side: int = 0, search: str = "") -> PlacedEffect:
    """Return an effect with parameters per side, reduced to one side.

    `names` maps the kernel's parameters to those of a place; the others are zero. `search`
    is how its shape is found, where it is another way than the effect's own.
    """
    effect = effect_of(name)
    effect = effect._replace(search=search or effect.search)
    keep = [p._replace(name=names[p.name]) for p in effect.parameters if p.name in names]
    kept = [p.name for p in keep]
    fields = [kept.index(names[p.name]) if p.name in names else 0.0 for p in effect.parameters]
    return PlacedEffect(effect, tuple(keep), tuple(fields), side)


_DRIFT, _LOAD = effect_of("thermal_drift"), effect_of("load_dependent_friction")
_SHAFT = effect_of("shaft_compliance")
_WAVE = {"left_cosine": "cosine", "left_sine": "sine", "order": "order"}
_GAP = {"cosine": "cosine", "sine": "sine", "order": "order"}  # of one mesh
_TEETH = "orders"  # search of numbers that no file states

PLACED_CATALOGUE: dict[str, PlacedEffect] = {
    entry.name: entry
    for entry in (
        *(whole(effect_of(f"{kind}_friction")) for kind in ("viscous", "coulomb")),
        *(whole(effect_of(name)) for name in ("friction_asymmetry", "stribeck_friction")),
        _one_side("presliding", {"ring_distance": "distance"}, RING),
        whole(_LOAD._replace(kernel=body_load_friction)),  # its own kernel is of reducers
        *(whole(effect_of(name)) for name in ("position_dependent_friction", "local_spot")),
        # the ring gear's own terms need the length of a log
        PlacedEffect(
            _DRIFT,
            tuple(p for p in _DRIFT.parameters if p.name in ("rise", "time_constant")),
            (0, 0.0, 0.0, 1, 1.0),
            0,
        ),
        *(whole(effect_of(name)) for name in ("quadratic_drag", "unbalance", "cable_spring")),
        whole(effect_of("base_vibration")),
        _one_side("cogging", _WAVE),
        _one_side("drive_offset", {"left": "offset"}),
        _one_side("torque_constant_mismatch", {"error": "error"}),  # of its own motor, side 0
        *(whole(effect_of(f"drive_{name}")) for name in ("dead_band", "saturation")),
        *(whole(effect_of(name)) for name in ("current_lag", "drive_delay")),
        PlacedEffect(
            _SHAFT,
            # friction of the declared body may sit on either side of the spring
            (*_SHAFT.parameters, Parameter("far_viscous", "N·m·s/rad", 0.0, inf, 1.0)),
            (0, 1, 2),
        ),
        whole(BACKLASH),
        _one_side("pinion_runout", _WAVE),
        whole(effect_of("ring_gear_eccentricity")),
        _one_side("mesh_error", _WAVE, search=_TEETH),
        _one_side("backlash_variation", _GAP),
        whole(effect_of("stiffness_variation")._replace(search=_TEETH)),
        *(whole(effect_of(f"sensor_{name}")) for name in ("delay", "gain")),
        whole(effect_of("encoder_eccentricity")),
    )
}


def register(entry: PlacedEffect) -> PlacedEffect:
    """Add a user's own effect for drives of any shape; ValueError for a wrong name or site."""
    if entry.name in PLACED_CATALOGUE:
        raise ValueError(
            f"effect {entry.name!r} is in the catalogue of rig files; choose another name"
        )
    if entry.site not in SITES:
        raise ValueError(f"effect {entry.name!r}: rig files have no site {entry.site!r}")
    PLACED_CATALOGUE[entry.name] = entry
    return entry


def place_of(rig: Rig, declared: DeclaredEffect) -> str:
    """Place of an effect that a rig file declares; RigError where it cannot stand there."""

    def fail(key: str, message: str) -> NoReturn:
        TableReader(rig.text, rig.source).fail(f"effect.{name}", key, message)

    name, on = declared.name, declared.on
    if (entry := PLACED_CATALOGUE.get(name)) is None:
        near = difflib.get_close_matches(name, PLACED_CATALOGUE, 1)
        hint = f"did you mean {near[0]!r}? " if near else ""
        fail("", f"no effect {name!r}; {hint}there are {', '.join(PLACED_CATALOGUE)}")
    has = {p.name: p for p in entry.keep}
    for key, value in declared.values.items():
        if key not in has:
            fail(key, f"{name} has no parameter {key!r}; it has {_listed(entry, has)}")
        if has[key].low == 0.0 > value.value:
            fail(key, f"{key} is {value.value:g}; it must be zero or more")
    lacking = [p.name for p in entry.effect.parameters if p.name not in declared.values]
    if entry.site == "shaft" and lacking:
        fail("", f"{name} needs {', '.join(lacking)}")
    parts: dict[str, tuple[Any, ...]] = {
        "input": rig.inputs, "body": rig.bodies, "link": rig.links, "sensor": rig.sensors,
    }  # fmt: skip
    rigid = tuple(link for link in rig.links if link.rigid)
    may = [part.name for part in (*parts[entry.place], *(rigid if entry.site == "shaft" else ()))]
    kind = {"input": "an input", "body": "a body", "link": "a shaft or mesh", "sensor": "a sensor"}
    stands = f"{name} stands on {kind[entry.place]}: {', '.join(may) or 'the rig has none'}"
    if not on and (len(may) == 1 or (may and entry.place == "body")):
        on = may[0]
    if on not in may:
        fail("on", f"{stands}; not on {on!r}" if on else f"on = … is missing; {stands}")
    softened = any(e.name == _SHAFT.name and e.on == on for e in rig.effects)
    if entry.place == "link" and on in {link.name for link in rigid} and not softened:
        fail("on", f"{name} on {on}, which is rigid; give it a stiffness")
    if entry.place == "body" and rig.body(on).linear and entry.effect.wave and "order" not in has:
        fail("on", f"{name} goes with a turn, and {on} slides; a constant load is drive_offset")
    if not any(p in declared.values for p in entry.amplitudes):
        there = entry._replace(
            keep=tuple(p._replace(unit=unit_at(on, rig, p.unit)) for p in entry.keep)
        )
        fail("", f"{name} has no size, so it does nothing; give {_listed(there, there.amplitudes)}")
    return on


def _listed(entry: PlacedEffect, names: Iterable[str]) -> str:
    """Return names of parameters with their units."""
    units = {p.name: f" [{p.unit}]" * bool(p.unit) for p in entry.keep}
    return ", ".join(f"{name}{units[name]}" for name in names)


@cache
def all_places(
    _: tuple[int, ...], parts: tuple[tuple[str, ...], ...]
) -> tuple[tuple[Place, ...], dict[str, tuple[int, int]], Floats]:
    """Places of the catalogue's effects in a rig; where each one's flag and numbers are.

    And the numbers of effects that are absent.
    """
    named = dict(zip(("input", "body", "link", "sensor"), parts, strict=True))
    places: list[Place] = []
    index: dict[str, tuple[int, int]] = {}
    first = 0
    # a lag is a number of its input
    entries = [c for c in PLACED_CATALOGUE.values() if c.site in CALLED and c.site != "lag"]
    # part by part, so that flags and numbers of each stand alike
    for kind, parts_ in named.items():
        for k, part in enumerate(parts_):
            for entry in (c for c in entries if c.place == kind):
                index[f"{entry.name}@{part}"] = len(places), first
                places.append(Place(entry.effect, k, entry.side, len(places), first))
                first += len(entry.fields)
    return tuple(places), index, np.hstack([p.effect.defaults() for p in places])
