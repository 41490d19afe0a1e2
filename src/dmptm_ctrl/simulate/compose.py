"""Write the site chains of the catalogue as source text, in front of the time-stepping loop.

numba compiles and caches per file, so the text becomes a file whose name carries the hash
of everything it is made of: the loop, and each kernel. A changed kernel or a user's new
effect gives another name, and so one recompile.
"""

from collections.abc import Mapping
from functools import cache
from types import ModuleType

from dmptm_ctrl.contract import SITES, Effect
from dmptm_ctrl.effects import CATALOGUE, backlash, lookup, presliding, stribeck
from dmptm_ctrl.effects.lookup import looked_up
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.kernel_calls import (
    body_of,
    chain_text,
    flags_text,
    layout,
    per_catalogue,
    slots,
)
from dmptm_ctrl.simulate.loading import LOADING, key_of, load

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
_ROWS = ("A0", "A1", "A2", "A3", "R0", "R1")


# kernels that the loop calls by itself
_OWN_KERNELS = (
    *("landing", "mesh_region", "mesh_torque", "region_torque"),
    *("stribeck_law", "breakaway_torque", "sliding_torque", "viscous_torque"),
    *("bristle_lag", "build_up_distance", "fading"),
)


_INLINE = (
    *(
        "held_average",
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
    "law_of",
)
# What Python calls; the rest is called by these alone and has no wrapper for Python, which
# would be more text for the compiler than the function itself.
_ENTRIES = ("march", "march_groups", "command")
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


def _vector_kernel(index: int, effect: Effect) -> str:
    """Name of an effect's kernel for several drives at once."""
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
    first = slots()
    for index, (key, effect) in enumerate(CATALOGUE.items()):
        if effect.site != site:
            continue
        values = ", ".join(
            f"s[VALUE_{first[key] + j} + lane]" for j in range(len(effect.parameters))
        )
        call = f"{_vector_kernel(index, effect)}({args.format(**rows)}, Values_{index}({values}))"
        lines += [f"    if on[{index}]:", "        for lane in range(width):"]
        lines += [f"            {part}" for part in change.format(call=call, **rows).split("; ")]
    return "\n".join([*lines, "    return"])


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
    chains = "\n\n\n".join([flags_text(effects), *(chain_text(site, effects) for site in SITES)])
    return (
        f"{_HEAD}{own}\n{names}\n\n\n{chains}\n\n\n"
        f"{body_of('control_core.py')}\n\n{body_of('core.py')}\n\n"
    )


def plain_source() -> str:
    """Return the text of the loop for drives without effects, whatever is in the catalogue."""
    return _compiled(_loop({}))


def source() -> str:
    """Return the text of the engine for the catalogue as it is now."""
    lane_chains = "\n\n\n".join(_lane_chain(site) for site in _LANE_CHAINS)
    lanes = body_of("lane_stages_core.py")
    cut = lanes.index("\n@njit\n")  # behind the constants that the chains need
    places = "".join(
        f"VALUE_{k} = VALUES + {k} * LANES\n"  # a constant each: less arithmetic to compile
        for k in range(sum(len(effect.parameters) for effect in CATALOGUE.values()))
    )
    return _compiled(
        f"{_loop(CATALOGUE)}"
        f"{lanes[:cut]}\n{places}\n\n{lane_chains}\n\n{lanes[cut:]}\n\n{body_of('lane_core.py')}"
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
    return text.replace("@njit\n", f"@njit({options})\n")


_KERNELS = (backlash, lookup, presliding, stribeck, elementary)


def _key(text: str, effects: Mapping[str, Effect] = CATALOGUE) -> str:
    return key_of(text, _KERNELS, effects.values())


def _load(key: str, text: str, effects: Mapping[str, object] = CATALOGUE) -> ModuleType:
    return load(key, text, f"the simulator for {len(effects) or 'no'} effects")


def engine() -> ModuleType:
    """Return the compiled engine module for the catalogue as it is now."""
    return _engine()


@cache
def plain_engine() -> ModuleType:
    """Return the compiled loop for drives without effects, a sixth faster than with their chains.

    It is `march` alone, and the same when the catalogue changes.
    """
    with LOADING:
        text = plain_source()
        return _load("plain_" + _key(text, {}), text, {})


@per_catalogue
@cache
def _engine(_: tuple[Effect, ...]) -> ModuleType:
    text = source()
    return _load(_key(text), text)


__all__ = ["engine", "layout", "per_catalogue", "plain_engine", "plain_source", "source"]
