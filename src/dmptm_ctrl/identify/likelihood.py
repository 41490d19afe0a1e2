"""How much the rows of a balance of torques say about a model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.identify.free_parameters import scales_of
from dmptm_ctrl.identify.heavy_tails import bent, robust_scale, tails
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.reading_noise import noise_in_balance
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import RigModel

LEAST_SCALE = 0.005  # of the torque; friction laws are not known more finely
BLOCKS = 120  # over all logs; the spread of the score between them is its uncertainty
TOLERANCE = 0.3  # of −2 log-likelihood; less decides nothing
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Likelihood:
    """How much the rows of a balance say: each equation at its own scale in each log.

    With one scale for all logs, those of violent motion would hide what quiet ones show.

    Attributes
    ----------
    independent : (equations,) array
        Share of the rows of each equation that is independent.
    noise : (equations,) array, optional
        Variance of the residual by the noise of readings to which all models are brought.
        Without it, what a model makes of that noise counts like anything else that is left.
    doubt : dict of label to float
        How many times less surely the rows show a number than their count says. Its declared range
        weighs so much more beside them (Pauli, Racugno and Ventura, Stat. Sinica 21 (2011) 149).
    """

    balance: Balance
    independent: Floats
    noise: Floats | None = None
    doubt: Mapping[str, float] = field(default_factory=dict)

    def on(self, balance: Balance) -> "Likelihood":
        """Return the same for other logs."""
        return replace(self, balance=balance)

    def knowing(self, model: RigModel, left: Sequence[Floats]) -> "Likelihood":
        """Return the same with the noise of readings separated from what else a model leaves."""
        noise = self.noise_of(model)
        share = noise[:, None] / self.scales(left) ** 2
        return replace(self, noise=noise if np.sum(self.counts * share) > TOLERANCE else None)

    def between(self, *models: RigModel) -> "Likelihood":
        """Return the same with all models brought to the least noise of these."""
        if self.noise is None:
            return self
        return replace(self, noise=np.min([self.noise_of(m) for m in models], axis=0))

    def noise_of(self, model: RigModel) -> Floats:
        """Variance that the noise of readings gives the residual of a model, (equations,)."""
        return np.array([float(f @ f) for f in noise_in_balance(model, self.balance)])

    @cached_property
    def floor(self) -> float:
        """Least scale of an equation."""
        return LEAST_SCALE * scales_of(self.balance).force

    @cached_property
    def rows(self) -> Ints:
        """Number of rows that count, (equations, logs)."""
        found = np.zeros((len(self.balance.points), len(self.balance.logs)), np.int64)
        for use, log in zip(self.balance.counted, self.balance.log_of, strict=True):
            found[:, log] += use.sum(axis=1)
        return found

    @cached_property
    def price(self) -> float:
        """What a fitted number costs: the logarithm of the number of independent rows.

        Schwarz, Ann. Statist. 6 (1978) 461.
        """
        return float(np.log(max(float(self.counts[0].sum()), 1.0)))

    def parts(self, left: Sequence[Floats]) -> list[Floats]:
        """Rows that count, (rows[, k]) per equation."""
        return np.split(self.stack(left), np.cumsum(self.rows.sum(axis=1))[:-1])

    @cached_property
    def blocks(self) -> Ints:
        """Block of every row, in the order of `stack`: equal numbers of rows on end."""
        whole = np.concatenate(self.balance.counted, axis=1)
        count = max(int(self.rows[0].sum()), 1)
        block = (np.cumsum(whole[0]) - whole[0]) * min(BLOCKS, count) // count
        return np.concatenate([block[use] for use in whole])

    def stack(self, left: Sequence[Floats]) -> Floats:
        """Rows that count, equation after equation, (all rows[, k])."""
        out, start = np.empty((int(self.rows.sum()), *left[0].shape[2:])), 0
        for e, logs in enumerate(self.balance.places):
            for part, rows in zip(left, logs, strict=True):
                np.take(part[e], rows, axis=0, out=out[start : start + rows.size])
                start += rows.size
        return out

    def along(self, values: Floats, equation: int) -> Floats:
        """Values of the logs at each row of an equation that counts."""
        return np.repeat(values, self.rows[equation])

    def sizes(self, left: Sequence[Floats]) -> Floats:
        """What is left of each equation, (equations,): its rms, or its scale beside bursts."""
        parts = zip(self.parts(left), self.balance.bursts, strict=True)
        return np.array([size_of(part, heavy) if part.size else 1.0 for part, heavy in parts])

    def scales(self, left: Sequence[Floats]) -> Floats:
        """Scale of each equation in each log, (equations, logs), with what no law is known below.

        Where no row counts it is 1.
        """
        return self._scales_of(self.parts(left))

    def _scales_of(self, parts: Sequence[Floats]) -> Floats:
        ends = np.cumsum(self.rows, axis=1)[:, :-1]
        sizes = [
            [size_of(one, heavy) if one.size else 1.0 for one in np.split(own, end)]
            for own, end, heavy in zip(parts, ends, self.balance.bursts, strict=True)
        ]
        return np.hypot(sizes, self.floor)

    def weights(self, left: Sequence[Floats]) -> Floats:
        """Square roots of what each row counts, in the order of `stack`."""
        parts = self.parts(left)
        scales = self._scales_of(parts)
        rows = zip(self.independent, parts, self.balance.bursts, strict=True)
        return np.concatenate(
            [
                weights_of(part, share, self.along(scales[e], e), heavy)
                for e, (share, part, heavy) in enumerate(rows)
            ]
        )

    def surprise(self, left: Sequence[Floats], model: RigModel) -> float:
        """−2 log-likelihood, by scales of equations and logs, with one noise for all models."""
        parts = self.parts(left)
        squares = self._scales_of(parts) ** 2
        if self.noise is not None:
            # More noise than there is left makes no model better. What a model adds to the noise is
            # separated from what else it leaves no better than so many rows determine a variance.
            own, noise = self.noise_of(model)[:, None], self.noise[:, None]
            uncertain = np.sqrt(2.0 / np.maximum(self.counts, 2.0)) * (own - noise)
            least = np.maximum(self.floor**2, uncertain)
            squares = np.maximum(squares - own, least) + noise
        # the mean square over the scale's is left in: near the floor it still falls
        spread = self.counts * (1.0 - self.floor**2 / squares)
        for e in np.flatnonzero(self.balance.bursts).tolist():
            whole = np.sum(tails(parts[e] ** 2 / self.along(squares[e], e)))
            spread[e] = self.independent[e] * whole / spread.shape[1]
        return float(np.sum(self.counts * np.log(squares) + spread))

    @cached_property
    def counts(self) -> Floats:
        """Independent rows, (equations, logs)."""
        return self.independent[:, None] * self.rows

    def row_surprises(self, left: Sequence[Floats]) -> list[Floats]:
        """The same of each row as if it were independent, per equation."""
        parts = self.parts(left)
        scales, rows = self._scales_of(parts), zip(parts, self.balance.bursts, strict=True)
        along = ((part, self.along(scales[e], e), heavy) for e, (part, heavy) in enumerate(rows))
        squares = [((part / s) ** 2, s, heavy) for part, s, heavy in along]
        return [2.0 * np.log(s) + (tails(x) if heavy else x) for x, s, heavy in squares]


def size_of(rows: Floats, heavy: bool) -> float:
    """Size of rows: their root mean square, or of heavy tails the scale."""
    return robust_scale(rows) if heavy else float(np.sqrt(np.mean(rows**2)))


def weights_of(rows: Floats, share: float, scale: float | Floats, heavy: bool) -> Floats:
    """Square roots of what rows of one equation count: less where they are bursts."""
    return np.sqrt(share * (bent(rows, scale) if heavy else np.ones(len(rows)))) / scale
