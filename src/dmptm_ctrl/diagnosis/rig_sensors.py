"""Sensors of one motion against each other, before any dynamics: which reads wrongly."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dmptm_ctrl.diagnosis.sensors import SensorCheck, cross_check
from dmptm_ctrl.drive.rig import Rig, Sensor, is_known
from dmptm_ctrl.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from dmptm_ctrl.effects.sensor_delay import SENSOR_DELAY
from dmptm_ctrl.effects.sensor_gain import SENSOR_GAIN
from dmptm_ctrl.identify.measured_motion import on_time
from dmptm_ctrl.parallel import small_matrices
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed


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


@dataclass(frozen=True, eq=False)
class _Reading:
    """A position and a speed of one motion, as the regression of sensors reads them."""

    dt: float
    theta: np.ndarray
    omega: np.ndarray


def together(rig: Rig, body: str) -> dict[str, float]:
    """Motion of each body that is rigidly tied to one, per motion of that one."""
    turns = {body: 1.0}
    for _ in rig.links:
        for link in (k for k in rig.links if k.rigid and is_known(k.ratio)):
            if link.first in turns:  # q_first = ratio · q_second
                turns.setdefault(link.second, turns[link.first] / link.ratio.value)
            elif link.second in turns:
                turns[link.first] = turns[link.second] * link.ratio.value
    return turns


@small_matrices
def sensor_faults(rig: Rig, logs: Sequence[Log]) -> list[SensorFault]:
    """Compare every speed sensor with the first position sensor that shows the same motion.

    A gain and a delay are put down to the speed sensor, an eccentricity to the encoder.
    """
    found: dict[str, SensorFault] = {}
    for speed in (s for s in rig.sensors if s.measures == "speed"):
        turns = together(rig, speed.body)
        angle = next((s for s in rig.sensors if s.measures == "position" and s.body in turns), None)
        if angle is None:
            continue
        factor = turns[angle.body]  # of the encoder's motion per that of the speed sensor
        readings = [
            _Reading(log.sample_time, log[angle.channel], log[speed.channel] * factor)
            for log in logs
        ]
        check = cross_check(readings, turns=not rig.body(angle.body).linear)
        for fault in _of(rig, check, angle, speed):
            found.setdefault(fault.placed.key, fault)
    return list(found.values())


def _of(rig: Rig, check: SensorCheck, angle: Sensor, speed: Sensor) -> list[SensorFault]:
    faults = []
    for name in check.values:
        if not check.significant(name):
            continue
        if name == SENSOR_DELAY.name and check.values[name]["delay"] < 0:
            continue  # no sensor reads ahead
        on = angle if name == ENCODER_ECCENTRICITY.name else speed
        faults.append(SensorFault(Placed(name, on.name, check.values[name]), check.errors[name]))
    return faults


def put_right(rig: Rig, log: Log, faults: Sequence[SensorFault]) -> Log:
    """Return a log as right sensors would have read it."""
    channels = dict(log.channels)
    sensors = {s.name: s for s in rig.sensors}
    for fault in faults:
        name, values = fault.placed.name, fault.placed.values
        channel = sensors[fault.placed.on].channel
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
