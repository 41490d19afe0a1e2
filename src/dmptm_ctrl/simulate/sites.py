"""What effects change at a site, compiled apart from the step of a drive.

A step calls one function per kind of site. No shape of a drive is in its text: compiled once it
serves all drives, and an effect that is added changes no step.
"""

import dis
from typing import Any, NamedTuple

import numpy as np
from numba import float64, int64, types, uint8

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import lookup
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.loading import LOADING, key_of, load
from dmptm_ctrl.simulate.plant import NO_FLAGS, Flags, Ints, Place, Plant, Structure

# kind -> arguments of its kernels, and what they change: {0} to {3}, from what they get
CHANGES = {
    "amplifier": ("{0}, t", "{0} = {call}"),
    "lag": ("{0}", "c = {call}; {0} = c[0]; {1} = {1} + c[1]"),
    "motor": ("{a}, {b}, {c}, t", "{0} = {0} + {lever}{call}"),
    "load": ("{a}, {b}, t", "{0} = {0} + {lever}{call}"),
    "mesh": (
        "{a}, {b}, {c}, {d}",
        "c = {call}; {0} = {0} + c[0]; {1} = {1} + c[1]; {2} = {2} + c[2]; {3} = {3} + c[3]",
    ),
    "friction": ("{a}, {b}, t, {c}", "c = {call}; {0} = {0} * c[0]; {1} = {1} + c[1]"),
    "slip": ("{a}", "{0} = max({0}, {call}[1])"),
    "aged": ("{a}", "{0} = {0} + {call}[0]"),
    "sensor": ("{0}, {1}, t", "{0}, {1} = {call}"),
}
CHANGES["turning"] = CHANGES["friction"]  # by the direction of the motion too
_SITE = {"slip": "dwell", "aged": "dwell", "turning": "friction"}
_WITHOUT_SIDE = ("load", "sensor")  # kernels that take no side
_NO_POSTS = np.zeros(0, np.int64)
_ARRAYS = int64, uint8, float64, float64
SIGNATURE = types.void(*[float64] * 6, int64, *map(types.CPointer, _ARRAYS))
_TEXT = """\
from functools import partial

from dmptm_ctrl.simulate.elementary import FAST, compiled_callback, hosted
from dmptm_ctrl.simulate.sites import SIGNATURE

{kernels}


@partial(compiled_callback, SIGNATURE, cache=True, error_model="numpy", fastmath=FAST)
def at_site(a, b, c, d, t, lever, n, posts, on, e, r):
    side, flag, first = posts[3 * n], posts[3 * n + 1], posts[3 * n + 2]
{lines}
"""


def kernel_call(name: str, arguments: str, site: str, side: str, values: str) -> str:
    """Text that calls a kernel."""
    side = "" if site in _WITHOUT_SIDE else f"{side}, "
    return f"kernel_{name}({arguments}, {side}Values_{name}({values}))"


def uses_speed(effect: Effect) -> bool:
    """Whether what a kernel of friction returns depends on the speed or its direction."""
    code = getattr(effect.kernel, "py_func", effect.kernel).__code__
    speed = code.co_varnames[1]
    read = (i for i in dis.get_instructions(code) if i.opname.startswith("LOAD_FAST"))
    return any(speed == i.argval or speed in np.atleast_1d(i.argval) for i in read)


def places_at(s: Structure, kind: str, part: int) -> list[Place]:
    """Places of a kind of site at one part."""
    found = s.at(_SITE.get(kind, kind), part)
    if kind in ("friction", "turning"):
        found = [p for p in found if uses_speed(p.effect) == (kind == "turning")]
    return found


class _One(NamedTuple):
    """An effect at a site; its side, flag and numbers from those of the first."""

    effect: Effect
    side: int | None  # None: as the first
    flag: int
    first: int


class Sites:
    """Sites of a structure at which effects may act, and the functions that do.

    `posts` (3 n,) are the side, first flag and first number of each.
    """

    def __init__(self, s: Structure) -> None:
        self.index: dict[tuple[str, int], int] = {}  # of each kind and part
        self.function: dict[tuple[str, int], int] = {}  # its number
        self._own: list[tuple[str, tuple[_One, ...]]] = []
        posts: list[int] = []
        self._flags: list[int] = []
        self._begins: list[int] = []
        for kind in CHANGES:
            for part in sorted({p.part for p in s.places}):
                places = places_at(s, kind, part)
                if not places:
                    continue
                side, flag, first = places[0].side, places[0].flag, places[0].first
                key = kind, tuple(
                    _One(p.effect, None if p.side == side else p.side, p.flag - flag,
                         p.first - first)
                    for p in places
                )  # fmt: skip
                self.index[kind, part] = len(self.index)
                if key not in self._own:
                    self._own.append(key)
                self.function[kind, part] = self._own.index(key)
                posts += [side, flag, first]
                self._begins.append(len(self._flags))
                self._flags += [p.flag for p in places]
        self.posts: Ints = np.array(posts, np.int64)
        self._known: dict[bytes, tuple[Flags, Any]] = {}

    def of(self, plant: Plant) -> tuple[Flags, Any]:
        """At which sites an effect of a plant acts, and the functions of those."""
        if not self.index:
            return NO_FLAGS, _NO_POSTS
        key = plant.on.tobytes()
        if key not in self._known:
            acts = np.bitwise_or.reduceat(plant.on[self._flags], self._begins)
            used = {self.function[where] for where, n in self.index.items() if acts[n]}
            found = [_function(*own) if k in used else 0 for k, own in enumerate(self._own)]
            functions = np.array(found, np.int64 if elementary.COMPILED else object)
            self._known[key] = acts, functions
        return self._known[key]


_SITES: dict[int, Sites] = {}


def sites_of(s: Structure) -> Sites:
    """Return the sites of a structure, which `structure_of` gave; found once."""
    if id(s) not in _SITES:
        _SITES[id(s)] = Sites(s)
    return _SITES[id(s)]


def acting(s: Structure, plant: Plant) -> tuple[Flags, Ints, Any]:
    """At which sites of a structure an effect acts, their posts and functions; none inline."""
    if not s.either:
        return NO_FLAGS, _NO_POSTS, _NO_POSTS
    sites = sites_of(s)
    acts, functions = sites.of(plant)
    return acts, sites.posts, functions


def _function(kind: str, effects: tuple[_One, ...]) -> Any:
    arguments, change = CHANGES[kind]
    names = {"lever": "lever * ", **{x: x for x in "abcd"}}
    changed = [f"r[{i}]" for i in range(4)]
    lines, kernels = [], []
    for i, (effect, side, flag, first) in enumerate(effects):
        kernels += [
            f"kernel_{i} = hosted(EFFECTS[{i}].kernel)",
            f"Values_{i} = EFFECTS[{i}].values",
        ]
        values = ", ".join(f"e[first + {first + j}]" for j in range(len(effect.parameters)))
        call = kernel_call(
            str(i), arguments.format(*changed, **names), effect.site,
            "side" if side is None else str(side), values,
        )  # fmt: skip
        lines.append(f"    if on[flag + {flag}]:")
        parts = change.replace("c = ", "o = ").replace("c[", "o[").split("; ")
        lines += [f"        {part.format(*changed, call=call, **names)}" for part in parts]
    text = _TEXT.format(kernels="\n".join(kernels), lines="\n".join(lines))
    used = tuple(one.effect for one in effects)
    key = key_of(text, (elementary, lookup), used)
    with LOADING:
        found = load(f"site_{key}", text, EFFECTS=used).at_site
    return elementary.address_of(found)
