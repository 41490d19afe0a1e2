"""Position, speed and acceleration of measured bodies from a log, at the bandwidth it allows."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.signal import butter, firwin, sosfiltfilt, upfirdn, welch

from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.signals import Log

Floats = NDArray[np.float64]

NOISE_SHARE = 0.05  # of the acceleration may be sensor noise, rms
MOTION_OVER_BALANCE = 2.0  # bandwidth of the motion over that of the balance
HIGHEST = 0.1  # of the sample rate: derivatives by differences stay within 1 % below it
LOWEST = 0.002
ROWS_PER_HERTZ = 2.5  # of balance bandwidth, after decimation
TAPS = 3.0  # half-length of the decimation filter in periods of its cut-off
REST_SHARE = 5e-3  # of the highest speed; slower is at rest
REST_TIME = 2.0  # at rest for longer than this many periods of the bandwidth is left out
STRETCHES = 10  # that a log is cut into where there are few logs
HELD_STRETCHES = (2, 5, 8)  # of these, not fitted
FLOOR_BAND = 0.4  # of the sample rate; above it the spectrum of a sensor is its noise


@dataclass(frozen=True)
class Sight:
    """What the sensors of one body allow.

    Attributes
    ----------
    sensor : Sensor
        The one that gives speed and acceleration.
    angle : Sensor or None
        The one that gives position; None: integral of the speed.
    bandwidth : float
        Up to which the acceleration is signal [Hz].
    """

    sensor: Sensor
    angle: Sensor | None
    bandwidth: float


@dataclass(frozen=True)
class Motion:
    """One log as the balance of torques needs it.

    Attributes
    ----------
    name : str
    dt : float
        Sample time [s].
    time : (n,) array
        From the log's start [s].
    u : dict of input name to (n,) array
        As logged, SI.
    q, v, a : dict of body to (n,) array
        Zero-phase filtered.
    bandwidth : float
        Of the balance [Hz].
    """

    name: str
    dt: float
    time: Floats
    u: dict[str, Floats]
    q: dict[str, Floats]
    v: dict[str, Floats]
    a: dict[str, Floats]
    bandwidth: float
    angles: frozenset[str]  # bodies whose position is measured, not integrated
    by_speed: bool = False  # the first point's acceleration is that of a speed sensor
    part: str = ""  # "fit" or "held-out" stretches of the log; "" is all of it

    @cached_property
    def step(self) -> int:
        """Samples per row of the balance."""
        return max(int(1.0 / (self.dt * ROWS_PER_HERTZ * self.bandwidth)), 1)

    @cached_property
    def taps(self) -> Floats:
        """Low-pass filter of the balance."""
        half = max(int(TAPS / (self.bandwidth * self.dt)), 1)
        if self.step == 1:
            return np.ones(1)
        return firwin(2 * half + 1, self.bandwidth, fs=1.0 / self.dt, window="hann")

    def reduce(self, signal: Floats) -> Floats:
        """Low-pass a signal and keep one row in `step`, (rows,); the edges are left out."""
        half = self.taps.size // 2
        if signal.size <= 4 * half:
            return signal[:0]
        full = upfirdn(self.taps, signal, down=1)[2 * half : signal.size]
        return full[self._inset :: self.step] if self._inset == 0 else (
            full[self._inset : -self._inset : self.step]
        )  # fmt: skip

    @property
    def _inset(self) -> int:
        """Samples at each end that the motion's own filter spoils."""
        return int(1.0 / (self.bandwidth * self.dt))

    @cached_property
    def rows(self) -> Floats:
        """Times of the rows [s]."""
        half = self.taps.size // 2
        full = self.time[half : self.time.size - half]
        inset = self._inset
        return full[inset : full.size - inset or None : self.step] if inset else full[:: self.step]

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Rows at which the bodies move, or rest only in passing, (rows,)."""
        shares = []
        for v in self.v.values():
            slow = np.abs(v) < REST_SHARE * np.abs(v).max(initial=0.0)
            slow |= v == 0
            shares.append(self.reduce(_long_runs(slow, REST_TIME / (self.bandwidth * self.dt))))
        rest = np.max(shares, axis=0)
        return (rest < 0.05) & self._own

    @property
    def _own(self) -> NDArray[np.bool_]:
        """Rows of the stretches that this motion is about."""
        tenth = (np.arange(self.rows.size) * STRETCHES) // max(self.rows.size, 1)
        held = np.isin(tenth, HELD_STRETCHES)
        return {"fit": ~held, "held-out": held}.get(self.part, np.ones_like(held))


def _long_runs(flag: NDArray[np.bool_], shortest: float) -> Floats:
    """1.0 where a flag holds for at least `shortest` samples on end, else 0.0."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flag.astype(np.int8), [0]))))
    out = np.zeros(flag.size)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start >= shortest:
            out[start:stop] = 1.0
    return out


def choose_sensors(rig: Rig, logs: Sequence[Log]) -> dict[str, Sight]:
    """Choose, per sensor group, what gives the motion, and how far it reaches.

    Returns
    -------
    dict of sensor name to Sight
        One entry per body that is measured; bodies with sensors that disagree (a compliance
        between them) are told apart by the diagnosis, which asks per sensor.
    """
    sights: dict[str, Sight] = {}
    for body in rig.bodies:
        own = [s for s in rig.sensors if s.body == body.name]
        if not own:
            continue
        reach = {s.name: acceleration_bandwidth(s, logs) for s in own}
        best = max(own, key=lambda s: reach[s.name])
        angle = next((s for s in own if s.measures == "position"), None)
        if best.measures == "position":
            angle = best
        sights[body.name] = Sight(best, angle, reach[best.name])
    return sights


def acceleration_bandwidth(sensor: Sensor, logs: Sequence[Log]) -> float:
    """Frequency up to which a sensor gives acceleration with little noise [Hz].

    The noise is taken as white, at the level of the spectrum above 0.4 of the sample rate (the
    quietest log tells), but not below what the declared resolution and noise give.
    """
    order = 2 if sensor.measures == "position" else 1
    reach = []
    for log in logs:
        y, rate = log[sensor.channel], 1.0 / log.sample_time
        length = min(y.size, 4096)
        trend = np.polyval(np.polyfit(log.time - log.time[0], y, 1), log.time - log.time[0])
        f, power = welch(y - trend, rate, nperseg=length, detrend="linear")
        floor = float(np.median(power[f > FLOOR_BAND * rate]))
        floor = max(floor, _declared_variance(sensor, y) / (rate / 2))
        weight = (2 * np.pi * f) ** (2 * order)
        noise = np.cumsum(weight * floor)
        whole = np.cumsum(weight * np.maximum(power, floor))
        good = noise <= NOISE_SHARE**2 * np.maximum(whole - noise, 0.0)
        good[0] = False
        below = f[good]
        best = float(below.max()) if below.size else 0.0
        reach.append(float(np.clip(best, LOWEST * rate, HIGHEST * rate)))
    return float(np.median(reach))


def _declared_variance(sensor: Sensor, y: Floats) -> float:
    """Variance of noise and rounding; the step of the readings where none is declared."""
    noise = sensor.noise.value if sensor.noise is not None else 0.0
    if sensor.resolution is not None:
        step = sensor.resolution.value
    else:
        different = np.abs(np.diff(np.unique(y)))
        step = float(np.median(different)) if different.size else 0.0
        if different.size > 0.2 * y.size:
            step = 0.0  # values hardly repeat: not quantised to a grid that matters
    return noise**2 + step**2 / 12


def prepare(
    log: Log,
    rig: Rig,
    sights: dict[str, Sight],
    bandwidth: float,
    late: Mapping[str, float] | None = None,
) -> Motion:
    """Filter one log into the motion of its measured bodies, late sensors put right.

    Parameters
    ----------
    sights : as from `choose_sensors`
        Keys may be any names; they become those of the bodies in the motion.
    bandwidth : float
        Of the balance [Hz].
    """
    dt = log.sample_time
    rate = 1.0 / dt
    cut = min(MOTION_OVER_BALANCE * bandwidth, 0.45 * rate)
    sos = butter(6, cut, fs=rate, output="sos")
    q, v, a = {}, {}, {}
    for body, sight in sights.items():
        signal = log[sight.sensor.channel]
        if late and late.get(sight.sensor.name):
            signal = on_time(signal, dt, late[sight.sensor.name])
        signal = sosfiltfilt(sos, signal, padlen=_padding(log, cut))
        if sight.sensor.measures == "position":
            q[body] = signal
            v[body] = derivative(signal, dt)
        else:
            v[body] = signal
            q[body] = (
                cumulative_trapezoid(signal, dx=dt, initial=0.0)
                if sight.angle is None
                else sosfiltfilt(sos, log[sight.angle.channel], padlen=_padding(log, cut))
            )
        a[body] = derivative(v[body], dt)
    return Motion(
        log.name,
        dt,
        log.time - log.time[0],
        {i.name: np.array(log[i.channel]) for i in rig.inputs},
        q,
        v,
        a,
        bandwidth,
        frozenset(body for body, sight in sights.items() if sight.angle is not None),
        next(iter(sights.values())).sensor.measures == "speed",
    )


def _padding(log: Log, cut: float) -> int:
    return int(min(3.0 / (cut * log.sample_time) + 10, len(log) - 1))


def derivative(signal: Floats, dt: float) -> Floats:
    """Derivative by central differences of sixth order; of lower order at the ends."""
    out = np.gradient(signal, dt, edge_order=2)
    if signal.size > 6:
        s = signal
        out[3:-3] = (
            45 * (s[4:-2] - s[2:-4]) - 9 * (s[5:-1] - s[1:-5]) + (s[6:] - s[:-6])
        ) / (60 * dt)  # fmt: skip
    return out


def on_time(signal: Floats, dt: float, delay: float) -> Floats:
    """Return a signal with a delay undone, by cubic interpolation."""
    time = dt * np.arange(signal.size)
    return CubicSpline(time, signal)(np.minimum(time + delay, time[-1]))
