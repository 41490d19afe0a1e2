"""First step of the diagnosis: what was measured, and which logs fit and which judge."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.identify.records import Record, record, started
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.simulate.model import Model

MIN_SAMPLES = 200
HOLD_EVERY = 3  # of many logs, one in so many is held out


@dataclass(frozen=True, eq=False)
class Measured:
    """Logs prepared and split.

    Attributes
    ----------
    fit, held : tuples of Record
        Fitted on, and tested on: other amplitudes of the same kinds of experiment.
    drive : Drive
        The declared model.
    """

    logs: Sequence[Log]
    fit: tuple[Record, ...]
    held: tuple[Record, ...]
    drive: Drive
    warnings: tuple[str, ...] = ()

    def started(self, model: Model) -> "Measured":
        """The same logs, each from where the ring gear is by the sensors of a model."""
        fit, held = (tuple(started(rec, model) for rec in recs) for recs in (self.fit, self.held))
        return replace(self, fit=fit, held=held)

    @property
    def held_logs(self) -> tuple[Log, ...]:
        """Logs that judge and are never fitted."""
        names = {rec.name for rec in self.held}
        return tuple(log for log in self.logs if log.name in names)

    @property
    def has_motor_encoders(self) -> bool:
        """Whether every log has the motor angles."""
        return all(rec.twist is not None for rec in (*self.fit, *self.held))


def split(names: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Divide experiments into those to fit and those to judge on.

    One of each kind is held out. Without any twins every third log is.
    """
    held = of_each_kind(names)
    if not held and len(names) >= 2:
        held = sorted(names)[1::HOLD_EVERY]
    return tuple(n for n in names if n not in held), tuple(held)


def of_each_kind(names: Sequence[str]) -> list[str]:
    """Choose one log of each kind of experiment: the last of one kind and the first of the next.

    Logs whose names differ in digits only are of one kind. What has no twin is not chosen.
    """
    kinds: dict[str, list[str]] = {}
    for name in sorted(names):
        kinds.setdefault(re.sub(r"\d+", "", name), []).append(name)
    twins = [group for group in kinds.values() if len(group) > 1]
    return [group[-1] if i % 2 == 0 else group[0] for i, group in enumerate(twins)]


def measure(logs: Sequence[Log], drive: Drive) -> Measured:
    """Check and split logs; LogError of one that is too short, or lacks a channel."""
    for log in logs:
        if len(log) < MIN_SAMPLES:
            raise LogError(
                f"{log.name}: {len(log)} samples; a diagnosis needs at least {MIN_SAMPLES}"
            )
    records = {log.name: record(log, drive) for log in logs}
    fit, held = split(tuple(records))
    warnings = [f"{log.name}: {text}" for log in logs for text in log.warnings]
    if not held:
        warnings.append("one log only: it is fitted and judged on itself, so no error is held out")
    return Measured(
        tuple(logs),
        tuple(records[n] for n in fit),
        tuple(records[n] for n in (held or fit)),
        drive,
        tuple(warnings),
    )
