"""The kernels of the catalogue chained site by site, as source text.

What calls a chain gives it the flags and numbers of all effects of a dual-motor drive, as
`Model.arrays` has them.
"""

import ast
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.loading import LOADING

_T = TypeVar("_T")

# per site: name of the chain, its arguments, neutral result, how one effect changes it
CHAINS: dict[str, tuple[str, str, str, str]] = {
    "drive": ("drive_voltage", "u, t, side", "u", "u = {call}"),
    "motor": ("motor_torque", "u, theta_m, omega_m, t, side", "0.0", "r += {call}"),
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
    "load": ("load_torque", "theta_L, omega_L, t", "0.0", "r += {call}"),
    "sensor": (
        "sensor_reading",
        "theta_L, omega_L, t",
        "theta_L, omega_L",
        "theta_L, omega_L = {call}",
    ),
}


def slots() -> dict[str, int]:
    """Position of each effect's first parameter in the flat vector."""
    position, slots = 0, {}
    for name, effect in CATALOGUE.items():
        slots[name] = position
        position += len(effect.parameters)
    return slots


def chain_text(site: str, effects: Mapping[str, Effect]) -> str:
    """Text of a site's chain."""
    name, args, neutral, change = CHAINS[site]
    lines = [f"@njit\ndef {name}({args}, on, values):"]
    in_place = change.startswith(("u = ", "theta_L, "))
    if not in_place:
        lines.append(f"    r = {neutral}" if "," not in neutral else f"    r = ({neutral})")
    firsts = slots()
    for index, (key, effect) in enumerate(effects.items()):
        if effect.site != site:
            continue
        first = firsts[key]
        values = ", ".join(f"values[{first + j}]" for j in range(len(effect.parameters)))
        call = f"kernel_{index}({args}, Values_{index}({values}))"
        lines.append(f"    if on[{index}]:")
        lines += [f"        {part}" for part in change.format(call=call).split("; ")]
    result = {"drive": "u", "sensor": "theta_L, omega_L"}.get(site, "r")
    lines.append(f"    return {result}")
    return "\n".join(lines)


def flags_text(effects: Mapping[str, Effect]) -> str:
    """Text of the function that tells which of the sites of a feed-forward are in use."""
    keys = list(effects)
    tests = []
    for site in ("motor", "friction", "load"):
        terms = [f"on[{keys.index(k)}] > 0" for k, e in effects.items() if e.site == site]
        tests.append(" or ".join(terms) or "False")
    return (
        "@njit\ndef active_sites(on):\n    return (\n"
        + "".join(f"        {test},\n" for test in tests)
        + "    )"
    )


def body_of(name: str) -> str:
    """Text of a loop module after its last import."""
    text = Path(__file__).with_name(name).read_text(encoding="utf-8")
    imports = [node for node in ast.parse(text).body if isinstance(node, ast.ImportFrom)]
    return "".join(text.splitlines(keepends=True)[imports[-1].end_lineno :])


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
        with LOADING:
            if key not in known:
                # the effects too, or another may get an identity
                known[key] = effects, function(effects, *args)
            last[args] = known[key]
        return known[key][1]

    return found


def layout() -> dict[str, tuple[int, int]]:
    """Return, per effect, its index in `on` and its first slot in `values`."""
    return _layout(tuple(CATALOGUE))


@cache
def _layout(names: tuple[str, ...]) -> dict[str, tuple[int, int]]:
    firsts = slots()
    return {name: (index, firsts[name]) for index, name in enumerate(names)}
