"""What an error is, and when an effect is worth its name."""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.signal import csd, welch

from dmptm_ctrl.diagnosis.ladder_tries import Candidate
from dmptm_ctrl.identify.chain_fit import ChainFit
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.simulate.chain_model import Placed

Floats = NDArray[np.float64]

MIN_GAIN = 0.05  # share of the residual's square; less is not worth a name
MIN_SHARE = 0.5  # % of the driving torque; a smaller effect is of no interest
IN_BAND = 0.9  # of the bandwidth; a resonance must lie below
CLIPS = 1.05  # input over a saturation's limit that counts
CLIPPED = 0.02  # of the samples must be beyond the limit, and as many well inside
LOWEST_LEVEL = 0.2  # of the limit; smaller inputs say nothing about it
CLEAR = 2.0  # times the speed that a sensor does not tell from rest
CLEAR_DROP = 5.0  # of friction that falls towards rest: bodies that stick look so
OVERDAMPED = 0.5  # damping ratio from which there is no resonance to speak of
DRIVEN = 0.5  # of what a spring changes must be coherent with the drive
SEGMENTS = 8  # of a log, for a coherence
SHORTEST_SEGMENT = 16  # rows
EXOTIC_GAIN = 2.0  # times the gain that a plain effect must have, for those from here on in SIMPLE
FIRST_EXOTIC = "presliding"
SIMPLE = (  # the order in which engineers think of them
    *("coulomb_friction", "viscous_friction", "drive_offset", "friction_asymmetry"),
    *("stribeck_friction", "cogging", "unbalance", "shaft_compliance", "backlash"),
    *("drive_delay", "current_lag", "presliding", "quadratic_drag", "load_dependent_friction"),
    *("position_dependent_friction", "drive_dead_band", "drive_saturation", "cable_spring"),
    *("thermal_drift", "base_vibration"),
)


class Errors(NamedTuple):
    """Error of a balance of torques.

    Attributes
    ----------
    rmse : float [N·m or N, or the input's unit where the gain is unknown]
    percent : float
        100 · ‖residual‖/‖drive‖.
    fit_percent, pearson_r : float
        Of the torque that the model gives against the driving one.
    """

    rmse: float
    percent: float
    fit_percent: float
    pearson_r: float


def errors_of(left: Sequence[Floats], drive: Sequence[Floats]) -> Errors:
    """Errors of the first equation over logs together; rows at rest do not count."""
    e = np.concatenate([part[0] for part in left])
    f = np.concatenate(list(drive))
    use = f != 0
    e, f = e[use], f[use]
    if e.size == 0:
        return Errors(0.0, 0.0, 0.0, 0.0)
    rmse = float(np.sqrt(np.mean(e**2)))
    size = float(np.sqrt(np.mean(f**2)))
    spread = float(np.std(f))
    model = f - e
    both = spread * float(np.std(model))
    r = float(np.mean((f - f.mean()) * (model - model.mean())) / both) if both > 0 else 0.0
    return Errors(
        rmse,
        100.0 * rmse / size,
        100.0 * (1.0 - rmse / spread) if spread > 0 else 0.0,
        r,
    )


Outcome = tuple[Sequence[Floats], Sequence[Floats]]  # residual and drive per log


def gain_of(before: Outcome, after: Outcome) -> float:
    """Share of the residual's square that went, relative to the drive.

    Mean over the equations that both have: the first one does not see the torque between two
    bodies that are both measured.
    """
    count = min(before[0][0].shape[0], after[0][0].shape[0])
    old, new = (np.array([_power(left, drive, e) for e in range(count)])
                for left, drive in (before, after))  # fmt: skip
    left = np.divide(new, old, out=np.ones(count), where=old > 0)
    return 1.0 - float(np.mean(left))


def _power(left: Sequence[Floats], drive: Sequence[Floats], equation: int) -> float:
    total = sum(float(part[equation] @ part[equation]) for part in left)
    size = sum(float(part @ part) for part in drive)
    return total / size if size > 0 else inf


def least_gain(name: str) -> float:
    """Share of the residual's square that an effect must explain to be named."""
    return MIN_GAIN * (EXOTIC_GAIN if exotic(name) else 1.0)


def exotic(name: str) -> bool:
    """Whether an effect is a rare one."""
    return name not in SIMPLE or SIMPLE.index(name) >= SIMPLE.index(FIRST_EXOTIC)


def worthwhile(name: str, gain: float, before: Outcome, after: Outcome, least: float) -> bool:
    """Whether an effect explains enough, and of the whole balance as well.

    A gap acts between two bodies alone; that balance does not see it.
    """
    if gain < max(least, least_gain(name)):
        return False
    if name == "backlash":
        return True
    first = [([part[:1] for part in left], drive) for left, drive in (before, after)]
    return gain_of(*first) >= least_gain(name)


def plausible(candidate: Candidate, before: ChainFit, fit: ChainFit, logs: Balance) -> bool:
    """Whether a refitted effect is what its name says.

    A saturation clips more than the tips of the input. A resonance above the bandwidth is a delay
    or a filter by another name; what a spring changes must follow from the drive, or it only
    hides the noise of the acceleration.
    """
    effect = next(e for e in fit.model.effects if e.key == candidate.placed.key)
    if effect.name == "drive_saturation":
        return _clips(logs, effect.on, 1.0 / max(effect.values["inverse_limit"], 1e-300))
    if effect.name in ("presliding", "stribeck_friction"):
        return _seen_slow(effect, fit, logs)
    if effect.name != "shaft_compliance":
        return True
    layout, plant = fit.model.layout, fit.model.plant()
    k = layout.links.index(effect.key if effect.key in layout.links else effect.on)
    ratio, stiffness = plant.link_values[k, :2]
    near, far = (plant.inertia[plant.body_coordinate[b]] for b in plant.link_body[k])
    # a sensor on the driven side sees the antiresonance first
    square = stiffness * (ratio**2 / far + (1 / near if effect.far else 0.0))
    if square > (2 * np.pi * IN_BAND * logs.bandwidth) ** 2:
        return False
    if effect.values["damping_ratio"] > OVERDAMPED:
        return False
    changes = [b[0] - a[0] for b, a in zip(before.left, fit.left, strict=True)]
    return driven_share(changes, fit.drive) >= DRIVEN


def _clips(logs: Balance, source: str, limit: float) -> bool:
    """Whether a limit is passed for a while, and not always: then it would be a gain."""
    size = np.concatenate([np.abs(m.u[source]) for m in logs.motions])
    beyond = float(np.mean(size > CLIPS * limit))
    inside = float(np.mean((size > LOWEST_LEVEL * limit) & (size < limit / CLIPS)))
    return beyond >= CLIPPED and inside >= CLIPPED


def _seen_slow(effect: Placed, fit: ChainFit, logs: Balance) -> bool:
    """Whether what friction does at low speed is more than a sensor that cannot see it."""
    layout = fit.model.layout
    group, r = layout.coordinate[effect.on], abs(layout.ratio[effect.on])
    speeds = [
        r * m.unclear.get(p.name, 0.0) / abs(layout.ratio[layout.sensor_body[p.name]])
        for p in logs.points
        if layout.coordinate[layout.sensor_body[p.name]] == group
        for m in logs.motions
    ]
    unclear = float(np.median(speeds)) if speeds else 0.0
    if effect.name == "presliding":
        return effect.values["distance"] >= CLEAR * unclear / (2 * np.pi * logs.bandwidth)
    clear = CLEAR if effect.values["excess"] > 0 else CLEAR_DROP
    return effect.values["speed"] >= clear * unclear


def driven_share(changes: Sequence[Floats], drive: Sequence[Floats]) -> float:
    """Share of the power of signals that is coherent with the drive."""
    driven = total = 0.0
    for change, push in zip(changes, drive, strict=True):
        length = change.size // SEGMENTS
        if length < SHORTEST_SEGMENT:
            continue
        _, cross = csd(push, change, nperseg=length)
        _, one = welch(push, nperseg=length)
        _, two = welch(change, nperseg=length)
        driven += float(np.sum(np.abs(cross) ** 2 / np.maximum(one, 1e-300)))
        total += float(np.sum(two))
    return driven / total if total > 0 else 1.0


def rank(name: str) -> int:
    """Place in the order in which engineers think of effects; dead time and lag alike."""
    name = "drive_delay" if name == "current_lag" else name
    return SIMPLE.index(name) if name in SIMPLE else len(SIMPLE)
