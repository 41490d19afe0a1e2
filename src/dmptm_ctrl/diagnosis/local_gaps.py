"""Where gaps vary around the ring gear: what each reversal, taken alone, has for its gaps.

A gap that is nearly all variation opens and closes within the logs' angles; from a small one no
descent finds it, for the first impacts of logs that start near each other are met as well by
another gap that does not vary. Each reversal is run with many pairs of gaps that do not vary;
waves of the gaps over the ring gear's angle are then looked up in these, many at once.
"""

from collections.abc import Sequence

import numpy as np
from scipy.ndimage import map_coordinates

from dmptm_ctrl.drive import Drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.fit import Drives, Unknown
from dmptm_ctrl.identify.led import Bench
from dmptm_ctrl.identify.lock import NEWS, loss
from dmptm_ctrl.identify.records import Record
from dmptm_ctrl.identify.segments import reversals
from dmptm_ctrl.simulate.compiled import SUBSTEPS
from dmptm_ctrl.simulate.model import Floats, Model

VARYING = "backlash_variation"
GAPS = ("gap_l", "gap_r")
SECONDS = 0.07  # of each reversal from where the meshes open; the pinions land within
SHARES = np.linspace(0.05, 1.95, 12)  # of a model's gaps, with which each reversal is run
DRAWS = 20_000  # of waves
LARGEST = 1.2  # share of the gaps: where a gap closes altogether the backlash stops at none
PLACES, APART = 8, 5.0  # the best that differ by so many steps of the effect


def waves_of_gaps(
    records: Sequence[Record], model: Model, declared: Drive, jobs: int, seed: int
) -> list[Model]:
    """Return models with gaps that vary, the likeliest first, by the reversals of some records.

    Parameters
    ----------
    records : sequence of Record
    model : Model
        Without the effect.
    declared : Drive
        Whose ranges the mean gaps keep.
    seed : int
        Of the waves that are drawn.

    Returns
    -------
    list of Model
        Empty if no mesh opens.
    """
    turned = reversals(records, model, SECONDS)
    if not turned:
        return []
    tables = losses_of_gaps(turned, model, jobs)
    angles = np.array([rec.theta[rec.led] for rec in turned])
    means, amplitudes = drawn(declared, np.random.default_rng(seed))
    own = np.array([model.drive[gap] for gap in GAPS])
    gaps = means[:, None] + np.einsum("rsa,da->drs", by_angle(angles), amplitudes)
    places = (gaps / own - SHARES[0]) / (SHARES[1] - SHARES[0])
    looked_up = [
        map_coordinates(table, places[:, i].T, order=1, mode="nearest")
        for i, table in enumerate(tables)
    ]
    cost = np.sum(looked_up, axis=0)
    effect = CATALOGUE[VARYING]
    steps = amplitudes / [p.step for p in effect.parameters if p.name in effect.amplitudes]
    kept: list[int] = []
    for i in np.argsort(cost):
        if all(np.abs(steps[i] - steps[j]).max() > APART for j in kept):
            kept.append(int(i))
        if len(kept) == PLACES:
            break
    return [
        model.with_values(**dict(zip(GAPS, map(float, means[i]), strict=True))).with_effect(
            VARYING, **dict(zip(effect.amplitudes, map(float, amplitudes[i]), strict=True))
        )
        for i in kept
    ]


def losses_of_gaps(turned: Sequence[Record], model: Model, jobs: int) -> Floats:
    """Loss of each reversal by the shares of both gaps, (reversals, shares, shares)."""
    unknowns = [Unknown(None, gap, 0.0, model.drive[gap], 0.0, np.inf, np.inf) for gap in GAPS]
    pairs = [np.array([left, right]) for left in SHARES for right in SHARES]
    drives = Drives(model, unknowns)(pairs)
    missed = [Bench([rec]).compared(drives, jobs, SUBSTEPS) for rec in turned]
    table = np.array([NEWS * loss(one).sum(axis=1) for one in missed])
    return table.reshape(len(turned), SHARES.size, SHARES.size)


def drawn(declared: Drive, rng: np.random.Generator) -> tuple[Floats, Floats]:
    """Draw mean gaps (draws, 2) and amplitudes of waves (draws, 4) [rad at the pinion].

    As large on both sides, as a centre distance makes it, or as large a share of each gap, or
    between the two.
    """
    means = np.column_stack([rng.uniform(*declared.quantities[g].range, DRAWS) for g in GAPS])
    share = LARGEST * np.sqrt(rng.uniform(0.0, 1.0, DRAWS))
    phase = rng.uniform(0.0, 2.0 * np.pi, DRAWS)
    common = share * means.mean(axis=1)
    apart = share * 0.5 * (means[:, 0] - means[:, 1]) * rng.uniform(0.0, 1.0, DRAWS)
    sizes = {"cosine": common, "sine": common, "apart_cosine": apart, "apart_sine": apart}
    effect = CATALOGUE[VARYING]
    waves = [
        sizes[name] * (np.cos(phase) if name.endswith("cosine") else np.sin(phase))
        for name in effect.amplitudes
    ]
    bounds = {p.name: (p.low, p.high) for p in effect.parameters}
    limited = [
        np.clip(wave, *bounds[name]) for wave, name in zip(waves, effect.amplitudes, strict=True)
    ]
    return means, np.column_stack(limited)


def by_angle(angles: Floats) -> Floats:
    """Change of both gaps by one unit of each amplitude, (angles, sides, amplitudes)."""
    effect = CATALOGUE[VARYING]
    ones = [effect.values(*unit) for unit in np.eye(len(effect.parameters))]
    return np.array(
        [
            [[effect.kernel(0.0, 0.0, angle, 0.0, side, one)[2] for one in ones] for side in (0, 1)]
            for angle in angles
        ]
    )
