"""Fit whole logs by ensembles: where bounces grow everything, slopes are a matter of distance.

Past some bounces the slope of a run says where it goes for the millionth part of a value, and
nothing of what it does for what is not known. So drives are drawn from what is known, all run the
whole logs, and a regression on them tells how a run moves on the mean over that distance. What
is left of their spread is chance: no value of these drives tells it, and it counts as noise. So
does what a run in steps of another length does otherwise: after a hard reversal the true values
have lost step there, and a fit would bend the drive to it. What a step has learnt narrows the next
draw, which sees farther into the logs.
Source: statistical linearisation, Gelb (ed.), Applied Optimal Estimation (1974) 6.2; iterated by
ensembles as in Chen & Oliver, Math. Geosci. 44 (2012) 1; what a scheme misses counted as noise as
in Kennedy & O'Hagan, J. R. Stat. Soc. B 63 (2001) 425.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dmptm_ctrl.identify.fit import Fit, Known, arrays_at, place
from dmptm_ctrl.identify.led import SPEED_UNIT, compared
from dmptm_ctrl.identify.lock import ROUGH, TINY, Steps, cut
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.parallel import in_threads
from dmptm_ctrl.simulate.compiled import FINE_SUBSTEPS, SUBSTEPS
from dmptm_ctrl.simulate.model import Arrays, Floats, Model

STEPS = 5
DRIVES = 64  # drawn, of up to 28 unknowns
SPARE = 8  # drives beyond two per unknown
# Of each log, whose slopes tell what is known before the first draw; by those of 0.6 s true values
# may be five to thirteen standard deviations off where a fit has met 0.9 s.
FIRST_SECONDS = 0.4
WIDER = 2.0  # factor on the variance of the first draw: what those slopes know is too much
# Sum of logs' logarithms by which a step may miss more than the one before; else one half as wide
# is tried instead.
WORSE, NARROWER = 1.0, 0.5
BLOCK_SECONDS = 0.01
# One unit of speed: what a gyro of 0.05 deg/s leaves in a block of ten samples, beside what a
# law that is nearly right may miss.
UNIT = np.deg2rad(np.hypot(0.05 / np.sqrt(10.0), 0.006))  # rad/s
FREEDOM = 9.0  # what a run misses counts by the logarithm beyond three units
NEWS = 0.3  # share of the blocks that is independent
# Share of what they tell that narrows the next draw: of 11 rigs whose laws are the model's true
# values are then 1 to 2 standard deviations off, step after step; with all of it 3 to 20.
BELIEVED = 0.2
# A machine differs from a run by so many times what runs in two lengths of steps differ by: true
# values lose step after the hardest reversal of ten logs, in a quarter of the length as well.
SCHEME = 6.0
CHANCE = 1.0  # variance that no value tells, below which a block is judged as it is,
TOLD = 0.5  # or share of its spread that is told, above which it is judged nevertheless
AT_ONCE = 16  # drives of one call
SHARPER = 9.0  # factor by which one step narrows a variance at most,
VAGUER = 0.3  # and by which it may widen it
LONGEST = 2.0  # standard deviations of a draw, per unknown, that a step goes at most


def smoothed(
    records: Sequence[Record],
    begun: tuple[float, Fit],
    known: Known,
    missed: Callable[[Model], float],
    jobs: int,
    seed: int = 0,
) -> list[tuple[float, Fit]]:
    """Go on with a fit over whole logs.

    Parameters
    ----------
    records : sequence of Record
        Each from rest.
    begun : (float, Fit)
        One that is near, its runs go the same way for most of the time, behind what it misses.
    known : Known
        What is known of its unknowns beforehand.
    missed : callable
        How badly a model meets whole logs: a step that makes it worse by :data:`WORSE` is not
        taken.
    jobs : int
        Threads. The result does not depend on it.
    seed : int
        Of the drives that are drawn.

    Returns
    -------
    list of (float, Fit)
        Where it began, and each step that was taken, behind what it misses.
    """
    parts = [replace(rec, block=max(1, round(BLOCK_SECONDS / rec.dt))) for rec in records]
    rng = np.random.default_rng(seed)
    taken = [begun]
    fit = replace(begun[1], covariance=WIDER * at_first(records, begun[1], known, jobs))
    for _ in range(STEPS):
        p, covariance = step(parts, fit, known, jobs, rng)
        tried = replace(fit, model=place(fit.model, fit.unknowns, p), p=p, covariance=covariance)
        miss = missed(tried.model)
        if miss > taken[-1][0] + WORSE:
            fit = replace(fit, covariance=NARROWER * fit.covariance)
            continue
        fit = tried
        taken.append((miss, fit))
    return taken


def at_first(records: Sequence[Record], done: Fit, known: Known, jobs: int) -> Floats:
    """Covariance of the unknowns, as the slopes over the starts of logs tell it."""
    starts = [cut(rec, FIRST_SECONDS) for rec in records]
    steps = Steps(starts, done.model, done.unknowns, known, jobs, ROUGH)
    return steps.descend(done.p, 1)[1]


def step(
    records: Sequence[Record],
    done: Fit,
    known: Known,
    jobs: int,
    rng: np.random.Generator,
) -> tuple[Floats, Floats]:
    """Draw drives from what is known; what all teach: values, and covariance of the next draw."""
    low = np.array([k.low for k in done.unknowns])
    high = np.array([k.high for k in done.unknowns])
    k = done.p.size
    size, vectors = np.linalg.eigh(done.covariance)
    root = vectors * np.sqrt(np.maximum(size, TINY))
    half = rng.standard_normal((max(DRIVES, 2 * k + SPARE) // 2, k))
    drawn = np.clip(done.p + np.concatenate([half, -half]) @ root.T, low, high)
    drives = arrays_at(done.model, done.unknowns, [*drawn])
    missed = _missed(records, drives, jobs)
    # in the draw's own units from here on
    shifts = np.linalg.solve(root, (drawn - done.p).T).T
    regressors = np.column_stack([np.ones(len(shifts)), shifts])
    lines, *_ = np.linalg.lstsq(regressors, missed, rcond=None)
    r, slopes = lines[0], lines[1:]
    chance = np.sum((missed - regressors @ lines) ** 2, 0) / (len(shifts) - k - 1)
    spread = np.maximum(missed.var(0, ddof=1), TINY)
    judged = (chance < CHANCE) | (chance < (1.0 - TOLD) * spread)
    here = arrays_at(done.model, done.unknowns, [done.p])
    w = judged / (1.0 + chance + _of_scheme(records, here, jobs))
    w = NEWS * w / (1.0 + w * r**2 / FREEDOM)
    before = root.T @ known.precision @ root + TINY * np.eye(k)
    told = (slopes * w) @ slopes.T
    normal = told + before
    downhill = -(slopes * w) @ r - root.T @ known.precision @ (done.p - known.mean)
    move = np.linalg.solve(normal, downhill)
    move *= min(1.0, LONGEST * np.sqrt(k) / max(float(np.linalg.norm(move)), TINY))
    p = np.clip(done.p + root @ move, low, high)
    size, vectors = np.linalg.eigh(BELIEVED * told + before)
    root = root @ (vectors / np.sqrt(np.clip(size, VAGUER, SHARPER)))
    return p, np.asarray(root @ root.T)


def _of_scheme(records: Sequence[Record], drive: Sequence[Arrays], jobs: int) -> Floats:
    """Variance of each block by what steps of a finite length miss, in units."""
    coarse, fine = (_missed(records, drive, jobs, n)[0] for n in (SUBSTEPS, FINE_SUBSTEPS))
    return np.asarray((SCHEME * (coarse - fine)) ** 2)


def _missed(
    records: Sequence[Record], drives: Sequence[Arrays], jobs: int, substeps: int = SUBSTEPS
) -> Floats:
    """Measured minus simulated of many drives, in blocks and units of whole logs."""

    def one(task: tuple[Record, int]) -> Floats:  # some drives at a time: runs take memory
        rec, first = task
        some = compared([rec], drives[first : first + AT_ONCE], 1, substeps)
        finer = np.where(np.array(rec.channels) == "speed", SPEED_UNIT / UNIT, 1.0)
        return some * np.repeat(finer, rec.omega.size // rec.block)

    parts = range(0, len(drives), AT_ONCE)
    done = in_threads(one, [(rec, first) for rec in records for first in parts], jobs)
    return np.hstack([np.vstack(done[i : i + len(parts)]) for i in range(0, len(done), len(parts))])
