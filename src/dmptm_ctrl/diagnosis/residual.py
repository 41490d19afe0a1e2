"""Second step: what the declared model, fitted inside its declared ranges, leaves."""

from dataclasses import dataclass, field

from dmptm_ctrl.diagnosis.measure import Measured
from dmptm_ctrl.identify.balance import Balance, BalanceFit, fit_balance, loss
from dmptm_ctrl.identify.fit import Misfit, Unknown, drive_unknowns, effect_unknowns
from dmptm_ctrl.identify.motion import motions
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Floats, Model

LEAD_HZ = 0.05  # slow lead of simulated runs by the measured angle: bounds drift only
ECCENTRIC = "encoder_eccentricity"
ROUNDS = 3  # fits without motor encoders: each tells better who touches, for the next


@dataclass(eq=False)
class Residual:
    """A model fitted to the balances of the fitted logs, and those of the held-out ones.

    Attributes
    ----------
    measured : Measured
    balance, held : Balance
        Missing torques on the logs that fit and on those that judge.
    base : BalanceFit
    held_news : (e,) array
        Independent share of the windows of each held-out equation.
    """

    measured: Measured
    balance: Balance
    held: Balance
    base: BalanceFit
    held_news: Floats
    _held: dict[int, float] = field(default_factory=dict)

    def held_loss(self, model: Model) -> float:
        """Loss on the held-out logs, nothing fitted."""
        if id(model) not in self._held:
            kinds = [e.kind for e in self.held.equations]
            self._held[id(model)] = loss(self.held.missing(model), kinds, self.held_news, (), ())
            self._alive = [*getattr(self, "_alive", []), model]  # an id must not come again
        return self._held[id(model)]


def balances(records: tuple[Record, ...], model: Model, declared: Model, jobs: int) -> Balance:
    """Prepare balances; without motor encoders `model` tells which pinions touch."""
    runs = None
    if any(rec.twist is None for rec in records):
        runs = Misfit(records, LEAD_HZ, jobs).runs(model)
    return Balance(motions(records, model, runs), declared, jobs)


def residual(
    measured: Measured,
    model: Model,
    *,
    unknowns: tuple[Unknown, ...] | None = None,
    jobs: int = 2,
) -> Residual:
    """Fit a model to the balances and return what it leaves.

    Parameters
    ----------
    model : Model
        Where the fit starts; its effects stay as they are unless `unknowns` frees them.
    unknowns : tuple of Unknown, optional
        By default the parameters of the drive inside their declared ranges.
    """
    declared = Model(measured.drive)
    free = unknowns
    if free is None:
        free = drive_unknowns(model)
        if ECCENTRIC in model.effects and all(rec.twist is not None for rec in measured.fit):
            free += effect_unknowns(ECCENTRIC)  # the twist tells it more finely than the gyro
    balance = balances(measured.fit, model, declared, jobs)
    base = fit_balance(balance, model, free)
    for _ in range(ROUNDS - 1):
        if not balance.simulated:
            break
        balance = balances(measured.fit, base.model, declared, jobs)
        base = fit_balance(balance, base.model, free)
    # Once more with the independent shares of the end, which hold for every comparison.
    base = fit_balance(balance, base.model, free, news=base.scatter.news)
    held = balances(measured.held, base.model, declared, jobs)
    return Residual(measured, balance, held, base, held.scatter(base.model).news)
