"""One drive from a sample to the next, and what is seen of it: text for the loop over samples."""

from typing import Any

from numba import float64, int64, types

from dmptm_ctrl.simulate.generate import (
    Engine,
    Names,
    called_of,
    engine_by,
    head_text,
    reading_lines,
    row_text,
    sensed,
    step_lines,
    torque_lines,
)
from dmptm_ctrl.simulate.plant import Structure

_ADVANCE = types.void(types.CPointer(int64), *[int64] * 4, *[float64] * 3)


def source(s: Structure) -> str:
    """Return the text of `advance` of a structure, which `loops.march` calls.

    It takes a drive `substeps` steps of `h` seconds further, from the time `begin` on, and reads
    its sensors at the time `end`; torques and twists of links too, if there are `links`. Steps have
    rows of `signals`, a `stride` apart; each leaves readings for later in `latest`, if `lates`.
    """
    names = Names(s)
    late = [i for i, sensor in enumerate(s.sensors) if sensor[2]]
    turn = [*step_lines(s), "    row += stride"]
    (read, readings), (twisted, links) = reading_lines(s), torque_lines(s)
    if late:
        now = row_text(" * ".join(filter(None, sensed(s, i))) for i in late)
        turn += ["    if lates > 0:", f"        gather(latest, {now}, kept)", "    kept += lates"]
        names_ = [f"late{i}" for i in late]
        read = [
            f"    {', '.join(names_)}, = {now}", "    if lates > 0:",
            f"    {_spread(names_, 'late')}", *read,
        ]  # fmt: skip
    if readings:
        read.append(f"    gather(seen, {row_text(readings)}, 0)")
    twisted.append(f"    gather(seen, {row_text(links)}, {len(readings)})" if links else "    pass")
    lines = [
        "    x, p, on, e, acts, sites, posts, r, signals, late, latest, seen = "
        'arrays_at(drive, "ddBdBllddddd")',
        # as tuples: one by one they are long to compile
        _spread(names.numbers, "p"), _spread(names.state, "x"),
        "    row, kept = 0, 0",
        "    for k in range(substeps):",
        "        t = begin + (k + 0.5) * h",
        *(f"    {line}" for line in (_spread(names.signals, "signals", "row"), *turn)),
        f"    gather(x, {row_text(names.state)}, 0)",
        "    t = end", *read,
        "    if links > 0:", *(f"    {line}" for line in twisted),
    ]  # fmt: skip
    head = "def advance(drive, stride, lates, substeps, links, begin, h, end):\n"
    return f"{head_text(s, kernels=not s.either)}\n\n{head}" + "\n".join(lines) + "\n"


def _spread(names: list[str], array: str, first: str = "0") -> str:
    return f"    {', '.join(names)}, = spread({array}, {len(names)}, {first})"


def scalar_engine(s: Structure) -> Engine:
    """Return the code of one drive of a structure, which `structure_of` gave."""
    return engine_by(s, "scalar", source)


def advance_of(s: Structure) -> Any:
    """Return what the loop over samples calls of a structure, compiled when first asked for."""
    return called_of(scalar_engine(s).module, "advance", _ADVANCE)
