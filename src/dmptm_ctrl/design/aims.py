"""What a loop is to do, and how far from it a controller stays."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from dmptm_ctrl.arguments import refusing
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, Duty, usual_duty
from dmptm_ctrl.simulate.batch import simulate_batch
from dmptm_ctrl.simulate.compiled import rest
from dmptm_ctrl.simulate.dual import dual_plant
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts

LOST = 1e3  # deg/s, error of a run that left the finite numbers
GYRO = 0.05 * DEG  # rad/s rms, noise of the speed reading the loop is tuned with
HIGHEST_HZ = 60.0
EVERY = 4  # samples, one of which is judged


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
    plants: Sequence[Model],
    aims: Aims,
    *,
    seed: int = 0,
    n_jobs: int = -1,
) -> tuple[Floats, Floats]:
    """Run a controller over the duty on many plants.

    Returns
    -------
    errors : (plants,) array [deg/s]
        RMS of setpoint minus true speed, after the settling.
    volts : (plants,) array [V]
        Largest voltage of either motor.
    """
    duty = aims.duty
    rng = np.random.default_rng(seed)
    noise = aims.noise * rng.standard_normal(duty.reference.size)
    starts = np.array([rest(plant, 0.0) for plant in plants])
    runs = simulate_batch(
        plants,
        duty.time,
        duty.reference,
        starts,
        loop=controller.law(),
        noise=noise,
        outputs=["omega_L"],
        every=EVERY,
        n_jobs=n_jobs,
    )
    first = round(duty.settling / duty.sample_time / EVERY)
    miss = np.array(
        [
            missed(plant, duty, reading, EVERY)
            for plant, reading in zip(plants, runs.outputs[:, 0], strict=True)
        ]
    )
    errors = np.sqrt(np.mean((miss[:, first:] / DEG) ** 2, axis=1))
    volts = np.maximum(-runs.least, runs.greatest)[:, -2:].max(axis=1)
    return np.where(np.isfinite(errors), np.minimum(errors, LOST), LOST), volts


def missed(model: Model, duty: Duty, reading: Floats, every: int = 1) -> Floats:
    """Return true speed minus setpoint [rad/s] at each sample of a simulated speed sensor.

    A reading that is late is compared with the setpoint of its time, and one with a wrong gain
    is put right: a loop is to move the load, not the sensor.

    Parameters
    ----------
    model : Model
        That gave the reading.
    duty : Duty
    reading : (m,) array [rad/s]
        Without noise, one of `every` samples.
    every : int
    """
    plant = dual_plant(model.arrays())
    gain = Parts(plant).reading(1, 0.0, 1.0, 0.0)
    then = duty.time[::every] - float(plant.sensor_delay[1])
    return np.asarray(reading / gain - np.interp(then, duty.time, duty.reference))
