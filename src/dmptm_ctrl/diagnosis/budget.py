"""The error budget: what each effect is worth on held-out logs, what is left, and the verdict.

Every equation of the balance counts in units of its own scatter under the final model, so that
torques and twists add up. A share is what this mean square rises by when one effect alone is left
out and the rest is refitted, over the removable mean square, before less floor.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from math import sqrt
from typing import Any, NamedTuple

NONE = 1.5  # times its floor that the error before may be where nothing is missing
EXPLAINED = 0.8  # share of the removable mean square that named effects take at least
MATERIAL = 0.02  # share of the removable mean square from which an effect matters
# What is left must rise by without an effect, over what is left that is no noise. A law of friction
# that is only nearly right imitates effects below it: benchmarks/calibrate.py --ordinary.
NEGLIGIBLE = 0.1
NOT_EXPLAINED, FLOOR = "not explained", "floor"  # the last rows


class Squares(NamedTuple):
    """Mean squares of another measure: before, after and floor, as in :class:`Errors`."""

    before: float
    after: float
    floor: float


@dataclass(frozen=True)
class Errors:
    """Held-out mean squares in units of the final model's scatter.

    Attributes
    ----------
    before, after, floor : float
        Of the declared model refitted inside its ranges, of the augmented model, and of what
        neither an effect nor a curve predicts.
    runs, short : Squares, optional
        Mean squares of free runs and of short predictions, each in a unit of its own.
    """

    before: float
    after: float
    floor: float
    runs: Squares | None = None
    short: Squares | None = None

    @property
    def removable(self) -> float:
        """Mean square that a better model could remove."""
        return max(self.before - self.floor, 0.0)

    @property
    def balanced(self) -> bool:
        """Whether the declared model leaves no more of the balance than any would."""
        return near(self.before, self.floor)

    @property
    def within_floor(self) -> bool:
        """Whether the declared model is as good as any, in free runs too."""
        return self.balanced and (self.runs is None or near(self.runs.before, self.runs.floor))

    @property
    def explained(self) -> float:
        """Share of the removable mean square that the named effects take.

        Of the balance, or less where runs show less, free and short ones in units of their floors.
        A measure that is near its floor without the effects cannot show what they take.
        """
        others = [m for m in (self.runs, self.short) if m and not near(m.before, m.floor)]
        before, after = (sum(m[side] / m.floor for m in others) for side in (0, 1))
        predicted = share(before, after, float(len(others)))
        if others and self.balanced:
            return predicted
        return min(share(self.before, self.after, self.floor), predicted)


def share(before: float, after: float, floor: float) -> float:
    """Share of the removable mean square that is gone; 1 where nothing was removable."""
    return min(max(before - after, 0.0) / (before - floor), 1.0) if before > floor else 1.0


def near(before: float, floor: float) -> bool:
    """Whether a mean square is near its floor."""
    return sqrt(before) <= NONE * sqrt(floor)


@dataclass(frozen=True)
class Row:
    """One line of the budget.

    Attributes
    ----------
    speed_rms, torque_rms : float or None
        What the held-out error rises by without it, root mean square, in the drive's own units;
        None where it does not act on that quantity.
    share : float
        Of the removable mean square; of the mean square before for the last two rows.
    """

    name: str
    location: str
    speed_rms: float | None
    torque_rms: float | None
    share: float
    depends_on: tuple[str, ...] = ()

    def without_rise(self, value: float) -> bool:
        """Whether an error is no larger without it, where it is an effect."""
        return value == 0.0 and self.name not in (NOT_EXPLAINED, FLOOR)

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of diagnosis.json."""
        return {**asdict(self), "depends_on": list(self.depends_on)}


def verdict_of(errors: Errors, material: bool, curve: bool) -> str:
    """Return "none", "explained" or "unknown".

    By whether any named effect is material, and whether a curve without a name is needed.
    """
    if not material and errors.within_floor:
        return "none" if not curve else "unknown"
    if material and errors.explained >= EXPLAINED:
        return "explained"
    return "unknown"


def closed_rows(
    rows: Sequence[Row],
    errors: Errors,
    left: tuple[float | None, float | None],
    floor: tuple[float | None, float | None],
    depends_on: tuple[str, ...],
) -> list[Row]:
    """Scale shares to the whole and add what is shared, not explained, and the floor.

    Parameters
    ----------
    rows : sequence of Row
        Of the effects, shares of the removable mean square.
    left, floor : (speed, torque)
        Root mean squares of what is not explained, and of the floor.
    depends_on : tuple of str
        Variables of what is not explained.
    """
    whole = max(errors.before, errors.after, errors.floor, 1e-300)
    unexplained = max(errors.after - errors.floor, 0.0) / whole
    named = max(1.0 - unexplained - errors.floor / whole, 0.0)
    total = sum(r.share for r in rows)
    own = min(total * errors.removable / whole, named)
    if len(rows) == 1 or named - own <= MATERIAL:
        own = named  # too little to be listed as shared
    done = [
        replace(r, share=own * (r.share / total if total > 0.0 else 1.0 / len(rows))) for r in rows
    ]
    if rows and own < named:
        done.append(Row("shared", "several of these effects", None, None, named - own))
    done.sort(key=lambda r: -r.share)
    done.append(Row(NOT_EXPLAINED, "", *left, unexplained, depends_on))
    done.append(Row(FLOOR, "", *floor, errors.floor / whole))
    return done


def table_lines(rows: Sequence[Row], units: tuple[str, str]) -> list[str]:
    """Return the budget as lines of text.

    Units are those of (speed, torque), empty where the drive has no such column.
    """
    wide = max(14, *(len(f"{r.name} @ {r.location}".rstrip(" @")) for r in rows))
    speed, torque = units
    said = [f"  {'effect @ place':{wide}}"]
    said += [
        f"{name:>{10 + len(unit)}}" for name, unit in (("speed", speed), ("torque", torque)) if unit
    ]
    lines = ["  ".join([*said, f"{'share':>7}", "depends on"])]
    for r in rows:
        name = f"{r.name} @ {r.location}".rstrip(" @").replace("_", " ")
        parts = [f"  {name:{wide}}"]
        for value, unit in ((r.speed_rms, speed), (r.torque_rms, torque)):
            if unit:
                shown = f"{'–':>9}" if value is None else f"{value:9.3g} {unit}"
                if value is not None and r.without_rise(value):
                    shown = f"{'no rise':>9}"
                parts.append(f"{shown:{10 + len(unit)}}")
        parts.append(f"{100.0 * r.share:5.1f} %")
        if r.depends_on:
            parts.append(", ".join(r.depends_on))
        lines.append("  ".join(parts))
    return lines


Sides = Mapping[str, Mapping[str, Any]]


def error_entry(
    on: str, speed: Sides | None, torque: Sides, horizon: Sides | None
) -> dict[str, Any]:
    """Return the entry `error` of diagnosis.json.

    Parameters
    ----------
    on : str
        What it is measured on.
    speed, torque, horizon : mapping of "before", "after", "floor" to mapping
        Free runs, balance, short predictions: rmse, unit and more. None: not to be had.
    """
    kinds = {"speed": speed, "torque": torque, "horizon": horizon}
    first = speed or torque
    sides = {
        side: {**first[side], **{k: dict(v[side]) for k, v in kinds.items() if v is not None}}
        for side in ("before", "after", "floor")
    }
    unit = first["after"]["unit"]
    width = {k: first["after"][k] for k in ("bandwidth_hz",) if k in first["after"]}
    return {"on": on, "unit": unit, **width, **sides}
