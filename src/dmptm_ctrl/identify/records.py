"""Logs prepared for fitting: arrays, masks and the residual of a simulated run."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.observer import observer_gains
from dmptm_ctrl.simulate.parts import Parts

SHORT_BLOCK = 4  # samples
RING_COUNT = 2 * np.pi / 2**18  # rad
KNOWN_TO = 4.0 * RING_COUNT  # rad, to which an error of the ring encoder is known
ROUNDING = 1e-9  # rad, of angles in double precision; no encoder has so fine a step
INVERSIONS = 8  # of a sensor whose error is far smaller than the angle it varies over


@dataclass(frozen=True, eq=False)
class Record:
    """One log as the fit needs it. SI units.

    Attributes
    ----------
    u : (2, n) array [V]
    theta, omega : (n,) arrays [rad, rad/s]
        Ring-gear readings.
    twist : (n, 2) array [rad] or None
        Measured z = θm/N1 − N2 θL per side, where the log has motor encoders.
    x0 : (6,) array
        State at rest at the first reading.
    """

    name: str
    dt: float
    u: Floats
    theta: Floats
    omega: Floats
    twist: Floats | None
    x0: Floats
    time: Floats

    @property
    def seconds(self) -> float:
        """How long the log lasts [s]."""
        return self.omega.size * self.dt


def record(log: Log, drive: Drive) -> Record:
    """Prepare a log of the dual-motor rig.

    Raises
    ------
    LogError
        A channel that the fit needs is missing.
    """
    dt = log.sample_time
    theta, omega = log["theta_L"], log["omega_L"]
    u = np.ascontiguousarray([log["u_left"], log["u_right"]])
    n1, n2 = drive["N_1"], drive["N_2"]
    twist, motors = None, None
    if log.has("theta_ml", "theta_mr"):
        motors = np.column_stack([log["theta_ml"], log["theta_mr"]])
        twist = motors / n1 - n2 * theta[:, None]
    x0 = _resting(Model(drive), theta[0], motors, RING_COUNT)
    return Record(log.name, dt, u, theta, omega, twist, x0, log.time)


def true_angle(model: Model, reading: float) -> float:
    """Angle [rad] at which the ring gear rests where its sensor says `reading` [rad]."""
    parts, angle = Parts(model.plant()), reading
    for _ in range(INVERSIONS):
        angle += reading - parts.reading(0, angle, 0.0, 0.0)
    return angle


def started(rec: Record, model: Model) -> Record:
    """Move the start of a record to where the ring gear is, if its sensor says another angle."""
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    reading = float(rec.theta[0])
    motors = None if rec.twist is None else n1 * (rec.twist + n2 * rec.theta[:, None])
    return replace(rec, x0=_resting(model, true_angle(model, reading), motors, KNOWN_TO))


def _resting(model: Model, angle: float, motors: Floats | None, known_to: float) -> Floats:
    """State at rest, mid-gap unless the motors' angles [rad] say otherwise by more than is known.

    The rounding of the encoders, `known_to` [rad] at the ring gear, is worth many a bounce. Of
    what turns with the motors the run depends on more digits of the angle than the ring encoder
    has: where both motors say the same angle, it is theirs.
    """
    if motors is None:
        return rest(model, angle)
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    begun = motors[0]
    if np.abs(begun / n1 - n2 * angle).max() > n2 * known_to:
        return rest(model, angle, motors=begun)
    between = np.diff(np.unique(motors[:, 0]))
    count = float(np.min(between, where=between > ROUNDING, initial=np.inf))
    alike = abs(begun[0] - begun[1]) < 1.5 * count and count < n1 * n2 * RING_COUNT
    return rest(model, float(begun.mean()) / (n1 * n2) if alike else angle)


def records(logs: Iterable[Log], drive: Drive) -> tuple[Record, ...]:
    """Prepare several logs."""
    return tuple(record(log, drive) for log in logs)


def block_mean(signal: Floats, block: int) -> Floats:
    """Means over consecutive blocks along the last axis; what does not fill one is dropped."""
    n = signal.shape[-1] // block
    if block <= SHORT_BLOCK:  # few of them: as many sums of whole rows are faster
        parts = (signal[..., i : n * block : block] for i in range(block))
        return np.asarray(sum(parts) / block)
    return signal[..., : n * block].reshape(*signal.shape[:-1], n, block).mean(-1)


def predict(rec: Record, model: Model, bandwidth_hz: float = 0.0) -> Floats:
    """Run the model on a record; with a bandwidth, kept near the measured angle by a slow observer.

    Returns
    -------
    (n, 8) array
        Columns of `compiled.OUTPUTS`.
    """
    observer = observer_gains(bandwidth_hz, rec.dt) if bandwidth_hz > 0 else None
    run = model.over(rec.seconds)
    return march(run, rec.u, rec.x0, rec.dt, observer=observer, measured=rec.theta)
