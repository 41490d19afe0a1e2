"""Write the step of a structure as source text.

Lines of a step: state, signals and numbers in, state out. One drive takes them in a row, lanes cut
them into loops; what is written so is called by the loops over samples of `loops.py`. The file's
name carries the hash of all that it is made of, so numba's cache on disk serves what is unchanged.
"""

from collections.abc import Callable, Iterable
from functools import cache
from types import ModuleType
from typing import Any, NamedTuple

from dmptm_ctrl.effects import backlash, lookup, presliding, stribeck
from dmptm_ctrl.simulate import elementary, step
from dmptm_ctrl.simulate.loading import LOADING, key_of, load
from dmptm_ctrl.simulate.plant import (
    DECLARED,
    ELASTIC_IMPACT,
    GAP,
    LAW_FIELDS,
    LINEAR,
    TWO_STATES,
    Place,
    Structure,
    number_names,
)
from dmptm_ctrl.simulate.sites import CHANGES, kernel_call, places_at, sites_of

_OWN = (
    *("aged", "at_once", "at_rest", "friction", "lagged", "mesh_step"),
    *("plain_mesh", "preslide", "two_state_step"),
)
_KERNELS = (
    *(("backlash", n) for n in ("impact_torque", "mesh_torque", "twist_torque")),
    ("stribeck", "breakaway_torque"),
)
_HEAD = """\
from math import cos, exp, floor, sin

import numpy as np
from numba import njit

from dmptm_ctrl.effects.backlash import Backlash
from dmptm_ctrl.effects.stribeck import Stribeck
from dmptm_ctrl.effects import backlash, stribeck
from dmptm_ctrl.simulate import step as pieces
from dmptm_ctrl.simulate.elementary import FAST, arrays_at, called, called_at, gather, hosted
from dmptm_ctrl.simulate.elementary import spread, wide
from dmptm_ctrl.simulate.generate import vector_kernel

TINY, UNKNOWN = pieces.TINY, pieces.UNKNOWN
"""


class Names:
    """State, signals and numbers of a structure, in the order of the step's arguments.

    Where drives stand in rows beside each other, parameters of effects are numbers too.
    """

    def __init__(self, s: Structure, rows: bool = False) -> None:
        coordinates = range(s.coordinates)
        self.state = [f"{x}{g}" for x in "qvp" for g in coordinates]
        self.state += [f"s{k}" for k, link in enumerate(s.links) if link[2] in (GAP, TWO_STATES)]
        self.state += [f"l{j}" for j, source in enumerate(s.inputs) if source[2]]
        self.state += [f"f{b}_bristle" for b in (coordinates if s.either else s.bristles)]
        self.state += [f"age{b}" for b in range(len(s.bodies)) if s.at("dwell", b)]
        self.signals = [f"u{j}" for j in range(len(s.inputs))]
        self.signals += [f"push{g}" for g in coordinates]
        for g in coordinates if s.either else ():
            self.signals += [f"xg{g}", f"sg{g}"]
        self.numbers = number_names(s, values=rows or not s.switched)
        # at zero, meshes that have been nowhere
        meshes = {f"s{k}" for k, link in enumerate(s.links) if link[2] == GAP}
        self.start = [step.UNKNOWN if name in meshes else 0.0 for name in self.state]


class _Text:
    """Lines of a function; with `rows` parameters of effects have names of their own."""

    def __init__(self, s: Structure, rows: bool = False) -> None:
        self.s, self.rows = s, rows
        self.sites = sites_of(s)
        self.lines: list[str] = []
        self.numbers = {id(p): i for i, p in enumerate(s.places)}

    def add(self, *lines: str) -> None:
        self.lines += [f"    {line}" for line in lines]

    def act(self, kind: str, part: int, changed: str, *values: str, lever: str = "") -> None:
        """What effects change at a site: by its function, or behind their flags where inline."""
        arguments, change = CHANGES[kind]
        names = [changed] if "," not in changed else changed.split(", ")
        if not self.s.either:
            given = dict(zip("abcd", values, strict=False))
            own = arguments.format(*names, **given)
            self.effects(
                places_at(self.s, kind, part),
                change.format(*names, lever=lever, call="{call}"), *own.split(", "),
            )  # fmt: skip
        elif (kind, part) in self.sites.index:
            n, k = self.sites.index[kind, part], self.sites.function[kind, part]
            row = ", ".join(f"r[{i}]" for i in range(len(names)))
            zeros = ["0.0"] * (4 - len(values))
            given_ = ", ".join([*values, *zeros, "t", lever.removesuffix(" * ") or "1.0", str(n)])
            self.add(
                f"if acts[{n}]:",
                f"    {row} = {changed}",
                f"    called_at(sites[{k}], ({given_}, posts, on, e, r))",
                f"    {changed} = {row}",
            )

    def effects(self, places: Iterable[Place], change: str, *arguments: str) -> None:
        """What places change: behind their flags, where they have some."""
        for p in places:
            indent = ""
            if self.s.switched:
                self.add(f"if on[{p.flag}]:")
                indent = "    "
            for part in change.format(call=self.call(p, *arguments)).split("; "):
                self.add(indent + part)

    def where(self, kind: str, part: int, *lines: str) -> None:
        """Lines that are of matter where an effect acts at a site."""
        if not self.s.switched:
            self.add(*lines)
        elif places := places_at(self.s, kind, part):
            flags = dict.fromkeys(f"on[{p.flag}]" for p in places)
            if self.s.either:
                flags = {f"acts[{self.sites.index[kind, part]}]": None}
            self.add(f"if {' or '.join(flags)}:", *(f"    {line}" for line in lines))

    def call(self, p: Place, *arguments: str) -> str:
        e = "e[{}]" if self.s.switched and not self.rows else "e{}"
        values = ", ".join(e.format(p.first + j) for j in range(len(p.effect.parameters)))
        i = str(self.numbers[id(p)])
        return kernel_call(i, ", ".join(arguments), p.effect.site, str(p.side), values)

    def turned(self, body: int, name: str) -> str:
        """Motion of a body by that of its coordinate."""
        g, sign, _ = self.s.bodies[body]
        return f"r{body} * {name}{g}" if sign else f"{name}{g}"

    def lever(self, body: int) -> str:
        return f"r{body} * " if self.s.bodies[body][1] else ""

    def twist(self, k: int, at: str, speed: str) -> None:
        """Twist of a link and its rate, and the record of its contact law."""
        first, second, law, _ = self.s.links[k]
        ends = [self.turned(b, x) for b in (first, second) for x in (at, speed)]
        self.add(f"z{k} = {ends[0]} - n{k} * ({ends[2]})")
        self.add(f"zr{k} = {ends[1]} - n{k} * ({ends[3]})")
        meshes = self.s.at("mesh", k)
        stiff, gap = f"k{k}", f"g{k}"
        if meshes:
            self.add(f"za{k}, zb{k}, zc{k}, zd{k} = 0.0, 0.0, 0.0, 0.0")
            self.act("mesh", k, f"za{k}, zb{k}, zc{k}, zd{k}", *ends)
            self.add(f"z{k} = z{k} + za{k}", f"zr{k} = zr{k} + zb{k}")
            stiff, gap = f"k{k} + zd{k}", f"max(g{k} + zc{k}, 0.0)"
        if law == LINEAR:
            self.add(f"T{k} = ({stiff}) * z{k} + c{k} * zr{k}")
        else:
            self.add(f"law{k} = Backlash({stiff}, c{k}, f{k}, {gap})")


def step_lines(s: Structure, rows: bool = False) -> list[str]:
    """Lines of the step, up to its end."""
    text = _Text(s, rows)
    _middle(s, text)
    _inputs(s, text)
    _links(s, text)
    for g in range(s.coordinates):
        _forces(s, text, g)
    for g in range(s.coordinates):
        _rub(s, text, g)
    for g in range(s.coordinates):
        for b in s.body_names(g):
            if s.at("dwell", b):
                speed = f"0.5 * {text.lever(b)}(v{g} + new{g})"
                text.where("slip", b, f"age{b} = aged(age{b}, {speed}, h, slip{b})")
        text.add(f"p{g}, v{g} = v{g}, new{g}", f"q{g} = x{g} + 0.5 * h * v{g}")
        if s.either:
            text.add(f"if is{g} > 0.0:", f"    q{g}, v{g}, p{g} = x{g}, o{g}, o{g}")
    return text.lines


def row_text(names: Iterable[str]) -> str:
    row = ", ".join(names)
    return f"({row},)"


def _middle(s: Structure, text: _Text) -> None:
    """Coordinates and speeds in the middle of the step."""
    for g in range(s.coordinates):
        given, turning = (f"{x}g{g} if is{g} > 0.0 else " * s.either for x in "xs")
        text.add(f"x{g} = {given}q{g} + 0.5 * h * v{g}")
        text.add(f"o{g} = {turning}1.5 * v{g} - 0.5 * p{g}")


def _inputs(s: Structure, text: _Text) -> None:
    for j, (_, limited, lags) in enumerate(s.inputs):
        text.act("amplifier", j, f"u{j}")
        if limited:
            text.add(f"u{j} = min(lim{j}, max(-lim{j}, u{j}))")
        if lags:
            relax = f"u{j}, l{j} = lagged(l{j}, u{j}, time{j}, h)"
            text.add(f"time{j} = tau{j}")
            text.act("lag", j, f"u{j}, time{j}")
            if s.either:
                text.add(f"if time{j} > 0.0:", f"    {relax}")
            elif lags == DECLARED:
                text.add(relax)
            else:
                text.where("lag", j, relax)
        text.add(f"drive{j} = gain{j} * u{j}")


def _links(s: Structure, text: _Text) -> None:
    meshes = [k for k, link in enumerate(s.links) if link[2] == GAP and text.rows]
    for k, (_, _, law, _) in enumerate(s.links):
        text.twist(k, "x", "o")
        if k in meshes:
            text.add(f"T{k}, r{k}_new, odd{k} = plain_mesh(z{k}, zr{k}, law{k}, s{k})")
        elif law == GAP:
            text.add(f"T{k}, s{k} = mesh_step(z{k}, zr{k}, law{k}, s{k}, h)")
        elif law == TWO_STATES:
            text.add(f"T{k}, s{k} = two_state_step(z{k}, zr{k}, s{k}, law{k}, h)")
        elif law == ELASTIC_IMPACT:
            text.add(f"T{k} = impact_torque(z{k}, zr{k}, law{k})")
    # lanes with a mesh that reaches a flank, or is about to, are few
    for k in meshes:
        text.add(f"if some(odd{k}):")
        text.add(f"    T{k}, r{k}_new = mesh_step(z{k}, zr{k}, law{k}, s{k}, h)")
        text.add(f"s{k} = r{k}_new")


def _forces(s: Structure, text: _Text, g: int) -> None:
    """Net torque on a coordinate without friction."""
    terms = [f"push{g}"]
    bodies = s.body_names(g)
    for j, (b, _, _) in enumerate(s.inputs):
        if b in bodies:
            terms.append(f"{text.lever(b)}drive{j}")
    for k, (first, second, _, _) in enumerate(s.links):
        if first in bodies:
            terms.append(f"-{text.lever(first)}T{k}")
        if second in bodies:
            terms.append(f"{text.lever(second)}n{k} * T{k}")
    text.add(f"force{g} = {' + '.join(terms)}".replace("+ -", "- "))
    for b in bodies:
        volts = next((f"u{j}" for j, source in enumerate(s.inputs) if source[0] == b), "0.0")
        motion = text.turned(b, "x"), text.turned(b, "o")
        text.act("motor", b, f"force{g}", volts, *motion, lever=text.lever(b))
        text.act("load", b, f"force{g}", *motion, lever=text.lever(b))


def _load(s: Structure, body: int) -> str:
    """What presses on the bearings of a body."""
    terms = []
    for k, (first, second, _, loads) in enumerate(s.links):
        if loads and body in (first, second):
            terms.append(f"T{k}" if body == first else f"n{k} * T{k}")
    return " + ".join(f"abs({term})" for term in terms) or "0.0"


def _rub(s: Structure, text: _Text, g: int) -> None:
    """Speed of a coordinate after friction of its bodies."""
    bodies = [
        b for b in s.body_names(g) if s.bodies[b][2] or s.at("friction", b) or s.at("dwell", b)
    ]
    if not bodies:
        text.add(f"new{g} = v{g} + force{g} * m{g}")
        return
    bristle = next((b for b in s.bristles if b in bodies), None)
    speed = f"v{g}" if bristle is None else f"o{g}"  # which way, is of no matter at rest
    if s.either:
        speed = f"(o{g} if by{g} > 0.0 else v{g})"
    text.add(
        f"rest{g} = 1.0 if force{g} > 0.0 else -1.0",
        f"way{g} = 1.0 if {speed} > 0.0 else -1.0",
        f"level{g} = 0.0",
    )
    if s.either or bristle is not None:
        text.add(f"once{g} = 0.0")
    holds = [_rub_of_body(s, text, g, b, bristle) for b in bodies]
    rigid = [
        f"new{g} = v{g} + force{g} * m{g} - level{g} * (way{g} * m{g})",
        f"new{g} = at_rest("
        f"v{g}, new{g}, way{g}, rest{g}, {' + '.join(holds)}, force{g}, m{g}"
        f") if v{g} == 0.0 or new{g} * way{g} < 0.0 else new{g}",
    ]
    own, law = g, f"Stribeck({', '.join(f'of{g}_{x}' for x in LAW_FIELDS)})"
    numbers = f"by{g}, lag{g}"
    if bristle is not None:
        own, law = bristle, f"law_{bristle}"
        distance = f"bd{own} / abs(r{own})" if s.bodies[own][1] else f"bd{own}"
        numbers = f"{distance}, bl{own}"
    elastic = (
        f"new{g}, f{own}_bristle = preslide("
        f"v{g}, o{g}, force{g}, m{g}, h, way{g} * level{g} - once{g}, once{g}, "
        f"f{own}_bristle, {numbers}, {law})"
    )
    if s.either:
        text.add(f"if by{g} > 0.0:", f"    {elastic}", "else:", *(f"    {x}" for x in rigid))
    else:
        text.add(*([elastic] if bristle is not None else rigid))


def _rub_of_body(s: Structure, text: _Text, g: int, b: int, bristle: int | None) -> str:
    """Add the friction of one body while it slides; return the text of what holds at rest."""
    _, sign, law = s.bodies[b]
    lever = f"abs(r{b}) * " if sign else ""
    flip = "-" if sign < 0 else ""
    theta, load = text.turned(b, "x"), _load(s, b)
    if law:
        fields = [f"w{b}_{field}" for field in LAW_FIELDS]
        if law == 1:
            fields[LAW_FIELDS.index("exponent")] = "1.0"
        text.add(f"law_{b} = Stribeck({', '.join(fields)})")
    elif b == bristle:
        text.add(f"law_{b} = Stribeck({', '.join(['0.0'] * 8 + ['1.0'] * 3)})")
    text.add(
        f"way_{b} = {flip}way{g}",
        f"omega_{b} = {text.turned(b, 'o')}",
        f"load_{b} = {load}",
        f"scale_{b}, added_{b} = 1.0, 0.0",
    )
    if s.at("dwell", b):
        text.add(f"slip{b} = 0.0")
        text.act("slip", b, f"slip{b}", f"age{b}")
        speed = f"0.5 * {text.lever(b)}(v{g} + o{g})"
        text.where("slip", b, f"middle{b} = aged(age{b}, {speed}, 0.5 * h, slip{b})")
        text.act("aged", b, f"added_{b}", f"middle{b}")
    change = f"scale_{b}, added_{b}"
    text.act("friction", b, change, theta, f"omega_{b}", f"load_{b}")
    turning = places_at(s, "turning", b)
    at_rest = f"scale_{b}", f"added_{b}"
    if turning:
        text.add(f"size_{b} = way_{b} * ({lever}max(o{g} * way{g}, 0.0) + TINY)")
    if turning and bristle is None:
        at_rest = f"scale0_{b}", f"added0_{b}"
        text.add(
            f"{', '.join(at_rest)} = scale_{b}, added_{b}",
            f"omega0_{b} = {flip}rest{g} * TINY",
        )
        text.act("turning", b, ", ".join(at_rest), theta, f"omega0_{b}", f"load_{b}")
    text.act("turning", b, change, theta, f"size_{b}", f"load_{b}")
    if law:
        text.add(
            f"level{g} = level{g} + {lever}"
            f"friction(omega_{b}, way_{b}, scale_{b}, added_{b}, law_{b})"
        )
    else:
        text.add(f"level{g} = level{g} + {lever}max(scale_{b} * added_{b}, 0.0)")
    if law and (s.either or bristle is not None):
        share = f"share{g}" if s.either else f"bs{bristle}"
        once = f"at_once(omega_{b}, way_{b}, scale_{b}, {share}, law_{b})"
        if s.either:
            text.add(f"if by{g} > 0.0:")
        text.add(f"{'    ' * s.either}once{g} = once{g} + {text.lever(b)}{once}")
    held = f"breakaway_torque({flip}rest{g}, law_{b}) + {at_rest[1]}" if law else at_rest[1]
    return f"{lever}max({at_rest[0]} * ({held}), 0.0)"


def reading_lines(s: Structure, rows: bool = False) -> tuple[list[str], list[str]]:
    """Lines that read the sensors, and the names of what they read."""
    text = _Text(s, rows)
    for i, (b, speed, is_late) in enumerate(s.sensors):
        text.add(f"a{i}, w{i} = {text.turned(b, 'q')}, {text.turned(b, 'v')}")
        if is_late:
            text.add(f"{'w' if speed else 'a'}{i} = late{i}")
        text.act("sensor", i, f"a{i}, w{i}")
    return text.lines, [f"{'w' if speed else 'a'}{i}" for i, (_, speed, _) in enumerate(s.sensors)]


def torque_lines(s: Structure, rows: bool = False) -> tuple[list[str], list[str]]:
    """Lines that find torques and twists of links, and the names of these."""
    text = _Text(s, rows)
    for k, (first, second, law, _) in enumerate(s.links):
        text.twist(k, "q", "v")
        if law == GAP:
            text.add(f"T{k} = mesh_torque(z{k}, zr{k}, law{k})")
        elif law == TWO_STATES:
            text.add(f"T{k} = twist_torque(s{k}, z{k}, zr{k}, law{k})")
        elif law == ELASTIC_IMPACT:
            text.add(f"T{k} = impact_torque(z{k}, zr{k}, law{k})")
        # as the bodies turn, without what teeth add
        text.add(f"z{k} = {text.turned(first, 'q')} - n{k} * ({text.turned(second, 'q')})")
    return text.lines, [f"{x}{k}" for x in "Tz" for k in range(len(s.links))]


def sensed(s: Structure, i: int) -> tuple[str, str]:
    """Names of the ratio and of the motion that a sensor sees; no name for a ratio of 1."""
    b, speed, _ = s.sensors[i]
    g, sign, _ = s.bodies[b]
    return f"r{b}" if sign else "", f"{'v' if speed else 'q'}{g}"


def vector_kernel(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """Return a kernel inline, with tables that lanes look up side by side."""
    return elementary.hosted(kernel, (lookup.looked_up, lookup.summed))


def head_text(s: Structure, rows: bool = False, *, kernels: bool = True) -> str:
    """Text of the names that the functions use, of effects their kernels."""
    host = "vector_kernel" if rows else "called" if s.switched else "hosted"
    lines = [_HEAD]
    lines += [f"{name} = hosted(pieces.{name})" for name in _OWN]
    lines += [f"{name} = hosted({module}.{name})" for module, name in _KERNELS]
    for i in range(len(s.places) if kernels else 0):
        lines += [
            f"kernel_{i} = {host}(EFFECTS[{i}].kernel)",
            f"Values_{i} = EFFECTS[{i}].values",
        ]
    return "\n".join(lines) + "\n"


def compiled(text: str, *entries: str) -> str:
    """Text whose functions numba compiles; `entries` are called from Python, others inline."""
    options = 'cache=True, error_model="numpy", nogil=True, fastmath=FAST, no_cfunc_wrapper=True'
    for entry in entries:
        text = text.replace(f"@njit\ndef {entry}(", f"@njit({options})\ndef {entry}(")
    inner = f"{options}, no_cpython_wrapper=True, forceinline=True"
    return text.replace("@njit\n", f"@njit({inner})\n")


class Engine(NamedTuple):
    """The compiled loop of a structure and the names of what it takes."""

    module: ModuleType
    names: Names


_ENGINES: dict[tuple[int, str], Engine] = {}


def engine_by(s: Structure, kind: str, text: Callable[[Structure], str]) -> Engine:
    """Return an engine, written once for each structure."""
    key = id(s), kind
    if key not in _ENGINES:
        modules = (backlash, lookup, presliding, stribeck, elementary, step)
        with LOADING:
            written = text(s)
            effects = tuple(p.effect for p in s.places) if "EFFECTS" in written else ()
            name = f"{kind}_{key_of(written, modules, effects)}"
            what = f"{'single runs' if kind == 'scalar' else 'many runs at once'} of this drive"
            module = load(name, written, what, EFFECTS=effects)
            _ENGINES[key] = Engine(module, Names(s))
    return _ENGINES[key]


@cache
def called_of(module: ModuleType, name: str, signature: Any) -> Any:
    """Address of a function of an engine, compiled when it is first asked for."""
    with LOADING:
        options: dict[str, Any] = {"error_model": "numpy", "fastmath": elementary.FAST}
        function = getattr(module, name)
        return elementary.address_of(
            elementary.compiled_callback(signature, function, cache=True, **options)
        )
