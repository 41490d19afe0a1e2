"""A curve without a name as a lookup table in the model, so that the error falls even so."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.residual import Residual, residual
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import (
    ANGLE,
    BRAKING,
    CLOCK,
    DRAG,
    KNOTS,
    PATH,
    SPEED,
    TIME,
    TURN,
    VOLTAGE,
)
from dmptm_ctrl.effects.unknown_motor import BOTH, LEFT, RIGHT
from dmptm_ctrl.identify.balance import BalanceFit, columns, fit_balance, scatter
from dmptm_ctrl.identify.fit import Unknown, place
from dmptm_ctrl.identify.motion import Motion
from dmptm_ctrl.simulate.model import Floats, Model

TORQUE, FRICTION, VOLTS = "unknown_torque", "unknown_friction", "unknown_voltage"
MOTOR = "unknown_motor"
PRIOR_STEPS = 3.0  # of a knot, in steps of its parameter: where no log goes, it stays at zero
QUIET = 0.2  # of the largest knot of a period, below which nothing happens
HELD = 8.0  # fall of the loss on the held-out logs that a table must bring
# Tables that can stand for a curve of these variables; of others (a rate, a product) none can.
PLANS: dict[tuple[str, ...], tuple[tuple[str, float], ...]] = {
    ("theta_L",): ((FRICTION, ANGLE), (TORQUE, ANGLE)),
    ("theta_L", "omega_L"): ((TORQUE, DRAG),),
    ("theta_L", "u"): ((MOTOR, PATH),),
    ("theta_m", "u"): ((MOTOR, TURN),),
    ("omega_m", "u"): ((MOTOR, BRAKING),),
    ("omega_L",): ((TORQUE, SPEED),),
    ("u",): ((VOLTS, VOLTAGE),),
    ("time",): ((FRICTION, TIME), (TORQUE, TIME)),
    ("omega_L", "time"): ((FRICTION, TIME),),
}
CLOCKED = ((MOTOR, CLOCK),)  # for what comes at fixed intervals
ALONE = 1.1  # times what a table of both motors explains, from which one of one goes before it
NO_PERIOD = 1.0  # s, of a table that is not over the clock: any


@dataclass(frozen=True, eq=False)
class Tables:
    """Fitted lookup tables.

    Attributes
    ----------
    variables : tuple of str
        That they are of.
    names : tuple of str
        Entries of the catalogue.
    errors : mapping
        (entry, knot) → standard error.
    gain, held_gain : float
        Fall of the loss on fitted and held-out logs.
    beside, left : Residual
        Without and with the tables in the model.
    """

    variables: tuple[str, ...]
    names: tuple[str, ...]
    errors: dict[tuple[str, str], float]
    gain: float
    held_gain: float
    beside: Residual
    left: Residual

    @property
    def evidence(self) -> float:
        """Fall of the loss on all logs."""
        return self.gain + self.held_gain


def tabulate(
    left: Residual, variables: Sequence[str], jobs: int, *, period: float = 0.0
) -> Tables | None:
    """Fit tables over variables beside a model; None where they do not help.

    Parameters
    ----------
    variables : sequence of str
        Of the curve; of what comes at fixed intervals they are told here.
    period : float
        Of what comes at fixed intervals [s]; 0 if nothing does.
    """
    plan = CLOCKED if period > 0.0 else PLANS.get(tuple(variables))
    if plan is None:
        return None
    shapes = {}
    for name, variable in plan:
        low, high = (0.0, period) if period > 0.0 else ends(left.balance.motions, variable)
        shapes[name] = {"variable": variable, "low": low, "high": high}
        if name in (MOTOR, TORQUE):
            shapes[name]["period"] = period if period > 0.0 else NO_PERIOD
    if MOTOR in shapes:
        fitted = of_motors(left, shapes[MOTOR])
    else:
        fitted = tabled(left, shapes)
    if period > 0.0:
        fitted = better(left, [fitted, tabled(left, {TORQUE: shapes[MOTOR]})])
        fitted = better(left, [fitted, tabled(left, narrowed(fitted.model))])
    held = left.held_base - left.held_loss(fitted.model)
    if held < HELD:
        return None
    errors = np.sqrt(np.diag(fitted.covariance))
    own = {
        (k.effect, k.name): float(k.scale * e)
        for k, e in zip(fitted.unknowns, errors, strict=True)
        if k.effect is not None
    }
    # The knots are known as well as they can be; the simulator refits the rest.
    rest = residual(left.measured, fitted.model, unknowns=left.base.unknowns, jobs=jobs)
    gain = left.base.loss - fitted.loss
    names = tuple(name for name in fitted.model.effects if name not in left.base.model.effects)
    if period > 0.0:
        variables = ("time", "u") if MOTOR in names else ("time",)
    return Tables(tuple(variables), names, own, gain, held, left, rest)


def of_motors(left: Residual, shape: Mapping[str, float]) -> BalanceFit:
    """Fit a table of both motors, or of one alone if that explains clearly more.

    The motors turn together: what one of them does seems to be done by both, and the reverse.
    """
    both, *single = (
        tabled(left, {MOTOR: {**shape, "motors": motors}}) for motors in (BOTH, LEFT, RIGHT)
    )
    one = better(left, single)
    gains = [left.base.loss + left.held_base - total(left, fit) for fit in (both, one)]
    return one if gains[1] > ALONE * gains[0] else both


def total(left: Residual, fit: BalanceFit) -> float:
    """Loss on fitted and held-out logs together."""
    return fit.loss + left.held_loss(fit.model)


def better(left: Residual, fits: Sequence[BalanceFit]) -> BalanceFit:
    """Return the one that leaves least on fitted and held-out logs."""
    return min(fits, key=lambda one: total(left, one))


def narrowed(model: Model) -> dict[str, dict[str, float]]:
    """Shape of a table over the part of a period in which something happens."""
    name = MOTOR if MOTOR in model.effects else TORQUE
    values = model.effects[name]
    knots = np.abs([values[f"k{i}"] for i in range(KNOTS)])
    apart = values["period"] / (KNOTS - 1)
    # the longest quiet stretch, across the end of the period too, is left out
    loud = np.flatnonzero(knots > QUIET * knots.max())
    quiet = np.diff([*loud, loud[0] + KNOTS - 1])
    last = int(np.argmax(quiet))
    first = int(loud[(last + 1) % loud.size])
    low, length = apart * (first - 1), apart * (KNOTS + 1 - int(quiet[last]))
    shape = {key: x for key, x in values.items() if key in ("variable", "motors", "period")}
    return {name: {**shape, "low": low, "high": low + length}}


def tabled(left: Residual, shapes: Mapping[str, Mapping[str, float]]) -> BalanceFit:
    """Fit the knots of tables, and the drive beside them."""
    model, base = left.base.model, left.base
    knots: list[Unknown] = []
    for name, shape in shapes.items():
        model = model.with_effect(name, **shape, **{f"k{i}": 0.0 for i in range(KNOTS)})
        step = next(p for p in CATALOGUE[name].parameters if p.name == "k0")
        low, high = step.low / step.step, step.high / step.step
        knots += [
            Unknown(name, f"k{i}", 0.0, step.step, low, high, PRIOR_STEPS) for i in range(KNOTS)
        ]
    parts = left.balance.missing(model)
    nothing = np.concatenate(parts)
    linear = columns(left.balance, model, knots, nothing)  # a table is linear in its knots
    jacobian = np.hstack([base.jacobian, linear])
    # what stands far out pulls a robust fit no longer: begin where the squares are least, too
    w = np.repeat(1.0 / np.array(scatter(parts, left.balance.kinds)), [x.size for x in parts])
    ridge = np.eye(len(knots)) / PRIOR_STEPS**2
    start, *_ = np.linalg.lstsq(
        np.vstack([w[:, None] * linear, ridge]),
        np.concatenate([-w * nothing, np.zeros(len(knots))]),
        rcond=None,
    )
    begun = (model, place(model, knots, np.clip(start, low, high)))
    unknowns = (*base.unknowns, *knots)
    fits = [fit_balance(left.balance, one, unknowns, jacobian=jacobian) for one in begun]
    return min(fits, key=lambda one: one.loss)


def ends(motions: Sequence[Motion], variable: float) -> tuple[float, float]:
    """Range of a variable over all motions."""

    def along(mo: Motion) -> Floats:
        if variable == TURN:
            return np.array([0.0, 2.0 * np.pi])
        if variable == PATH:
            return mo.run[:, 2:4]
        if variable == BRAKING:
            fastest = np.abs(mo.pinion_speed).max() * mo.declared.drive["N_1"]
            return np.array([-fastest, fastest])
        if variable in (ANGLE, DRAG):
            return mo.run[:, 0]
        if variable == SPEED:
            return mo.run[:, 1]
        if variable == VOLTAGE:
            return mo.rec.u
        return np.array([0.0, mo.rec.dt * mo.run.shape[0]])

    return (
        min(float(along(mo).min()) for mo in motions),
        max(float(along(mo).max()) for mo in motions),
    )
