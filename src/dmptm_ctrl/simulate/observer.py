"""Runs corrected by what sensors measured: each sample moves the state by what was missed.

With ``leak`` 1 it is Luenberger's observer: the miss of a sample moves the state and is
forgotten. With less a part of it stays: the coordinates are where the sensor says, so that
what depends on an angle acts at the right one, and readings show how a run would drift that
is pulled back by the share ``leak`` of its miss a sample.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.simulate.plant import Floats, Ints, Plant, untwisted

FASTEST = 0.5  # decay of an observer a sample; from 2 on its gains no longer damp


class Observer(NamedTuple):
    """How a run of a plant follows measurements of m sensors."""

    sensors: Ints
    # (2 coordinates, m): what a miss adds to the coordinates and, where they move, to their speeds;
    # a coordinate at rest stays at rest
    gains: Floats
    leak: Floats  # share of a miss that is forgotten by the next sample, 0 to 1

    def shown(self, plant: Plant) -> Floats:
        """What of a lead the readings do not show, (sensors, m)."""
        if not self.sensors.size:
            return self.gains
        at = plant.body_coordinate[plant.sensor_body]
        ratio = np.where(plant.sensor_speed > 0, 0.0, plant.body_ratio[plant.sensor_body])
        return ratio[:, None] * self.gains[at]


NO_OBSERVER = Observer(np.zeros(0, np.int64), np.zeros((0, 0)), np.zeros(0))


def rigid_observer(plant: Plant, sensor: int, gains: Sequence[float]) -> Observer:
    """Return the observer that leads the rigid motion of a plant by one sensor.

    `gains` per sample are as of :func:`observer_gains`. A sensor of speed moves the speed by the
    first of them and forgets each miss.
    """
    body = int(plant.sensor_body[sensor])
    mode = untwisted(plant, int(plant.body_coordinate[body])) / plant.body_ratio[body]
    angle, speed = gains
    if plant.sensor_speed[sensor] > 0:
        both = np.concatenate([0.0 * mode, angle * mode])[:, None]
        return Observer(np.array([sensor]), both, np.ones(1))
    both = np.concatenate([mode, speed * mode])[:, None]
    return Observer(np.array([sensor]), both, np.array([angle]))


def observer_gains(bandwidth_hz: float, dt: float) -> tuple[float, float]:
    """Return per-sample gains of a critically damped rigid-mode observer.

    Its bandwidth is lower where samples are too rare for it.
    """
    pole = min(2.0 * np.pi * bandwidth_hz * dt, FASTEST)
    return 2.0 * pole, pole**2 / dt
