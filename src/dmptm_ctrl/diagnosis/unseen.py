"""What the balances tell nothing of: tried in the simulator, by keeping step.

Friction that grows with the time at rest acts where no window is counted; without motor encoders
the twist is not measured, and an error of the teeth or a soft reducer moves only the times of
the impacts. On a machine that obeys the model's laws otherwise, the one that is there lets the
model meet the bounces of the first tenths of a second, and no other does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from dmptm_ctrl.diagnosis.at_rest import sized
from dmptm_ctrl.diagnosis.race import beside, loosely
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.diagnosis.runoff import KEEPS_SECONDS, Run, lost, run, starts
from dmptm_ctrl.diagnosis.trace import WITHOUT_TWIST, unknowns_of
from dmptm_ctrl.identify.balance import BalanceFit
from dmptm_ctrl.identify.fit import Fit, Unknown
from dmptm_ctrl.identify.lock import Locked, lock
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.simulate.model import Model

AGEING = "unknown_breakaway"
LEAST_SECONDS = 0.1  # for which a winner keeps step; the first landings are before
LEAST = 100.0  # evidence of a winner
# Errors of the teeth move the landings alike: of 13 such names on rigs of benchmarks/rigs 10 were
# right (seeds 97, 199, 401 to 406, 801).
SUREST = 0.8
MARGIN = 40.0  # evidence by which another one is out of step


@dataclass(frozen=True, eq=False)
class Shown:
    """An effect with which alone the model keeps step.

    Attributes
    ----------
    name : str
    fit : Fit
        Of the model with it.
    gain, held_gain : float
        Fall of the loss on the starts of fitted and held-out logs.
    rivals : tuple of Shown
        Others that keep step as long.
    """

    name: str
    fit: Fit
    gain: float
    held_gain: float
    rivals: tuple["Shown", ...] = ()

    @property
    def evidence(self) -> float:
        """Fall of the loss on all logs."""
        return self.gain + self.held_gain


def names(left: Residual) -> tuple[str, ...]:
    """Effects of which the balances of these logs tell nothing."""
    return (AGEING,) if left.measured.has_motor_encoders else (AGEING, *WITHOUT_TWIST)


def unseen(left: Residual, before: Fit, *, jobs: int = 2, seed: int = 0) -> Shown | None:
    """Find what lets a model keep step that loses it.

    Parameters
    ----------
    left : Residual
        What the model leaves.
    before : Fit
        That model, refitted inside the simulator.

    Returns
    -------
    Shown or None
        None where nothing, or not one thing alone, lets the model keep step.
    """
    if before.horizon >= KEEPS_SECONDS:
        return None
    whole = left.measured.fit, left.measured.held
    base = rattled(whole[0], left.base, left.measured.drive, jobs)
    found = {
        name: kept(name, base, whole[0], seed, jobs)
        for name in names(left)
        if name not in base.model.effects
    }
    name = max(found, key=lambda n: found[n][0].lasts(), default=None)
    if name is None:
        return None
    winner = found[name][0]
    ahead = lost(whole, before.model, winner.model, (LEAST_SECONDS, winner.horizon), jobs)
    if ahead is None:
        return None
    seconds, bare, _ = ahead
    parts = starts(whole, seconds)
    runs = {n: run(parts, one.model, jobs) for n, (one, _) in found.items()}
    near = [n for n in found if n != name and runs[n].beyond(runs[name]) < MARGIN]
    near = [n for n in near if bare.loses_to(runs[n])]
    rivals = tuple(shown(n, *found[n], bare, runs[n]) for n in near)
    best = shown(name, *found[name], bare, runs[name], rivals)
    return best if best.evidence > LEAST else None


def kept(
    name: str, base: BalanceFit, records: Sequence[Record], seed: int, jobs: int
) -> tuple[Locked, tuple[Unknown, ...]]:
    """Keep step with an effect."""
    own = unknowns_of(name)
    model: Model = sized(name, base.model, 1.0)
    known = beside(loosely(base), model, own)
    unknowns = (*base.unknowns, *own)
    return lock(records, model, unknowns, known, jobs=jobs, seed=seed), unknowns


def shown(
    name: str,
    found: Locked,
    unknowns: tuple[Unknown, ...],
    bare: Run,
    own: Run,
    rivals: tuple[Shown, ...] = (),
) -> Shown:
    """Describe one that keeps step where the model as it is does not."""
    fit = Fit(found.model, unknowns, found.p, found.covariance, found.horizon)
    return Shown(name, fit, bare.fitted - own.fitted, bare.held - own.held, rivals)
