"""Gaps before bodies that nothing measures.

When teeth meet depends on all that came before, so the fit of such a gap has many minima, and
gradients lead to the nearest. An evolution strategy looks at a whole region: first over all that is
unknown of the link, then, with all numbers of the model free, around the fit from there.
Source: N. Hansen, The CMA evolution strategy, arXiv:1604.00772.
"""

from collections.abc import Callable
from math import exp, inf, isfinite, log, nan, sqrt
from typing import Any

import numpy as np

from dmptm_ctrl.drive.rig import is_known
from dmptm_ctrl.identify.free_parameters import scales_of
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.likelihood import TOLERANCE
from dmptm_ctrl.identify.rig_fit import RigFit, fit_rig, residuals, total_loss
from dmptm_ctrl.identify.rig_start import HIGHEST_MODE, LOWEST_MODE
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import BACKLASH
from dmptm_ctrl.simulate.rig_model import Placed, RigModel, link_inertias, link_sides

GAPS = 1e-5, 3e-2  # half-gaps, of the travel
DAMPED = 0.02, 1.0  # damping ratios
REGION = 0.3  # of each number, or of its range; that far is looked at first
POINTS = 100  # that are looked at, per number at most
CROWD = 2  # times as many in a round as for one valley, as Hansen advises where there are many

Start = tuple[tuple[Placed, ...], dict[str, float]]


def gap_start(
    model: RigModel,
    balance: Balance,
    link: str,
    surprise: Callable[[RigModel], float],
    *,
    jobs: int = 1,
) -> Start | None:
    """Return the best gap with values of what is unknown beside it.

    Where the gap of the link is declared, only the values; None where there is nothing to find.

    Without a gap the logs show only the sum of the friction on both sides of a link; through a gap
    it does not pass. A gap that is not in the model makes a spring soft and inertias wrong, so
    they are taken as declared.

    Parameters
    ----------
    surprise : callable
        −2 log-likelihood of a model, infinite where it has none.
    """
    make, low, high = _family(model, balance, link)

    def surprise_at(x: Floats) -> float:
        return surprise(at_start(model, make(low + (high - low) * x)))

    ends = np.zeros_like(low), np.ones_like(low)
    best = lowest(surprise_at, np.full_like(low, 0.5), ends, jobs) if low.size else None
    return None if best is None else make(low + (high - low) * best)


def lowest(
    loss: Callable[[Floats], float], start: Floats, ends: tuple[Floats, Floats], jobs: int
) -> Floats | None:
    """Return the lowest point that an evolution strategy finds; None where none is finite.

    Parameters
    ----------
    loss : callable
        Of a point, (n,), as −2 log-likelihood; infinite where it has none.
    start : (n,) array
    ends : two (n,) arrays
        Bounds, below and above.
    """
    import cma  # not before it is needed: it takes long to import

    own = start.size
    if own == 1:  # it needs two; the other does nothing
        start, ends = np.append(start, 0.5), (np.append(ends[0], 0.0), np.append(ends[1], 1.0))
    draw = np.random.default_rng(0)  # of its own: the user's numbers stay what they are
    options = {
        "bounds": [*ends],
        "popsize": CROWD * (4 + int(3 * log(start.size))),
        "maxfevals": POINTS * start.size,
        "tolfun": TOLERANCE,
        "randn": lambda *size: draw.standard_normal(size),
        "seed": nan,
        "verbose": -9,
    }
    search = cma.CMAEvolutionStrategy(start, REGION, options)
    with np.errstate(invalid="ignore"):  # it takes differences of losses, of infinite ones too
        while not search.stop():
            points = search.ask()
            found = np.array(in_threads(loss, [x[:own] for x in points], jobs))
            # what is too little to count must not decide either, as the last digits would
            search.tell(points, TOLERANCE * np.round(found / TOLERANCE))
    best = search.result
    return best.xbest[:own] if isfinite(best.fbest) else None


def at_start(model: RigModel, start: Start) -> RigModel:
    """Return a model with the values and the gap of a start."""
    placed, values = start
    model = model.with_values(values)
    for effect in placed:
        model = model.with_effect(effect)
    return model


def from_elsewhere(fit: RigFit, *, iterations: int, jobs: int) -> RigFit:
    """Fit again from the best of many models around; return the better fit."""
    balance, like = fit.likelihood.balance, fit.likelihood
    frees = [f for f in fit.frees if f.kind in ("value", "effect")]

    def there(step: Floats) -> State:
        return fit.state.moved(frees, fit.state.after(frees, step))

    def loss(step: Floats) -> float:
        one = there(step)
        try:
            left, _ = residuals(one, balance)
        except (ValueError, ArithmeticError):
            return inf
        found = total_loss(one, fit.frees, left, like)
        return found if isfinite(found) else inf

    best = lowest(loss, np.zeros(len(frees)), fit.state.room(frees), jobs)
    if best is None:
        return fit
    again = fit_rig(there(best), balance, like=like, iterations=iterations, jobs=jobs)
    return min(fit, again, key=lambda one: total_loss(one.state, one.frees, one.left, like))


def _family(
    model: RigModel, balance: Balance, link: str
) -> tuple[Callable[[Floats], Start], Floats, Floats]:
    """Return what makes a start of numbers, and their bounds."""
    travel, top = scales_of(balance).position, 2.0 * np.pi * balance.bandwidth
    bounds: dict[str, Any] = {}
    declared = {k.name: k for k in model.rig.links}  # effects make others
    if link not in declared or not is_known(declared[link].half_gap):
        bounds["gap"] = np.log(travel * np.array(GAPS))
    known, beyond = dict[str, float](), 0.0
    stiffness, damping = f"link.{link}.stiffness", f"link.{link}.damping"
    if link in declared:
        near, far = link_sides(model, link)
        known = model.declared(lambda key: key.endswith((".inertia", stiffness)))
        _, beyond = link_inertias(model.with_values(known), link)
        for kind in ("coulomb", "viscous"):
            if all(_unknown(model, side, kind) for side in (near, far)):
                bounds[kind] = 0.0, 1.0
        if not isfinite(model.quantity(stiffness).value):
            bounds["mode"] = np.log(top * np.array([LOWEST_MODE, 2.0 * HIGHEST_MODE]))
        if not isfinite(model.quantity(damping).value):
            bounds["damped"] = np.log(DAMPED)

    def make(x: Floats) -> Start:
        now = dict(zip(bounds, x.tolist(), strict=True))
        values = dict(known)
        for kind in (k for k in ("coulomb", "viscous") if k in now):
            values |= friction_shared(model, link, kind, now[kind])
        if "mode" in now:
            values[stiffness] = beyond * exp(2.0 * now["mode"])
        if "damped" in now:
            stiff = model.with_values(values).value(stiffness)
            values[damping] = exp(now["damped"]) * 2.0 * sqrt(beyond * stiff)
        if "gap" not in now:
            return (), values
        return (Placed(BACKLASH.name, link, {"half_gap": exp(now["gap"])}),), values

    low, high = np.reshape([*bounds.values()], (-1, 2)).T
    return make, low, high


def _unknown(model: RigModel, side: dict[str, float], kind: str) -> list[str]:
    """Bodies whose friction of a kind is unknown."""
    quantities = ((b, model.quantities.get(f"body.{b}.{kind}")) for b in side)
    return [b for b, q in quantities if q and not isfinite(q.value)]


def friction_shared(model: RigModel, link: str, kind: str, beyond: float) -> dict[str, float]:
    """Values that put a share of what friction of a kind is unknown on the far side of a link."""
    near, far = link_sides(model, link)
    far = {body: r / model.value(f"link.{link}.ratio") for body, r in far.items()}
    weight = {b: abs(r) ** {"coulomb": 1, "viscous": 2}[kind] for b, r in (near | far).items()}
    sides = _unknown(model, near, kind), _unknown(model, far, kind)
    whole = sum(weight[b] * model.value(f"body.{b}.{kind}") for side in sides for b in side)
    return {
        f"body.{b}.{kind}": part * whole / len(side) / weight[b]
        for side, part in zip(sides, (1.0 - beyond, beyond), strict=True)
        for b in side
    }
