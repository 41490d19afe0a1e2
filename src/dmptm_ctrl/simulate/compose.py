"""Write the site chains of the catalogue as source text, in front of the time-stepping loop.

numba compiles and caches per file, so the text becomes a file whose name carries the hash
of everything it is made of: the loop, and each kernel. A changed kernel or a user's new
effect gives another name, and so one recompile.
"""

import ast
import hashlib
import importlib.util
import inspect
import os
import re
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from threading import RLock
from types import ModuleType
from typing import Any, TypeVar

from dmptm_ctrl.contract import SITES, Effect
from dmptm_ctrl.effects import CATALOGUE, backlash, lookup, presliding, stribeck
from dmptm_ctrl.effects.lookup import looked_up
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.slope_chains import slope_source

# one thread writes an engine at a time: where two parse at once Python 3.11.0 to 3.11.7 counts
# their depths together and fails (CPython issue 106905)
_LOADING = RLock()
_T = TypeVar("_T")

# per site: name of the chain, its arguments, neutral result, how one effect changes it
_CHAINS: dict[str, tuple[str, str, str, str]] = {
    "drive": ("drive_voltage", "u, t, side", "u", "u = {call}"),
    "delay": ("voltage_delay", "", "0.0", "r += {call}"),
    "lag": ("lag_relaxation", "u, side", "u, 0.0", "u, r = {call}"),
    "motor": ("motor_torque", "u, theta_m, omega_m, t, side", "0.0", "r += {call}"),
    "shaft": ("shaft_compliance", "inertia", "0.0, 0.0", "r = {call}"),
    "mesh": (
        "mesh_shift",
        "theta_p, omega_p, theta_L, omega_L, side",
        "0.0, 0.0, 0.0, 0.0",
        "c = {call}; r = (r[0] + c[0], r[1] + c[1], r[2] + c[2], r[3] + c[3])",
    ),
    "friction": (
        "friction_level",
        "theta, omega, t, mesh_torque, body",
        "1.0, 0.0",
        "c = {call}; r = (r[0] * c[0], r[1] + c[1])",
    ),
    "presliding": (
        "presliding_law",
        "body",
        "0.0, 0.0, 0.0",
        "c = {call}; r = (r[0] + c[0], max(r[1], c[1]), max(r[2], c[2]))",
    ),
    "ageing": (
        "aged_friction",
        "age, body",
        "0.0, 0.0",
        "c = {call}; r = (r[0] + c[0], max(r[1], c[1]))",
    ),
    "load": ("load_torque", "theta_L, omega_L, t", "0.0", "r += {call}"),
    "sensor": (
        "sensor_reading",
        "theta_L, omega_L, t",
        "theta_L, omega_L",
        "theta_L, omega_L = {call}",
    ),
    "sensor_delay": ("speed_delay", "", "0.0", "r += {call}"),
}
# per site of the inner loop: the same over lanes, from rows A to rows R of the work array
_LANE_CHAINS: dict[str, tuple[str, str, str]] = {
    "drive": ("drive_lanes", "{A0}, t, side", "{A0} = {call}"),
    "lag": ("lag_lanes", "{R0}, side", "{R0}, {R1} = {call}"),
    "motor": ("motor_lanes", "{A2}, {A0}, {A1}, t, side", "{R0} += {call}"),
    "mesh": (
        "mesh_lanes",
        "{A0}, {A1}, {A2}, {A3}, side",
        "c = {call}; s[result + lane] += c[0]; s[result + LANES + lane] += c[1]; "
        "s[result + 2 * LANES + lane] += c[2]; s[result + 3 * LANES + lane] += c[3]",
    ),
    "friction": (
        "friction_lanes",
        "{A0}, {A1}, t, {A2}, side",
        "c = {call}; {R0} *= c[0]; {R1} += c[1]",
    ),
    "ageing": ("ageing_lanes", "{A0}, side", "{R1} += {call}[0]"),
    "load": ("load_lanes", "{A0}, {A1}, t", "{R0} += {call}"),
    "sensor": ("sensor_lanes", "{A0}, {A1}, t", "{A0}, {A1} = {call}"),
}
# the same over samples of a recorded run: kernels' arguments are rows of its work array
_SAMPLE_CHAINS: dict[str, tuple[str, str]] = {
    "drive": ("drive_samples", "s[X_VOLTS + i] = {call}"),
    "motor": ("motor_samples", "s[X_ADDED_TORQUE + i] += {call}"),
    "mesh": ("mesh_samples", "c = {call}; s[X_SHIFT + i] += c[0]; s[X_GAP + i] += c[2]"),
    "friction": ("friction_samples", "c = {call}; s[X_SCALE + i] *= c[0]; s[X_ADDED + i] += c[1]"),
    "load": ("load_samples", "s[X_ADDED_TORQUE + i] += {call}"),
}
_SAMPLE_ROWS = {
    "u": "X_VOLTS",
    "theta_m": "X_MOTOR",
    "omega_m": "X_MOTOR_SPEED",
    "t": "X_TIME",
    "theta_p": "X_ANGLE",
    "omega_p": "X_SPEED",
    "theta_L": "X_RING",
    "omega_L": "X_RING_SPEED",
    "theta": "X_ANGLE",
    "omega": "X_SPEED",
    "mesh_torque": "X_MESH",
}
_ROWS = ("A0", "A1", "A2", "A3", "R0", "R1")
_KERNEL_ARGS = {"delay": "0", "lag": "u, side"}  # a delay is the same on both sides


# kernels that the loop calls by itself
_OWN_KERNELS = (
    *("landing", "mesh_region", "mesh_torque", "region_torque"),
    *("stribeck_law", "breakaway_torque", "sliding_torque", "viscous_torque"),
    *("bristle_lag", "build_up_distance", "fading"),
)


_INLINE = (
    *(
        "held_average",
        *("rub", "scale", "without_power", "in_blocks", "slide_along"),
        "slide",
        "stop",
        "slide_or_stick",
        "preslide",
        "friction_step",
        "mesh_step",
    ),
    *("aged", "bristles_of"),
    *("law", "plain_region", "level_stage"),
    *("section", "direction_of", "friction_along", "built_up", "feed_forward", "undone"),
    *(
        "stays",
        "mesh_slopes",
        "law_slopes",
        "one_way",
        "one_of",
        "smooth_body",
        "mesh_change",
        "mesh_own",
        *("frictions_own", "own_of_bodies", "moved_by"),
        "law_own",
    ),
    *(
        "change_along",
        "mesh_along",
        "meshes_along",
        "plain_mesh",
        "is_same",
        "change_of_mesh",
        "own_of",
    ),
    *("own_of_mesh", "volts_along", "load_slopes_of", "friction_slopes_of"),
    "ageing_slopes_of",
    *("bristling", "bristle_change", "grown", "older_by", "sliding", "with_level"),
    *("without_level", "voltage_of", "level_of", "lagged", "law_of", "bristles_in", "law_in"),
    *("keep_along", "own_by_slopes"),
    *("row_step", "motor_step"),
)
# What Python calls; the rest is called by these alone and has no wrapper for Python, which
# would be more text for the compiler than the function itself.
_ENTRIES = (
    *("march", "march_groups", "march_tangents", "march_site_tangents", "command"),
    *("along", "sliding_along", "presliding_along", "readings"),
    *("presliding_law", "speed_delay"),
)
_HEAD = """\
from math import cos, exp, floor, log, sin, sqrt, tanh
from typing import NamedTuple

import numpy as np
from numba import njit

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.backlash import (
    Backlash,
    landing,
    mesh_region,
    mesh_torque,
    region_torque,
)
from dmptm_ctrl.effects.lookup import looked_up, summed
from dmptm_ctrl.effects.presliding import bristle_lag, build_up_distance, fading
from dmptm_ctrl.effects.stribeck import (
    Stribeck,
    breakaway_torque,
    sliding_torque,
    stribeck_law,
    viscous_torque,
)
from dmptm_ctrl.simulate.elementary import cos, exp, sin, FAST, borrowed, hosted, wide

"""


def _slots() -> dict[str, int]:
    """Position of each effect's first parameter in the flat vector."""
    position, slots = 0, {}
    for name, effect in CATALOGUE.items():
        slots[name] = position
        position += len(effect.parameters)
    return slots


def _chain(site: str, effects: Mapping[str, Effect], rows: bool = False) -> str:
    """Text of a site's chain; with `rows` of one of several drives, whose numbers are in a row."""
    name, args, neutral, change = _CHAINS[site]
    head = (
        f"{name}_of({args + ', ' if args else ''}on, values, row)"
        if rows
        else (f"{name}({args + ', ' if args else ''}on, values)")
    )
    at = "row, " if rows else ""
    lines = [f"@njit\ndef {head}:"]
    in_place = change.startswith(("u = ", "theta_L, "))
    if site == "lag":
        lines.append("    r = 0.0")
    elif not in_place:
        lines.append(f"    r = {neutral}" if "," not in neutral else f"    r = ({neutral})")
    slots = _slots()
    for index, (key, effect) in enumerate(effects.items()):
        if effect.site != site:
            continue
        first = slots[key]
        values = ", ".join(f"values[{at}{first + j}]" for j in range(len(effect.parameters)))
        passed = _KERNEL_ARGS.get(site, args)
        call = f"kernel_{index}({passed + ', ' if passed else ''}Values_{index}({values}))"
        lines.append(f"    if on[{index}]:")
        lines += [f"        {part}" for part in change.format(call=call).split("; ")]
    result = {"drive": "u", "lag": "u, r", "sensor": "theta_L, omega_L"}.get(site, "r")
    lines.append(f"    return {result}")
    return "\n".join(lines)


def _vector_kernel(index: int, effect: Effect) -> str:
    """Name of an effect's kernel for several drives, or samples, at once."""
    calls = getattr(effect.kernel, "py_func", effect.kernel).__code__.co_names
    return f"vector_kernel_{index}" if looked_up.__name__ in calls else f"kernel_{index}"


def _lane_chain(site: str) -> str:
    """Text of a site's chain over lanes: one loop per effect, skipped where no lane has it."""
    name, args, change = _LANE_CHAINS[site]
    rows = {row: f"s[{row} + lane]" for row in _ROWS}
    result = "result, " if site == "mesh" else ""
    lines = [f"@njit\ndef {name}(s, width, {result}side, t, on):"]
    if site == "lag":
        lines.append("    for lane in range(width):")
        lines.append("        s[R0 + lane], s[R1 + lane] = s[A0 + lane], 0.0")
    slots = _slots()
    for index, (key, effect) in enumerate(CATALOGUE.items()):
        if effect.site != site:
            continue
        values = ", ".join(
            f"s[VALUE_{slots[key] + j} + lane]" for j in range(len(effect.parameters))
        )
        call = f"{_vector_kernel(index, effect)}({args.format(**rows)}, Values_{index}({values}))"
        lines += [f"    if on[{index}]:", "        for lane in range(width):"]
        lines += [f"            {part}" for part in change.format(call=call, **rows).split("; ")]
    return "\n".join([*lines, "    return"])


def _sample_chain(site: str) -> str:
    """Text of a site's chain over samples: one loop per effect, whose numbers stay."""
    name, change = _SAMPLE_CHAINS[site]
    args = ", ".join(
        f"s[{_SAMPLE_ROWS[arg]} + i]" if arg in _SAMPLE_ROWS else "side"
        for arg in _CHAINS[site][1].split(", ")
    )
    lines = [f"@njit\ndef {name}(s, width, side, on, values):"]
    slots = _slots()
    for index, (key, effect) in enumerate(CATALOGUE.items()):
        if effect.site != site:
            continue
        values = ", ".join(f"values[{slots[key] + j}]" for j in range(len(effect.parameters)))
        lines += [f"    if on[{index}]:", f"        p = Values_{index}({values})"]
        call = f"{_vector_kernel(index, effect)}({args}, p)"
        lines += ["        for i in range(width):"]
        lines += [f"            {part}" for part in change.format(call=call).split("; ")]
    return "\n".join([*lines, "    return"])


def _flags(effects: Mapping[str, Effect]) -> str:
    """Text of the function that tells which of the sites in the inner loop are in use."""
    keys = list(effects)
    tests = []
    for site in ("drive", "motor", "mesh", "friction", "load", "sensor"):
        terms = [f"on[{keys.index(k)}] > 0" for k, e in effects.items() if e.site == site]
        tests.append(" or ".join(terms) or "False")
    return (
        "@njit\ndef active_sites(on):\n    return (\n"
        + "".join(f"        {test},\n" for test in tests)
        + "    )"
    )


def _body(name: str) -> str:
    """Text of a loop module after its last import."""
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    imports = [node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom)]
    return "".join(text.splitlines(keepends=True)[imports[-1].end_lineno :])


def _loop(effects: Mapping[str, Effect]) -> str:
    """Text of the loop with the chains of these effects."""
    names = "\n".join(
        f"kernel_{i} = hosted(CATALOGUE[{name!r}].kernel)\nValues_{i} = CATALOGUE[{name!r}].values"
        for i, name in enumerate(effects)
    )
    names += "".join(
        f"\n{name} = hosted(CATALOGUE[{key!r}].kernel, (looked_up, summed))"
        for i, (key, effect) in enumerate(effects.items())
        if (name := _vector_kernel(i, effect)) != f"kernel_{i}"
    )
    own = "\n".join(f"{name} = hosted({name})" for name in _OWN_KERNELS)
    chains = "\n\n\n".join([_flags(effects), *(_chain(site, effects) for site in SITES)])
    return (
        f"{_HEAD}{own}\n{names}\n\n\n{chains}\n\n\n"
        f"{_body('control_core.py')}\n\n{_body('core.py')}\n\n"
    )


def plain_source() -> str:
    """Return the text of the loop for drives without effects, whatever is in the catalogue."""
    return _compiled(_loop({}))


def source() -> str:
    """Return the text of the engine for the catalogue as it is now."""
    row_chains = "\n\n\n".join(_chain(site, CATALOGUE, rows=True) for site in SITES)
    lane_chains = "\n\n\n".join(_lane_chain(site) for site in _LANE_CHAINS)
    sample_chains = "\n\n\n".join(_sample_chain(site) for site in _SAMPLE_CHAINS)
    lanes = _body("lane_stages_core.py")
    cut = lanes.index("\n@njit\n")  # behind the constants that the chains need
    places = "".join(
        f"VALUE_{k} = VALUES + {k} * LANES\n"  # a constant each: less arithmetic to compile
        for k in range(sum(len(effect.parameters) for effect in CATALOGUE.values()))
    )
    return _compiled(
        f"{_loop(CATALOGUE)}{_body('tangent_core.py')}\n\n"
        f"{sample_chains}\n\n\n{_body('along_core.py')}\n\n"
        f"{row_chains}\n\n\n{_body('row_step_core.py')}\n\n"
        f"{slope_source(CATALOGUE, _slots())}\n\n\n{_body('bristle_core.py')}\n\n"
        f"{_body('site_change_core.py')}\n\n{_body('tangent_site_core.py')}\n\n"
        f"{lanes[:cut]}\n{places}\n\n{lane_chains}\n\n{lanes[cut:]}\n\n{_body('lane_core.py')}"
    )


def _compiled(text: str) -> str:
    """Text whose functions numba compiles, each as it is called."""
    if not elementary.COMPILED:
        text = text.replace("elementary import cos, exp, sin,", "elementary import")
    options = 'cache=True, error_model="numpy", nogil=True, fastmath=FAST'
    for entry in _ENTRIES:
        text = text.replace(f"@njit\ndef {entry}(", f"@njit({options})\ndef {entry}(")
    options += "".join(f", {key}={value}" for key, value in elementary.INNER.items())
    for helper in _INLINE:
        text = text.replace(
            f"@njit\ndef {helper}(", f"@njit({options}, forceinline=True)\ndef {helper}("
        )
    inline = f"@njit({options}, forceinline=True)\ndef "
    text = re.sub(r"@njit\ndef (?=\w+_slopes_\d+\()", inline, text)
    return text.replace("@njit\n", f"@njit({options})\n")


_KERNELS = (backlash, lookup, presliding, stribeck, elementary)


def _key(text: str, effects: Mapping[str, Effect] = CATALOGUE) -> str:
    parts = [text, *(inspect.getsource(m) for m in _KERNELS)]
    for effect in effects.values():
        module = sys.modules.get(effect.kernel.__module__)
        file = getattr(module, "__file__", None)
        parts.append(Path(file).read_text(encoding="utf-8") if file else _cell(effect.kernel))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]


def _cell(kernel: object) -> str:
    """Source of a kernel defined in a notebook, or its bytecode where that is not kept."""
    function = getattr(kernel, "py_func", kernel)
    try:
        return inspect.getsource(function)  # type: ignore[arg-type]
    except OSError:
        return repr(function.__code__.co_code)  # type: ignore[attr-defined]


def cache_folder() -> Path:
    """Folder of the compiled engine; a temporary one where nothing can be written."""
    places = [os.environ.get("DMPTM_CACHE_DIR"), os.environ.get("XDG_CACHE_HOME")]
    candidates = [Path(p) / "dmptm_ctrl" for p in places if p]
    candidates.append(Path.home() / ".cache" / "dmptm_ctrl")
    for folder in candidates:
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                return folder
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="dmptm_ctrl_"))


def _load(key: str, text: str, effects: Mapping[str, object] = CATALOGUE) -> ModuleType:
    with _LOADING:
        return _loaded(key, text, len(effects))


@cache
def _loaded(key: str, text: str, effects: int) -> ModuleType:
    file = cache_folder() / f"engine_{key}.py"
    if not file.exists() or file.read_text(encoding="utf-8") != text:
        if elementary.COMPILED:
            sys.stderr.write(
                f"Compiling the simulator for {effects or 'no'} effects, once for this catalogue "
                "and kind of run; about ten seconds.\n"
            )
            sys.stderr.flush()
        fresh = file.with_suffix(f".{os.getpid()}")
        fresh.write_text(text, encoding="utf-8")
        os.replace(fresh, file)
    spec = importlib.util.spec_from_file_location(file.stem, file)
    if spec is None or spec.loader is None:
        raise ImportError(f"cannot load the engine from {file.name}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[file.stem] = module
    spec.loader.exec_module(module)
    return module


def per_catalogue(function: Callable[..., _T]) -> Callable[..., _T]:
    """Keep what a function returns for as long as the catalogue has the same effects.

    A fit asks hundred thousands of times. The effects are told apart by identity, for to compare
    all their numbers takes longer than what is asked for. Threads that ask at once get one answer.
    """
    known: dict[tuple[Any, ...], tuple[tuple[Effect, ...], _T]] = {}
    last: dict[tuple[int, ...], tuple[tuple[Effect, ...], _T]] = {}

    def found(*args: int) -> _T:
        effects = tuple(CATALOGUE.values())
        kept = last.get(args)
        if kept is not None and kept[0] == effects:  # compares those first that are the same
            return kept[1]
        key = (*map(id, effects), *args)
        with _LOADING:
            if key not in known:
                # the effects too, or another may get an identity
                known[key] = effects, function(effects, *args)
            last[args] = known[key]
        return known[key][1]

    return found


def engine() -> ModuleType:
    """Return the compiled engine module for the catalogue as it is now."""
    return _engine()


@cache
def plain_engine() -> ModuleType:
    """Return the compiled loop for drives without effects, a sixth faster than with their chains.

    It is `march` alone, and the same when the catalogue changes.
    """
    with _LOADING:
        text = plain_source()
        return _load("plain_" + _key(text, {}), text, {})


@per_catalogue
@cache
def _engine(_: tuple[Effect, ...]) -> ModuleType:
    text = source()
    return _load(_key(text), text)


def layout() -> dict[str, tuple[int, int]]:
    """Return, per effect, its index in `on` and its first slot in `values`."""
    return _layout(tuple(CATALOGUE))


@cache
def _layout(names: tuple[str, ...]) -> dict[str, tuple[int, int]]:
    slots = _slots()
    return {name: (index, slots[name]) for index, name in enumerate(names)}
