"""A curve without a name as a lookup table in the model, so that the error falls even so."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from dmptm_ctrl.diagnosis.bursts import BURSTS
from dmptm_ctrl.diagnosis.residual import Residual, residual
from dmptm_ctrl.diagnosis.unknown import CURVE, Unexplained
from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import (
    ANGLE,
    BRAKING,
    CLOCK,
    DRAG,
    HALF,
    KNOTS,
    LONGEST,
    PATH,
    SPEED,
    TIME,
    TURN,
    VOLTAGE,
    WAVE,
)
from dmptm_ctrl.effects.unknown_friction import UNKNOWN_FRICTION
from dmptm_ctrl.effects.unknown_motor import BOTH, LEFT, RIGHT, UNKNOWN_MOTOR
from dmptm_ctrl.effects.unknown_torque import UNKNOWN_TORQUE
from dmptm_ctrl.effects.unknown_voltage import UNKNOWN_VOLTAGE
from dmptm_ctrl.identify.balance import BalanceFit, columns, fit_balance, scatter
from dmptm_ctrl.identify.fit import Unknown, place
from dmptm_ctrl.identify.motion import Motion
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats, Model

TORQUE, FRICTION, VOLTS = UNKNOWN_TORQUE.name, UNKNOWN_FRICTION.name, UNKNOWN_VOLTAGE.name
MOTOR = UNKNOWN_MOTOR.name
PRIOR_STEPS = 3.0  # of a knot, in steps of its parameter: where no log goes, it stays at zero
LARGEST = 3.0  # of the knots, in standard deviations of what they are likely to be
FAR = 3.0  # times the usual range of a variable in a log, beyond which one goes far
QUIET = 0.2  # of the largest knot, below which nothing happens
MOST_OF_IT = 0.6  # of a table, in which something happens: it needs no finer one
HELD = 8.0  # fall of the loss on the held-out logs that a table must bring
# Tables that can stand for a curve of these variables; of others (a rate, a mesh torque) none can.
# Of several the one that explains most: a brake in a sector of the turn is a curve over the angle,
# and whether it grows with the speed only a table of each shows.
Plan = tuple[tuple[str, float], ...]
PLANS: dict[tuple[str, ...], tuple[Plan, ...]] = {
    ("theta_L",): (((FRICTION, ANGLE), (TORQUE, ANGLE)), ((TORQUE, ANGLE),), ((TORQUE, DRAG),)),
    ("theta_L", "omega_L"): (((TORQUE, DRAG),), ((TORQUE, WAVE),)),
    ("theta_L", "u"): (((MOTOR, PATH),),),
    ("theta_m", "u"): (((MOTOR, TURN),),),
    ("omega_m", "u"): (((MOTOR, BRAKING),),),
    ("omega_L",): (((TORQUE, SPEED),),),
    ("u",): (((VOLTS, VOLTAGE),),),
    ("time",): (((FRICTION, TIME), (TORQUE, TIME)),),
    ("time", "u"): (((MOTOR, CLOCK),),),
    ("omega_L", "time"): (((FRICTION, TIME),),),
}
ALONE = 1.1  # times what a table of both motors explains, from which one of one goes before it


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
    left : Residual
        With the tables in the model.
    """

    variables: tuple[str, ...]
    names: tuple[str, ...]
    errors: dict[tuple[str, str], float]
    gain: float
    held_gain: float
    left: Residual

    @property
    def evidence(self) -> float:
        """Fall of the loss on all logs."""
        return self.gain + self.held_gain


def in_tables(
    left: Residual, what: Unexplained, jobs: int
) -> tuple[Unexplained | None, Tables | None]:
    """Put what has no name into tables, where any can stand for it.

    What comes by the clock may be the log's excitation, and what moves the voltage may be its
    answer to what comes by the clock: the held-out logs decide.
    """
    curve = what.curve
    by_curve = None if curve is None else tabulate(left, curve.variables, jobs, order=curve.order)
    period = what.bursts.period
    by_clock = clock_table(left, period, jobs) if period > 0.0 else None
    best = max(one.held_gain if one else 0.0 for one in (curve, by_curve))
    if by_clock is not None and by_clock.held_gain > best and by_clock.evidence > CURVE:
        return replace(what, variables=by_clock.variables, curve=None), by_clock
    if curve is None and what.bursts.share < BURSTS and what.slips == 0.0:
        return None, None
    return what, by_curve


def tabulate(
    left: Residual, variables: Sequence[str], jobs: int, *, order: int = 0
) -> Tables | None:
    """Fit tables over the variables of a curve beside a model; None where they do not help.

    `order` of the ring gear's turn, of a curve that is a wave over it.
    """
    plans = PLANS.get(tuple(variables), ())
    plans = tuple(plan for plan in plans if order or all(over != WAVE for _, over in plan))
    if not plans:
        return None
    tried: list[dict[str, dict[str, float]]] = []
    # a log that goes far leaves few knots where the others are
    reached = {
        variable: np.array([ends(mo, variable) for mo in left.balance.motions])
        for plan in plans
        for _, variable in plan
    }
    for plan, range_of in product(plans, (widest, together, usual)):
        shapes = {}
        for name, variable in plan:
            low, high = range_of(reached[variable])
            turn = turn_of(left.measured.drive, variable)
            shapes[name] = {"variable": variable, "low": low, "high": min(high, low + turn)}
            if name in (MOTOR, TORQUE):
                shapes[name]["period"] = min(turn, LONGEST)
            if variable == WAVE:
                shapes[name]["period"] = 2.0 * np.pi / order
        if shapes not in tried:
            tried.append(shapes)
    fits = in_threads(
        lambda shapes: of_motors(left, shapes[MOTOR]) if MOTOR in shapes else tabled(left, shapes),
        tried,
        jobs,
    )
    near = [focused(fit, shapes) for fit, shapes in zip(fits, tried, strict=True)]
    fits += [tabled(left, shapes) for shapes in near if shapes is not None]
    if ((MOTOR, TURN),) in plans:
        fits.append(tabled(left, {MOTOR: waves(left)}))
    return described(left, better(left, fits), variables, jobs)


def waves(left: Residual) -> dict[str, float]:
    """Shape of a table over one wave of those that a motor's turn has, the strongest kind.

    Of a short wave a table of the whole turn has only a few knots. Both motors have the same one,
    at other angles: how far apart, a table for each of them shows.
    """
    turn = {"variable": TURN, "low": 0.0, "high": 2.0 * np.pi, "period": LONGEST}
    entered = [entered_into(left.base.model, MOTOR, {**turn, "motors": m}) for m in (LEFT, RIGHT)]
    nothing = left.balance.missing(entered[0][0])
    linear = np.hstack([columns(left.balance, m, knots) for m, knots in entered])
    each = linear_fit(left, nothing, linear).reshape(2, KNOTS)[:, :-1]  # the last is the first
    spectrum = np.fft.rfft(each)[:, 1:]
    most = int(np.argmax(np.sum(np.abs(spectrum) ** 2, axis=0)))
    ahead = float(np.angle(spectrum[1, most] / spectrum[0, most]))
    count = most + 1
    return {**turn, "high": turn["high"] / count, "motors": BOTH, "apart": ahead / count}


def clock_table(left: Residual, period: float, jobs: int) -> Tables | None:
    """Fit a table over the time in a period [s]; None where it does not help."""
    shape = {"variable": CLOCK, "low": 0.0, "high": period, "period": period}
    first = better(left, [of_motors(left, shape), tabled(left, {TORQUE: shape})])
    fitted = better(left, [first, tabled(left, narrowed(first.model))])
    variables = ("time", "u") if MOTOR in fitted.model.effects else ("time",)
    return described(left, fitted, variables, jobs)


def described(
    left: Residual, fitted: BalanceFit, variables: Sequence[str], jobs: int
) -> Tables | None:
    """Describe fitted tables; None where the held-out logs gain nothing by them."""
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
    return Tables(tuple(variables), names, own, gain, held, rest)


def of_motors(left: Residual, shape: Mapping[str, float]) -> BalanceFit:
    """Fit a table of both motors, or of one alone if that explains clearly more.

    The motors turn together: what one of them does seems to be done by both, and the reverse.
    """
    both, *single = in_threads(
        lambda motors: tabled(left, {MOTOR: {**shape, "motors": motors}}),
        (BOTH, LEFT, RIGHT),
        left.balance.jobs,
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


def focused(
    fit: BalanceFit, shapes: Mapping[str, Mapping[str, float]]
) -> dict[str, dict[str, float]] | None:
    """Shapes of tables over the part of the ring gear's turn in which something happens.

    None where that is most of it, or the tables are over something else.
    """
    if any(shape["variable"] not in (ANGLE, DRAG) for shape in shapes.values()):
        return None
    happens = np.zeros(KNOTS, np.bool_)
    for name in shapes:
        knots = np.array([fit.model.effects[name][f"k{i}"] for i in range(KNOTS)])
        above = np.abs(knots - np.median(knots))
        happens |= (above >= QUIET * above.max()) & (above > 0.0)
    loud = np.flatnonzero(happens)
    if loud.size == 0 or loud[-1] - loud[0] + 2 > MOST_OF_IT * (KNOTS - 1):
        return None
    shape = next(iter(shapes.values()))
    spacing = (shape["high"] - shape["low"]) / (KNOTS - 1)
    ends = (loud[0] - 1, loud[-1] + 1)
    low, high = (float(shape["low"] + spacing * end) for end in ends)
    return {name: {**shape, "low": low, "high": high} for name, shape in shapes.items()}


def narrowed(model: Model) -> dict[str, dict[str, float]]:
    """Shape of a table over the part of a period in which something happens."""
    name = MOTOR if MOTOR in model.effects else TORQUE
    values = model.effects[name]
    knots = np.abs([values[f"k{i}"] for i in range(KNOTS)])
    spacing = values["period"] / (KNOTS - 1)
    # the longest quiet stretch, across the end of the period too, is left out
    loud = np.flatnonzero(knots >= QUIET * knots.max())
    quiet = np.diff([*loud, loud[0] + KNOTS - 1])
    last = int(np.argmax(quiet))
    first = int(loud[(last + 1) % loud.size])
    low = spacing * (first - 1)
    length = min(values["period"], spacing * (KNOTS + 1 - int(quiet[last])))
    shape = {key: x for key, x in values.items() if key in ("variable", "motors", "period")}
    return {name: {**shape, "low": low, "high": low + length}}


def tabled(left: Residual, shapes: Mapping[str, Mapping[str, float]]) -> BalanceFit:
    """Fit the knots of tables, and the drive beside them."""
    model, base = left.base.model, left.base
    knots: list[Unknown] = []
    for name, shape in shapes.items():
        model, own = entered_into(model, name, shape)
        knots += own
    parts = left.balance.missing(model)
    linear = columns(left.balance, model, knots)  # linear in its knots
    jacobian = np.hstack([base.jacobian, linear])
    # what stands far out pulls a robust fit no longer: begin where the squares are least, too
    low, high = ([getattr(k, end) for k in knots] for end in ("low", "high"))
    start = np.clip(linear_fit(left, parts, linear), low, high)
    likely = max(PRIOR_STEPS, float(np.abs(start).max()) / LARGEST)
    knots = [replace(knot, prior=likely) for knot in knots]
    begun = (model, place(model, knots, start))
    unknowns = (*base.unknowns, *knots)
    fits = [fit_balance(left.balance, one, unknowns, jacobian=jacobian) for one in begun]
    return min(fits, key=lambda one: one.loss)


def entered_into(
    model: Model, name: str, shape: Mapping[str, float]
) -> tuple[Model, list[Unknown]]:
    """Model with a table of zeros, and its knots."""
    effect = CATALOGUE[name]
    knots = {f"k{i}": 0.0 for i in range(KNOTS)}
    model = model.with_effect(name, **{**effect.absent(), **shape, **knots})
    step = next(p for p in effect.parameters if p.name == "k0")
    low, high = step.low / step.step, step.high / step.step
    own = [Unknown(name, f"k{i}", 0.0, step.step, low, high, PRIOR_STEPS) for i in range(KNOTS)]
    return model, own


def linear_fit(left: Residual, parts: Sequence[Floats], linear: Floats) -> Floats:
    """Knots that leave the least squares of what is missing, where no log goes zero."""
    w = np.repeat(1.0 / np.array(scatter(parts, left.balance.kinds)), [x.size for x in parts])
    n = linear.shape[1]
    rows = np.vstack([w[:, None] * linear, np.eye(n) / PRIOR_STEPS**2])
    found, *_ = np.linalg.lstsq(
        rows, np.concatenate([-w * np.concatenate(parts), np.zeros(n)]), rcond=None
    )
    return np.asarray(found, np.float64)


def turn_of(drive: Drive, variable: float) -> float:
    """What a variable grows by over a turn of the ring gear [rad]; of no angle inf."""
    if variable in (ANGLE, DRAG):
        return 2.0 * np.pi
    return 2.0 * np.pi * drive["N_1"] * drive["N_2"] if variable == PATH else np.inf


def widest(reached: Floats) -> tuple[float, float]:
    """Range of a variable over all motions, from the ends (n, 2) that each of them reaches."""
    return float(reached[:, 0].min()), float(reached[:, 1].max())


def together(reached: Floats) -> tuple[float, float]:
    """Range of a variable over all motions but those that go far."""
    length = reached[:, 1] - reached[:, 0]
    return widest(reached[length <= FAR * np.median(length)])


def usual(reached: Floats) -> tuple[float, float]:
    """Range of a variable in most motions."""
    low, high = np.median(reached, axis=0)
    return float(low), float(high)


def ends(mo: Motion, variable: float) -> tuple[float, float]:
    """Range of a variable along a motion."""
    if variable == TURN:
        return 0.0, 2.0 * np.pi
    if variable == BRAKING:
        fastest = float(np.abs(mo.pinion_speed).max()) * mo.declared.drive["N_1"]
        return -fastest, fastest
    if variable in (ANGLE, DRAG):
        along = mo.run[:, 0]
    elif variable == PATH:
        along = mo.run[:, 2:4]
    elif variable == SPEED:
        along = mo.run[:, 1]
    elif variable == WAVE:  # half of the table is over all speeds
        return 0.0, float(np.abs(mo.run[:, 1]).max()) * (KNOTS - 1) / (HALF - 1)
    elif variable == VOLTAGE:
        along = mo.rec.u
    else:
        return 0.0, mo.rec.dt * mo.run.shape[0]
    return float(along.min()), float(along.max())
