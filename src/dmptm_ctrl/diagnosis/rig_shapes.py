"""What effects change of the balances of a rig, and shapes at which they explain most."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.diagnosis.rig_tangent import Tangent
from dmptm_ctrl.identify.by_torque import by_torque
from dmptm_ctrl.identify.forces import measured_motion, unfolded
from dmptm_ctrl.identify.free_parameters import on_slide, scales_of
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.measured_motion import FEWEST_ROWS, Motion
from dmptm_ctrl.identify.rig_fit import RigFit, residuals
from dmptm_ctrl.simulate.along import acting_of, friction_along, torque_along
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

MAX_ORDER = 400  # per turn
SCREENED = 6  # orders and places of a screening that are looked at closely
BAND = 2.0**0.25  # of orders that are seen on the same rows
LEAST_PERIODS = 3.0  # in the travel, or a spring or a slope would do as well
WIDTHS = (0.003, 0.01, 0.03)  # local spots, of the travel
SPOT_BINS = 2048
SMALL = 0.01  # of the wind-up of a mesh or of its stiffness: a difference step


def motion_of(
    balance: Balance, motion: Motion, model: RigModel, body: str
) -> tuple[Floats, Floats]:
    """Return angle and speed of a body along a log, (n,) each.

    One that nothing measures moves nearly as if no link were twisted.
    """
    measured, _ = measured_motion(model, balance, motion)
    layout, group = model.layout, model.layout.coordinate[body]
    seen = group if group in measured else next(iter(measured))
    reach, (angle, speed, _) = untwisted(model.plant()), measured[seen]
    by = layout.ratio[body] * reach[group] / reach[seen]
    return by * angle, by * speed


def unit_columns(
    fit: RigFit, balance: Balance, shape: Placed, names: tuple[str, ...]
) -> list[Floats]:
    """Derivative of the residual by each amplitude, per log (equations, rows, p).

    `shape` is the effect at its place, without amplitudes.
    """
    entry, body = PLACED_CATALOGUE[shape.name], shape.on
    if entry.place == "link":
        return _mesh_columns(fit, balance, shape, names)

    def torques(motion: Motion, theta: Floats, omega: Floats) -> Floats:
        load = np.zeros_like(theta)  # what goes with it is tried at a finite size
        columns = []
        for name in names:
            acting = [acting_of(_sized(shape, name, 1.0))]
            if entry.site == "friction":
                _, added = friction_along(acting, theta, omega, motion.time, load)
                columns.append(_against(added, omega, motion))
            else:
                columns.append(torque_along(acting, load, theta, omega, motion.time))
        return np.asarray(unfolded(shape, omega, motion) * np.array(columns))

    return _body_columns(fit, balance, body, torques)


def friction_columns(
    fit: RigFit, balance: Balance, body: str, level: Callable[[Floats], Floats]
) -> list[Floats]:
    """The same by the amplitude of friction that depends on the angle by `level` alone."""
    return _body_columns(
        fit, balance, body, lambda m, theta, omega: _against(level(theta), omega, m)[None]
    )


def _against(friction: Floats, omega: Floats, motion: Motion) -> Floats:
    """Torque of a friction while a body moves, (n,)."""
    slow = motion.rest_share * np.abs(omega).max(initial=0.0)
    return np.asarray(-np.sign(omega) * friction * (np.abs(omega) > slow))


def _body_columns(
    fit: RigFit,
    balance: Balance,
    body: str,
    torques: Callable[[Motion, Floats, Floats], Floats],
) -> list[Floats]:
    """Change of the residual by torques on a body, (p, n) of its angle and speed per log."""
    model = fit.model
    group, ratio = model.layout.coordinate[body], model.layout.ratio[body]
    stiffness = {name: model.value(f"link.{name}.stiffness") for name in balance.teeth}
    parts = []
    for motion in balance.motions:
        torque = ratio * torques(motion, *motion_of(balance, motion, model, body))
        column = by_torque(model, balance, motion, group, torque, stiffness)
        parts.append(np.moveaxis(column, 1, 2))
    return parts


def _mesh_columns(
    fit: RigFit, balance: Balance, shape: Placed, names: tuple[str, ...]
) -> list[Floats]:
    """The same on a link, by differences: bodies that nothing measures move with it."""
    here = balance is fit.likelihood.balance and shape.key not in {e.key for e in fit.model.effects}
    bare = fit.state.without([shape.key])
    stiffness = bare.model.value(f"link.{shape.on}.stiffness")
    wind = scales_of(balance).force / stiffness
    units = {p.name: p.unit for p in PLACED_CATALOGUE[shape.name].keep}
    left, columns = fit.left if here else residuals(bare, balance)[0], []
    for name in names:
        step = SMALL * (wind if units[name] == "rad" else stiffness)
        model = bare.model.with_effect(_sized(shape, name, step))
        moved, _ = residuals(replace(bare, model=model), balance)
        columns.append([(m - e) / step for m, e in zip(moved, left, strict=True)])
    return [np.stack(parts, axis=-1) for parts in zip(*columns, strict=True)]


def _sized(shape: Placed, name: str, amplitude: float) -> Placed:
    return shape._replace(values={**shape.values, name: amplitude})


def rows_of(tangent: Tangent, log: int, body: str) -> tuple[Floats, Floats, Floats]:
    """Angle, speed and weighted residual at the rows of a log's first equation that count."""
    motion, model = tangent.balance.motions[log], tangent.fit.model
    use = motion.moving
    angle, speed = (
        np.interp(motion.rows[use], motion.time, along)
        for along in motion_of(tangent.balance, motion, model, body)
    )
    return angle, speed, tangent.fit.left[log][0][use]


class Travel(NamedTuple):
    """What a residual says of friction along the way of a body.

    Attributes
    ----------
    angle, excess : (rows,) arrays
        Of the rows of all logs; how much more than the model's it is.
    low, span : float
        Where the way begins, and how long it is: one turn at most.
    turns : bool
        Whether it is closed.
    """

    angle: Floats
    excess: Floats
    low: float
    span: float
    turns: bool

    def bins(self, angle: Floats, count: int) -> NDArray[np.int64]:
        """Which of so many equal parts of the way each angle is in."""
        along = np.mod(angle, self.span) if self.turns else angle
        return np.clip(((along - self.low) / self.span * count).astype(int), 0, count - 1)


def travel_of(tangent: Tangent, body: str) -> Travel | None:
    """Return the way of a body; None where it does not move."""
    logs = [rows_of(tangent, k, body) for k in range(len(tangent.balance.motions))]
    angle, speed, left = (np.concatenate(x) for x in zip(*logs, strict=True))
    if angle.size == 0 or np.ptp(angle) == 0:
        return None
    low, span = float(angle.min()), float(np.ptp(angle))
    turns = not on_slide(tangent.fit.model, body) and span > 2 * np.pi
    if turns:
        low, span = 0.0, 2 * np.pi
    return Travel(angle, np.sign(speed) * left, low, span, turns)


def spots(tangent: Tangent, body: str) -> list[dict[str, float]]:
    """Places at which friction is most unlike that around, by the residual over the angle."""
    travel = travel_of(tangent, body)
    if travel is None:
        return []
    low, span = travel.low, travel.span
    place = travel.bins(travel.angle, SPOT_BINS)
    push = np.bincount(place, -travel.excess, SPOT_BINS)
    count = np.bincount(place, minlength=SPOT_BINS).astype(float)
    found: list[tuple[float, dict[str, float]]] = []
    for width in WIDTHS:
        half = int(3 * width * SPOT_BINS)
        bump = np.exp(-0.5 * (np.arange(-half, half + 1) / (width * SPOT_BINS)) ** 2)
        along = np.convolve(push, bump, "same")
        gain = along**2 / np.maximum(np.convolve(count, bump**2, "same"), 1.0)
        gain[along > 0] = 0.0  # a spot holds
        k = int(np.argmax(gain))
        found.append((gain[k], {"place": low + span * (k + 0.5) / SPOT_BINS,
                                "width": width * span}))  # fmt: skip
    return [shape for _, shape in sorted(found, key=lambda f: -f[0])]


def orders(tangent: Tangent, body: str, pushed: Sequence[Floats] | None = None) -> list[float]:
    """Orders at which the residual repeats with the angle, by FFT over the angle.

    `pushed` is what a constant amplitude changes of all equations, (equations, rows, 1) per log;
    by default of the first, everywhere alike. In the first, mesh torques cancel.
    """
    balance, slide = tangent.balance, on_slide(tangent.fit.model, body)
    logs = [rows_of(tangent, k, body) for k in range(len(balance.motions))]
    if pushed is not None:
        weights = tangent.fit.likelihood.scales(tangent.fit.left) ** -2.0
        weights[0] *= len(weights) == 1
        each = weights.T[list(balance.log_of)]
        rows = zip(logs, tangent.fit.left, pushed, balance.motions, each, strict=True)
        logs = [
            (
                angle,
                speed,
                np.einsum("er,er,e->r", own, push[..., 0], by)[motion.moving],
            )
            for (angle, speed, _), own, push, motion, by in rows
        ]
    span = max((float(np.ptp(a)) for a, _, _ in logs if a.size), default=0.0)
    if span <= 0:
        return []
    bins = 16384
    length = 2 * span if slide else 2 * np.pi
    counts = 2 * np.pi * np.arange(bins // 2 + 1) / length
    lowest = LEAST_PERIODS * 2 * np.pi / span
    lowest = lowest if slide else max(lowest, 2.0)
    highest = counts[-1] / 2 if slide else MAX_ORDER
    power = np.zeros(counts.size)
    for (angle, speed, left), motion in zip(logs, balance.motions, strict=True):
        place = (angle - angle.min(initial=0.0)) if slide else np.mod(angle, length)
        bins_of = (place / length * bins).astype(int) % bins
        low = lowest
        while low < highest:  # band by band, each where it passes the filter of the balance
            band = (counts >= low) & (counts < BAND * low)
            slow = np.abs(speed) < 2 * np.pi * motion.bandwidth / low
            low *= BAND
            if (seen := int(slow.sum())) < FEWEST_ROWS:
                break
            sums = np.bincount(bins_of[slow], left[slow], bins)
            power[band] += np.abs(np.fft.rfft(sums)[band]) ** 2 / seen
    peak = np.zeros(power.size, bool)
    peak[1:-1] = (power[1:-1] >= power[:-2]) & (power[1:-1] >= power[2:])
    usable = np.flatnonzero(peak & (counts >= lowest) & (counts <= highest))
    return [float(counts[i]) for i in usable[np.argsort(-power[usable])][:SCREENED]]


def frequencies(tangent: Tangent) -> list[float]:
    """Frequencies at which the residual repeats with the clock."""
    motions = tangent.balance.motions
    grid = np.linspace(0.0, 0.8 * tangent.balance.bandwidth, 2000)[1:]
    total = np.zeros(grid.size)
    for left, motion in zip(tangent.fit.left, motions, strict=True):
        size = 4 * left.shape[1]
        if size == 0:
            continue
        f = np.fft.rfftfreq(size, motion.dt * motion.step)
        total += np.interp(grid, f, np.abs(np.fft.rfft(left[0] * motion.moving, size)) ** 2)
    longest = tangent.balance.longest
    top = float(grid[int(np.argmax(total))])
    return [max(top + d / longest, 0.1 / longest) for d in (-0.4, -0.2, 0.0, 0.2, 0.4)]
