"""Links with a declared gap whose bodies are measured at both ends.

While teeth rest on a flank, the measured twist shows what they carry,

    z + shift − gap · flank + (c/k) ż = torque/k,

and the balance of all bodies on one side of the link shows the same torque. It stands in the
twist, so that the noise of a twist does not make a stiffness small. After a reversal teeth
chatter, which no model predicts: they are off their flank by about as much as they swing, and
count less there.
Source: paper Eq. 21, in contact.
"""

from collections.abc import Container, Iterable, Mapping
from dataclasses import replace
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from dmptm_ctrl.drive.rig import Link, Rig, is_known
from dmptm_ctrl.identify.measured_motion import Motion, Moves, Nuisance, acting_by, kept
from dmptm_ctrl.simulate.along import acting_of, shift_along, stiffness_along
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

if TYPE_CHECKING:
    from dmptm_ctrl.identify.inverse_dynamics import Balance, Point


def toothed(rig: Rig, points: tuple["Point", ...], found: Container[str] = ()) -> dict[str, int]:
    """Links that are measured so, each with the equation that it takes.

    Of the two sides of a link that is the one of the point beyond it, seen from the first point.
    Gaps of some links may have been `found` where none is declared.
    """
    first: dict[str, int] = {}
    for k, point in enumerate(points):
        for body in rig.turns(point.body, rigidly=True):
            first.setdefault(body, k)
    taken = {}
    for link in (k for k in rig.links if not k.rigid and (k.name in found or _declared(k))):
        if not all(b in first and points[first[b]].sight.angle for b in (link.first, link.second)):
            continue
        cut = replace(rig, links=tuple(k for k in rig.links if k is not link))
        here = cut.turns(points[0].body)
        beyond = [b for b in (link.first, link.second) if b not in here]
        if len(beyond) == 1:
            taken[link.name] = first[beyond[0]]
    return taken


def _declared(link: Link) -> bool:
    return is_known(link.half_gap) and link.half_gap.value > 0


def side_of(model: RigModel, link: str) -> tuple[list[int], float]:
    """Coordinates on the smaller side of a link, and the sign of what the link takes of them."""
    layout, plant = model.layout, model.plant()
    ends = tuple(map(tuple, plant.body_coordinate[plant.link_body].tolist()))
    side, sign = _side(ends, layout.coordinates, layout.links.index(link))
    return [*side], sign


@cache
def _side(
    ends: tuple[tuple[int, ...], ...], count: int, index: int
) -> tuple[tuple[int, ...], float]:
    """The same of links between coordinates; fits ask again and again."""
    side, others = {ends[index][1]}, [*ends[:index], *ends[index + 1 :]]
    for _ in range(count):
        side.update(*(pair for pair in others if side & {*pair}))
    rest = {*range(count)} - side
    return (tuple(sorted(rest)), 1.0) if len(rest) < len(side) else (tuple(sorted(side)), -1.0)


def carried(model: RigModel, links: Iterable[str], left: Mapping[int, Any]) -> dict[str, Any]:
    """Torque of links at their first bodies, by what the bodies on one side leave [N·m].

    Parameters
    ----------
    left : mapping of coordinate to (n,) array
        Driving torque less what motion and friction take, without that of these links.
    """
    reach, found = untwisted(model.plant()), {}
    for name in links:
        side, sign = side_of(model, name)
        whole = sum((reach[g] * left[g] for g in side if g in left), np.zeros(1))
        found[name] = sign / lever_of(model, name) * whole
    return found


def twist_of(
    model: RigModel, name: str, motion: Motion, measured: Moves, nuisance: Nuisance
) -> tuple[Floats, Floats, Floats, Floats]:
    """Twist of a link with its errors of teeth, its rate, half-gap and stiffness, (n,) each."""
    layout, plant = model.layout, model.plant()
    k = layout.links.index(name)
    ratio, stiffness, _, _, half_gap = plant.link_values[k].tolist()
    own = [e for e in model.effects if e.on == name and PLACED_CATALOGUE[e.name].site == "mesh"]
    bodies = plant.link_body[k].tolist()
    turns = [float(plant.body_ratio[b]) for b in bodies]
    moves = [measured[int(plant.body_coordinate[b])][:2] for b in bodies]
    start = nuisance.twist.get(name, 0.0), motion.zero.get(name, 0.0)

    def turn() -> tuple[Floats, Floats, Floats, Floats]:
        near, far = ((r * q, r * v) for r, (q, v) in zip(turns, moves, strict=True))
        z = near[0] - ratio * (far[0] + start[0]) - start[1]
        wider, stiffer = np.zeros(1), np.zeros(1)
        if own:
            keys = {e.key for e in own}
            turned = model.shifted(nuisance.zero).effects
            acting = [acting_of(e) for e in turned if e.key in keys]
            shift, wider = shift_along(acting, near, far)
            z, stiffer = z + shift, stiffness_along(acting, near, far)
        return z, near[1] - ratio * far[1], wider, stiffer

    what = name, ratio, *turns, *start, acting_by(own, nuisance)
    z, rate, wider, stiffer = kept(motion, what, [x for pair in moves for x in pair], turn)
    return z, rate, half_gap + wider, stiffness + stiffer


def missing(
    model: RigModel,
    balance: "Balance",
    name: str,
    motion: Motion,
    twist: tuple[Floats, Floats, Floats, Floats],
    torque: Floats,
) -> Floats:
    """Twist that a model does not explain, as a torque at the first coordinate, (n,)."""
    z, rate, gap, stiffness = twist
    wound = z - gap * motion.flank.get(name, np.sign(z))
    calm = motion.calm.get(name, 1.0)
    return np.asarray(calm * in_twist(model, balance, name, wound, rate, torque, stiffness))


def in_twist(
    model: RigModel,
    balance: "Balance",
    name: str,
    wound: Any,
    rate: Any,
    torque: Any,
    stiffness: Any,
) -> Any:
    """Twist beyond what a torque winds a link up by, as a torque at the first coordinate.

    Times the declared stiffness: the fitted one would make its own noise small. Where that is
    unknown, times one that would let the drive ring at the bandwidth.
    """
    damping = model.plant().link_values[model.layout.links.index(name), 2]
    lever, declared = lever_of(model, name), model.quantity(f"link.{name}.stiffness").value
    if not isfinite(declared):
        declared = balance.heft * (2.0 * np.pi * balance.bandwidth / lever) ** 2
    more = wound + (damping * rate - torque) / stiffness
    return lever * declared * more


def lever_of(model: RigModel, name: str) -> float:
    """Motion of a link's first body per motion of the first coordinate, no link twisted."""
    plant = model.plant()
    body = plant.link_body[model.layout.links.index(name), 0]
    return float(untwisted(plant)[plant.body_coordinate[body]] * plant.body_ratio[body])


def shares_of(model: RigModel, name: str) -> dict[str, float]:
    """Bodies at the ends of a link of the rig, and torque on each per torque at the first."""
    link = model.rig.link(name)
    return {link.first: 1.0, link.second: abs(model.value(f"link.{name}.ratio"))}


def put_through(
    model: RigModel, left: dict[int, Floats], torques: Mapping[str, Floats]
) -> dict[int, Floats]:
    """Return what coordinates leave with the torque of links on them."""
    plant, found = model.plant(), dict(left)
    for name, torque in torques.items():
        k = model.layout.links.index(name)
        for body, factor in zip(plant.link_body[k], (1.0, -plant.link_values[k, 0]), strict=True):
            group = int(plant.body_coordinate[body])
            if group in found:
                found[group] = found[group] - plant.body_ratio[body] * factor * torque
    return found
