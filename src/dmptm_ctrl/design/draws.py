"""Plants that a model may stand for: its numbers drawn within their uncertainty."""

import numpy as np

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.model import Model

DECLARED = 1.0  # share of the declared ranges: nothing but the declaration is known
FITTED = 0.25  # what a fit to a rig's logs usually leaves of them
# Of the flanks' damping no log tells much, and pinions that hammer depend on it.
CONTACT, CONTACT_SHARE = ("c", "c_f"), 1.0
# Friction builds up over some distance on every machine. Below one and a half counts of an
# 18-bit ring encoder no log shows it, and at each reversal it is what a controller feels.
HIDDEN_DISTANCE = 3.6e-5  # rad at the ring gear
AMPLITUDES = 0.4  # relative half-width of an effect's amplitudes at share 1
_PAIRED = tuple(  # breakaway and sliding friction
    (f"T{body}s_{way}", f"T{body}c_{way}") for body in "3L" for way in ("plus", "minus")
)


def draw_plants(
    model: Model, count: int, *, uncertainty: float = DECLARED, seed: int = 0
) -> list[Model]:
    """Draw plants around a model; plant k is the same for every `count`.

    `uncertainty` is the share of the declared ranges, which are taken around the model's values;
    amplitudes of effects move by :data:`AMPLITUDES` times it, angles and orders of effects stay.
    The damping of the flanks always takes its whole range, unless nothing is uncertain, and
    friction builds up over up to :data:`HIDDEN_DISTANCE` more than the model says.
    """
    if count < 0 or uncertainty < 0.0:
        raise ValueError(f"count {count} and uncertainty {uncertainty:g} must not be negative")
    return [one_plant(model, uncertainty, seed, k) for k in range(count)]


def one_plant(model: Model, uncertainty: float, seed: int, index: int) -> Model:
    """Draw plant `index` of the series `seed`."""
    rng = np.random.default_rng([seed, index])
    values = {}
    for name, quantity in model.drive.quantities.items():
        u = rng.uniform(-1.0, 1.0)
        if quantity.is_free:
            share = CONTACT_SHARE if name in CONTACT and uncertainty > 0.0 else uncertainty
            values[name] = _moved(model.drive[name], quantity.range, share * u)
    for static, coulomb in _PAIRED:  # breakaway is not below sliding
        if static in values and coulomb in values:
            values[static] = max(values[static], values[coulomb])
    effects: dict[str, dict[str, float]] = {}
    for name, parameters in model.effects.items():
        amplitudes = CATALOGUE[name].amplitudes
        moved = 1.0 + AMPLITUDES * uncertainty * rng.uniform(-1.0, 1.0)
        effects[name] = {
            key: value * moved if key in amplitudes else value for key, value in parameters.items()
        }
    plant = Model(model.drive.with_values(**values), effects)
    more = HIDDEN_DISTANCE * rng.uniform(-0.5, 1.0)
    if uncertainty > 0.0 and ("presliding" in effects or more > 0.0):
        plant = plant.with_effect("presliding", **slow_friction(plant, more))
    return plant


def slow_friction(model: Model, more: float) -> dict[str, float]:
    """Return presliding over a longer way than the model says, `more` at the ring gear [rad].

    `more` is alike in all bodies, and may be negative; no distance is below 0.
    """
    told = model.effects.get("presliding", {})
    ratios = {"reducer_distance": model.drive["N_2"], "ring_distance": 1.0}
    return {**told, **{k: max(told.get(k, 0.0) + n * more, 0.0) for k, n in ratios.items()}}


def _moved(value: float, declared: tuple[float, float], u: float) -> float:
    """Value moved by the share u of its range; on a log scale where the range is wide."""
    low, high = declared
    if low > 0.0 and high > 4.0 * low:
        moved = value * np.exp(u * 0.5 * np.log(high / low))
    else:
        moved = value + u * 0.5 * (high - low)
    return float(np.clip(moved, min(low, value), max(high, value)))
