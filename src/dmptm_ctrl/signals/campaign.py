"""Several logs of one rig."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import overload

import numpy as np

from dmptm_ctrl.signals.errors import LogError, repeated
from dmptm_ctrl.signals.log import Log

# Logged in some experiments of a rig and not in others: the setpoint of a closed loop.
OPTIONAL = frozenset({"ref"})
SAME_RATE = 1e-6  # relative; decimal time stamps give the step to better than this


@dataclass(frozen=True, eq=False)
class Campaign(Sequence[Log]):
    """Logs of one rig: same channels, same sample time, no two alike.

    LogError for none, two of one name, and logs that cannot be of one rig.
    """

    logs: tuple[Log, ...]  # a setpoint ``ref`` may be in some and not in others
    warnings: tuple[str, ...] = ()  # what is suspect across logs; each has its own besides

    def __post_init__(self) -> None:
        logs, warnings = without_duplicates(tuple(self.logs))
        if not logs:
            raise LogError("no logs")
        first = logs[0]
        for log in logs[1:]:
            _refuse_other_rig(first, log)
        if (twice := repeated(log.name for log in logs)) is not None:
            raise LogError(
                f"two logs named {twice} with different samples: of different rigs, or rename one"
            )
        object.__setattr__(self, "logs", logs)
        object.__setattr__(self, "warnings", (*self.warnings, *warnings))

    @overload
    def __getitem__(self, index: int | str) -> Log: ...
    @overload
    def __getitem__(self, index: slice) -> "Campaign": ...
    def __getitem__(self, index: int | str | slice) -> "Log | Campaign":
        """Log by position or name; a slice is a campaign."""
        if isinstance(index, slice):
            return Campaign(self.logs[index])
        if isinstance(index, int):
            return self.logs[index]
        for log in self.logs:
            if log.name == index:
                return log
        raise KeyError(f"no log {index!r}; there are {', '.join(self.names)}")

    def __len__(self) -> int:
        return len(self.logs)

    def __repr__(self) -> str:
        return f"<Campaign of {len(self)} logs: {', '.join(self.names)}>"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the logs."""
        return tuple(log.name for log in self.logs)

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that every log has."""
        return tuple(c for c in self.logs[0] if all(log.has(c) for log in self.logs))

    @property
    def sample_time(self) -> float:
        """Time between samples [s], the same in all logs."""
        return self.logs[0].sample_time


def without_duplicates(logs: tuple[Log, ...]) -> tuple[tuple[Log, ...], list[str]]:
    """Leave out logs that hold the samples of another one; return why, too."""
    kept: list[Log] = []
    warnings = []
    for log in logs:
        twin = next((other for other in kept if _same_samples(log, other)), None)
        if twin is None:
            kept.append(log)
        else:
            warnings.append(f"{log.name} holds the same samples as {twin.name} and is left out")
    return tuple(kept), warnings


def _same_samples(one: Log, other: Log) -> bool:
    if one.sha256 is not None and one.sha256 == other.sha256:
        return True
    return (
        len(one) == len(other)
        and set(one) == set(other)
        and all(np.array_equal(one[channel], other[channel]) for channel in ("time", *one))
    )


def _refuse_other_rig(first: Log, log: Log) -> None:
    differing = (set(first) ^ set(log)) - OPTIONAL
    if differing:
        channel = min(differing)
        with_it, without = (first, log) if channel in first else (log, first)
        raise LogError(
            f"logs of different rigs: {with_it.name} has {channel}, {without.name} has not"
        )
    if any(first.units[c] != log.units[c] for c in set(first) & set(log)):
        channel = min(c for c in set(first) & set(log) if first.units[c] != log.units[c])
        raise LogError(
            f"logs of different rigs: {channel} is in {first.units[channel]} in {first.name}, "
            f"in {log.units[channel]} in {log.name}"
        )
    if abs(log.sample_time / first.sample_time - 1) > SAME_RATE:
        raise LogError(
            f"logs of different sample time: {first.name} {first.sample_time:.6g} s, "
            f"{log.name} {log.sample_time:.6g} s"
        )
