"""Plants that a model may stand for: its numbers drawn within their uncertainty."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from dmptm_ctrl.simulate.any_model import (
    AnyModel,
    declared_in,
    effects_of,
    loop_parts,
    with_numbers,
)
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

DECLARED = 1.0  # share of the declared ranges: nothing but the declaration is known
FITTED = 0.25  # what a fit to a rig's logs usually leaves of them
# Of the flanks' damping no log shows much, and pinions that hammer depend on it.
CONTACT_SHARE = 1.0
# Friction builds up over some distance on every machine. Below one and a half counts of an
# 18-bit ring encoder no log shows it, and at each reversal it is what a controller feels.
HIDDEN_COUNTS, HIDDEN_DISTANCE = 1.5, 3.6e-5  # rad at the ring gear
AMPLITUDES = 0.4  # relative half-width of an effect's amplitudes at share 1


def draw_plants(
    model: AnyModel, count: int, *, uncertainty: float = DECLARED, seed: int = 0
) -> list[Any]:
    """Draw plants around a model; plant k is the same for every `count`.

    `uncertainty` is the share of the declared ranges, which are taken around the model's values;
    amplitudes of effects move by :data:`AMPLITUDES` times it, angles and orders of effects stay.
    The damping of the flanks always takes its whole range, unless nothing is uncertain, and
    friction builds up over up to :data:`HIDDEN_DISTANCE` more than the model says; on a rig
    :data:`HIDDEN_COUNTS` of its sensor.
    """
    if count < 0 or uncertainty < 0.0:
        raise ValueError(f"count {count} and uncertainty {uncertainty:g} must not be negative")
    return [one_plant(model, uncertainty, seed, k) for k in range(count)]


def one_plant(model: AnyModel, uncertainty: float, seed: int, index: int) -> Any:
    """Draw plant `index` of the series `seed`."""
    rng = np.random.default_rng([seed, index])
    quantities, own = declared_in(model)
    contact, values = _contact(model), {}
    for name in own:
        u = rng.uniform(-1.0, 1.0)
        if quantities[name].is_free:
            share = CONTACT_SHARE if name in contact and uncertainty > 0.0 else uncertainty
            values[name] = _moved(own[name], quantities[name].range, share * u)
    for static, coulomb in _paired(list(own)):  # breakaway is not below sliding
        if static in values and coulomb in values:
            values[static] = max(values[static], values[coulomb])

    def drawn(effect: Any, parameters: Mapping[str, float]) -> dict[str, float]:
        moved = 1.0 + AMPLITUDES * uncertainty * rng.uniform(-1.0, 1.0)
        return {k: v * moved if k in effect.amplitudes else v for k, v in parameters.items()}

    plant = with_numbers(model, values, drawn)
    more = hidden_distance(model) * rng.uniform(-0.5, 1.0)
    if uncertainty > 0.0 and (more > 0.0 or any("presliding" in key for key in effects_of(model))):
        plant = slow_friction(plant, more)
    return plant


def _contact(model: AnyModel) -> tuple[str, ...]:
    """Names of the flanks' damping."""
    if not isinstance(model, RigModel):
        return ("c", "c_f")
    gaps = [link.name for link in model.rig.links if link.half_gap is not None]
    return tuple(f"link.{name}.{key}" for name in gaps for key in ("damping", "gap_damping"))


def _paired(names: list[str]) -> list[tuple[str, str]]:
    """Breakaway and sliding friction of one body."""
    both = [(n, n.replace("static", "coulomb")) for n in names if "static" in n]
    both += [(f"T{b}s_{way}", f"T{b}c_{way}") for b in "3L" for way in ("plus", "minus")]
    return [pair for pair in both if set(pair) <= set(names)]


def hidden_distance(model: AnyModel) -> float:
    """Distance [rad or m] over which friction may build up without a sensor that shows it."""
    if not isinstance(model, RigModel):
        return HIDDEN_DISTANCE
    body = model.rig.sensors[loop_parts(model)[1]].body
    counts = [
        s.resolution.value
        for s in model.rig.sensors
        if s.body == body and s.measures == "position" and s.resolution is not None
    ]
    return HIDDEN_COUNTS * min(counts, default=0.0)


def slow_friction(model: AnyModel, more: float) -> Any:
    """Return a model whose friction builds up later than it says, by `more` [rad or m].

    `more` is that of the controlled body, alike in all others, and may be negative; no distance is
    below 0.
    """
    if not isinstance(model, RigModel):
        own_values = model.effects.get("presliding", {})
        ratios = {"reducer_distance": model.drive["N_2"], "ring_distance": 1.0}
        longer = {k: max(own_values.get(k, 0.0) + n * more, 0.0) for k, n in ratios.items()}
        return model.with_effect("presliding", **{**own_values, **longer})
    plant, layout = model.plant(), model.layout
    root = int(plant.sensor_body[loop_parts(model)[1]])
    per = untwisted(plant, int(plant.body_coordinate[root])) / plant.body_ratio[root]
    for k, body in enumerate(layout.bodies):
        own = next((e for e in model.effects if e.key == f"presliding@{body}"), None)
        g = layout.coordinate[body]
        rubs = plant.law[k, [1, 5]].any() or any(
            e.on == body and PLACED_CATALOGUE[e.name].site == "friction" for e in model.effects
        )
        if not rubs:
            continue
        own_values = dict(own.values) if own else {}
        longer = own_values.get("distance", 0.0) + abs(per[g] * layout.ratio[body]) * more
        effect = Placed("presliding", body, {**own_values, "distance": max(longer, 0.0)})
        model = model.with_effect(effect)
    return model


def _moved(value: float, declared: tuple[float, float], u: float) -> float:
    """Value moved by the share u of its range; on a log scale where the range is wide."""
    low, high = declared
    if low > 0.0 and high > 4.0 * low:
        moved = value * np.exp(u * 0.5 * np.log(high / low))
    else:
        moved = value + u * 0.5 * (high - low)
    return float(np.clip(moved, min(low, value), max(high, value)))
