"""How much of a residual a candidate would explain, and how surely, before any refit."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import f as f_distribution

from dmptm_ctrl.identify.chain_fit import ChainFit
from dmptm_ctrl.identify.inverse_dynamics import Balance

Floats = NDArray[np.float64]

BLOCKS = 120  # over all logs; the spread of the score between them is its uncertainty
MIN_BLOCKS_PER_LOG = 4
BLOCK_PERIODS = 10.0  # a block is not shorter than this many periods of the bandwidth
FEW_BLOCKS = 20  # fewer are too few for their spread to tell
NEWS = 20.0  # independent pieces of evidence in all blocks, for odds between rival effects


class Score(NamedTuple):
    """What a candidate explains of a residual that refitted parameters could not.

    Attributes
    ----------
    gain : float
        Share of the residual's square.
    statistic, p_value : float
        Wald statistic over blocks, and how often chance gives more (one candidate alone).
    amplitudes : (p,) array
        Least-squares amplitudes, in units of the columns.
    survival : float
        Share of the candidate's own size that refitted parameters cannot take over.
    direction : (rows,) array
        What it explains, projected, for comparing candidates.
    """

    gain: float
    statistic: float
    p_value: float
    amplitudes: Floats
    survival: float
    direction: Floats


@dataclass(frozen=True, eq=False)
class Tangent:
    """Residual of a fit in one vector, and what its parameters can change."""

    fit: ChainFit
    balance: Balance

    def stack(self, parts: list[Floats] | tuple[Floats, ...]) -> Floats:
        """Put (equations, rows[, p]) per log into (all rows[, p]), weighted."""
        w = self.fit.weights
        out = []
        for part in parts:
            count = min(part.shape[0], w.size)
            weight = w[:count].reshape(-1, *[1] * (part.ndim - 1))
            out.append((weight * part[:count]).reshape(-1, *part.shape[2:]))
        return np.concatenate(out)

    @cached_property
    def left(self) -> Floats:
        """Residual, (rows,)."""
        r = self.stack(self.fit.left)
        return r - self.basis @ (self.basis.T @ r)

    @cached_property
    def basis(self) -> Floats:
        """Orthonormal basis of what the fitted parameters change, (rows, p)."""
        slopes = self.stack(self.fit.slopes)
        if slopes.shape[1] == 0:
            return slopes
        norm = np.linalg.norm(slopes, axis=0)
        keep = norm > 1e-12 * norm.max(initial=0.0)
        u, s, _ = np.linalg.svd(slopes[:, keep] / norm[keep], full_matrices=False)
        return u[:, s > 1e-7 * s.max(initial=0.0)]

    @cached_property
    def blocks(self) -> NDArray[np.int64]:
        """Block of every row."""
        total = sum(float(m.rows[-1] - m.rows[0]) for m in self.balance.motions)
        ids, first = [], 0
        for motion in self.balance.motions:
            rows = motion.rows
            span = float(rows[-1] - rows[0])
            count = max(round(BLOCKS * span / total), MIN_BLOCKS_PER_LOG)
            count = max(min(count, int(span * motion.bandwidth / BLOCK_PERIODS)), 1)
            own = np.minimum((np.arange(rows.size) * count) // rows.size, count - 1) + first
            ids += [own] * min(self.fit.left[0].shape[0], self.fit.weights.size)
            first += count
        return np.concatenate(ids)

    def project(self, columns: Floats) -> Floats:
        """Take out what the fitted parameters could do."""
        return columns - self.basis @ (self.basis.T @ columns)

    def score(self, columns: Floats) -> Score:
        """Score a candidate by the derivatives of the residual by its amplitudes.

        Parameters
        ----------
        columns : (rows, p) array
            As from `stack`.
        """
        size = np.linalg.norm(columns, axis=0)
        free = self.project(columns)
        norm = np.linalg.norm(free, axis=0)
        good = norm > 1e-6 * np.maximum(size, 1e-300)
        survival = float(np.max(norm / np.maximum(size, 1e-300), initial=0.0))
        amplitudes = np.zeros(columns.shape[1])
        if not good.any():
            return Score(0.0, 0.0, 1.0, amplitudes, survival, np.zeros(columns.shape[0]))
        u, s, vt = np.linalg.svd(free[:, good] / norm[good], full_matrices=False)
        keep = s > 1e-4 * s[0]
        u = u[:, keep]
        along = u.T @ self.left
        amplitudes[good] = -(vt[keep].T @ (along / s[keep])) / norm[good]
        power = float(self.left @ self.left)
        gain = float(along @ along) / power if power > 0 else 0.0
        statistic, p_value = self._wald(u * self.left[:, None])
        if int(self.blocks.max()) + 1 < FEW_BLOCKS:
            p_value = min(p_value, self._f_test(u @ along, u.shape[1]))
        return Score(gain, statistic, p_value, amplitudes, survival, u @ along)

    def _f_test(self, explained: Floats, count: int) -> float:
        """How often chance explains as much, where blocks are too few to tell."""
        rest = self.left - explained
        lost = float(explained @ explained)
        return self.chance(lost, rest, count, self.basis.shape[1])

    def chance(self, lost: float, rest: Floats, count: int, fitted: int) -> float:
        """F-test, with as many independent rows as the rest's correlation leaves.

        Parameters
        ----------
        lost : float
            Square that `count` numbers explain.
        rest : (rows,) array
            What they leave, as from `stack`.
        fitted : int
            Numbers fitted besides.
        """
        power = float(rest @ rest)
        if power == 0.0 or lost <= 0.0:
            return 1.0
        news, start = 0.0, 0
        for part in self.fit.left:
            equations = min(part.shape[0], self.fit.weights.size)
            for _ in range(equations):
                one = rest[start : start + part.shape[1]]
                start += part.shape[1]
                used = one[one != 0]
                if used.size:
                    news += used.size / equations / _correlation_length(used)
        free = news - count - fitted
        if free < 1:
            return 1.0
        return float(f_distribution.sf((lost / count) / (power / free), count, free))

    @cached_property
    def _sizes(self) -> Floats:
        """Norm of the residual in each block."""
        count = int(self.blocks.max()) + 1
        return np.sqrt(np.bincount(self.blocks, self.left**2, count))

    def _wald(self, products: Floats) -> tuple[float, float]:
        """Wald statistic of block sums against zero, and its p-value.

        Once with the sums as they are, for what shows in many blocks alike; once relative to
        the residual in each block, for logs of very different size.
        """
        count = int(self.blocks.max()) + 1
        sums = np.array(
            [np.bincount(self.blocks, products[:, j], count) for j in range(products.shape[1])]
        ).T
        used = np.bincount(self.blocks, np.abs(products).sum(axis=1), count) > 0
        plain = _against_zero(sums[used])
        relative = _against_zero(sums[used] / np.maximum(self._sizes[used, None], 1e-300))
        best = plain if plain[1] <= relative[1] else relative
        return best[0], min(1.0, 2.0 * best[1])


def _correlation_length(x: Floats) -> float:
    """Rows that count as one: 1 + 2 Σ ρ, up to the first that is not positive."""
    spectrum = np.fft.rfft(x, 2 * x.size)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[: x.size]
    rho = covariance / covariance[0] if covariance[0] > 0 else covariance
    ends = np.flatnonzero(rho <= 0)
    return 1.0 + 2.0 * float(np.sum(rho[1 : ends[0] if ends.size else rho.size]))


def _against_zero(sums: Floats) -> tuple[float, float]:
    """Hotelling's test of the mean of rows against zero."""
    n, p = sums.shape
    if n < p + 3:
        return 0.0, 1.0
    mean = sums.mean(axis=0)
    spread = np.atleast_2d(np.cov(sums.T)) / n
    try:
        wald = float(mean @ np.linalg.solve(spread, mean))
    except np.linalg.LinAlgError:
        return 0.0, 1.0
    scaled = wald * (n - p) / (p * (n - 1))
    return wald, float(f_distribution.sf(scaled, p, n - p))


def similarity(one: Score, other: Score) -> float:
    """Cosine between what two candidates explain."""
    size = np.linalg.norm(one.direction) * np.linalg.norm(other.direction)
    return float(abs(one.direction @ other.direction) / size) if size > 0 else 0.0
