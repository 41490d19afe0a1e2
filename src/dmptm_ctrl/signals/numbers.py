"""Numbers as people write them: round, and in tables of files."""

import math
from typing import Any

from dmptm_ctrl.signals.errors import LogError


def finite_numbers(name: str, where: str, table: Any) -> dict[str, float]:
    """Return a table of a file as finite numbers; `name` and `where` are for messages."""
    if not isinstance(table, dict):
        raise LogError(f"{name}: no table [{where}]")
    for key, value in table.items():
        good = isinstance(value, int | float) and not isinstance(value, bool)
        if not good or not math.isfinite(value):
            raise LogError(f"{name}: {key} in [{where}] is {value!r}; it must be a finite number")
    return {key: float(value) for key, value in table.items()}


def roundest(value: float, error: float) -> float:
    """Number of fewest digits that is no further than `error` from a value."""
    shorter = (float(f"{value:.{digits}g}") for digits in range(1, 8))
    return next((number for number in shorter if abs(number - value) < error), value)
