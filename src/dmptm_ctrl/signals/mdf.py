"""MDF 4 files of measurement systems."""

import logging
from pathlib import Path
from typing import Any

from dmptm_ctrl.signals.columns import Choose, Table
from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.subprocess_reader import Signal, read_in_subprocess


def read_mdf(path: Path, choose: Choose) -> Table:
    """Read channels of an MDF 4 file (extra ``mf4``).

    The time of the clock that ticks most often is the column time_s.
    """
    found, meta = read_in_subprocess(path)
    times = {signal.clock: signal.values for signal in found if signal.is_time}
    signals = {signal.path[-1]: signal for signal in found if not signal.is_time}
    units = {name: signal.unit for name, signal in signals.items() if signal.unit}
    chosen = [name for name in choose(["time_s", *signals], units) if name in signals]
    if not chosen:
        raise LogError(
            f"{path.name}: none of its channels has a unit; it has {', '.join(signals) or 'none'}"
        )
    main = max((signals[name].clock for name in chosen), key=lambda c: len(times[c]))
    columns = {name: signals[name].values for name in chosen}
    clocks = {n: times[signals[n].clock] for n in chosen if signals[n].clock != main}
    return Table({"time_s": times[main], **columns}, units, meta, (), clocks)


def find_signals(path: Path) -> tuple[list[Signal], dict[str, Any]]:
    """Numeric channels of an MDF file; run it by `read_in_subprocess`, it may crash."""
    try:
        from asammdf import MDF
    except ImportError:
        raise ImportError("MDF files need asammdf: pip install 'dmptm-ctrl[mf4]'") from None
    logging.disable()
    found: list[Signal] = []
    clocks: dict[bytes, int] = {}  # groups that tick alike are on one clock
    with MDF(str(path)) as file:
        for channel in file.iter_channels():
            if channel.samples.dtype.kind not in "fiub" or channel.samples.ndim != 1:
                continue
            ticks = channel.timestamps.tobytes()
            if ticks not in clocks:
                clocks[ticks] = len(clocks)
                time = Signal(("time_s",), channel.timestamps, "s", clocks[ticks], is_time=True)
                found.append(time)
            unit = str(channel.unit) if channel.unit else None
            found.append(Signal((channel.name,), channel.samples, unit, clocks[ticks]))
    return found, {}
