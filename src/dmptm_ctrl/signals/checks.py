"""Is a log usable? Errors say in one sentence what is wrong, warnings what is suspect."""

import numpy as np

from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import Array

MIN_SAMPLES = 100  # fewer say nothing about a drive
HUGE = 1e30
SHORTEST_STEP = 1e-9  # s, faster than anything that samples a drive
LONGEST_STEP = 60.0  # s, slower than anything that samples a drive
SLOW = 0.5  # s, a step that is long for a drive


def finite(source: str, column: str, values: Array, above: int = 0) -> None:
    """Refuse NaN, infinity and numbers so large that their squares would overflow.

    `above` rows were left out before the first value.
    """
    good = np.abs(values) < HUGE  # False for NaN
    if not good.all():
        if np.isnan(values).all():
            raise LogError(f"{source}: {column} has no value in any row")
        row, count = int(np.argmin(good)), int((~good).sum())
        more = f" ({count} such values)" if count > 1 else ""
        value = values[row]
        kind = "missing (NaN)" if np.isnan(value) else f"{value:.3g}, no measured value,"
        raise LogError(
            f"{source}: {column} is {kind} in row {above + row + 1}{more}; leave that part out "
            "(start, stop in [data] of the rig file)"
        )


def usual_step(source: str, step: Array) -> float:
    """Median time step [s]; LogError where no drive is sampled like that."""
    usual = float(np.median(step))
    if usual < SHORTEST_STEP:
        raise LogError(f"{source}: time steps of {usual:.3g} s; time must be in seconds")
    if usual > LONGEST_STEP:
        raise LogError(
            f"{source}: time steps of {usual:.3g} s are no log of a drive; {_other_unit(usual)}"
        )
    return usual


def slow(time: Array) -> list[str]:
    """Warning about steps that are long for a drive, as of a clock in another unit."""
    step = float(np.median(np.diff(time)))
    return [f"time steps of {step:.4g} s are long; {_other_unit(step)}"] if step >= SLOW else []


def _other_unit(step: float) -> str:
    units = {"ms": 1e-3, "us": 1e-6, "ticks": 1e-7, "ns": 1e-9}
    near = next((u for u, f in units.items() if step * f < SLOW), "ns")
    return (
        f'perhaps the clock is in {near}: time = {{ column = "…", unit = "{near}" }} in [data] of '
        "the rig file"
    )
