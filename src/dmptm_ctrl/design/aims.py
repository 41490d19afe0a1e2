"""What a loop is to do, and how far from it a controller stays."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dmptm_ctrl.arguments import refusing
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, Duty, usual_duty
from dmptm_ctrl.simulate.any_model import AnyModel, at_rest, loop_parts, speed_read, steps_of
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import RigModel

LOST = 1e3  # deg/s, error of a run that left the finite numbers
GYRO = 0.05 * DEG  # rad/s rms, noise of the speed reading the loop is tuned with
HIGHEST_HZ = 60.0
EVERY = 4  # samples, one of which counts


@refusing
@dataclass(frozen=True)
class Aims:
    """What the loop is to do.

    Attributes
    ----------
    phase_margin_deg, gain_margin_db : float
        Of the linear loop about a turn under preload, with all delays.
    highest_hz : float
        Bandwidth not to exceed.
    limit : float [V]
        Of each motor.
    acceleration : float [rad/s²]
        Largest that a setpoint asks for; steps are fed forward with this.
    duty : Duty
        ``dmptm_ctrl.design.duty.Duty(reference, sample_time, settling)``: the setpoint over time
        [rad/s], its samples [s], and how long at the start does not count [s]. By default 9 s of
        sines, ramps and rests.
    noise : float [rad/s]
        Standard deviation of the speed reading.
    notch : bool
        Whether the search may add a notch; it then also tries more distances.

    Examples
    --------
    >>> dm.Aims(phase_margin_deg=60.0, limit=5.0).limit
    5.0
    """

    phase_margin_deg: float = 55.0
    gain_margin_db: float = 9.0
    highest_hz: float = HIGHEST_HZ
    limit: float = 10.0
    acceleration: float = 20.0
    duty: Duty = field(default_factory=usual_duty)
    noise: float = GYRO
    notch: bool = False

    def linear(self) -> dict[str, Any]:
        """Return what a linear design asks for."""
        names = ("phase_margin_deg", "gain_margin_db", "highest_hz")
        return {**{n: getattr(self, n) for n in names}, "sample_time": self.duty.sample_time}


def tracking(
    controller: Controller,
    plants: Sequence[AnyModel],
    aims: Aims,
    *,
    seed: int = 0,
    jobs: int = -1,
) -> tuple[Floats, Floats]:
    """Run a controller over the duty on many plants; two arrays, (plants,) each.

    RMS of setpoint minus true speed after the settling [deg/s, of a rig its sensor's SI unit], and
    the largest signal of an input [V, or its SI unit].
    """
    duty, law = aims.duty, controller.law()
    rng = np.random.default_rng(seed)
    noise = aims.noise * rng.standard_normal(duty.reference.size)
    inputs = plants[0].plant().input_body.size
    _, sensor = loop_parts(controller.model, controller.input, controller.sensor)
    common = Common(
        duty.sample_time, max(steps_of(plant, duty.sample_time) for plant in plants),
        duty.reference.size, np.zeros((1, inputs, 0)), duty.reference[None],
        noise[None], (f"reading{sensor}",), EVERY, tuple(f"signal{j}" for j in range(inputs)),
    )  # fmt: skip
    starts = [at_rest(plant) for plant in plants]
    runs, statistics = run_many(plants, starts, common, [law] * len(plants), jobs=jobs)
    first = round(duty.settling / duty.sample_time / EVERY)
    each = zip(plants, runs, strict=True)
    miss = np.array([missed(plant, duty, run[0], EVERY, sensor) for plant, run in each])
    unit = error_unit(controller)[1]
    errors = np.sqrt(np.mean((miss[:, first:] / unit) ** 2, axis=1))
    volts = np.array([np.maximum(-s[0], s[1]).max() for s in statistics])
    return np.where(np.isfinite(errors), np.minimum(errors, LOST), LOST), volts


def error_unit(controller: Controller) -> tuple[str, float]:
    """Return the unit in which tracking errors are given, and its size in SI."""
    if isinstance(controller.model, RigModel):
        return f"{controller.units[1]}/s", 1.0
    return "deg/s", DEG


def missed(model: AnyModel, duty: Duty, reading: Floats, every: int = 1, sensor: int = 1) -> Floats:
    """Return true speed minus setpoint [rad/s] at each sample of a simulated sensor.

    A reading that is late is compared with the setpoint of its time. The `reading` (m,) [rad/s, or
    rad of a position sensor] is without noise, one of `every` samples.
    """
    speed = speed_read(model, reading, every * duty.sample_time, sensor)
    then = duty.time[::every] - float(model.plant().sensor_delay[sensor])
    return np.asarray(speed - np.interp(then, duty.time, duty.reference))
