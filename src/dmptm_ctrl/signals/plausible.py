"""Do the channels of a log fit each other? Catches units, signs, stuck and clipped sensors."""

from typing import Any

import numpy as np

from dmptm_ctrl.signals.errors import LogError
from dmptm_ctrl.signals.log import Array, Log

# Below this correlation two channels do not show their ratio.
SURE = 0.9
# Sensor errors worth a diagnosis stay within a factor of 2; mistaken units do not.
SAME_UNIT = (0.5, 2.0)
NAMED = 1.15  # a factor within 15 % of a known mistake is that mistake
_MIXED = {
    180 / np.pi: "radians and degrees",
    1e3: "milliseconds and seconds, or thousandths,",
    6.0: "rpm and deg/s",
    30 / np.pi: "rpm and rad/s",
    360.0: "turns and degrees",
    100.0: "percent and shares, or centimetres and metres,",
    60.0: "arc-minutes and degrees, or turns per minute and per second,",
}
MISTAKES = {f: f"{what} are mixed up" for k, what in _MIXED.items() for f in (k, 1 / k)}
MISTAKES[np.pi / 180] = "degrees and radians are mixed up"
NOTICEABLE = np.radians(1.0)  # motion that every speed sensor must see
GENERATOR = -0.3  # energy that goes in, between -1 and 1, below which motors do not drive
STARTED = 0.3  # of the highest speed, with which a log's first motion ends
SHORTEST = 10  # samples at an extreme that count as clipped
MOTORS = {"theta_ml": "left", "theta_mr": "right"}


def refuse_inconsistent(log: Log, ratio: float | None = None) -> None:
    """Refuse a log whose channels contradict each other by a mistaken unit or sign.

    Of the paper's rig: omega_L with the rate of theta_L, motor angles with each other and, by the
    `ratio` of motor turns, with the ring gear, the power of the motors with its sign.
    """
    if log.has("theta_L", "omega_L"):
        travel = travelled(log)
        refuse_factor(
            log, log["theta_L"], travel, "theta_L changes", "omega_L adds up to", detrend=True
        )
    if log.has(*MOTORS):
        refuse_factor(log, log["theta_ml"], log["theta_mr"], "theta_ml changes", "theta_mr does")
    if ratio is not None and log.has("theta_L"):
        for motor in MOTORS:
            if log.has(motor):
                turned = ratio * log["theta_L"]
                expected = f"{ratio:g} times theta_L does"
                refuse_factor(log, log[motor], turned, f"{motor} changes", expected)
    if log.has("u_left", "u_right", "omega_L"):
        _refuse_generator(log)


def suspects(log: Log) -> list[str]:
    """What looks wrong with a log but does not forbid its use, one sentence each."""
    found = []
    for channel, values in log.channels.items():
        if np.ptp(values) == 0:
            found += _constant(log, channel, float(values[0]))
        elif (level := _clipped(log, channel)) is not None:
            found.append(
                f"{channel} is clipped or saturated: it stays at its extreme of "
                f"{level:.6g} {log.units[channel]}"
            )
    if log.has("u_left", "u_right", *MOTORS) and _swapped(log):
        found.append(
            "left and right may be swapped: the motor with the higher voltage lags behind the other"
        )
    if log.has("theta_L", "omega_L") and not found:
        travel = travelled(log)
        moves = max(np.ptp(log["theta_L"]), np.ptp(travel)) > NOTICEABLE
        if moves and abs(motion_ratio(log, log["theta_L"], travel, detrend=True)[1]) < SURE:
            found.append("omega_L does not follow theta_L: a foreign or failing sensor")
    return found


def travelled(log: Log, channel: str = "omega_L") -> Array:
    """Angle that a speed adds up to [rad], trapezoidal."""
    speed = log[channel]
    steps = 0.5 * (speed[1:] + speed[:-1]) * np.diff(log.time)
    return np.concatenate([[0.0], np.cumsum(steps)])


def _slope(y: Array, x: Array) -> tuple[float, float]:
    """Least-squares slope of y over x with an offset, and their correlation."""
    x, y = x - x.mean(), y - y.mean()
    xx, yy, xy = float(x @ x), float(y @ y), float(x @ y)
    if xx <= 0 or yy <= 0:
        return np.nan, 0.0
    return xy / xx, xy / np.sqrt(xx * yy)


def motion_ratio(log: Log, y: Array, x: Array, *, detrend: bool = True) -> tuple[float, float]:
    """Ratio of y to x and their correlation.

    Also without trends, where that is surer: a gyro's bias adds up to a ramp.
    """
    plain = _slope(y, x)
    if not detrend:
        return plain
    bent = _slope(_detrended(y, log.time), _detrended(x, log.time))
    return max(plain, bent, key=lambda ratio: abs(ratio[1]))


def _detrended(y: Array, time: Array) -> Array:
    t = time - time.mean()
    return y - y.mean() - t * float(t @ y) / max(float(t @ t), 1e-300)


def refuse_factor(
    log: Log, y: Array, x: Array, this: str, expected: str, *, detrend: bool = False
) -> None:
    """Refuse y that is not about 1 times x where their correlation shows it."""
    slope, correlation = motion_ratio(log, y, x, detrend=detrend)
    if abs(correlation) < SURE:
        return
    if slope < 0:
        raise LogError(
            f"{log.name}: {this} against what {expected}: one of the two has the wrong sign"
        )
    if SAME_UNIT[0] <= slope <= SAME_UNIT[1]:
        return
    nearest = min(MISTAKES, key=lambda factor: abs(np.log(slope / factor)))
    known = abs(np.log(slope / nearest)) < np.log(NAMED)
    why = MISTAKES[nearest] if known else "a wrong unit"
    raise LogError(f"{log.name}: {this} {slope:.4g} times what {expected}: {why}")


def _refuse_generator(log: Log) -> None:
    """Friction only takes energy: over a log, motors that drive put energy in."""
    voltage, speed = log["u_left"] + log["u_right"], log["omega_L"]
    # a late drive may swing against its commands for most of a log, but it starts with them
    started = int(np.argmax(np.abs(speed) > STARTED * np.abs(speed).max())) + 1
    if max(lean(voltage, speed), lean(voltage[:started], speed[:started])) < GENERATOR:
        raise LogError(
            f"{log.name}: the ring gear turns against u_left + u_right over the whole log: "
            "the voltages or the speed have the wrong sign"
        )


def lean(u: Array, v: Array) -> float:
    """Return the cosine between two signals, 0 where one is zero."""
    size = np.sqrt(float(u @ u) * float(v @ v))
    return float(u @ v) / size if size > 0 else 0.0


def _constant(log: Log, channel: str, value: float) -> list[str]:
    if channel.startswith("u_") or log.units[channel] in ("V", "A", "N", "N·m"):
        return [f"{channel} is {value:.6g} {log.units[channel]} all the time: no excitation"]
    if channel == "ref":
        return []
    moving = [c for c in log.channels if c != channel and np.ptp(log.channels[c]) > 0]
    if moving:
        return [
            f"{channel} stays at {value:.6g} {log.units[channel]} while {moving[0]} changes: "
            "a stuck sensor or a drive at rest"
        ]
    return [f"{channel} stays at {value:.6g} {log.units[channel]}"]


def _clipped(log: Log, channel: str) -> float | None:
    """Extreme at which a channel stays although the drive moves on."""
    values = log[channel]
    speed = f"omega{channel.removeprefix('theta')}"
    if channel == "ref" or (log.units[channel] == "rad" and not log.has(speed)):
        return None  # a setpoint may stay; an angle alone does not distinguish rest from clipping
    step = np.abs(np.diff(values))
    for level in (values.max(), values.min()):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], values == level, [False]])))
        begins, ends = edges[::2], edges[1::2]
        long = ends - begins >= SHORTEST
        begins, ends = begins[long], ends[long]
        if begins.size == 0:
            continue
        if log.units[channel] == "rad":
            travel = travelled(log, speed)
            moved = np.abs(travel[ends - 1] - travel[begins]).max()
            clipped = bool(moved > 10 * np.median(step[step > 0]))  # readings between its steps
        else:
            clipped = _abrupt(step, begins, ends)
        if clipped:
            return float(level)
    return None


def _abrupt(step: Array, begins: Any, ends: Any) -> bool:
    """Whether runs are entered and left at full rate: no coming to rest, no square wave."""
    around = [step[max(0, i - 6) : max(0, i - 1)] for i in begins]
    around += [step[i : i + 5] for i in ends]
    rates = [part.mean() for part in around if part.size == 5]
    return len(rates) > 0 and float(np.median(rates)) > 0.5 * float(np.median(step[step > 0]))


def _swapped(log: Log) -> bool:
    """Under a lasting voltage difference the stronger motor leads by the play of its mesh."""
    difference = log["u_left"] - log["u_right"]
    lasting = float(np.median(difference))
    level = np.sqrt(np.mean(np.square(log["u_left"]) + np.square(log["u_right"])))
    if abs(lasting) < 0.05 * level:
        return False
    apart = log["theta_ml"] - log["theta_mr"]
    lead = float(np.median(apart - apart[0]))
    return abs(lead) > float(np.radians(1.0)) and lead * lasting < 0
