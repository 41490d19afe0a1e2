"""Candidates of a selection, and what a kind of balance offers to it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import hypot
from typing import Any, NamedTuple, Protocol

import numpy as np
from scipy.stats import chi2, norm

from dmptm_ctrl.simulate.model import Floats

JOINED = " + "  # of places that have an effect together
Keys = tuple[str, ...]  # name@place of effects

# Evidence from which an effect is accepted: above what any absent effect reaches on drives that
# lack nothing, of all friction and contact laws, ordinary imperfections included
# (benchmarks/calibrate.py).
LEVEL = 50.0
# Standard errors that evidence is above nothing. A diagnosis looks at some 150 candidates. By
# chance one of 30 000 is so far out: one in one diagnosis of 200.
SURE = 4.0
FIRM = 3.0  # standard errors of an amplitude


def name_of(key: str) -> str:
    """Return the name in ``name@place``."""
    return key.partition("@")[0]


def members(key: str) -> tuple[str, ...]:
    """Return the ``name@place`` of each place in ``name@place + place``."""
    name, _, places = key.partition("@")
    return tuple(f"{name}@{place}" for place in places.split(JOINED))


def overlap(keys: Iterable[str]) -> bool:
    """Whether two of several keys share a place."""
    every = [one for key in keys for one in members(key)]
    return len(every) > len({*every})


def differ(amplitudes: Floats, covariance: Floats) -> bool:
    """Whether amplitudes (k,) differ from zero, as surely as one by three standard errors.

    All together: what two motors do alike, logs may show of both and of neither alone.
    """
    square = float(amplitudes @ np.linalg.pinv(covariance, hermitian=True) @ amplitudes)
    return bool(square > chi2.isf(2.0 * norm.sf(FIRM), amplitudes.size))


WEAKER = "others explain more"
NO_DIFFERENCE = f"its amplitudes together do not differ from zero by {FIRM:.0f} standard errors"


def needed(effects: int, *errors: float) -> float:
    """Evidence above which effects are accepted, by their number and its standard errors."""
    return max(LEVEL * effects, SURE * hypot(*errors))


@dataclass(frozen=True, eq=False)
class Candidate:
    """One effect, or a set of effects, fitted beside a model.

    Attributes
    ----------
    keys : tuple of str
        ``name@place`` of each effect.
    gain, held_gain : float
        Fall of −2 log-likelihood on the fitted and on the held-out logs.
    fitted : object
        What the evidence needs to continue from here.
    objection : str
        Why the fitted values are impossible; empty where they are not.
    numbers : int
        Of the effects together; of rivals that the logs hardly distinguish the simplest is named.
    order : int
        Place in the catalogue; of equally simple rivals the first is named.
    error, held_error : float
        Standard errors of `gain` and `held_gain`, from how the rows' shares of them scatter.
        A few bursts that an effect follows by chance are much evidence, and much scatter.
    """

    keys: tuple[str, ...]
    gain: float
    held_gain: float
    fitted: Any
    objection: str = ""
    numbers: int = 0
    order: int = 0
    error: float = 0.0
    held_error: float = 0.0

    @property
    def plainness(self) -> tuple[int, int, int]:
        """What decides between rivals that the logs hardly distinguish; the least is named."""
        return self.numbers, self.order, sum(len(members(key)) for key in self.keys)

    @property
    def evidence(self) -> float:
        """Fall of −2 log-likelihood on all logs."""
        return self.gain + self.held_gain

    @property
    def demanded(self) -> bool:
        """Whether the logs demand it, and held-out ones do not object."""
        enough = self.evidence > needed(len(self.keys), self.error, self.held_error)
        # the rule of one standard error: Breiman et al., Classification and Regression Trees, 1984
        return enough and self.held_gain >= -hypot(self.error, self.held_error)

    @property
    def acceptable(self) -> bool:
        """Whether the logs demand it and its values are possible."""
        return self.demanded and not self.objection


class State(Protocol):
    """A model fitted to the fitted logs."""

    @property
    def keys(self) -> tuple[str, ...]:
        """Effects that were added, ``name@place``."""

    @property
    def target(self) -> Floats:
        """Weighted residual, the model's own parameters projected out, (m,)."""


class Rows(NamedTuple):
    """A model and candidates to first order: ``left + derivatives @ d + columns @ a`` is left.

    Attributes
    ----------
    left : (m,) array
        Weighted residual, and the misfit of the declared ranges.
    derivatives : (m, p) array
        Its derivatives by the model's parameters.
    low, high : (p,) arrays
        How far each parameter can go.
    columns : mapping of keys to (m, k) arrays
        Its derivatives by the amplitudes of each candidate.
    """

    left: Floats
    derivatives: Floats
    low: Floats
    high: Floats
    columns: Mapping[Keys, Floats]


class Evidence(Protocol):
    """What a kind of balance offers to the selection."""

    def candidates(self, state: Any, only: Sequence[str] | None = None) -> list[Candidate]:
        """Fit every effect at every place beside a model."""

    def gains(self, smaller: Any, larger: Any) -> tuple[float, float]:
        """Fall of −2 log-likelihood by the larger model on the fitted and the held-out logs."""

    def errors(self, smaller: Any, larger: Any) -> tuple[float, float]:
        """Standard errors of these falls."""

    def held_residuals(self, smaller: Any, larger: Any) -> tuple[Floats, Floats]:
        """What both leave of held-out logs, in units of the larger's scatter, (m,) each."""

    def ratio(self, state: Any) -> float:
        """Rows of the fitted logs over those of the held-out ones."""

    def columns(self, state: Any, candidate: Candidate) -> Floats:
        """Weighted change of the residual per amplitude, (m, k), projected as the target is."""

    def rows(self, state: Any, candidates: Sequence[Candidate]) -> Rows:
        """Return a model and candidates to first order."""

    def together(self, state: Any, candidates: Sequence[Candidate]) -> Candidate:
        """Fit several effects beside a model."""

    def adopt(self, state: Any, candidate: Candidate) -> Any:
        """Put a candidate into the model and fit to the end, on the same rows."""

    def beside(self, state: Any, candidate: Candidate) -> Any:
        """Return the model with a candidate, as it was fitted."""

    def closed(self, state: Any) -> Any:
        """Prepare the rows anew, as the model has it now, and fit again."""

    def without(self, state: Any, key: str) -> Any:
        """Take an effect out and fit the rest again."""

    def wald(self, state: Any, key: str) -> float:
        """Square of an effect's amplitudes in standard errors: its evidence, to second order."""

    def objection(self, without: Any, state: Any, key: str) -> str:
        """Why the values of an effect of a settled model are impossible; empty if they are not."""

    def share(self, without: Any, state: Any, key: str) -> Floats:
        """What an effect changes of the residual, weighted, the other parameters projected out."""


def standard_error(
    few: Sequence[Floats], more: Sequence[Floats], lengths: Sequence[float] | Floats
) -> float:
    """Standard error of a fall of −2 log-likelihood, from how the rows' shares of it scatter.

    Vuong, Econometrica 57 (1989) 307.

    Parameters
    ----------
    few, more : sequences of arrays
        −2 log-likelihood of each row, per equation, by the smaller and by the larger model.
    lengths : sequence of float
        Rows of each equation that count as one.
    """
    rows = zip(few, more, lengths, strict=True)
    variances = (a.size * np.var(a - b) / length for a, b, length in rows if a.size)
    return float(np.sqrt(sum(variances)))
