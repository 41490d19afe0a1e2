"""Second step: what the declared model, fitted inside its declared ranges, leaves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.effects.encoder_eccentricity import ENCODER_ECCENTRICITY
from dmptm_ctrl.identify.balance import (
    Balance,
    BalanceFit,
    columns,
    covariance_of,
    fit_balance,
    loss,
    surprise,
    weights,
)
from dmptm_ctrl.identify.fit import Unknown, drive_unknowns, effect_unknowns
from dmptm_ctrl.identify.motion import motions
from dmptm_ctrl.identify.records import Record, predict
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.model import Floats, Model

LEAD_HZ = 0.05  # slow lead of simulated runs by the measured angle: bounds drift only
ECCENTRIC = ENCODER_ECCENTRICITY.name
SEEN = 1.0  # evidence of a scale of an unknown, below which the balances do not see it
ROUNDS = 3  # fits without motor encoders: each shows better which touch, for the next
SETTLED = 5.0  # fall of the loss by derivatives taken anew, below which they are not again


@dataclass(eq=False)
class Residual:
    """A model fitted to the balances of the fitted logs, and those of the held-out ones.

    Attributes
    ----------
    balance, held : Balance
        Missing torques on the logs that fit and on those that judge.
    """

    measured: Measured
    balance: Balance
    held: Balance
    base: BalanceFit

    def held_loss(self, model: Model) -> float:
        """Loss on the held-out logs, nothing fitted."""
        return surprise(self.held.missing(model), self.held.kinds)

    @cached_property
    def held_base(self) -> float:
        """Loss of the fitted model on the held-out logs."""
        return self.held_loss(self.base.model)

    @cached_property
    def fast(self) -> "Residual":
        """The same, judged by what is faster than windows besides.

        With motor encoders the sides' own balances show more, and nothing is added.
        """
        if self.balance.fast or not self.balance.simulated:
            return self
        balance, held = (replace(one, fast=True) for one in (self.balance, self.held))
        base, parts = self.base, balance.missing(self.base.model)
        # nothing of the drive alone changes its fast part
        still = np.zeros((sum(map(len, parts)) - len(base.missing), len(base.unknowns)))
        value = loss(parts, balance.kinds, base.unknowns, base.p)
        jacobian = np.vstack([base.jacobian, still])
        base = replace(base, parts=parts, kinds=balance.kinds, jacobian=jacobian, loss=value)
        return replace(self, balance=balance, held=held, base=base)


def predicting(left: Residual) -> Residual:
    """Count short predictions beside the balances, and fit again."""
    balance, held = (replace(one, observer_driven=True) for one in (left.balance, left.held))
    return replace(left, balance=balance, held=held, base=predicting_fit(balance, left.base))


def predicting_fit(balance: Balance, base: BalanceFit) -> BalanceFit:
    """Fit to balances and short predictions, derivatives taken anew a few times: runs cost most."""
    best, unknowns = base, base.unknowns
    value = loss(balance.missing(base.model), balance.kinds, unknowns, base.p)
    for _ in range(ROUNDS):
        derivatives = columns(balance, best.model, unknowns)
        best = fit_balance(balance, best.model, unknowns, jacobian=derivatives)
        gain, value = value - best.loss, best.loss
        if gain < SETTLED:
            break
    return replace(best, covariance=_covariance(best))


def _covariance(base: BalanceFit) -> Floats:
    """Covariance by the balances alone, of what they see.

    How a run continues after an impact depends steeply on every parameter, and identifies none.
    """
    count = sum(kind != "observer" for kind in base.kinds)
    parts, kinds = base.parts[:count], base.kinds[:count]
    derivatives = base.jacobian[: sum(map(len, parts))]
    rows = weights(parts, kinds)[:, None] * derivatives
    covariance = covariance_of(rows, base.unknowns)
    invisible = [j for j, free in enumerate(seen(rows, base.unknowns)) if not free]
    covariance[invisible, :] = base.covariance[invisible, :]
    covariance[:, invisible] = base.covariance[:, invisible]
    return covariance


def seen(rows: Floats, unknowns: Sequence[Unknown]) -> list[bool]:
    """Whether weighted derivatives (m, k) show each unknown; of the drive all count."""
    seen_rows = np.square(rows).sum(axis=0)
    return [k.effect is None or x > SEEN for k, x in zip(unknowns, seen_rows, strict=True)]


def of_windows(left: Residual) -> Residual:
    """Fit to the balances alone what they see; what they do not see stays as it is."""
    if not left.balance.observer_driven:
        return left
    balance, held = (replace(one, observer_driven=False) for one in (left.balance, left.held))
    model, unknowns = left.base.model, left.base.unknowns
    parts = balance.missing(model)
    derivatives = columns(balance, model, unknowns)
    shown = seen(weights(parts, balance.kinds)[:, None] * derivatives, unknowns)
    free = tuple(k for k, one in zip(unknowns, shown, strict=True) if one)
    base = fit_balance(balance, model, free, jacobian=derivatives[:, shown])
    return replace(left, balance=balance, held=held, base=base)


def balances(records: tuple[Record, ...], model: Model, declared: Model, jobs: int) -> Balance:
    """Prepare balances; without motor encoders `model` says which pinions touch."""
    simulated = any(rec.twist is None for rec in records)
    # a model that never touches with both is wrong about it: the declared one then says
    for contact in (model, declared) if simulated else (model,):
        runs: Sequence[Floats | None] = [None] * len(records)
        if simulated:
            run = partial(predict, model=contact, bandwidth_hz=LEAD_HZ)
            runs = in_threads(run, records, jobs, lambda rec: rec.omega.size)
        balance = Balance(motions(records, model, runs, jobs), declared, jobs, simulated)
        if balance.equations:
            break
    else:
        names = ", ".join(rec.name for rec in records)
        raise LogError(
            f"nothing to diagnose in {names}: at no time does the drive move one way with both "
            "meshes closed; record longer or stronger motions"
        )
    return balance


def residual(
    measured: Measured, model: Model, *, unknowns: tuple[Unknown, ...] | None = None, jobs: int = 2
) -> Residual:
    """Fit a model to the balances and return what it leaves.

    Parameters
    ----------
    model : Model
        Where the fit starts; its effects stay as they are unless `unknowns` frees them.
    unknowns : tuple of Unknown, optional
        By default the parameters of the drive inside their declared ranges.
    """
    free = unknowns
    if free is None:
        free = drive_unknowns(model)
        if ECCENTRIC in model.effects and all(rec.twist is not None for rec in measured.fit):
            free += effect_unknowns(ECCENTRIC)  # the twist shows it more finely than the gyro
    declared = Model(measured.drive)
    balance, base = closed(measured.fit, model, declared, free, jobs)
    held = balances(measured.held, base.model, declared, jobs)
    return Residual(measured, balance, held, base)


def closed(
    records: tuple[Record, ...],
    model: Model,
    declared: Model,
    unknowns: tuple[Unknown, ...],
    jobs: int,
) -> tuple[Balance, BalanceFit]:
    """Prepare balances of records and fit a model to them."""
    balance = balances(records, model, declared, jobs)
    base = fit_balance(balance, model, unknowns)
    for _ in range(ROUNDS - 1):
        if not balance.simulated:
            break
        balance = balances(records, base.model, declared, jobs)
        base = fit_balance(balance, base.model, unknowns)
    return balance, base
