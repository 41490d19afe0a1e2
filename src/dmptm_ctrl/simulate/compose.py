"""Write the site chains of the catalogue as source text, in front of loops along a motion.

numba compiles and caches per file, so the text becomes a file whose name carries the hash
of everything it is made of: the loops, and each kernel. A changed kernel or a user's new
effect gives another name, and so one recompile.
"""

from functools import cache
from types import ModuleType

from dmptm_ctrl.contract import SITES, Effect
from dmptm_ctrl.effects import CATALOGUE, lookup, presliding, stribeck
from dmptm_ctrl.effects.lookup import looked_up
from dmptm_ctrl.simulate import elementary
from dmptm_ctrl.simulate.kernel_calls import (
    CHAINS,
    body_of,
    chain_text,
    flags_text,
    layout,
    per_catalogue,
    slots,
)
from dmptm_ctrl.simulate.loading import key_of, load

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
_OWN_KERNELS = ("stribeck_law", "sliding_torque", "viscous_torque", "build_up_distance")
_INLINE = ("held_average", "rub", "scale", "without_power", "in_blocks", "slide_along")
# What Python calls; the rest is called by these alone and has no wrapper for Python, which
# would be more text for the compiler than the function itself.
_ENTRIES = (
    *("along", "sliding_along", "presliding_along", "readings"),
    *("presliding_law", "speed_delay"),
)
_HEAD = """\
from math import cos, exp, floor, log, sin, sqrt, tanh
import numpy as np
from numba import njit

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import looked_up, summed
from dmptm_ctrl.effects.presliding import build_up_distance
from dmptm_ctrl.effects.stribeck import sliding_torque, stribeck_law, viscous_torque
from dmptm_ctrl.simulate.elementary import cos, exp, sin, FAST, borrowed, hosted

"""


def _vector_kernel(index: int, effect: Effect) -> str:
    """Name of an effect's kernel for several drives, or samples, at once."""
    calls = getattr(effect.kernel, "py_func", effect.kernel).__code__.co_names
    return f"vector_kernel_{index}" if looked_up.__name__ in calls else f"kernel_{index}"


def _sample_chain(site: str) -> str:
    """Text of a site's chain over samples: one loop per effect, whose numbers stay."""
    name, change = _SAMPLE_CHAINS[site]
    args = ", ".join(
        f"s[{_SAMPLE_ROWS[arg]} + i]" if arg in _SAMPLE_ROWS else "side"
        for arg in CHAINS[site][1].split(", ")
    )
    lines = [f"@njit\ndef {name}(s, width, side, on, values):"]
    first = slots()
    for index, (key, effect) in enumerate(CATALOGUE.items()):
        if effect.site != site:
            continue
        values = ", ".join(f"values[{first[key] + j}]" for j in range(len(effect.parameters)))
        lines += [f"    if on[{index}]:", f"        p = Values_{index}({values})"]
        call = f"{_vector_kernel(index, effect)}({args}, p)"
        lines += ["        for i in range(width):"]
        lines += [f"            {part}" for part in change.format(call=call).split("; ")]
    return "\n".join([*lines, "    return"])


def source() -> str:
    """Return the text for the catalogue as it is now."""
    names = "\n".join(
        f"kernel_{i} = hosted(CATALOGUE[{name!r}].kernel)\nValues_{i} = CATALOGUE[{name!r}].values"
        for i, name in enumerate(CATALOGUE)
    )
    names += "".join(
        f"\n{name} = hosted(CATALOGUE[{key!r}].kernel, (looked_up, summed))"
        for i, (key, effect) in enumerate(CATALOGUE.items())
        if (name := _vector_kernel(i, effect)) != f"kernel_{i}"
    )
    own = "\n".join(f"{name} = hosted({name})" for name in _OWN_KERNELS)
    chains = [flags_text(CATALOGUE), *(chain_text(site, CATALOGUE) for site in SITES)]
    chains += [_sample_chain(site) for site in _SAMPLE_CHAINS]
    text = "\n\n\n".join(chains)
    return _compiled(f"{_HEAD}{own}\n{names}\n\n\n{text}\n\n\n{body_of('along_core.py')}\n")


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


def engine() -> ModuleType:
    """Return the compiled engine module for the catalogue as it is now."""
    return _engine()


@per_catalogue
@cache
def _engine(effects: tuple[Effect, ...]) -> ModuleType:
    text = source()
    key = key_of(text, (lookup, presliding, stribeck, elementary), effects)
    return load(key, text, f"what {len(effects)} effects do along a motion")


__all__ = ["engine", "layout", "source"]
