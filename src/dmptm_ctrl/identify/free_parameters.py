"""What a fit of a rig may move: declared quantities, effects, and what belongs to a log."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np

from dmptm_ctrl.effects.drive_offset import DRIVE_OFFSET
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.identify.fit import PRIOR_SHARE
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import FAR, Placed, RigModel, angle_body, link_inertias

OFFSET = DRIVE_OFFSET.name
ALL = ""  # in place of a log: what belongs to all of them
FASTEST = {"stiffness": 2, "damping": 1}  # power of a rate that an inertia follows them at
LEAST_SCALE = 0.01  # of the typical size of a quantity
WIDEST = 0.1  # of the travel; of a local spot
SHARES = 0.005, 0.99  # of the inertia behind a spring
NOT_FITTED = ("ratio", "gain", "gap_damping", "limit")


@dataclass(frozen=True)
class Free:
    """One number to fit.

    Attributes
    ----------
    kind : {"value", "effect", "zero", "twist"}
    owner, name : str
        Key of the declared quantity; or key and parameter of an effect; or log and effect; or
        log and link.
    scale : float
        A clearly visible size.
    prior : (centre, sigma) or None
    least : float
        Of the scale: a number that was driven to zero must find its way back.
    """

    kind: str
    owner: str
    name: str
    low: float
    high: float
    scale: float
    prior: tuple[float, float] | None = None
    least: float = 0.0

    @property
    def label(self) -> str:
        """Key of the number."""
        return self.owner if self.kind == "value" else f"{self.owner}.{self.name}"


@dataclass(frozen=True)
class Scales:
    """Typical sizes in the logs, from which those of parameters follow."""

    force: float
    position: float
    speed: float
    acceleration: float
    dt: float
    u: Mapping[str, float]

    def of(self, unit: str) -> float:
        """Size of a quantity by its unit, angles and lengths alike."""
        plain = unit.replace("N·m", "N").replace("rad", "m").replace("/(", "/")
        return {
            "N": self.force,
            "N·s/m": self.force / self.speed,
            "N·s²/m²": self.force / self.speed**2,
            "N/m": self.force / self.position,
            "kg·m²": self.force / self.acceleration,
            "kg": self.force / self.acceleration,
            "m": self.position,
            "m/s": self.speed,
            "s": self.dt,
            "": 1.0,
        }.get(plain.replace("N·m·s", "N·s"), 1.0)

    def at(self, model: RigModel, place: str, seen: str) -> "Scales":
        """Return the sizes at a body, or at the first body of a link, by those at another body."""
        layout, plant = model.layout, model.plant()
        reach, first = untwisted(plant), {k.name: k.first for k in model.rig.links}
        for name, body in zip(layout.links, plant.link_body[:, 0].tolist(), strict=True):
            first[name] = layout.bodies[body]  # effects make links, too
        body = first.get(place, place)
        turn, turn_seen = (abs(layout.ratio[b] * reach[layout.coordinate[b]]) for b in (body, seen))
        by = turn / turn_seen
        return replace(
            self,
            force=self.force / by,
            position=self.position * by,
            speed=self.speed * by,
            acceleration=self.acceleration * by,
        )


def scales_of(balance: Balance) -> Scales:
    """Return typical sizes, over all logs."""
    motions = balance.motions
    point = balance.points[0].name

    def rms(parts: Sequence[Floats]) -> float:
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) or 1.0

    return Scales(
        rms(balance.push),
        max(max(float(np.ptp(m.q[point])) for m in motions), 1e-12),
        rms([m.v[point] for m in motions]),
        rms([m.a[point] for m in motions]),
        motions[0].sample_time,
        {i.name: rms([m.u[i.name] for m in motions]) for i in balance.rig.inputs},
    )


def free_parameters(
    model: RigModel, balance: Balance, scales: Scales, *, nuisances: bool = True
) -> list[Free]:
    """Return what a fit may move: unknown and uncertain quantities, effects, and per-log terms."""
    frees = []
    seen = model.layout.sensor_body[balance.points[0].name]
    for key, quantity in model.quantities.items():
        kind, place, name = key.split(".")
        if name in NOT_FITTED or not quantity.is_free:
            continue
        if kind == "link" and place in model.closed:
            continue
        low, high = quantity.range
        known = isfinite(quantity.value)
        prior = None
        if known:
            half = 0.5 * (high - low) if isfinite(high - low) else inf
            prior = (quantity.value, PRIOR_SHARE * half)
        own = scales if kind == "input" else scales.at(model, place, seen)
        least = LEAST_SCALE * own.of(quantity.unit)
        size = max(abs(model.value(key)), least)
        ends = (low, high) if known and model.ranged else (0.0, inf)
        if kind == "link" and name in FASTEST and not known:  # samples show no faster motion
            near, far = link_inertias(model, place)
            ends = 0.0, near * far / (near + far) * (np.pi / scales.dt) ** FASTEST[name]
        frees.append(Free("value", key, name, *ends, size, prior, least))
    for effect in model.effects:
        beside = PLACED_CATALOGUE[effect.name].place in ("body", "link")
        own = scales.at(model, effect.on, seen) if beside else scales
        frees += _effect_parameters(effect, model, own)
    if not nuisances:
        return frees
    for log in balance.logs:
        frees += log_parameters(model, balance, log, balance.logs[0])
    return frees


def _effect_parameters(effect: Placed, model: RigModel, scales: Scales) -> list[Free]:
    frees = []
    linear, entry = on_slide(model, effect.on), PLACED_CATALOGUE[effect.name]
    for parameter in (p for p in entry.keep if not effect.like or p.name in entry.own):
        value = effect.values.get(parameter.name, 0.0)
        low, high, size = parameter.low, parameter.high, abs(value)
        if parameter.name == "order":
            if not linear:
                continue  # whole number per turn
            low, high = 0.98 * value, 1.02 * value
            size = 0.002 * value
        elif parameter.bank:
            # a shape stays near the member of the bank that it was found at
            low, high = value / 4, value * 4
            if parameter.name == "place":
                low, high = -inf, inf
            if parameter.name == "width":
                # wider, it is everywhere
                high = WIDEST * min(scales.position, inf if linear else 2 * np.pi)
            size = 0.3 * abs(value)
        else:
            # a gap and a bristle are tiny beside the travel
            if not (size and parameter.name in ("half_gap", "distance")):
                size = max(size, 0.05 * scales.of(parameter.unit))
            if not -1.0 <= low <= high <= 1.0 or parameter.unit:
                low = -inf if low < 0 else 0.0
                high = inf
        if parameter.unit == "s" and entry.place == "input":
            high = max(3.0 * value, 2.0 * scales.dt)  # a search far out finds aliases
        if entry.effect.search == "limits":
            high = 2.0 * value
        if parameter.name == "share":
            low, high = SHARES
        if effect.name == OFFSET:
            size = max(abs(value), 0.02 * scales.u[effect.on])
        frees.append(Free("effect", effect.key, parameter.name, low, high, size or 1.0))
    if any(e.name == OFFSET for e in model.effects):  # one constant is enough
        frees = [f for f in frees if f.name not in entry.effect.constants]
    if entry.effect.wave and entry.site == "friction" and linear:
        frees = [f for f in frees if f.name == "sine"]  # a slope along the axis
    if effect.name == SHAFT_COMPLIANCE.name and any(k.name == effect.on for k in model.rig.links):
        frees = [f for f in frees if f.name not in ("share", "far_viscous")]
    return frees


def on_slide(model: RigModel, body: str) -> bool:
    """Whether a body slides instead of turning."""
    return any(b.name == body.removesuffix(FAR) and b.linear for b in model.rig.bodies)


def log_parameters(model: RigModel, balance: Balance, log: str, reference: str) -> list[Free]:
    """Return what belongs to one log; phases are counted from those of the reference log."""
    frees = []
    layout = model.layout
    seen = balance.seen(layout)
    for k, link in enumerate(layout.links):
        ends = [layout.bodies[i] for i in model.plant().link_body[k]]
        if not all(layout.coordinate[b] in seen for b in ends):
            continue
        if not same_twist(model, balance, link):
            frees.append(Free("twist", log, link, -inf, inf, 1e-3))
        elif log == reference:  # the same zeros in every log
            frees.append(Free("twist", ALL, link, -inf, inf, 1e-3))
    for effect in model.effects:
        if log != reference and has_phase(model, balance, effect):
            size = 0.1 / effect.values.get("order", 1.0)
            frees.append(Free("zero", log, effect.key, -inf, inf, size))
    return frees


def same_twist(model: RigModel, balance: Balance, link: str) -> bool:
    """Whether the angles of both ends of a link have the same zeros in every log."""
    layout, plant = model.layout, model.plant()
    ends = plant.link_body[layout.links.index(link)]
    return all(absolute(model, balance, layout.bodies[i]) for i in ends)


def has_phase(model: RigModel, balance: Balance, effect: Placed) -> bool:
    """Whether an effect goes with the angle, of which each log has its own zero."""
    entry = PLACED_CATALOGUE[effect.name]
    slope = entry.site == "friction" and on_slide(model, effect.on)
    return (
        entry.effect.wave and not slope and not absolute(model, balance, angle_body(model, effect))
    )


def absolute(model: RigModel, balance: Balance, body: str) -> bool:
    """Whether the angle of a body has the same zero in every log."""
    group = model.layout.coordinate[body]
    return any(
        s.absolute and model.layout.coordinate[model.layout.sensor_body[s.name]] == group
        for s in balance.rig.sensors
    )
