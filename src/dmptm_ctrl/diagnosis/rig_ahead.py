"""Last fit of a rig: to the balances and to short predictions of its speed together.

Near rest, noise of the readings hides which way friction acts, and noise of a twist hides what
damps it. A run of the model shows both. An observer keeps it near the readings, so that it
forgets within 1/(2π f) what it began with.
Source: prediction errors of a fixed-gain observer, Ljung, System Identification, 1999, ch. 7.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from typing import Any, NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.diagnosis.rig_state import RigState
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.identify.compared_signals import correlation_length
from dmptm_ctrl.identify.fit import secant
from dmptm_ctrl.identify.free_parameters import Free
from dmptm_ctrl.identify.heavy_tails import bent, robust_scale, tails
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.likelihood import TOLERANCE
from dmptm_ctrl.identify.measured_motion import ROWS_PER_HERTZ
from dmptm_ctrl.identify.observer_driven import BANDWIDTH_HZ
from dmptm_ctrl.identify.rig_fit import Beside, RigFit, jacobian, residuals, stepped, total_loss
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import RigModel, link_inertias
from dmptm_ctrl.simulate.rig_run import substeps_for

MOST_STEPS = 5e7  # of the simulator for all derivatives once, some seconds; more is not begun
ROUNDS = 12  # Gauss–Newton steps at most; derivatives are taken anew where these gain no more
STEPS = 1e-4, 0.1  # difference steps are standard errors, but no less and no more scales
# Damping ratios of a link that are tried. Noise of its twist hides the damping from the balance;
# in runs it rings by it, and small steps from one that bounces lead nowhere.
DAMPED = tuple(np.geomspace(0.01, 1.0, 13).tolist())


@dataclass(frozen=True, eq=False)
class Predicted:
    """Short predictions as rows of a fit.

    Attributes
    ----------
    missing : (m,) array
        What a model does not predict of the sensor, in its unit.
    scale : float
        Most likely one of Student's t.
    independent : float
        Share of the rows that is independent.
    """

    missing: Floats
    scale: float
    independent: float

    @classmethod
    def of(cls, missing: Floats) -> "Predicted":
        """Count rows by how they scatter and correlate."""
        return cls(missing, robust_scale(missing), 1.0 / correlation_length(missing))

    @property
    def weights(self) -> Floats:
        """Square roots of what each row counts, (m,)."""
        return np.sqrt(self.independent * bent(self.missing, self.scale)) / self.scale

    def surprise(self, missing: Floats) -> float:
        """−2 log-likelihood of other predictions, as many of them independent."""
        scale = robust_scale(missing)
        return self.independent * float(
            missing.size * 2.0 * np.log(scale) + np.sum(tails((missing / scale) ** 2))
        )


@dataclass(frozen=True, eq=False)
class Ahead:
    """Short predictions of the logs that a model is fitted to.

    `derivatives` are those of the model before, per number; those of the next are nearly the same.
    """

    runs: Runs
    derivatives: dict[str, Floats] = field(default_factory=dict, init=False)

    @classmethod
    def of(
        cls, rig: Rig, logs: Sequence[Log], balance: Balance, samples: int, jobs: int
    ) -> "Ahead":
        """Take the beginning of each log, so many `samples` of all together."""
        bare = Runs.none_yet(rig, logs, balance, jobs, BANDWIDTH_HZ)
        most = samples // len(bare.logs)
        cut = [log.segment(log.time[0], log.time[min(most, len(log)) - 1]) for log in bare.logs]
        use = [mask[: len(log)] for mask, log in zip(bare.held, cut, strict=True)]
        return cls(replace(bare, logs=tuple(cut), held=tuple(use)))

    def missing(self, state: State) -> Floats | None:
        """What a model does not predict of the sensor, (m,); None where a run diverges."""
        return self._missing(self.runs.run(state))

    def _missing(self, runs: Sequence[Floats] | None) -> Floats | None:
        if runs is None:
            return None
        parts = zip(self.runs.misses(runs), self.runs.logs, strict=True)
        return np.concatenate([part[:: self._step(log)] for part, log in parts])

    def _step(self, log: Log) -> int:
        return max(1, int(1.0 / (ROWS_PER_HERTZ * self.runs.bandwidth * log.sample_time)))

    def fitted(self, state: RigState) -> RigState:
        """Fit a model to the balance that it was fitted to, and to short predictions.

        From where the balance has it, and from the declared values: how friction holds a body
        before it breaks away has several minima.
        """
        fit, plant = state.fit, state.fit.model.plant()
        steps = sum(len(x) * substeps_for(plant, x.sample_time) for x in self.runs.logs)
        if steps * len(fit.frees) > MOST_STEPS:
            return state
        ranged = [f for f in fit.frees if f.kind == "value" and f.prior]
        declared = fit.state.moved(ranged, [f.prior[0] for f in ranged if f.prior])
        starts = (fit.state, declared) if ranged else (fit.state,)
        begun = [here for here in self._ends(starts, fit) if here]
        ends = [self._settled(self._damped(here, fit), fit) for here in begun]
        if not ends:
            return state
        rows = Predicted.of(ends[0].missing)
        best = min(ends, key=lambda end: end.loss(fit, rows))
        if best.state is fit.state:
            return state
        derivatives = jacobian(
            best.state, fit.likelihood.balance, fit.frees, best.left, jobs=self.runs.jobs
        )
        loss = total_loss(best.state, fit.frees, best.left, fit.likelihood)
        done = replace(
            fit,
            state=best.state,
            left=best.left,
            drive=best.drive,
            derivatives=derivatives,
            loss=loss,
        )
        return replace(state, fit=done)

    def _ends(self, states: Sequence[State], fit: RigFit) -> list["_End | None"]:
        """What states leave; None where a run diverges."""
        found = zip(states, map(self._missing, self.runs.run_all(states)), strict=True)
        return [
            None if missing is None else _End(s, *residuals(s, fit.likelihood.balance), missing)
            for s, missing in found
        ]

    def _damped(self, here: "_End", fit: RigFit) -> "_End":
        """Return the best of several dampings of each spring."""
        for free in fit.frees:
            place, _, what = free.owner.rpartition(".")
            if free.kind != "value" or what != "damping":
                continue
            sizes = [x for x in dampings(here.state.model, place) if free.low <= x <= free.high]
            others = self._ends([here.state.moved([free], [x]) for x in sizes], fit)
            able, rows = [here, *filter(None, others)], Predicted.of(here.missing)
            here = able[int(np.argmin([one.loss(fit, rows) for one in able]))]
        return here

    def _settled(self, here: "_End", fit: RigFit) -> "_End":
        """Go on by Gauss–Newton."""
        steps = np.clip(np.sqrt(np.maximum(np.diag(fit.covariance), 0.0)), *STEPS)
        if not fit.frees:
            return here
        fresh = any(f.label not in self.derivatives for f in fit.frees)
        derivatives = self._derivatives(here, fit.frees, steps) if fresh else self._known(fit.frees)
        for _ in range(ROUNDS):
            rows = Predicted.of(here.missing)
            seen: dict[State, Floats] = {}

            def surprise(there: State, rows: Predicted = rows, seen: Any = seen) -> float:
                missing = self.missing(there)
                if missing is None:
                    return np.inf
                seen[there] = missing
                return rows.surprise(missing)

            weights = rows.weights
            beside = Beside(weights[:, None] * derivatives, weights * here.missing, surprise)
            loss, like = here.loss(fit, rows), fit.likelihood
            better = stepped(here.state, fit.frees, here.left, fit.derivatives, like, loss, beside)
            gain = 0.0 if better is None else loss - better[3]
            if gain < TOLERANCE and fresh:
                break
            if better is not None:
                before, here = here, _End(*better[:3], seen[better[0]])
                moved = [(here.state.get(f) - before.state.get(f)) / f.scale for f in fit.frees]
                derivatives = secant(derivatives, here.missing - before.missing, np.array(moved))
                fresh = False
            if gain < TOLERANCE:
                derivatives, fresh = self._derivatives(here, fit.frees, steps), True
        columns = zip(fit.frees, derivatives.T, strict=True)
        self.derivatives.update({f.label: column / f.scale for f, column in columns})
        return here

    def _known(self, frees: Sequence[Free]) -> Floats:
        """Derivatives as another model of the same logs has them."""
        return np.column_stack([self.derivatives[f.label] * f.scale for f in frees])

    def _derivatives(self, here: "_End", frees: Sequence[Free], steps: Floats) -> Floats:
        """Derivatives of what is not predicted, per scale of each number, (m, numbers)."""
        table = np.zeros((here.missing.size, len(frees)))
        known = [j for j, free in enumerate(frees) if free.kind in ("value", "effect")]
        sides, moved = [], []
        for free, step in ((frees[j], steps[j]) for j in known):
            value = here.state.get(free)
            sides.append(step if value + step * free.scale <= free.high else -step)
            moved.append(here.state.moved([free], [value + sides[-1] * free.scale]))
        # runs beside each other are as fine as the finest needs: their own base is among them
        base, *ahead = map(self._missing, self.runs.run_all([here.state, *moved]))
        for j, side, one in zip(known, sides, ahead, strict=True):
            if one is not None and base is not None:
                table[:, j] = (one - base) / side
        return table


class _End(NamedTuple):
    """A state, and what it leaves of the balance and of short predictions."""

    state: State
    left: tuple[Floats, ...]
    drive: tuple[Floats, ...]
    missing: Floats

    def loss(self, fit: RigFit, rows: Predicted) -> float:
        """−2 log-likelihood of both."""
        balance = total_loss(self.state, fit.frees, self.left, fit.likelihood)
        return balance + rows.surprise(self.missing)


def dampings(model: RigModel, link: str) -> list[float]:
    """Damping of a link, as ``link.name``, for each of several damping ratios of its mode."""
    near, far = link_inertias(model, link.partition(".")[2])
    critical = 2.0 * sqrt(model.value(f"{link}.stiffness") * near * far / (near + far))
    return [share * critical for share in DAMPED]
