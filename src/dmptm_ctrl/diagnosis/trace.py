"""Third step: which effect would explain what refitted parameters cannot.

Every catalogue effect gets columns G, the change of the residual per unit of its
amplitudes. Most come from its kernel evaluated along the run and a rigid first-order
response, which is free of the rattle that no model predicts; those that act through
contact or sensors from a second simulation. Projected score: M = I − J(JᵀJ)⁻¹Jᵀ takes out
what the declared parameters could explain; the gain is what G explains of Mr.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.diagnosis.residual import Residual
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.identify.records import Record, block_mean
from dmptm_ctrl.simulate.compose import engine
from dmptm_ctrl.simulate.model import Floats, Model

SIMULATED = frozenset({"shaft", "presliding", "sensor", "sensor_delay"})
SIMULATED_EFFECTS = frozenset({"backlash_variation", "drive_saturation"})
SEARCHED = frozenset({"cogging", "base_vibration", "local_spot"})
PROBE = 2.0  # steps of a simulated column: well above the rattle
MIN_SURVIVAL = 0.25  # share of a column that refitted parameters cannot imitate
RANK_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Score:
    """How well an effect explains the residual, to first order.

    Attributes
    ----------
    gain : float
        Fall of the weighted square of the projected residual.
    share : float
        `gain` over the whole.
    shapes, amplitudes : mappings
        The shape parameters tried and the amplitudes estimated, SI.
    survival : float
        ‖MG‖/‖G‖, largest over the columns: below 0.25 the declared parameters imitate it.
    detectable : mapping
        Smallest amplitude that these logs could have shown (3 standard errors), SI.
    columns, raw : (m, amplitudes) arrays
        Projected, and as they are.
    """

    name: str
    gain: float
    share: float
    shapes: Mapping[str, float]
    amplitudes: Mapping[str, float]
    survival: float
    detectable: Mapping[str, float]
    columns: Floats
    raw: Floats


@dataclass(frozen=True, eq=False)
class Projection:
    """Removes what refitted parameters could explain, priors included."""

    basis: Floats
    rows: int

    @classmethod
    def of(cls, jacobian: Floats, prior: Floats) -> "Projection":
        """Build from sensitivities (m, k) and inverse prior standard deviations (k,)."""
        basis, _ = np.linalg.qr(np.vstack([jacobian, np.diag(prior)]))
        return cls(basis, prior.size)

    def __call__(self, columns: Floats) -> Floats:
        """Project (m,) or (m, j), returned with the prior's rows appended."""
        columns = columns if columns.ndim == 2 else columns[:, None]
        tall = np.vstack([columns, np.zeros((self.rows, columns.shape[1]))])
        return tall - self.basis @ (self.basis.T @ tall)


def respond(rec: Record, run: Floats, model: Model, torque: Floats, shift: Floats) -> Floats:
    """Response of a record's channels to a disturbance, block means (channels, blocks)."""
    out = np.empty((rec.theta.size, 3))
    engine().respond(torque, shift, run, rec.dt, model.arrays()[0], out)
    return block_mean(np.ascontiguousarray(out.T[: len(rec.channels)]), rec.block)


def disturbance(rec: Record, run: Floats, model: Model) -> tuple[Floats, Floats]:
    """Torques (n, 3) and mesh shifts (n, 2) of the model's effects along a run."""
    n = rec.theta.size
    torque, shift = np.empty((n, 3)), np.empty((n, 2))
    engine().along(rec.u, aligned(rec, run, model), rec.dt, *model.arrays(), torque, shift)
    return torque, shift


def aligned(rec: Record, run: Floats, model: Model) -> Floats:
    """Return a run with its angles moved to where the sensor says that it was."""
    n1, n2 = model.drive["N_1"], model.drive["N_2"]
    moved = run.copy()
    lead = rec.theta - run[:, 0]
    moved[:, 0] += lead
    moved[:, 2] += n1 * n2 * lead
    moved[:, 3] += n1 * n2 * lead
    return moved


def along_columns(left: Residual, effect: Effect, shapes: Mapping[str, float]) -> Floats:
    """Columns per `step` of each amplitude, from the kernel along the run."""
    bare = left.base.model
    columns = []
    for p in effect.parameters:
        if p.bank:
            continue
        probe = Model(bare.drive, {effect.name: {**shapes, p.name: p.step}})
        diffs = [
            respond(rec, run, bare, *disturbance(rec, run, probe))
            for rec, run in zip(left.misfit.records, left.runs, strict=True)
        ]
        columns.append(left.misfit.stacked(diffs))
    return np.array(columns).T


def simulated_columns(left: Residual, effect: Effect, shapes: Mapping[str, float]) -> Floats:
    """Columns per `step` of each amplitude, from a second simulation."""
    columns = []
    for p in effect.parameters:
        if p.bank:
            continue
        probe = left.base.model.with_effect(effect.name, **{**shapes, p.name: PROBE * p.step})
        columns.append((left.vector - left.misfit.vector(probe)) / PROBE)
    return np.array(columns).T


def judge(
    effect: Effect, shapes: Mapping[str, float], columns: Floats, r: Floats, project: Projection
) -> Score:
    """Score columns against a projected residual `r`."""
    projected = project(columns)
    size = np.linalg.norm(columns, axis=0)
    kept = np.linalg.norm(projected, axis=0)
    survival = float(np.max(kept / np.maximum(size, 1e-300), initial=0.0))
    coefficients, *_ = np.linalg.lstsq(projected, r, rcond=RANK_TOLERANCE)
    total = float(r @ r)
    gain = total - float(np.sum((r - projected @ coefficients) ** 2))
    steps = {p.name: p.step for p in effect.parameters if not p.bank}
    return Score(
        effect.name,
        gain,
        gain / max(total, 1e-300),
        dict(shapes),
        {n: float(c) * s for (n, s), c in zip(steps.items(), coefficients, strict=True)},
        survival,
        {n: 3.0 * s / max(float(k), 1e-300) for (n, s), k in zip(steps.items(), kept, strict=True)},
        projected,
        columns,
    )


def rescore(scores: Sequence[Score], other: Residual) -> list[Score]:
    """Score the same columns against the residual at another start, best first."""
    project = Projection.of(other.jacobian, other.prior)
    r = project(other.vector)[:, 0]
    return best_by_name(judge(CATALOGUE[s.name], s.shapes, s.raw, r, project) for s in scores)


def best_by_name(scores: Iterable[Score]) -> list[Score]:
    """Keep the best shape of each effect, best effect first."""
    best: dict[str, Score] = {}
    for score in scores:
        if score.name not in best or score.gain > best[score.name].gain:
            best[score.name] = score
    return sorted(best.values(), key=lambda s: -s.gain)


def trace(left: Residual, *, skip: Iterable[str] = ()) -> list[Score]:
    """Score every catalogue effect that the model does not have yet, in every shape tried."""
    project = Projection.of(left.jacobian, left.prior)
    r = project(left.vector)[:, 0]
    skipped = {*skip, *left.base.model.effects}

    def score(name: str) -> list[Score]:
        effect = CATALOGUE[name]
        columns = (
            simulated_columns
            if effect.site in SIMULATED or name in SIMULATED_EFFECTS
            else along_columns
        )
        return [
            judge(effect, shapes, columns(left, effect, shapes), r, project)
            for shapes in shape_trials(left, effect, r, project)
        ]

    with ThreadPoolExecutor(left.misfit.jobs) as pool:
        parts = list(pool.map(score, [n for n in CATALOGUE if n not in skipped]))
    return [score for part in parts for score in part]


def shape_trials(
    left: Residual, effect: Effect, r: Floats, project: Projection
) -> Iterator[dict[str, float]]:
    """Shape parameters worth columns of their own."""
    if not effect.shapes:
        yield {}
    elif effect.name == "base_vibration":
        for frequency in frequency_search(left, effect, r, project):
            yield {"frequency": frequency}
    elif effect.name == "cogging":
        for order in order_search(left, effect, r, project):
            yield {"order": order}
    elif effect.name == "local_spot":
        yield from place_search(left, effect, r, project)
    else:
        (shape,) = (p for p in effect.parameters if p.bank)
        for value in shape.bank:
            yield {shape.name: value}


def _best(gains: Floats, keep: int, apart: int) -> list[int]:
    """Indices of the largest gains, no two closer than `apart`."""
    chosen: list[int] = []
    for i in np.argsort(-gains):
        if all(abs(i - j) >= apart for j in chosen):
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return chosen


def pair_gains(cosine: Floats, sine: Floats, r: Floats, project: Projection) -> Floats:
    """Gain of each (cosine, sine) pair of columns (m, k) against the projected residual."""
    c, s = project(cosine), project(sine)
    cc, ss, cs = (c * c).sum(0), (s * s).sum(0), (c * s).sum(0)
    rc, rs = r @ c, r @ s
    det = np.maximum(cc * ss - cs**2, 1e-12 * cc * ss + 1e-300)
    return np.asarray((ss * rc**2 - 2 * cs * rc * rs + cc * rs**2) / det)


def frequency_search(
    left: Residual, effect: Effect, r: Floats, project: Projection, keep: int = 3
) -> list[float]:
    """Frequencies [Hz] at which moving stretches oscillate in step with the clock."""
    (bank,) = (np.array(p.bank) for p in effect.parameters if p.bank)
    gains = []
    for part in np.array_split(bank, max(1, bank.size // 128)):
        waves: tuple[list[Floats], list[Floats]] = ([], [])
        for rec, run in zip(left.misfit.records, left.runs, strict=True):
            t = block_mean(rec.time - rec.time[0], rec.block)
            moving = block_mean((run[:, 1] != 0.0).astype(float), rec.block)
            phase = 2 * np.pi * part[:, None] * t
            for wave, function in zip(waves, (np.cos, np.sin), strict=True):
                wave.append(function(phase) * moving)
        cosine, sine = (_speed_columns(left, wave) for wave in waves)
        gains.append(pair_gains(cosine, sine, r, project))
    gain = np.concatenate(gains)
    return [float(bank[i]) for i in _best(gain, keep, 10)]


def _speed_columns(left: Residual, rows: list[Floats]) -> Floats:
    """Weight speed responses (k, blocks) per record into columns (m, k)."""
    k = rows[0].shape[0]
    shaped = []
    for i in range(k):
        diffs = []
        for rec, row in zip(left.misfit.records, rows, strict=True):
            diff = np.zeros((len(rec.channels), row.shape[1]))
            diff[0] = row[i]
            diffs.append(diff)
        shaped.append(left.misfit.stacked(diffs))
    return np.array(shaped).T


def order_search(
    left: Residual, effect: Effect, r: Floats, project: Projection, keep: int = 3
) -> list[float]:
    """Orders per motor turn: those in the twist at steady speed, and those in the response."""
    (bank,) = (p.bank for p in effect.parameters if p.bank)
    found = twist_orders(left, np.array(bank))[:keep]
    low = np.array([n for n in bank if n <= 24])
    cosine, sine = (
        np.array(
            [
                left.misfit.stacked(
                    [
                        respond(
                            rec,
                            run,
                            left.base.model,
                            *_motor_wave(aligned(rec, run, left.base.model), wave, n),
                        )
                        for rec, run in zip(left.misfit.records, left.runs, strict=True)
                    ]
                )
                for n in low
            ]
        ).T
        for wave in (np.cos, np.sin)
    )
    gains = pair_gains(cosine, sine, r, project)
    found += [float(low[i]) for i in _best(gains, keep, 1)]
    return list(dict.fromkeys(found))


def _motor_wave(run: Floats, wave: np.ufunc, order: float) -> tuple[Floats, Floats]:
    """Unit torque of an order on both pinions."""
    torque = np.zeros((run.shape[0], 3))
    torque[:, 0], torque[:, 1] = wave(order * run[:, 2]), wave(order * run[:, 3])
    return torque, np.zeros((run.shape[0], 2))


def twist_orders(left: Residual, bank: Floats) -> list[float]:
    """Orders of the motor angle in the measured twist while it turns on one flank.

    An order stands out when it exceeds its neighbours on *both* chains; the ring encoder's
    own lines are common to both and small.
    """
    rise = np.zeros(bank.size)
    n1, n2 = left.base.model.drive["N_1"], left.base.model.drive["N_2"]
    for rec, run in zip(left.misfit.records, left.runs, strict=True):
        if rec.twist is None:
            continue
        steady = (np.abs(run[:, 1]) > 0.05) & (np.abs(rec.twist).min(1) > 0.0)
        if steady.sum() * rec.dt < 2.0:
            continue
        for s in (0, 1):
            y = rec.twist[steady, s] - run[steady, 6 + s]
            y = np.clip(y - np.median(y), *np.quantile(y - np.median(y), (0.02, 0.98)))
            angle = n1 * (rec.twist[steady, s] + n2 * rec.theta[steady])
            spectrum = np.abs(np.exp(-1j * bank[:, None] * angle) @ y) / y.size
            rise += np.log(np.maximum(spectrum, 1e-300) / np.median(spectrum))
    return [float(bank[i]) for i in np.argsort(-rise)] if rise.any() else []


def place_search(
    left: Residual, effect: Effect, r: Floats, project: Projection, keep: int = 3
) -> list[dict[str, float]]:
    """Places and widths of a bump of friction over the ring-gear angle."""
    banks = {p.name: np.array(p.bank) for p in effect.parameters if p.bank}
    trials, gains = [], []
    for width in banks["width"]:
        places = banks["place"][:: max(1, int(width / 0.03))]
        columns = [
            left.misfit.stacked(
                [
                    respond(
                        rec,
                        run,
                        left.base.model,
                        *_bump(aligned(rec, run, left.base.model), place, width),
                    )
                    for rec, run in zip(left.misfit.records, left.runs, strict=True)
                ]
            )
            for place in places
        ]
        g = project(np.array(columns).T)
        gain = np.maximum(r @ g, 0.0) ** 2 / np.maximum((g * g).sum(0), 1e-9)
        for i in _best(gain, 2, 3):
            trials.append({"place": float(places[i]), "width": float(width)})
            gains.append(gain[i])
    return [trials[i] for i in np.argsort(-np.array(gains))[:keep]]


def _bump(run: Floats, place: float, width: float) -> tuple[Floats, Floats]:
    """Unit friction torque on the ring gear around a place."""
    away = (run[:, 0] - place + np.pi) % (2 * np.pi) - np.pi
    torque = np.zeros((run.shape[0], 3))
    torque[:, 2] = -np.sign(run[:, 1]) * np.exp(-0.5 * (away / width) ** 2)
    return torque, np.zeros((run.shape[0], 2))


def confusable(a: Score, b: Score) -> float:
    """Largest canonical correlation of two effects' projected columns."""

    def basis(x: Floats) -> Floats:
        u, s, _ = np.linalg.svd(x, full_matrices=False)
        return np.asarray(u[:, s > RANK_TOLERANCE * max(float(s[0]), 1e-300)])

    return float(np.linalg.svd(basis(a.columns).T @ basis(b.columns), compute_uv=False)[0])
