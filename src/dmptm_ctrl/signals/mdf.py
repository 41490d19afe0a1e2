"""MDF 4 files of measurement systems."""

import logging
from collections import Counter
from pathlib import Path
from typing import Any

from dmptm_ctrl.signals.columns import CLOCK, Choose, Table
from dmptm_ctrl.signals.errors import LogError, optional
from dmptm_ctrl.signals.subprocess_reader import Signal, read_in_subprocess


def read_mdf(path: Path, choose: Choose) -> Table:
    """Read channels of an MDF 4 file (extra ``mf4``).

    The clock is that of the chosen channel that ticks most often. Channels of one name
    differ by their groups, as in ``u (group 2)``.
    """
    found, meta = read_in_subprocess(path)
    times = {signal.clock: signal.values for signal in found if signal.is_time}
    named = Counter(signal.path[-1] for signal in found)
    signals = {
        s.path[-1] if named[s.path[-1]] == 1 else f"{s.path[-1]} ({s.path[0]})": s
        for s in found
        if not s.is_time
    }
    units = {name: signal.unit for name, signal in signals.items() if signal.unit}
    chosen = [n for n in choose([CLOCK, *signals], {CLOCK: "s", **units}) if n in signals]
    if not chosen:
        raise LogError(
            f"{path.name}: none of its channels has a unit; it has {', '.join(signals) or 'none'}"
        )
    main = max((signals[name].clock for name in chosen), key=lambda c: len(times[c]))
    columns = {name: signals[name].values for name in chosen}
    clocks = {n: times[signals[n].clock] for n in chosen if signals[n].clock != main}
    return Table({CLOCK: times[main], **columns}, {CLOCK: "s", **units}, meta, (), clocks)


def find_signals(path: Path) -> tuple[list[Signal], dict[str, Any]]:
    """Numeric channels of an MDF file; run it by `read_in_subprocess`, it may crash."""
    asammdf = optional("asammdf", "MDF files", "mf4")
    logging.disable()
    found: list[Signal] = []
    clocks: dict[bytes, int] = {}  # groups that tick alike are on one clock
    with asammdf.MDF(str(path)) as file:
        for channel in file.iter_channels():
            if channel.samples.dtype.kind not in "fiub" or channel.samples.ndim != 1:
                continue
            ticks = channel.timestamps.tobytes()
            if ticks not in clocks:
                clocks[ticks] = len(clocks)
                time = Signal(("time_s",), channel.timestamps, "s", clocks[ticks], is_time=True)
                found.append(time)
            unit = str(channel.unit) if channel.unit else None
            path_of = f"group {channel.group_index + 1}", channel.name
            found.append(Signal(path_of, channel.samples, unit, clocks[ticks]))
    return found, {}
