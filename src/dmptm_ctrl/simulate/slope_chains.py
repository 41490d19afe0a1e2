"""Write the slopes of the site chains as source text, and tell which effects have them."""

import inspect
import re
from collections.abc import Mapping
from typing import NamedTuple

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.effects.stribeck import Stribeck
from dmptm_ctrl.simulate import core, row_step_core
from dmptm_ctrl.simulate.slope_text import NoSlopes, Slopes
from dmptm_ctrl.simulate.slopes import Library


class Chain(NamedTuple):
    """How a site's chain goes on from one effect to the next."""

    args: str
    motion: tuple[str, ...]  # among these, what slopes are by
    begin: str  # values and slopes without effects
    change: str  # by an effect's values c and slopes e
    result: str
    first: str  # row of the first value's slopes by numbers, on the side or body
    scaled: tuple[str, ...] = ()  # what an effect does to those of effects before it
    weights: tuple[str, ...] = ()  # and those before it to its own


_SUMS = "; ".join(f"c_{k} += c[{k}]" for k in range(4))
CHAINS: dict[str, Chain] = {
    "drive": Chain(
        *("u, t, side", ("u",), "by = 1.0", "u, by = c[0], by * e[0]", "u, by", "side"),
        scaled=("r[{side} + k] *= e[0]",),
    ),
    "lag": Chain(
        *("u, side", ("u",), "tau, by, tau_by = 0.0, 1.0, 0.0"),
        "u, tau, by, tau_by = c[0], c[1], by * e[0], by * e[1]",
        *("(u, tau), (by, tau_by)", "2 * side"),
        scaled=("r[{2 * side + 1} + k] = r[{2 * side} + k] * e[1]", "r[{2 * side} + k] *= e[0]"),
    ),
    "motor": Chain(
        *("u, theta_m, omega_m, t, side", ("u", "theta_m", "omega_m")),
        *("c_0 = e_0 = e_1 = e_2 = 0.0", "c_0 += c[0]; e_0 += e[0]; e_1 += e[1]; e_2 += e[2]"),
        *("c_0, (e_0, e_1, e_2)", "side"),
    ),
    "mesh": Chain(
        "theta_p, omega_p, theta_L, omega_L, side",
        ("theta_p", "omega_p", "theta_L", "omega_L"),
        f"{' = '.join(f'c_{k}' for k in range(4))} = 0.0; "
        f"{' = '.join(f'e_{k}' for k in range(16))} = 0.0",
        f"{_SUMS}; " + "; ".join(f"e_{k} += e[{k}]" for k in range(16)),
        f"({', '.join(f'c_{k}' for k in range(4))}), ({', '.join(f'e_{k}' for k in range(16))})",
        "4 * side",
    ),
    "friction": Chain(
        *("theta, omega, t, mesh_torque, body", ("theta", "omega", "mesh_torque")),
        "level, added = 1.0, 0.0; e_0 = e_1 = e_2 = e_3 = e_4 = e_5 = 0.0",
        "; ".join(f"e_{k} = e_{k} * c[0] + level * e[{k}]" for k in range(3))
        + "; "
        + "; ".join(f"e_{k} += e[{k}]" for k in range(3, 6))
        + "; level *= c[0]; added += c[1]",
        *("(level, added), (e_0, e_1, e_2, e_3, e_4, e_5)", "2 * body"),
        scaled=("r[{2 * body} + k] *= c[0]",),
        weights=("level * ", ""),
    ),
    "ageing": Chain(
        *("age, body", ("age",), "c_0 = e_0 = 0.0", "c_0 += c[0]; e_0 += e[0]", "c_0, e_0", "body"),
    ),
    "load": Chain(
        *("theta_L, omega_L, t", ("theta_L", "omega_L"), "c_0 = e_0 = e_1 = 0.0"),
        *("c_0 += c[0]; e_0 += e[0]; e_1 += e[1]", "c_0, (e_0, e_1)", "0"),
    ),
}
# Of these the chain takes all bodies at once, to ask once what is in use; what each has of its own
_OF_BODIES = {"friction": ("theta", "omega", "mesh_torque", "body"), "ageing": ("age", "body")}
_BODIES = 3
_ROWS = 8  # of slopes by numbers: most values that a site has, of all its sides or bodies
_OUTPUTS = {"drive": 1, "lag": 2, "motor": 1, "mesh": 4, "friction": 2, "ageing": 1, "load": 1}


def effect_slopes(effect: Effect, library: Library) -> Slopes | None:
    """Slopes of an effect's kernel, or None where it has none or its site needs none."""
    if effect.site not in CHAINS:
        return None
    chain = CHAINS[effect.site]
    kernel = getattr(effect.kernel, "py_func", effect.kernel)
    names = [*inspect.signature(kernel).parameters]  # a user may call them otherwise
    args = chain.args.split(", ")
    if len(names) != len(args) + 1:
        raise NoSlopes(f"{effect.name}: the kernel does not take what its site gives")
    own = dict(zip(args, names[:-1], strict=True))
    chosen = [(names[-1], k) for k, p in enumerate(effect.parameters) if p.bank]
    fields = {names[-1]: [p.name for p in effect.parameters]}
    motion = [own[name] for name in chain.motion]
    # what is at rest stays there, and a mesh that is in its gap
    still = [own[name] for name in chain.motion if name.startswith(("omega", "mesh_torque"))]
    return library.of(kernel, motion, fields, speeds=still, chosen=chosen)


def deciding_fields(effect: Effect) -> frozenset[int] | None:
    """Positions of parameters that decide on branches of the kernel; None if it has no slopes."""
    try:
        slopes = effect_slopes(effect, Library())
    except NoSlopes:
        return None
    return frozenset(k for _, k in slopes.deciding) if slopes else frozenset()


def _rows(text: str) -> str:
    """Text in which rows stand for their first places."""
    return re.sub(r"\{(.*?)\}", r"R_OWN + (\1) * R_NUMBERS", text)


def _write_own(
    slopes: Slopes, chain: Chain, site: str, own: range, before: list[int], effect: int
) -> list[str]:
    """Lines that put slopes by an effect's `own` numbers into r."""
    first = own.start
    lines = [f"for k in ({', '.join(map(str, before))},):"] if chain.scaled and before else []
    lines += [f"    {_rows(text)}" for text in chain.scaled if before]
    for o in range(_OUTPUTS[site]):
        row = _rows(f"{{{chain.first} + {o}}}" if o else f"{{{chain.first}}}")
        weight = chain.weights[o] if chain.weights else ""
        used = f"r[R_LOOKED + {effect * _ROWS} + {chain.first} + {o}]"  # whether some are not 0
        if slopes.found:
            lines.append(f"if {used} != 0.0:")
            lines.append(f"    for k in range({first}, {own.stop}):")
            lines.append(f"        r[{row} + k] = 0.0")
        for k, (_, at) in enumerate(slopes.fields):
            lines.append(f"r[{row} + {first + at}] = {weight}q[{o * len(slopes.fields) + k}]")
        found = [f"looked[{o * slopes.found + k}]" for k in range(slopes.found)]
        if found:
            lines.append(f"{used} = {' + '.join(f'abs({slope})' for slope in found)}")
            lines.append(f"if {used} != 0.0:")
        for k, slope in enumerate(found):
            lines.append(f"    r[{row} + {first} + places[{k}]] += {weight}{slope}")
    return lines


def _of_body(text: str, k: int) -> str:
    """Text of one body's part of a chain."""
    own = "theta|omega|mesh_torque|age|body|level|added|c|e|[ce]_[0-9]+"
    return re.sub(rf"\b({own})\b", rf"\1_of_{k}", text)


def _chain(
    site: str, effects: Mapping[str, Effect], slots: Mapping[str, int], library: Library
) -> str:
    """Text of the slopes of a site's chain."""
    chain, own_of_body = CHAINS[site], _OF_BODIES.get(site)

    def each(*parts: str) -> list[str]:
        """Lines for each body, or those as they are."""
        if own_of_body is None:
            return [*parts]
        return [_of_body(part, k) for k in range(_BODIES) for part in parts]

    args = chain.args
    if own_of_body is not None:
        common = [name for name in args.split(", ") if name not in own_of_body]
        args = ", ".join([*each(*own_of_body), *common])
    lines = [f"@njit\ndef {site}_slopes_of({args}, own, r):", "    sure = True"]
    lines += each(*(f"    {part}" for part in chain.begin.split("; ")))
    before: list[int] = []
    for index, (name, effect) in enumerate(effects.items()):
        if effect.site != site:
            continue
        try:
            slopes = effect_slopes(effect, library)
        except NoSlopes:
            continue  # a run with this effect goes another way
        assert slopes is not None
        first, count = slots[name], len(effect.parameters)
        values = ", ".join(f"r[R_VALUES + {first + k}]" for k in range(count))
        kept = f", r, R_VALUES + {first}" if slopes.looked_in else ""
        lines.append(f"    if r[{index}] != 0.0:")
        part = [
            f"c, e, q, places, looked, good = "
            f"{slopes.name}({chain.args}, Values_{index}({values}){kept})",
            "sure = sure and good",
        ]
        own = _write_own(slopes, chain, site, range(first, first + count), before, index)
        if own:
            part += ["if own:", *(f"    {line}" for line in own)]
        part += chain.change.split("; ")
        lines += each(*(f"        {line}" for line in part))
        before += range(first, first + count)
    result = chain.result if own_of_body is None else f"({chain.result})"
    return "\n".join([*lines, f"    return {', '.join(each(result))}, sure"])


def slope_source(effects: Mapping[str, Effect], slots: Mapping[str, int]) -> str:
    """Return the text of all slopes that `tangent_site_core` calls."""
    library = Library()
    # numbers of the friction law move by whole steps with these
    motion = ("v", "v_mid", "force", "scale", "added", "bristle")
    records = {"law": Stribeck._fields, "bristles": ("distance", "share", "lag")}
    law: list[tuple[str, str | int]] = [("law", name) for name in Stribeck._fields]
    bristles: list[tuple[str, str | int]] = [("bristles", k) for k in range(3)]
    loops: dict[str, Slopes] = {
        "preslide": library.of(core.preslide, motion, records, still=law + bristles),
        "preslide_own": library.of(core.preslide, motion, records, still=law),
        "aged": library.of(core.aged, ("age", "v", "slip"), {}, speeds=["v"]),
        "lagged": library.of(row_step_core.lagged, ("aim", "tau", "kept"), {}),
        "toothed": library.of(row_step_core.toothed, ("x", "k_a", "z_3", "phi_r"), {}),
    }
    names = "\n".join(f"{name}_slopes = {slopes.name}" for name, slopes in loops.items())
    chains = "\n\n\n".join(_chain(site, effects, slots, library) for site in CHAINS)
    numbers = sum(len(effect.parameters) for effect in effects.values())
    own = len(effects) + numbers
    places = f"R_VALUES, R_NUMBERS, R_OWN = {len(effects)}, {numbers}, {own}\n"
    places += (
        f"R_LOOKED, R_MOVES = {own + _ROWS * numbers}, {own + _ROWS * (numbers + len(effects))}"
    )
    return f"{library.text()}\n\n\n{names}\n{places}\n\n\n{chains}"
