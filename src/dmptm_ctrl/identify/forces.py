"""Torques on the bodies of a drive along a log, whose motion sensors measured.

Coordinates that are not measured are simulated between the measured ones, driven by the same
signals.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.identify.following import loaded, loads_of
from dmptm_ctrl.identify.measured_motion import (
    HELD_POSITION,
    HELD_SPEED,
    NONE,
    Motion,
    Moves,
    Nuisance,
    acting_by,
    at_samples,
    derivative,
    kept,
    recent,
)
from dmptm_ctrl.identify.teeth import carried, put_through, shares_of, twist_of
from dmptm_ctrl.simulate.along import (
    acting_of,
    built_up_along,
    delayed_along,
    friction_along,
    lagged_along,
    law_along,
    signal_along,
    torque_along,
)
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import RigRun, march, substeps_for

if TYPE_CHECKING:
    from dmptm_ctrl.identify.inverse_dynamics import Balance

TINY = 1e-300  # a speed that has a direction and no size
LOADED = 3  # times that friction under load is taken from the load that it leaves
RECENT = 16  # frictions of bodies that are kept
SUBSTEPS = 40  # of hidden coordinates; faster ones are far above the bandwidth


@dataclass(frozen=True)
class Forces:
    """Torques along a log, per coordinate that is measured.

    Attributes
    ----------
    own, need : dict of coordinate to (n,) array
        What drives give, and what motion, friction and links take; of toothed links nothing.
    left : dict of coordinate to (n,) array
        What is left, the torque of toothed links included.
    carried : dict of link to (n,) array
        Torque of toothed links by the balance of one side, see :mod:`.teeth`.
    twists : dict of link to arrays
        Their measured twists.
    moved : dict of coordinate to (n,) array
        What drives and other links give beyond what takes the motion; friction takes it.
    load, volts : dict of body to (n,) array
        What presses on its bearings, and the signal of its motor.
    """

    measured: Moves
    own: dict[int, Floats]
    need: dict[int, Floats]
    left: dict[int, Floats]
    carried: dict[str, Floats]
    twists: dict[str, tuple[Floats, Floats, Floats, Floats]]
    moved: dict[int, Floats]
    load: Mapping[str, Floats]
    volts: Mapping[str, Floats]


def forces_of(
    model: RigModel, balance: "Balance", motion: Motion, nuisance: Nuisance = NONE
) -> Forces:
    """Return the torques along a log."""
    layout, plant = model.layout, model.plant()
    measured, _ = measured_motion(model, balance, motion, nuisance)
    twists = {n: twist_of(model, n, motion, measured, nuisance) for n in balance.teeth}
    others = [name for name in layout.links if name not in twists]
    runs = _link_torques(model, motion, measured, nuisance, others) if others else {}
    zeros = dict.fromkeys(layout.bodies, np.zeros(motion.time.size))
    pushes, volts = [], {}
    for j, name in enumerate(layout.inputs):
        body = layout.input_body[name]
        volts[body] = effective_input(model, motion, name)
        pushes.append((body, plant.input_values[j, 0] * volts[body]))
    weighs = loaded(model)
    shares = {name: shares_of(model, name) for name in model.closed} if weighs else {}
    for k, name in enumerate(layout.links if weighs else ()):
        first, second = (layout.bodies[b] for b in plant.link_body[k].tolist())
        shares[name] = {first: 1.0, second: abs(float(plant.link_values[k, 0]))}

    def on_bodies(sizes: Mapping[str, Floats]) -> dict[str, Floats]:
        load = dict(zeros)
        for name, size in sizes.items():
            for body, share in shares[name].items():
                load[body] = load[body] + share * size
        return load

    sizes = {name: np.abs(torque) for name, torque in runs.items()}
    load = on_bodies(sizes) if weighs else zeros

    def braked(body: str) -> Floats:
        group = layout.coordinate[body]
        q, v, _ = measured[group]
        rubs, other = _friction(model, motion, group, q, v, load, volts, nuisance, body)
        return (rubs + other) / layout.ratio[body]

    for _ in range(LOADED if model.closed and weighs else 0):
        loads = loads_of(model, measured, dict(pushes), braked)
        sizes |= {name: _size(motion, torque) for name, torque in loads.items()}
        load = on_bodies(sizes)
    own = {group: np.zeros_like(v) for group, (_, v, _) in measured.items()}
    for body, torque in pushes:
        if (group := layout.coordinate[body]) in own:
            own[group] = own[group] + layout.ratio[body] * torque
    free = {group: own[group] - plant.inertia[group] * a for group, (_, _, a) in measured.items()}
    moved, bare = put_through(model, free, runs), dict[int, Floats]()
    # the balance of one side shows a load with less noise than a twist does
    by_side = bool(layout.links) and len(measured) == layout.coordinates
    for _ in range(LOADED if (twists or by_side) and weighs else 1):
        left = {}
        for group, move in measured.items():
            left[group] = rubbed(
                model,
                motion,
                group,
                move,
                moved[group],
                load,
                volts,
                nuisance,
                toothed=bool(twists),
            )
            bare[group] = free[group] + left[group] - moved[group]
        through = carried(model, twists, left)
        if weighs:
            shown = carried(model, layout.links, bare) if by_side else through
            load = on_bodies(sizes | {n: _size(motion, torque) for n, torque in shown.items()})
    need = {group: own[group] - left[group] for group in own}
    whole = put_through(model, left, through)
    return Forces(measured, own, need, whole, through, twists, moved, load, volts)


def rubbed(
    model: RigModel,
    motion: Motion,
    group: int,
    move: tuple[Floats, Floats, Floats],
    moved: Floats,
    load: Mapping[str, Floats],
    volts: Mapping[str, Floats],
    nuisance: Nuisance,
    *,
    toothed: bool,
) -> Floats:
    """What is left at a coordinate after friction and load torques on its bodies, (n,)."""
    q, v, _ = move
    friction, other = _friction(model, motion, group, q, v, load, volts, nuisance)
    rest = moved - other
    if not toothed:  # what holds a body beside teeth, noise of their twist hides
        friction = _at_rest(friction, rest, v, motion.rest_share)
    return np.asarray(rest - friction)


def _size(motion: Motion, torque: Floats) -> Floats:
    """Size of a torque that the balance shows: noise has one too, and must not add to it."""
    return np.asarray(torque * np.sign(motion.smooth(torque)))


def measured_motion(
    model: RigModel, balance: "Balance", motion: Motion, nuisance: Nuisance = NONE
) -> tuple[Moves, dict[int, str]]:
    """Return the motion of each measured coordinate, and the body that it was measured at.

    Where the driven coordinate has no sensor and a spring leads to one that has, its motion
    follows from the torque that the measured one takes.
    """
    layout = model.layout
    found: Moves = {}
    bodies: dict[int, str] = {}
    for point in balance.points:
        body = layout.sensor_body[point.name]
        group, r = layout.coordinate[body], layout.ratio[body]
        if group not in found:
            found[group] = motion.at(point.name, r)
            bodies[group] = body
    if 0 not in found:
        driven = _through_spring(model, motion, found, nuisance)
        if driven is not None:
            at = layout.input_body[layout.inputs[0]]
            return {0: driven, **found}, {0: at, **bodies}
    return found, bodies


def _through_spring(
    model: RigModel, motion: Motion, found: Moves, nuisance: Nuisance
) -> tuple[Floats, Floats, Floats] | None:
    """Motion of the driven coordinate from that at the other end of its spring."""
    layout, plant = model.layout, model.plant()
    for k in range(len(layout.links)):
        ends = [layout.bodies[i] for i in plant.link_body[k]]
        groups = [layout.coordinate[b] for b in ends]
        ratio, stiffness, damping = plant.link_values[k, :3]
        if plant.link_gap[k] or 0 not in groups or not {*groups} & {*found}:
            continue
        other = groups[1] if groups[0] == 0 else groups[0]
        q, v, a = found[other]
        nothing = {b: np.zeros_like(q) for b in layout.bodies}
        need = plant.inertia[other] * a
        need = need + sum(_friction(model, motion, other, q, v, nothing, {}, nuisance))
        # lever of each end on the twist z = r1 q1 − ratio r2 q2
        lever = [layout.ratio[ends[0]], -ratio * layout.ratio[ends[1]]]
        here, there = (0, 1) if groups[0] == 0 else (1, 0)
        torque = -need / lever[there]
        # k z + c ż = torque; c/k is short
        z = (torque - damping / stiffness * derivative(torque, motion.dt)) / stiffness
        rate = derivative(z, motion.dt)
        change = derivative(rate, motion.dt)
        return tuple(
            (part - lever[there] * far) / lever[here]
            for part, far in ((z, q), (rate, v), (change, a))
        )
    return None


def _link_torques(
    model: RigModel, motion: Motion, measured: Moves, nuisance: Nuisance, names: list[str]
) -> dict[str, Floats]:
    """Torques of links at their first bodies, (n,) each.

    Without gaps, between measured bodies, they follow from the twists. Else a run gives them; it
    is kept where all bodies are measured, for fits ask again.
    """
    layout, plant = model.layout, model.plant()
    everything = len(measured) == layout.coordinates
    if everything and not plant.link_gap[[layout.links.index(name) for name in names]].any():
        return {name: _wound(model, motion, measured, nuisance, name) for name in names}

    def run() -> dict[str, Floats]:
        hidden = hidden_run(model, motion, measured, nuisance)
        return {name: hidden.link(name) for name in names}

    # identities of arrays that do not last come again
    if not everything or not all(id(v) in motion.known for _, v, _ in measured.values()):
        return run()
    own = tuple((e.key, *e.values.items()) for e in model.effects if e.on in layout.links)
    shifts = (tuple(sorted(d.items())) for d in (nuisance.twist, nuisance.zero, motion.zero))
    moves = tuple(id(v) for _, v, _ in measured.values())
    key = plant.link_values.tobytes(), own, moves, *shifts
    found: dict[str, Floats] = recent(motion.known.setdefault("links", {}), key, run, RECENT)
    return found


def _wound(
    model: RigModel, motion: Motion, measured: Moves, nuisance: Nuisance, name: str
) -> Floats:
    """Torque of a link without a gap, k z + c ż, (n,)."""
    z, rate, _, stiffness = twist_of(model, name, motion, measured, nuisance)
    damping = model.plant().link_values[model.layout.links.index(name), 2]
    return np.asarray(stiffness * z + damping * rate)


def hidden_run(model: RigModel, motion: Motion, measured: Moves, nuisance: Nuisance) -> RigRun:
    """Run the coordinates that nothing measures along the measured ones."""
    layout, plant = model.layout, model.plant()
    reach = untwisted(plant)
    ratios = dict(zip(layout.links, plant.link_values[:, 0].tolist(), strict=True))
    given, position, speed = {}, {}, {}
    base_group = next(iter(measured))
    q0, v0 = measured[base_group][0][0], measured[base_group][1][0]
    for body in layout.bodies:
        group, r = layout.coordinate[body], layout.ratio[body]
        if group in measured:
            q, v, _ = measured[group]
            twist = sum(
                nuisance.twist.get(link, 0.0) + motion.zero.get(link, 0.0) / ratios[link]
                for link in {*nuisance.twist, *motion.zero}
                if link in layout.links and _second(model, link) == body
            )  # fmt: skip
            given[body] = r * q + twist, r * v
        else:
            # in step with the measured ones at the start
            position[body] = r * q0 * reach[group] / reach[base_group]
            speed[body] = r * v0 * reach[group] / reach[base_group]
    shared = {layout.coordinate[b]: b for b in given}
    u = np.array([motion.u[name] for name in layout.inputs])
    everything = len(measured) == layout.coordinates
    return march(
        model.shifted(nuisance.zero) if nuisance.zero else model,
        u,
        motion.dt,
        position=position,
        speed=speed,
        given={b: given[b] for b in shared.values()},
        substeps=1 if everything else min(substeps_for(plant, motion.dt), SUBSTEPS * motion.thin),
    )


def _second(model: RigModel, link: str) -> str:
    plant, layout = model.plant(), model.layout
    return layout.bodies[plant.link_body[layout.links.index(link), 1]]


def _friction(
    model: RigModel,
    motion: Motion,
    group: int,
    q: Floats,
    v: Floats,
    load: Mapping[str, Floats],
    volts: Mapping[str, Floats],
    nuisance: Nuisance,
    only: str = "",
) -> tuple[Floats, Floats]:
    """Friction, and load torques, of a coordinate, signed against the motion (to be overcome).

    Of all its bodies, or of one.
    """
    layout, plant = model.layout, model.plant()
    tied = [k for k, b in enumerate(layout.bodies) if layout.coordinate[b] == group]
    # one body's bristles carry what rubs on all that are tied to it
    slow = next((k for k in tied if plant.bristles[k, 0]), None)
    parts = [layout.bodies.index(only)] if only else tied
    names = [layout.bodies[k] for k in parts]
    acting = [e for e in model.effects if e.on in names]

    def rub() -> tuple[Floats, Floats]:
        friction, other = np.zeros_like(v), np.zeros_like(v)
        for k, body in zip(parts, names, strict=True):
            r = layout.ratio[body]
            level = _sliding(motion, v, r, plant.law[k])
            factor: Floats | float = 1.0
            more: Floats | float = 0.0
            for effect in (e for e in acting if e.on == body):
                site = PLACED_CATALOGUE[effect.name].site
                if site == "friction":
                    scale, added = _rubbing(effect, motion, q, v, r, nuisance, load[body])
                    factor, more = factor * scale, more + r * added
                elif site in ("motor", "load"):
                    other -= r * _pushing(effect, motion, q, v, r, nuisance, volts.get(body))
            friction += factor * (level + more)
        if slow is not None:
            bristles = (
                plant.bristles[slow, 0] / abs(plant.body_ratio[slow]),
                plant.bristles[slow, 1],
            )
            begins, travel = np.zeros(1, np.int64), np.gradient(q)
            friction = built_up_along(
                friction, _nowhere_still(v), travel, begins, bristles, plant.law[slow]
            )
        return friction, other

    if any(PLACED_CATALOGUE[e.name].by_load for e in acting):
        return rub()
    laws = (x.tobytes() for x in (plant.law[tied], plant.body_ratio[tied], plant.bristles))
    what = (*names, *laws, acting_by(acting, nuisance))
    pushed = [volts[b] for b in names if b in volts]
    found: tuple[Floats, Floats] = kept(motion, what, [q, v, *pushed], rub)
    return found


def _turning(motion: Motion, q: Floats, v: Floats, r: float, zero: float) -> tuple[Floats, Floats]:
    """Angle and speed of a body along a log; the speed has a direction everywhere."""
    found: tuple[Floats, Floats] = kept(
        motion, (r, zero), [q, v], lambda: (r * q + zero, r * _nowhere_still(v))
    )
    return found


def _rubbing(
    effect: Placed, motion: Motion, q: Floats, v: Floats, r: float, nuisance: Nuisance, load: Floats
) -> tuple[Floats, Floats]:
    """Factor on a body's friction, and friction that is added, along a log, (n,) each."""

    def rub() -> tuple[Floats, Floats]:
        theta, omega = _turning(motion, q, v, r, nuisance.zero.get(effect.key, 0.0))
        scale, added = friction_along([acting_of(effect)], theta, omega, motion.time, load)
        share = unfolded(effect, omega, motion)
        return 1.0 + share * (scale - 1.0), share * np.where(omega > 0.0, added, -added)

    if PLACED_CATALOGUE[effect.name].by_load:
        return rub()
    found: tuple[Floats, Floats] = kept(motion, (r, acting_by([effect], nuisance)), [q, v], rub)
    return found


def _pushing(
    effect: Placed,
    motion: Motion,
    q: Floats,
    v: Floats,
    r: float,
    nuisance: Nuisance,
    u: Floats | None,
) -> Floats:
    """Torque of an effect on a body that moves as measured, along a log, (n,)."""

    def push() -> Floats:
        theta, omega = _turning(motion, q, v, r, nuisance.zero.get(effect.key, 0.0))
        signal = np.zeros_like(v) if u is None else u
        torque = torque_along([acting_of(effect)], signal, theta, omega, motion.time)
        return np.asarray(unfolded(effect, omega, motion) * torque)

    driven = [] if u is None else [u]
    found: Floats = kept(motion, (r, acting_by([effect], nuisance)), [q, v, *driven], push)
    return found


def unfolded(effect: Placed, omega: Floats, motion: Motion) -> Floats | float:
    """Share of a wave over the angle that counts at samples, (n,).

    All of what passes the filter of the balance; nothing of what is so fast that samples would
    fold it into its band.
    """
    order = effect.values.get("order", 0.0)
    if not order:
        return 1.0
    low, high = motion.bandwidth, 1.0 / motion.dt - motion.bandwidth
    beyond = (np.abs(order * omega) / (2.0 * np.pi) - low) / (high - low)
    return np.asarray(0.5 + 0.5 * np.cos(np.pi * np.clip(beyond, 0.0, 1.0)))


def _nowhere_still(v: Floats) -> Floats:
    """Speed with a direction everywhere: friction at rest has a size, if no direction."""
    return np.where(v == 0.0, TINY, v)


def _sliding(motion: Motion, v: Floats, ratio: float, law: Floats) -> Floats | float:
    """Friction of a body at its coordinate; kept along measured motion, for fits ask again."""
    if not np.any(law[[0, 1, 3, 4, 5, 7]]):
        return 0.0

    def slide() -> Floats:
        return ratio * law_along(ratio * _nowhere_still(v), law)

    found: Floats = recent(motion.known.get(id(v), {}), (ratio, law.tobytes()), slide, RECENT)
    return found


def _at_rest(friction: Floats, needed: Floats, v: Floats, share: float) -> Floats:
    """Friction with the set-valued part at rest: whatever holds the body, up to its level."""
    level = np.abs(friction)
    return np.where(resting(v, share), np.clip(needed, -level, level), friction)


def resting(v: Floats, share: float) -> NDArray[np.bool_]:
    """Where a body counts as at rest: friction there is whatever holds it."""
    return np.asarray(np.abs(v) < share * np.abs(v).max(initial=0.0))


def effective_input(model: RigModel, motion: Motion, name: str) -> Floats:
    """Signal of an input as it acts, around the samples, (n,): effects, limit, dead time, lag.

    The logged signal is held from each sample to the next. It is delayed and lagged, not the
    motion taken back in time: that would amplify the noise of readings.
    """
    own = [
        e for e in model.effects if e.on == name and PLACED_CATALOGUE[e.name].site == "amplifier"
    ]
    _, dead, tau, limit = model.plant().input_values[model.layout.inputs.index(name)].tolist()

    def act() -> Floats:
        signal, thin, dt = motion.sent[name], motion.thin, motion.sample_time
        time = motion.time[0] + dt * (np.arange(signal.size) - thin // 2)
        for effect in own:
            signal = signal_along([acting_of(effect)], signal, time)
        if limit > 0:
            signal = np.clip(signal, -limit, limit)
        if dead + tau > 0:
            before = float(signal[0])
            signal = delayed_along(signal, dead / dt, before)
            signal = lagged_along(signal, np.full_like(signal, tau), dt, before)
        signal = at_samples(signal, HELD_SPEED if motion.by_speed else HELD_POSITION)
        return signal.reshape(-1, thin).mean(axis=1)

    what = (acting_by(own), dead, tau, limit)
    found: Floats = kept(motion, what, [motion.sent[name]], act)
    return found
