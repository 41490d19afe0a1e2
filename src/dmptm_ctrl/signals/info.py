"""What is in a log, and which effects it can identify."""

from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from dmptm_ctrl.signals.checks import MIN_SAMPLES
from dmptm_ctrl.signals.clock import seconds_of
from dmptm_ctrl.signals.columns import CLOCKS, TIMES, Table, listed
from dmptm_ctrl.signals.counters import GRID, unwrapped_counts
from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.loaders import digest_of, log_of, numbers_or_times, read_table, stem
from dmptm_ctrl.signals.log import Array, Log
from dmptm_ctrl.signals.units import COUNTS, TICKS, door_column, named_unit, parse_unit

NO_UNIT = ("", "1", "-")  # of a number
INPUT_UNITS = ("V", "A", "N·m", "N", "%")
DECLARED = "the rig file declares it: it is fitted, not looked for"
REST_SHARE = 0.02  # of the greatest speed; slower is at rest
ROUNDING = 4e-15  # of a value; conversion to SI and back leaves less between equal readings
SMOOTH = 0.02  # s, moving average before counting reversals: longer than gyro noise lives


@dataclass(frozen=True)
class ChannelInfo:
    """One channel in the units people read."""

    column: str
    low: float
    high: float
    rms: float
    resolution: float  # grid of its values; of one without a grid the smallest difference


@dataclass(frozen=True)
class Excitation:
    """How a log exercises its drive."""

    travel: float  # rad or m, greatest minus least position
    unit: str
    top_speed: float  # rad/s or m/s
    slow_share: float  # of the time between rest and a fifth of the top speed
    reversals: int
    both_ways: bool
    stops: int  # times that it comes to rest
    bandwidth: float  # Hz, 99 % of the input's power lies below
    zero_crossings: int  # of the input
    preload: float  # lasting difference of the two inputs, in their unit
    both_sides: bool  # motor and load angles are there
    angle_and_speed: bool  # of the same shaft
    duration: float  # s


@dataclass(frozen=True)
class Testability:
    """Whether a log can identify an effect, and what is lacking if not."""

    effect: str
    testable: bool
    lacks: tuple[str, ...]


@dataclass(frozen=True)
class LogInfo:
    """What `describe` finds; `to_dict` for JSON."""

    name: str
    samples: int
    duration: float  # s
    sample_time: float  # s
    sha256: str | None
    channels: tuple[ChannelInfo, ...]
    excitation: Excitation | None  # None without an input or a motion
    testable: tuple[Testability, ...]
    warnings: tuple[str, ...]

    def to_dict(self) -> dict[str, Any]:
        """Plain dicts and lists."""
        return asdict(self)


def describe(
    log: Log,
    labels: Mapping[str, tuple[str, str]] | None = None,
    declared: Collection[str] = (),
    effects: Collection[str] | None = None,
    inputs: Collection[str] | None = None,
) -> LogInfo:
    """Say what is in a log and what it can and cannot identify, by rules of thumb.

    `labels`: what the file calls the channels, and how they are to be shown. `declared` effects
    are in the drive's model already; None of `effects` stands for all, None of `inputs` for the
    channels in units of voltage, current, force and torque.
    """
    excitation = _excitation(log, inputs)
    return LogInfo(
        name=log.name,
        samples=len(log),
        duration=log.duration,
        sample_time=log.sample_time,
        sha256=log.sha256,
        channels=tuple(_channel(log, channel, labels or {}) for channel in log),
        excitation=excitation,
        testable=_testable(excitation, declared, effects) if excitation else (),
        warnings=log.warnings,
    )


def _channel(log: Log, channel: str, labels: Mapping[str, tuple[str, str]]) -> ChannelInfo:
    column, factor = door_column(channel, log.units[channel])
    if channel in labels:
        name, unit = labels[channel]
        factor = parse_unit(unit).factor
        column = _with_unit(name, unit)
    return _figures(column, log[channel] / factor)


def _with_unit(name: str, unit: str) -> str:
    """Name of a column with its unit, where it has one and the name does not say it."""
    return name if unit in NO_UNIT or named_unit(name)[1] else f"{name} [{unit}]"


def _figures(column: str, values: Array) -> ChannelInfo:
    top = float(np.abs(values).max())
    rms = top * float(np.sqrt(np.mean(np.square(values / top)))) if top else 0.0  # no overflow
    return ChannelInfo(column, float(values.min()), float(values.max()), rms, _resolution(values))


def _resolution(values: Array) -> float:
    """Step of which all differences of values are multiples; else the smallest difference."""
    noise = ROUNDING * float(np.abs(values).max())
    levels = np.unique(values)
    steps = np.unique(np.diff(levels))
    steps = steps[steps > noise]
    size = smallest = float(steps.min()) if steps.size else 0.0
    away = levels[levels > levels[0] + size / 2] - levels[0]
    for far in away[np.unique(np.geomspace(1, away.size, 300).astype(int)) - 1] if size else ():
        times = round(far / size)
        if abs(far - times * size) > GRID * size:
            break
        size = float(far / times)  # those far away show it better, also of rounded decimals
    else:
        return size
    size = smallest
    while size and (unsure := noise * (1 + steps / size)).max() < GRID * size:
        rest = np.abs(steps - size * np.round(steps / size))
        rest = rest[rest > unsure]
        if not rest.size:
            return size
        size = float(rest.min())  # as Euclid does
    return smallest


def _excitation(log: Log, inputs: Collection[str] | None) -> Excitation | None:
    driving = [c for c in log if log.units[c] in INPUT_UNITS and c != "ref"]
    inputs = driving if inputs is None else [c for c in inputs if c in log]
    positions = [c for c in log if log.units[c] in ("rad", "m")]
    speeds = [c for c in log if log.units[c] in ("rad/s", "m/s") and c != "ref"]
    load = [c for c in positions if c == "theta_L"] or positions
    if not inputs or not (positions or speeds):
        return None
    step = log.sample_time
    position = log[load[0]] if load else step * np.cumsum(log[speeds[0]])
    raw = log[speeds[0]] if speeds else np.gradient(position, step)
    width = max(1, round(SMOOTH / step))
    speed = np.convolve(raw, np.full(width, 1 / width), mode="same")
    top = float(np.abs(speed).max())
    moving = np.abs(speed) > REST_SHARE * top
    signs = np.sign(speed[moving])
    command = sum((log[c] for c in inputs), np.zeros(len(log)))
    preload = (
        float(np.median(log["u_left"] - log["u_right"])) if log.has("u_left", "u_right") else 0
    )
    return Excitation(
        travel=float(np.ptp(position)),
        unit=log.units[load[0]] if load else "rad",
        top_speed=top,
        slow_share=float(np.mean(moving & (np.abs(speed) < 0.2 * top))),
        reversals=int((np.diff(signs) != 0).sum()),
        both_ways=bool((signs > 0).any() and (signs < 0).any()),
        stops=int((np.diff(moving.astype(int)) == -1).sum()),
        bandwidth=_bandwidth(command, step),
        zero_crossings=int((np.diff(np.sign(command[command != 0])) != 0).sum()),
        preload=preload,
        both_sides=len(positions) > 1,
        angle_and_speed=bool(positions and speeds),
        duration=log.duration,
    )


def _bandwidth(values: Array, step: float) -> float:
    """Frequency below which 99 % of the power lies, the mean left out [Hz]."""
    lines = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(values.size)))
    power = np.square(lines / (lines.max() or 1.0))
    total = np.cumsum(power)
    if total[-1] <= 0:
        return 0.0
    return float(np.searchsorted(total, 0.99 * total[-1])) / (values.size * step)


# What an experiment must have, in words for people, and the rule of thumb behind it.
_Need = tuple[str, Callable[[Excitation], bool]]
_MOTION: _Need = ("motion", lambda e: e.top_speed > 0)
_BOTH_WAYS: _Need = ("motion in both directions", lambda e: e.both_ways)
_REVERSALS: _Need = ("four reversals or more", lambda e: e.reversals >= 4)
_BOTH_SIDES: _Need = ("angles of motor and load", lambda e: e.both_sides)
_PAIR: _Need = ("angle and speed of one shaft", lambda e: e.angle_and_speed)
_FAST_INPUT: _Need = ("input above 20 Hz (multisine, square)", lambda e: e.bandwidth > 20)
_PRELOAD: _Need = ("a lasting difference of the two inputs (preload)", lambda e: e.preload != 0)
_STOPS: _Need = ("two stops or more", lambda e: e.stops >= 2)
_SLOW: _Need = ("time at low speed", lambda e: e.slow_share > 0.02)
_LONG: _Need = ("20 s or more", lambda e: e.duration >= 20)
_CROSSINGS: _Need = ("an input that crosses zero", lambda e: e.zero_crossings >= 2)


def _turned(degrees: float) -> _Need:
    def enough(e: Excitation) -> bool:
        return e.unit != "rad" or e.travel >= np.radians(degrees)

    return f"travel of {degrees:g} degrees or more", enough


NEEDS: dict[str, tuple[_Need, ...]] = {
    "back_emf": (_MOTION,),
    "backlash": (_REVERSALS,),
    "backlash_variation": (_REVERSALS, _turned(90)),
    "base_vibration": (_MOTION,),
    "cable_spring": (_turned(30),),
    "cogging": (_MOTION,),
    "coulomb_friction": (_BOTH_WAYS,),
    "current_lag": (_FAST_INPUT,),
    "drive_dead_band": (_CROSSINGS,),
    "drive_delay": (_FAST_INPUT,),
    "drive_offset": (_BOTH_WAYS,),
    "drive_saturation": (_MOTION,),
    "encoder_eccentricity": (_PAIR, _turned(180)),
    "friction_asymmetry": (_BOTH_WAYS, _REVERSALS),
    "load_dependent_friction": (_PRELOAD,),
    "local_spot": (_turned(30), _BOTH_WAYS),
    "mesh_error": (_BOTH_SIDES, _turned(10)),
    "pinion_runout": (_BOTH_SIDES, _turned(45)),
    "position_dependent_friction": (_BOTH_WAYS, _turned(30)),
    "presliding": (_STOPS,),
    "quadratic_drag": (_MOTION, _SLOW),
    "reducer_compliance": (_BOTH_SIDES, _FAST_INPUT),
    "ring_gear_eccentricity": (_BOTH_SIDES, _turned(90)),
    "sensor_delay": (_PAIR,),
    "sensor_gain": (_PAIR,),
    "shaft_compliance": (_FAST_INPUT,),
    "stiffness_variation": (_BOTH_SIDES,),
    "stribeck_friction": (_SLOW, _REVERSALS),
    "thermal_drift": (_LONG,),
    "torque_constant_mismatch": (_BOTH_SIDES,),
    "unbalance": (_turned(30), _BOTH_WAYS),
    "viscous_friction": (_MOTION, _SLOW),
}


def _testable(
    excitation: Excitation, declared: Collection[str], effects: Collection[str] | None
) -> tuple[Testability, ...]:
    results = []
    for effect, needs in NEEDS.items():
        if effects is not None and effect not in effects:
            continue
        lacks = tuple(words for words, met in needs if not met(excitation))
        lacks = (DECLARED,) if effect in declared else lacks
        results.append(Testability(effect, not lacks, lacks))
    return tuple(results)


def describe_file(path: Path) -> LogInfo:
    """Say what is in a file without a rig: all its columns as they are, and how it is excited.

    Effects are listed where the columns are those of the dual-motor drive.
    """
    columns, table, more = _columns_of(path)
    samples = max((len(values) for values in table.columns.values()), default=0)
    try:
        log = log_of(table, path.name, digest_of(path), {}, stem(path.name))
        info = describe(log, effects=None if log.has("u_left", "u_right") else ())
    except LogError as error:
        if samples < MIN_SAMPLES or not columns:
            raise
        notes = (*table.notes, *more, str(error))
        return LogInfo(path.name, samples, 0.0, 0.0, None, columns, None, (), notes)
    kept = tuple(w for w in info.warnings if "no known unit" not in w)
    return replace(info, channels=columns, warnings=(*kept, *more))


def _columns_of(path: Path) -> tuple[tuple[ChannelInfo, ...], Table, list[str]]:
    """Columns of numbers of any readable file, and what to know of them."""
    stated: dict[str, str] = {}

    def choose(names: list[str], units: Mapping[str, str]) -> list[str]:
        stated.update(units)
        return names

    table = read_table(path, choose)
    found, words, wraps = [], [], []
    for name, values in table.columns.items():
        try:
            column = np.asarray(values)
            if column.dtype.kind not in "mMiub":
                column = numbers_or_times(column, name, path.name)
        except LogError:
            words.append(name)
            continue
        if dated := column.dtype.kind in "mM":
            column, _ = seconds_of(column, 1.0)
        good = column[np.isfinite(column)].astype(np.float64)
        if good.size and not (dated and np.ptp(good) == 0.0):  # a date beside the time of day
            unit = "s" if stated.get(name) == TIMES else stated.get(name, "")
            found.append(_figures(*_in_seconds(name, unit, good)))
            if (unit or named_unit(name)[1] or name.rpartition("_")[2]).lower() in COUNTS:
                wraps.append(
                    unwrapped_counts(name, good)[1].replace(": unw", "; as a position it is unw")
                )
    left_out = [f"left out {listed(words)}: no column of numbers"] if words else []
    return tuple(found), table, [*filter(None, wraps), *left_out]


def _in_seconds(name: str, unit: str, values: Array) -> tuple[str, Array]:
    """Name with its unit, and values; of a clock in ticks or since an epoch from its first row."""
    own = unit or named_unit(name)[1]
    counts = own.lower() in TICKS
    if counts or (not own and name != "T" and name.lower() in CLOCKS):
        seconds, note = seconds_of(values, parse_unit(own).factor)
        if counts or note:
            return f"{named_unit(name)[0]} [s]", seconds - seconds[0]
    return _with_unit(name, unit), values
