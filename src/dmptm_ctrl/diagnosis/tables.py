"""A curve without a name as a lookup table in the model, so that the error falls even so."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.diagnosis.residual import Residual, residual
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import ANGLE, KNOTS, SPEED, TIME, VOLTAGE
from dmptm_ctrl.identify.balance import columns, fit_balance
from dmptm_ctrl.identify.fit import Unknown
from dmptm_ctrl.identify.motion import Motion
from dmptm_ctrl.simulate.model import Floats

TORQUE, FRICTION, VOLTS = "unknown_torque", "unknown_friction", "unknown_voltage"
PRIOR_STEPS = 3.0  # of a knot, in steps of its parameter: where no log goes, it stays at zero
HELD = 8.0  # fall of the loss on the held-out logs that a table must bring
# Tables that can stand for a curve of these variables; of others (a rate, a product) none can.
PLANS: dict[tuple[str, ...], tuple[tuple[str, float], ...]] = {
    ("theta_L",): ((FRICTION, ANGLE), (TORQUE, ANGLE)),
    ("theta_L", "omega_L"): ((FRICTION, ANGLE), (TORQUE, ANGLE)),
    ("omega_L",): ((TORQUE, SPEED),),
    ("u",): ((VOLTS, VOLTAGE),),
    ("time",): ((FRICTION, TIME), (TORQUE, TIME)),
    ("omega_L", "time"): ((FRICTION, TIME),),
}


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


def tabulate(left: Residual, variables: Sequence[str], jobs: int) -> Tables | None:
    """Fit tables over variables beside a model; None where they do not help."""
    plan = PLANS.get(tuple(variables))
    if plan is None:
        return None
    model = left.base.model
    knots: list[Unknown] = []
    for name, variable in plan:
        low, high = ends(left.balance.motions, variable)
        shape = {"variable": variable, "low": low, "high": high}
        model = model.with_effect(name, **shape, **{f"k{i}": 0.0 for i in range(KNOTS)})
        step = next(p for p in CATALOGUE[name].parameters if p.name == "k0")
        knots += [
            Unknown(
                name,
                f"k{i}",
                0.0,
                step.step,
                step.low / step.step,
                step.high / step.step,
                PRIOR_STEPS,
            )
            for i in range(KNOTS)
        ]
    base = left.base
    nothing = np.concatenate(left.balance.missing(model))
    linear = columns(left.balance, model, knots, nothing)  # a table is linear in its knots
    fitted = fit_balance(
        left.balance,
        model,
        (*base.unknowns, *knots),
        jacobian=np.hstack([base.jacobian, linear]),
    )
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
    rest = residual(left.measured, fitted.model, unknowns=base.unknowns, jobs=jobs)
    names = tuple(name for name, _ in plan)
    return Tables(tuple(variables), names, own, base.loss - fitted.loss, held, left, rest)


def ends(motions: Sequence[Motion], variable: float) -> tuple[float, float]:
    """Range of a variable over all motions."""

    def along(mo: Motion) -> Floats:
        if variable == ANGLE:
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
