"""Write the dispatch of the chain catalogue as source text, in front of the loop of chains.

As in `compose.py`: the file's name carries the hash of all it is made of.
"""

import hashlib
import inspect
import sys
from functools import cache
from pathlib import Path
from types import ModuleType

from dmptm_ctrl.effects import backlash, stribeck
from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE, SITES, ChainEffect
from dmptm_ctrl.simulate.compose import _cell, _load

# function of the loop -> sites that it serves, arguments, result of no effect
_DISPATCH = {
    "drive_signal": (("drive",), "kind, u, t, p", "u"),
    "effect_torque": (("motor", "load"), "kind, theta, omega, t, p", "0.0"),
    "friction_change": (("friction",), "kind, theta, omega, t, load, p", "1.0, 0.0"),
}


def kind_of(name: str) -> int:
    """Number by which the loop knows an effect."""
    return list(CHAIN_CATALOGUE).index(name)


def _function(name: str) -> str:
    sites, args, neutral = _DISPATCH[name]
    lines = [f"@njit\ndef {name}({args}):"]
    for number, chain in enumerate(CHAIN_CATALOGUE.values()):
        if chain.site in sites:
            fields = ", ".join(f"p[{f}]" if isinstance(f, int) else repr(f) for f in chain.fields)
            call = f"kernel_{number}({SITES[chain.site][1]}, Values_{number}({fields}))"
            lines.append(f"    if kind == {number}:\n        return {call}")
    return "\n".join([*lines, f"    return {neutral}"])


def source() -> str:
    """Return the text of the engine for the chain catalogue as it is now."""
    loop = Path(__file__).with_name("chain_core.py").read_text(encoding="utf-8")
    start = loop.index("from dmptm_ctrl.simulate.chain_sites import")
    end = loop.index(")\n", start) + 2
    names = "\n".join(
        f"kernel_{i} = CHAIN_CATALOGUE[{name!r}].effect.kernel\n"
        f"Values_{i} = CHAIN_CATALOGUE[{name!r}].effect.values"
        for i, name in enumerate(CHAIN_CATALOGUE)
    )
    sites = "\n\n\n".join(_function(name) for name in _DISPATCH)
    head = "from dmptm_ctrl.simulate.chain_catalogue import CHAIN_CATALOGUE\n\n"
    text = f"{loop[:start]}{head}{names}\n\n\n{sites}\n\n\n{loop[end:]}"
    return text.replace("@njit\n", '@njit(cache=True, error_model="numpy", nogil=True)\n')


def engine() -> ModuleType:
    """Return the compiled engine of chains for the catalogue as it is now."""
    return _engine(tuple(CHAIN_CATALOGUE.values()))


@cache
def _engine(chains: tuple[ChainEffect, ...]) -> ModuleType:
    text = source()
    parts = [text, inspect.getsource(backlash), inspect.getsource(stribeck)]
    for chain in chains:
        module = sys.modules.get(chain.effect.kernel.__module__)
        file = getattr(module, "__file__", None)
        kernel = chain.effect.kernel
        parts.append(Path(file).read_text(encoding="utf-8") if file else _cell(kernel))
    key = hashlib.sha256("\0".join(parts).encode()).hexdigest()[:16]
    return _load(f"chain_{key}", text, CHAIN_CATALOGUE)
