"""Position, speed and acceleration of measured bodies from a log, at the bandwidth it allows."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from math import ceil
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline
from scipy.ndimage import uniform_filter1d
from scipy.signal import butter, firwin, freqz, sosfiltfilt, welch

from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.identify.compared_signals import NORMAL_MEDIAN, noise_below
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import Layout, Placed

NOISE_SHARE = 0.05  # of the acceleration may be sensor noise, rms
MOTION_OVER_BALANCE = 2.0  # bandwidth of the motion over that of the balance
HIGHEST = 0.1  # of the sample rate: derivatives by differences stay within 1 % below it
LOWEST = 0.002
ROWS_PER_HERTZ = 2.5  # of balance bandwidth, after decimation
SAMPLES_PER_ROW = 8.0  # at least; the motion has nothing above a fifth of their rate
TAPS = 3.0  # half-length of the decimation filter in periods of its cut-off
REST_SHARE = 5e-3  # of the highest speed; slower is at rest
REST_NOISE = 3.0  # standard deviations of a sensor's noise; slower is at rest
MOST_REST = 0.05  # of the highest speed
REST_TIME = 2.0  # at rest for longer than this many periods of the bandwidth is left out
STRETCHES = 10  # that a log is cut into where there are few logs
HELD_STRETCHES = (2, 5, 8)  # of these, not fitted
FEWEST_ROWS = 60  # of a balance; fewer say nothing
NO_STAIRS = 0.4  # of the bandwidth; a filter that lets single counts of slow motion pass no more
DUST = 1e-9  # of the range; readings that differ by less are the same
FEW_STEPS = 5.5  # over which the rounding of a text file is small beside a step
OFF_GRID = 0.1  # of a step; readings on no grid are off one by a quarter on average
KEPT = 48  # results per log that fits ask for again
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
    noise : float
        Density of the sensor's noise, in its unit squared per Hz; the lower of what the
        readings show and what is declared.
    """

    sensor: Sensor
    angle: Sensor | None
    bandwidth: float
    noise: float = 0.0


@dataclass(frozen=True)
class Motion:
    """One log as the balance of torques needs it.

    Attributes
    ----------
    dt : float
        Time between its samples [s]: one in `thin` of the log's.
    time : (n,) array
        From the log's start [s].
    u : dict of input name to (n,) array
        Mean from each sample to the next, SI.
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
    rest_share: float = REST_SHARE  # of the highest speed; slower is at rest, or noise
    part: str = ""  # "fit" or "held-out" stretches of the log; "" is all of it
    first: int = 0  # sample of the log that it begins with
    tenth: int | None = None  # of the log, where it is a piece of one that is too long
    open_links: Floats | None = None  # 1.0 at samples that do not count: followed links are open
    loose: Mapping[str, Floats] = field(default_factory=dict)  # the same of each toothed link
    flank: Mapping[str, Floats] = field(default_factory=dict)  # 1 or −1, on which they push
    # what samples of a twist count, 1 or less where teeth swing by more than they wind up
    calm: Mapping[str, Floats] = field(default_factory=dict)
    zero: Mapping[str, float] = field(default_factory=dict)  # middle of the gap of each, rad or m
    thin: int = 1  # samples of the log per sample, an odd number; the middle one is kept
    sent: Mapping[str, Floats] = field(default_factory=dict)  # `u` at all of the log's samples
    known: dict[Any, Any] = field(default_factory=dict, repr=False)  # what fits ask for again

    @property
    def sample_time(self) -> float:
        """Sample time of the log [s]."""
        return self.dt / self.thin

    @cached_property
    def step(self) -> int:
        """Samples per row of the balance."""
        return max(int(1.0 / (self.dt * ROWS_PER_HERTZ * self.bandwidth)), 1)

    @cached_property
    def taps(self) -> Floats:
        """Low-pass filter of the balance, an odd number of weights."""
        if self.step == 1:
            return np.ones(1)
        half = self.step * ceil(TAPS / (self.bandwidth * self.dt * self.step))
        return firwin(2 * half + 1, self.bandwidth, fs=1.0 / self.dt, window="hann")

    def reduce(self, signal: Floats) -> Floats:
        """Low-pass signals and keep one row in `step`, (..., rows); the edges are left out."""
        inner = signal[..., self._inset : signal.shape[-1] - self._inset]
        rows, step = self.rows.size, self.step
        out = self.taps[-1] * inner[..., self.taps.size - 1 :: step][..., :rows]
        blocks = self.taps.size // step  # the last tap is one more
        if rows and blocks > 0 and step > 1:
            taps = self.taps[:-1].reshape(blocks, step)  # the same from either end
            cut = inner[..., : (rows + blocks - 1) * step]
            parts = cut.reshape(*cut.shape[:-1], -1, step) @ taps.T
            for k in range(blocks):
                out += parts[..., k : k + rows, k]
        return out

    def smooth(self, signal: Floats) -> Floats:
        """Mean of a signal over one period of what is fastest in the motion, at all samples."""
        period = 1.0 / (MOTION_OVER_BALANCE * self.bandwidth)
        return np.asarray(uniform_filter1d(signal, max(round(period / self.dt), 1)))

    def response(self, omega: Floats) -> Floats:
        """Gain of `reduce` at angular frequencies [rad/s], as far as the filter goes."""
        if self.step == 1:
            return np.ones_like(omega)
        return freqz(self.taps, worN=omega * self.dt)[1]

    @property
    def _inset(self) -> int:
        """Samples at each end that the motion's own filter spoils."""
        return int(1.0 / (self.bandwidth * self.dt))

    @cached_property
    def rows(self) -> Floats:
        """Times of the rows [s]."""
        left = self.time.size - 2 * self._inset - self.taps.size
        if left < 0:
            return self.time[:0]
        first = self._inset + self.taps.size // 2
        return self.time[first :: self.step][: left // self.step + 1]

    @cached_property
    def moving(self) -> NDArray[np.bool_]:
        """Rows at which the bodies move, or rest only in passing, (rows,).

        Between teeth, where noise of the twist hides what holds a body, they do not rest at all.
        """
        shares, least = [], 1.0 if self.loose else REST_TIME / (self.bandwidth * self.dt)
        for v in self.v.values():
            slow = np.abs(v) < self.rest_share * np.abs(v).max(initial=0.0)
            slow |= v == 0
            if self.loose:
                slow[1:] |= np.sign(v[1:]) != np.sign(v[:-1])
            shares.append(self.reduce(_long_runs(slow, least)))
        if self.open_links is not None:
            shares.append(self.reduce(self.open_links))
        rest = np.max(shares, axis=0)
        return (rest < 0.05) & self._own

    def pushing(self, link: str) -> NDArray[np.bool_]:
        """Rows of these at which the teeth of a link push, (rows,)."""
        if link not in self.loose:
            return self.moving
        return self.moving & (self.reduce(self.loose[link]) < 0.05)

    def at(self, point: str, ratio: float) -> tuple[Floats, Floats, Floats]:
        """Position, speed and acceleration of a point's coordinate; the same arrays each time."""
        key = point, ratio
        if key not in self.known:
            q, v, a = (x[point] / ratio for x in (self.q, self.v, self.a))
            self.known[key] = q, v, a
            self.known[id(v)] = {}
        found: tuple[Floats, Floats, Floats] = self.known[key]
        return found

    @property
    def samples(self) -> slice:
        """Samples of the log that it holds."""
        first = self.first * self.thin + self.thin // 2
        return slice(first, first + (self.time.size - 1) * self.thin + 1, self.thin)

    def pieces(self, samples: int) -> tuple["Motion", ...]:
        """Return the middle of each tenth, a motion each, all as many samples together.

        They are longer where filters would leave fewer than :data:`FEWEST_ROWS`.
        """
        least = FEWEST_ROWS * self.step + self.taps.size + 1 + 2 * self._inset
        length = max(samples // STRETCHES, least)
        edges = np.arange(STRETCHES + 1) * self.time.size // STRETCHES
        if length >= edges[1]:
            return (self,)
        found = []
        for k, (start, stop) in enumerate(pairwise(edges.tolist())):
            first = (start + stop - length) // 2
            cut = slice(first, first + length)
            fine = slice(self.thin * first, self.thin * (first + length))
            sent = {name: x[fine] for name, x in self.sent.items()}
            u, q, v, a = (
                {name: x[cut] for name, x in signals.items()}
                for signals in (self.u, self.q, self.v, self.a)
            )
            cut_out = replace(self, time=self.time[cut], u=u, q=q, v=v, a=a, sent=sent, known={})
            found.append(replace(cut_out, first=first, tenth=k))
        return tuple(found)

    def of(self, part: str) -> bool:
        """Whether some of it may belong to a part of the log."""
        return self.tenth is None or (self.tenth in HELD_STRETCHES) == (part == "held-out")

    @property
    def _own(self) -> NDArray[np.bool_]:
        """Rows of the stretches that this motion is about."""
        if self.tenth is not None:
            return np.ones(self.rows.size, bool)
        return of_part(self.part, self.rows.size)


def of_part(part: str, count: int) -> NDArray[np.bool_]:
    """Rows of a log that are in its "fit" or "held-out" stretches, or all of them, (count,)."""
    held = np.isin(np.arange(count) * STRETCHES // max(count, 1), HELD_STRETCHES)
    return {"fit": ~held, "held-out": held}.get(part, np.ones_like(held))


@dataclass(frozen=True)
class Nuisance:
    """What belongs to a log and not to the rig.

    Attributes
    ----------
    zero : dict of effect key to float
        Added to the measured angle for an effect that depends on it [rad]: an incremental
        encoder starts anywhere.
    twist : dict of link to float
        Twist that the sensors on both sides show without torque [rad].
    """

    zero: Mapping[str, float] = field(default_factory=dict)
    twist: Mapping[str, float] = field(default_factory=dict)


NONE = Nuisance()
Moves = dict[int, tuple[Floats, Floats, Floats]]  # coordinate -> position, speed, acceleration


def recent(kept: dict[Any, Any], key: Any, make: Callable[[], Any], most: int) -> Any:
    """Return what was made for a key, or make it; of more than `most` the oldest are forgotten."""
    found = kept.pop(key, None)
    if found is None:
        found = make()
        for old in list(kept)[: max(len(kept) - most, 0)]:
            kept.pop(old, None)
    kept[key] = found  # what was asked for last is last
    return found


def kept(motion: Motion, key: Any, arrays: Sequence[Floats], make: Callable[[], Any]) -> Any:
    """Return what follows from signals along a motion and a key, or make it.

    Fits ask again and again, while they move other numbers. The signals are kept with it: others
    in their place in memory would be taken for them.
    """
    known = motion.known.setdefault("along", {})
    whole = (key, *map(id, arrays))
    return recent(known, whole, lambda: (make(), *arrays), KEPT)[0]


def acting_by(effects: Iterable[Placed], nuisance: Nuisance = NONE) -> tuple[Any, ...]:
    """What effects do along a motion depends on, for :func:`kept`."""
    return tuple((e.key, nuisance.zero.get(e.key, 0.0), *e.values.items()) for e in effects)


def coordinates_of(layout: Layout, sensors: Iterable[str]) -> list[int]:
    """Return the coordinate that each sensor sees."""
    return [layout.coordinate[layout.sensor_body[name]] for name in sensors]


def _long_runs(flag: NDArray[np.bool_], shortest: float) -> Floats:
    """1.0 where a flag holds for at least `shortest` samples on end, else 0.0."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flag.astype(np.int8), [0]))))
    out = np.zeros(flag.size)
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        if stop - start >= shortest:
            out[start:stop] = 1.0
    return out


def order_of(sensor: Sensor) -> int:
    """How many times its readings are differentiated to accelerations."""
    return 2 if sensor.measures == "position" else 1


def acceleration_bandwidth(sensor: Sensor, logs: Sequence[Log]) -> tuple[float, float]:
    """Frequency up to which a sensor gives acceleration with little noise [Hz]; its noise.

    The noise is taken as white, at the level of the spectrum above 0.4 of the sample rate (the
    quietest log shows), but not below what the declared resolution and noise give. What
    rounding makes at low frequencies is not white: none at rest, and more where motion is slow.
    """
    order = order_of(sensor)
    reach, floors = [], []
    for log in logs:
        y, rate = log[sensor.channel], 1.0 / log.sample_time
        length = min(y.size, 4096)
        trend = np.polyval(np.polyfit(log.time - log.time[0], y, 1), log.time - log.time[0])
        f, power = welch(y - trend, rate, nperseg=length, detrend="linear")
        # the median of χ², of two degrees of freedom per segment, over its mean
        low = (1.0 - 1.0 / (9.0 * max(2 * y.size // length - 1, 1))) ** 3
        floor = float(np.median(power[f > FLOOR_BAND * rate])) / low
        step = grid_of(sensor, y)
        declared = _declared_variance(sensor, step) / (rate / 2)
        quiet = min(floor, declared or floor)
        floor = max(floor, declared)
        weight = (2 * np.pi * f) ** (2 * order)
        noise = np.cumsum(weight * floor)
        whole = np.cumsum(weight * np.maximum(power, floor))
        good = noise <= NOISE_SHARE**2 * np.maximum(whole - noise, 0.0)
        good[0] = False
        below = f[good]
        best = float(below.max()) if below.size else 0.0
        reach.append(float(np.clip(best, LOWEST * rate, HIGHEST * rate)))
        white = min(quiet, 2.0 * step**2 / (12.0 * rate))
        slow = rounding_noise(y, step, rate, reach[-1], order) if step else 0.0
        floors.append(quiet - white + slow)
    return float(np.median(reach)), float(np.median(floors))


def rounding_noise(y: Floats, step: float, rate: float, reach: float, order: int) -> float:
    """Density below `reach` of what rounding adds to a motion like that of the readings.

    The smoothed readings are rounded anew, from several places between two counts; an
    acceleration weighs the noise of each frequency.
    """
    sos = butter(6, NO_STAIRS * reach, fs=rate, output="sos")
    smooth = sosfiltfilt(sos, y) / step + np.arange(0.125, 1.0, 0.25)[:, None]
    error = (np.round(smooth) - smooth) * step
    f, power = welch(error, rate, nperseg=min(y.size, 4096))
    weight = np.where(f <= reach, f ** (2 * order), 0.0)
    return float(np.sum(weight * power.mean(axis=0)) / np.sum(weight))


def reading_variance(sensor: Sensor, y: Floats) -> float:
    """Variance of a sensor's noise, and of rounding, as declared or as the readings show."""
    step, white = grid_of(sensor, y), noise_below(y, 1.0, 0.5)
    own = _declared_variance(sensor, step)
    return max(own, white**2) if white > step else own  # rounding alone is no white noise


def _declared_variance(sensor: Sensor, step: float) -> float:
    """Variance of noise, and of rounding to a step."""
    noise = sensor.noise.value if sensor.noise is not None else 0.0
    return noise**2 + step**2 / 12


def grid_of(sensor: Sensor, y: Floats) -> float:
    """Step of the readings: as declared, or as they are; 0 where they are on no grid."""
    if sensor.resolution is not None:
        return sensor.resolution.value
    different = np.diff(np.unique(y))
    different = different[different > DUST * np.ptp(y)]
    if different.size == 0:
        return 0.0
    if different.size <= 0.2 * y.size:
        return float(np.median(different))
    step = float(np.quantile(different, 0.01))  # fast motion: hardly a reading comes twice
    steps = different[different < FEW_STEPS * step] / step
    off_grid = float(np.quantile(np.abs(steps - np.round(steps)), 0.95))
    whole = np.unique(np.round(steps)).size > 2  # steady motion repeats any difference
    return step if whole and off_grid < OFF_GRID else 0.0


def prepare(log: Log, rig: Rig, sights: dict[str, Sight], bandwidth: float) -> Motion:
    """Filter one log into the motion of its measured bodies.

    Parameters
    ----------
    sights : dict of name to Sight
        The names become those of the points in the motion.
    bandwidth : float
        Of the balance [Hz].
    """
    dt = log.sample_time
    rate = 1.0 / dt
    cut = min(MOTION_OVER_BALANCE * bandwidth, 0.45 * rate)
    sos = butter(6, cut, fs=rate, output="sos")
    q, v, a = {}, {}, {}
    rest = REST_SHARE
    for body, sight in sights.items():
        raw = log[sight.sensor.channel]
        signal = sosfiltfilt(sos, raw, padlen=_padding(log, cut))
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
        fastest = float(np.abs(v[body]).max())
        unclear = _unclear_speed(sight.sensor, raw, signal, cut, rate)
        if fastest > 0:
            rest = max(rest, min(unclear / fastest, MOST_REST))
    # the largest odd number that leaves so many samples in a row, and some in a short log
    row = min(rate / (ROWS_PER_HERTZ * bandwidth), len(log))
    thin = max(2 * ((int(row / SAMPLES_PER_ROW) + 1) // 2) - 1, 1)
    middle = slice(thin // 2, len(log) // thin * thin, thin)
    sent = {i.name: np.array(log[i.channel])[: middle.stop] for i in rig.inputs}
    q, v, a = ({body: x[middle] for body, x in signals.items()} for signals in (q, v, a))
    return Motion(
        log.name,
        thin * dt,
        (log.time - log.time[0])[middle],
        {name: _from_sample_on(u, thin) for name, u in sent.items()},
        q,
        v,
        a,
        bandwidth,
        frozenset(body for body, sight in sights.items() if sight.angle is not None),
        next(iter(sights.values())).sensor.measures == "speed",
        rest,
        thin=thin,
        sent=sent,
    )


def _from_sample_on(u: Floats, thin: int) -> Floats:
    """Mean of a signal from each sample that is kept to the next, (n,)."""
    return np.append(u[thin // 2 :], [u[-1]] * (thin // 2)).reshape(-1, thin).mean(axis=1)


def _unclear_speed(sensor: Sensor, raw: Floats, filtered: Floats, cut: float, rate: float) -> float:
    """Speed below which a sensor does not distinguish motion from rest."""
    if sensor.measures == "position":
        return 2.0 * cut * grid_of(sensor, raw)  # peak of one count through the filter
    # white noise: what the filter took out is that above the cut
    noise = float(np.median(np.abs(raw - filtered))) / NORMAL_MEDIAN
    return REST_NOISE * noise * float(np.sqrt(cut / max(0.5 * rate - cut, 0.05 * rate)))


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


# A signal held from sample to sample, as the derivative of sampled motion shows it: weights of
# the two samples around and of the two beyond. A body J gives v(k+1) − v(k) = dt u(k)/J, so that
# the band-limited derivative of sampled speed is u e^{−jx/2}/sinc(x/2), x = ω dt; of sampled
# position twice differentiated it is u e^{−jx/2} cos(x/2)/sinc²(x/2). Right to x².
HELD_SPEED = (7 / 12, -1 / 12)
HELD_POSITION = (13 / 24, -1 / 24)


def at_samples(signal: Floats, weights: tuple[float, float]) -> Floats:
    """Signal that is held from sample to sample, as it acts at the samples."""
    near, far = weights
    padded = np.concatenate(([signal[0]] * 2, signal, [signal[-1]]))
    return near * (padded[1:-2] + padded[2:-1]) + far * (padded[:-3] + padded[3:])


def on_time(signal: Floats, dt: float, delay: float) -> Floats:
    """Return a signal with a delay undone, by cubic interpolation."""
    time = dt * np.arange(signal.size)
    return CubicSpline(time, signal)(np.minimum(time + delay, time[-1]))
