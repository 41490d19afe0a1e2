"""Sensors against each other: what needs no dynamics is settled first.

The speed sensor and the ring encoder see one motion, so
ω(t) = (1 + s) θ̇(t − T) + b and an eccentric disc adds terms of order 1.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis.report import NamedEffect, estimate
from dmptm_ctrl.drive.rig import Rig, Sensor
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from dmptm_ctrl.effects.sensor_delay import SENSOR_DELAY
from dmptm_ctrl.effects.sensor_gain import SENSOR_GAIN
from dmptm_ctrl.identify.fit import Fit
from dmptm_ctrl.identify.measured_motion import on_time
from dmptm_ctrl.identify.records import Record, block_mean
from dmptm_ctrl.parallel import small_matrices
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.rig_model import Placed

# The two sensors settle it without a model; what is left is that both are wrong alike.
SENSOR_PROBABILITY = 0.99
WINDOW_SECONDS = 0.05  # span of the derivative filter of the encoder
BLOCK_SECONDS = 0.05  # blocks whose errors count as independent
SIGNIFICANT = 4.5  # standard errors
ROUNDS = 3  # of the regression: a delay is found to 1 % in the first
NAMES = (
    (SENSOR_GAIN.name, "error"),
    (SENSOR_DELAY.name, "delay"),
    (ENCODER_ECCENTRICITY.name, "cosine"),
    (ENCODER_ECCENTRICITY.name, "sine"),
)


class Reading(NamedTuple):
    """A position [rad or m] and a speed of one motion, and their sample time [s]."""

    dt: float
    theta: Floats
    omega: Floats


@dataclass(frozen=True, eq=False)
class SensorFault:
    """What a sensor does to its reading.

    Attributes
    ----------
    placed : Placed
        The effect, with its values.
    errors : dict of str to float
        Standard errors.
    """

    placed: Placed
    errors: dict[str, float]


@dataclass(frozen=True)
class SensorCheck:
    """Estimates of the sensor effects, SI, with standard errors."""

    values: dict[str, dict[str, float]]
    errors: dict[str, dict[str, float]]

    def significant(self, name: str) -> bool:
        """Whether the disagreement is beyond doubt and beyond what matters."""
        size = np.hypot.reduce(list(self.values[name].values()))
        error = max(self.errors[name].values())
        return bool(size > SIGNIFICANT * error and size > CATALOGUE[name].matters)


def cross_check(records: Sequence[Reading | Record], *, turns: bool = True) -> SensorCheck:
    """Regress the speed reading on the encoder's derivative over all records.

    A delay is linear only while it is short: the reading is moved by what was found, and
    regressed again. Of what does not turn, no encoder is eccentric.
    """
    late = 0.0
    for _ in range(ROUNDS):
        beta, se = regressed(records, late, turns)
        late += beta[1]
    beta[1] = late
    values: dict[str, dict[str, float]] = {}
    errors: dict[str, dict[str, float]] = {}
    for (effect, name), b, e in zip(NAMES, beta, se, strict=True):
        values.setdefault(effect, {})[name] = float(b)
        errors.setdefault(effect, {})[name] = float(e)
    return SensorCheck(values, errors)


def regressed(
    records: Sequence[Reading | Record], late: float, turns: bool = True
) -> tuple[Floats, Floats]:
    """Estimates of :data:`NAMES` and their standard errors, the delay beyond `late` [s]."""
    left, right = [], []
    for rec in records:
        span = max(5, 2 * round(0.5 * WINDOW_SECONDS / rec.dt) + 1)
        if rec.theta.size <= 3 * span:
            continue
        time = rec.dt * np.arange(rec.omega.size)
        mean, first, second = _one_filter(span, rec.dt)
        speed = np.convolve(np.interp(time + late, time, rec.omega), mean, "same")
        rate, change = (np.convolve(rec.theta, kernel, "same") for kernel in (first, second))
        rows = np.array(
            [
                speed - rate,
                rate,
                -change,
                -turns * np.convolve(np.cos(rec.theta), first, "same"),
                -turns * np.convolve(np.sin(rec.theta), first, "same"),
                np.ones_like(rate),
            ]
        )[:, span:-span]
        blocks = block_mean(rows, max(1, round(BLOCK_SECONDS / rec.dt)))
        left.append(blocks[0])
        right.append(blocks[1:])
    y, x = np.concatenate(left), np.concatenate(right, axis=1).T
    # Reversals ring faster than the filter passes: they count less.
    weight = np.ones_like(y)
    for _ in range(5):
        beta, *_ = np.linalg.lstsq(x * weight[:, None], y * weight, rcond=None)
        miss = y - x @ beta
        scale = max(1.4826 * float(np.median(np.abs(miss))), 1e-12)
        weight = np.sqrt(1.0 / (1.0 + (miss / (2.0 * scale)) ** 2))
    covariance = scale**2 * np.linalg.pinv((x * weight[:, None]).T @ (x * weight[:, None]))
    return beta[: len(NAMES)], np.sqrt(np.diag(covariance))[: len(NAMES)]


def _one_filter(span: int, dt: float) -> tuple[Floats, Floats, Floats]:
    """Weights of a moving mean, cos⁴ over `span` samples, and of its first two derivatives.

    Through one filter both sensors read alike what is faster than it passes.
    """
    t = dt * np.arange(-(span // 2), span // 2 + 1)
    w = 2.0 * np.pi / ((span + 1) * dt)
    cos, sin = np.cos(w * t), np.sin(w * t)
    mean, first, second = (1 + cos) ** 2, -(1 + cos) * sin, -(cos + np.cos(2 * w * t))
    # right for a constant, a ramp and a parabola
    return mean / mean.sum(), -first / (first @ t), (second - second.mean()) * 2.0 / (second @ t**2)


def with_sensors(model: Model, sensors: SensorCheck) -> Model:
    """Add the sensor effects that the cross-check leaves no doubt about."""
    for name in sensors.values:
        if sensors.significant(name):
            model = model.with_effect(name, **sensors.values[name])
    return model


def sensor_effect(name: str, sensors: SensorCheck, final: Fit, share: float) -> NamedEffect:
    """Describe a sensor effect found by the cross-check, with the values of the model."""
    effect = CATALOGUE[name]
    parameters = {}
    for p in effect.parameters:
        try:
            value, se = final.value(name, p.name)
        except KeyError:  # only the two sensors show it
            value, se = sensors.values[name][p.name], sensors.errors[name][p.name]
        parameters[p.name] = estimate(value, se, p.unit)
    largest = max(
        abs(v) / max(sensors.errors[name][k], 1e-300) for k, v in sensors.values[name].items()
    )
    return NamedEffect(
        name,
        effect.location,
        SENSOR_PROBABILITY,
        parameters,
        (),
        f"Speed sensor and ring encoder disagree by it by {largest:.0f} standard errors, "
        "whatever the drive does.",
        share,
    )


@small_matrices
def sensor_faults(rig: Rig, logs: Sequence[Log]) -> list[SensorFault]:
    """Compare every speed sensor with the first position sensor that shows the same motion.

    A gain and a delay are put down to the speed sensor, an eccentricity to the encoder.
    """
    found: dict[str, SensorFault] = {}
    for speed in (s for s in rig.sensors if s.measures == "speed"):
        turns = rig.turns(speed.body, rigidly=True)
        angle = next((s for s in rig.sensors if s.measures == "position" and s.body in turns), None)
        if angle is None:
            continue
        factor = turns[angle.body]  # of the encoder's motion per that of the speed sensor
        readings = [
            Reading(log.sample_time, log[angle.channel], log[speed.channel] * factor)
            for log in logs
        ]
        check = cross_check(readings, turns=not rig.body(angle.body).linear)
        for fault in _of(check, angle, speed):
            found.setdefault(fault.placed.key, fault)
    return list(found.values())


def _of(check: SensorCheck, angle: Sensor, speed: Sensor) -> list[SensorFault]:
    faults = []
    for name in check.values:
        if not check.significant(name):
            continue
        if name == SENSOR_DELAY.name and check.values[name]["delay"] < 0:
            continue  # no sensor reads ahead
        on = angle if name == ENCODER_ECCENTRICITY.name else speed
        faults.append(SensorFault(Placed(name, on.name, check.values[name]), check.errors[name]))
    return faults


def put_right(rig: Rig, log: Log, effects: Iterable[Placed]) -> Log:
    """Return a log as sensors without these effects would have read it."""
    channels = dict(log.channels)
    sensors = {s.name: s for s in rig.sensors}
    for effect in effects:
        name, values = effect.name, effect.values
        channel = sensors[effect.on].channel
        signal = channels[channel]
        if name == SENSOR_GAIN.name:
            signal = signal / (1.0 + values["error"])
        elif name == SENSOR_DELAY.name:
            signal = on_time(signal, log.sample_time, values["delay"])
        else:
            c, s = values["cosine"], values["sine"]
            signal = signal - c * np.cos(signal) - s * np.sin(signal)
        channels[channel] = signal
    return replace(log, channels=channels)
