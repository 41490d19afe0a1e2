"""What a drive of any shape may lack: every effect at every place, with starting values."""

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from dmptm_ctrl.contract import Parameter
from dmptm_ctrl.diagnosis.candidate import JOINED, members
from dmptm_ctrl.diagnosis.rig_shapes import (
    frequencies,
    motion_of,
    orders,
    spots,
    unit_columns,
)
from dmptm_ctrl.diagnosis.rig_tangent import Tangent, Trial
from dmptm_ctrl.drive.rig import DECLARES, is_known
from dmptm_ctrl.effects.backlash_variation import BACKLASH_VARIATION
from dmptm_ctrl.effects.coulomb_friction import COULOMB_FRICTION
from dmptm_ctrl.effects.shaft_compliance import SHAFT_COMPLIANCE
from dmptm_ctrl.effects.stribeck_friction import STRIBECK_FRICTION
from dmptm_ctrl.effects.viscous_friction import VISCOUS_FRICTION
from dmptm_ctrl.identify.forces import measured_motion
from dmptm_ctrl.identify.free_parameters import ALL, absolute, on_slide, same_twist, scales_of
from dmptm_ctrl.identify.gap_search import gap_start
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.identify.rig_fit import residuals
from dmptm_ctrl.identify.rig_start import (
    ends_of,
    regress,
    regress_gaps,
    spring_values,
    unknown_inertias,
)
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import BACKLASH, PLACED_CATALOGUE, PlacedEffect
from dmptm_ctrl.simulate.rig_model import FAR, Placed, RigModel, angle_body, placed_at

DELAYS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)  # sample times
LONGEST_DELAY = 0.2  # s
OFFSET = 0.02  # of the input's size
BANDS = (0.01, 0.05, 0.15)  # dead bands, of the input's size
LIMITS = (0.95, 0.8, 0.6, 0.4)  # saturations, of the input's peaks
PEAKS = (0.99, 1.0)  # quantiles of the input; the highest may be a short spike
SPEEDS = (0.01, 0.03, 0.06, 0.12, 0.25)  # Stribeck speeds, of the highest
SIZES = (1e-5, 1e-4, 1e-3, 1e-2)  # bristles, of the travel
MEASURED_GAPS = 3  # tried where both ends are measured: a wide one and a stiff link look alike
HIDDEN_MODES = 14  # antiresonances tried
SHARES = (0.25, 0.6)  # of the inertia behind a spring, tried
FRICTION = COULOMB_FRICTION.name, VISCOUS_FRICTION.name, STRIBECK_FRICTION.name
SPRING = SHAFT_COMPLIANCE.name


# -- every place -------------------------------------------------------------------------------


def trials(tangent: Tangent, only: Sequence[str] | None = None) -> list[Trial]:
    """Return every effect at every legal place, at the best of its starting values."""
    model = tangent.fit.model
    present = {e.key for e in model.effects}
    found: list[Trial | None] = []

    def wanted(entry: PlacedEffect, places: Sequence[str]) -> Iterator[tuple[str, ...]]:
        """Each place, and those of one make together."""
        for on in (*((place,) for place in places), *makes(model, entry, places)):
            key = f"{entry.name}@{JOINED.join(on)}"
            if present.isdisjoint(members(key)) and (only is None or key in only):
                yield on

    for entry in PLACED_CATALOGUE.values():
        if entry.place == "input" and entry.stands_in(model.rig):
            for on in wanted(entry, model.layout.inputs):
                found.append(_input_effect(tangent, entry, on))
    for name, entry in PLACED_CATALOGUE.items():
        if entry.place != "body" or name == SPRING:
            continue
        bodies = bodies_for(tangent, entry)
        for on in wanted(entry, [b for b in bodies if not declared_already(model, name, b)]):
            found.append(_body_effect(tangent, entry, on))
    for entry in (c for c in PLACED_CATALOGUE.values() if c.site == "mesh"):
        for on in wanted(entry, [k.name for k in model.rig.links]):
            found.append(_mesh_effect(tangent, entry, on))
    return [t for t in found if t is not None]


def makes(model: RigModel, entry: PlacedEffect, places: Sequence[str]) -> Iterator[tuple[str, ...]]:
    """Places of one make that may have an effect together, and all whose friction may change so.

    Where each has a phase of its own, they must move by themselves.
    """
    factor = entry.place == "body" and not entry.effect.wave and _factors(entry)
    rubbing = tuple(b.name for b in model.rig.bodies if factor and _rubs(model, b.name))
    known = places if entry.of_make else ()
    alike = (tuple(p for p in model.rig.alike(place) if p in places) for place in known)
    for group in dict.fromkeys((rubbing, *alike)):
        moving = {model.layout.coordinate.get(p, p) for p in group}
        if len(group) > 1 and (not entry.own or len(moving) == len(group)):
            yield group


def structures(
    tangent: Tangent, only: Collection[str] | None = None, left_out: Collection[str] = ()
) -> list[Trial]:
    """Return springs and gaps, which change how many coordinates move, or cost most to try."""
    present = {*(e.key for e in tangent.fit.model.effects), *left_out}

    def wanted(key: str) -> bool:
        return key not in present and (only is None or key in only)

    springs = (s for s in _compliances(tangent) if wanted(s[0][0][0].key))
    found = [_finite(tangent, *one) for one in (*springs, *_gaps(tangent, wanted))]
    return [t for t in found if t is not None]


def declared_already(model: RigModel, name: str, body: str) -> bool:
    """Whether the rig declares what an effect would add to a body."""
    if body.endswith(FAR):
        return name == VISCOUS_FRICTION.name  # part of the compliance that made the body
    friction = model.rig.body(body).friction
    return any(k in friction for k in DECLARES.get(name, ()))


def bodies_for(tangent: Tangent, entry: PlacedEffect) -> list[str]:
    """Bodies at which an effect is identified: of a rigid group the one that it can act on.

    Friction under load acts where links end, what scales friction where there is some, and what
    goes with a motor's angle at the motor. A wave of one turn has another period on each body
    that turns at a rate of its own, measured or not.
    """
    model = tangent.fit.model
    layout, ends = model.layout, {b for k in model.rig.links for b in (k.first, k.second)}
    driven = {*layout.input_body.values()}
    under_load = entry.by_load
    if entry.effect.wave and not entry.effect.search and not _factors(entry):
        turns = {(layout.coordinate[b], abs(layout.ratio[b])): b for b in reversed(layout.bodies)}
        return [*turns.values()][::-1]
    found = []
    _, measured = measured_motion(model, tangent.balance, tangent.balance.motions[0])
    for seen in measured.values():
        group = [b for b in layout.bodies if layout.coordinate[b] == layout.coordinate[seen]]
        group.sort(key=lambda b: b != seen)
        if under_load:
            found += [b for b in group if b in ends and _rubs(model, b)] or [seen]
        elif entry.site == "presliding" or _factors(entry):
            found.append(next((b for b in group if _rubs(model, b)), seen))
        elif entry.site == "motor" and entry.effect.wave:
            found.append(next((b for b in group if b in driven), seen))
        else:
            found.append(seen)
    return found


def _factors(entry: PlacedEffect) -> list[Parameter]:
    """Amplitudes that scale the friction which is there."""
    return [p for p in entry.keep if p.name in entry.amplitudes and not p.unit]


def _input_effect(tangent: Tangent, entry: PlacedEffect, on: tuple[str, ...]) -> Trial | None:
    scales = scales_of(tangent.balance)
    size, dt = scales.u[on[0]], scales.dt
    (number,) = entry.amplitudes
    if entry.effect.search == "limits":
        sent = np.concatenate([np.abs(m.sent[p]) for m in tangent.balance.motions for p in on])
        values = [1.0 / (s * p) for p in np.quantile(sent, PEAKS) if p > 0 for s in LIMITS]
    elif entry.keep[0].unit == "s":
        values = [d * dt for d in DELAYS if d * dt <= LONGEST_DELAY]
    elif entry.effect.kink:
        values = [s * size for s in BANDS]
    else:
        values = [OFFSET * size]
    tries = [placed_at(entry.name, on, {number: v}) for v in values]
    return _finite(tangent, tries, scaled=not entry.effect.kink)


def _body_effect(tangent: Tangent, entry: PlacedEffect, on: tuple[str, ...]) -> Trial | None:
    model, balance, body = tangent.fit.model, tangent.balance, on[0]
    name, slide = entry.name, on_slide(model, body)
    if name == STRIBECK_FRICTION.name and not _rubs(model, body, (COULOMB_FRICTION.name,)):
        return None  # it is what breakaway exceeds Coulomb friction by
    factors = _factors(entry)
    slow = entry.site == "presliding"
    own = (slow or factors) and not entry.by_load
    if own and not _rubs(model, body):
        return None
    if slow:
        travel = scales_of(balance).position
        (number,) = entry.amplitudes
        return _finite(tangent, [placed_at(name, on, {number: s * travel}) for s in SIZES])
    shapes = _shapes(tangent, entry, body)
    if factors:
        first = {factors[0].name: factors[0].step}
        return _finite(tangent, [placed_at(name, on, first | one) for one in shapes], scaled=True)
    if not entry.effect.wave:
        return _linear(tangent, entry, on, shapes)
    if slide and not entry.effect.search:
        if entry.site != "friction":
            return None  # the way of a slide has no turns
        return _linear(tangent, entry, on, [{}], ("sine",))  # a slope along it
    same = absolute(model, balance, body)
    return _linear(tangent, entry, on, shapes, ("cosine", "sine"), same)


def _mesh_effect(tangent: Tangent, entry: PlacedEffect, on: tuple[str, ...]) -> Trial | None:
    """Try an error of teeth or gears where the angle that it goes with is measured."""
    link, own = tangent.fit.model.rig.link(on[0]), tangent.fit
    tangent = tangent.beside_declared_meshes
    model, balance, layout = tangent.fit.model, tangent.balance, tangent.fit.model.layout
    body = angle_body(model, Placed(entry.name, link.name))
    measured, _ = measured_motion(model, balance, balance.motions[0])
    if not link.mesh or link.rigid or link.name in model.closed or on_slide(model, body):
        return None
    if layout.coordinate[body] not in measured:
        return None
    if (
        entry.name == BACKLASH_VARIATION.name
        and not model.plant().link_gap[layout.links.index(link.name)]
    ):
        return None
    pushed = None
    if entry.effect.search == "orders":
        constant = Placed(entry.name, link.name, {"order": 0.0})
        pushed = unit_columns(tangent.fit, balance, constant, ("cosine",))
    shapes = _shapes(tangent, entry, body, pushed)
    same = absolute(model, balance, body)
    found = _linear(tangent, entry, on, shapes, ("cosine", "sine"), same)
    moved = {k: v for k, v in model.values.items() if v != own.model.values.get(k)}
    twist = {log: n.twist for log, n in tangent.fit.state.logs.items()}
    return found and replace(found, values=moved, twist=twist)


def _shapes(
    tangent: Tangent, entry: PlacedEffect, body: str, pushed: Sequence[Floats] | None = None
) -> list[dict[str, float]]:
    """Values of what has no meaning at zero amplitude, to try; `pushed` as of :func:`orders`."""
    model, motions = tangent.fit.model, tangent.balance.motions
    search = entry.effect.search
    if search == "orders":
        return [{"order": n} for n in orders(tangent, body, pushed)]
    if search == "frequencies":
        return [{"frequency": f} for f in frequencies(tangent)]
    if search == "places":
        return spots(tangent, body)
    banks = {p.name: p.bank for p in entry.keep if p.bank}
    if "time_constant" in banks:
        return [{"time_constant": s * tangent.balance.longest} for s in (0.1, 0.3, 1.0)]
    if "speed" in banks:
        fastest = max(
            float(np.abs(motion_of(tangent.balance, m, model, body)[1]).max()) for m in motions
        )
        return [{"speed": s * fastest} for s in SPEEDS]
    return [{"order": n} for n in sorted(banks["order"])] if "order" in banks else [{}]


def _rubs(model: RigModel, body: str, laws: Sequence[str] = FRICTION) -> bool:
    """Whether a body has friction by one of some laws."""
    if any(e.on == body and e.name in laws for e in model.effects):
        return True
    return any(declared_already(model, name, body) for name in laws)


# -- by amplitude: linear ----------------------------------------------------------------------


def _linear(
    tangent: Tangent,
    entry: PlacedEffect,
    on: tuple[str, ...],
    shapes: Sequence[Mapping[str, float]],
    names: tuple[str, ...] | None = None,
    same: bool = True,
) -> Trial | None:
    """Best of several shapes, amplitudes solved for; `same` where logs share the angle's zero."""
    names = names or entry.amplitudes
    logs, each = tangent.balance.logs, len(names)
    low = {p.name: p.low for p in entry.keep}
    best: tuple[float, Trial] | None = None
    for shape in shapes:
        parts = _columns_at(tangent, entry, on, shape, names)
        per_log = not same and len(logs) > 1 and entry.effect.wave
        wide = _per_log(parts, tangent.balance) if per_log else parts
        gain, amplitudes = tangent.score(wide)
        pairs = amplitudes.reshape(-1, parts[0].shape[-1])
        zero: dict[str, dict[str, float]] = {log: {} for log in logs[1:]} if per_log else {}
        if any(low[n] >= 0 and pairs[0][j] < 0 for j, n in enumerate(names)):
            gain = 0.0  # friction that drives, a spring that pushes
        if best is not None and gain <= best[0]:
            continue
        placed = []
        for k, one in enumerate(placed_at(entry.name, on, shape)):
            mine = pairs[:, k * each : (k + 1) * each] if entry.own else pairs
            sizes = mine[0]
            if per_log:
                sizes, shifts = _common_phase(mine, logs, shape.get("order", 1.0))
                for log, shift in shifts.items():
                    zero[log][one.key] = shift
            sized = {n: max(float(a), 0.0) if low[n] >= 0 else float(a)
                     for n, a in zip(names, sizes, strict=True)}  # fmt: skip
            placed.append(one._replace(values={**shape, **sized}))
        best = gain, Trial(tuple(placed), tuple(wide), zero, gain=gain)
    return best[1] if best else None


def _columns_at(
    tangent: Tangent,
    entry: PlacedEffect,
    on: Sequence[str],
    shape: Mapping[str, float],
    names: tuple[str, ...],
) -> list[Floats]:
    """Columns of amplitudes; of places of one make together, or beside each other."""

    def at(place: str) -> list[Floats]:
        key = entry.name, place, names, tuple(shape.items())
        if key not in tangent.columns:
            placed = Placed(entry.name, place, shape)
            tangent.columns[key] = unit_columns(tangent.fit, tangent.balance, placed, names)
        return tangent.columns[key]

    together = zip(*map(at, on), strict=True)
    return [np.concatenate(p, axis=-1) if entry.own else np.sum(p, axis=0) for p in together]


def _per_log(parts: Sequence[Floats], balance: Balance) -> list[Floats]:
    wide, logs = [], balance.logs
    for part, motion in zip(parts, balance.motions, strict=True):
        padded, k = np.zeros((*part.shape[:2], part.shape[2] * len(logs))), logs.index(motion.name)
        padded[:, :, k * part.shape[2] : (k + 1) * part.shape[2]] = part
        wide.append(padded)
    return wide


def _common_phase(
    pairs: Floats, logs: Sequence[str], order: float
) -> tuple[Floats, dict[str, float]]:
    """One amplitude for all logs, and the shift of the angle in each after the first.

    C cos n(θ + z) + S sin n(θ + z) has the complex amplitude (C − iS) e^{inz}.
    """
    complex_ = pairs[:, 0] - 1j * pairs[:, 1]
    size = float(np.sqrt(np.mean(np.abs(complex_) ** 2)))
    first = complex_[0] / (abs(complex_[0]) or 1.0) * size
    zero = {
        log: float(np.angle(c / first) / order) if first else 0.0
        for log, c in zip(logs[1:], complex_[1:], strict=True)
    }
    return np.array([first.real, -first.imag]), zero


# -- at finite sizes ---------------------------------------------------------------------------


def _finite(
    tangent: Tangent,
    tries: Sequence[tuple[Placed, ...]],
    values: Sequence[Mapping[str, float]] = ({},),
    twist: Mapping[str, Mapping[str, float]] | None = None,
    *,
    scaled: bool = False,
) -> Trial | None:
    """Best of several finite sizes, each beside several `values` of the declared quantities.

    `scaled` where the effect is linear in its amplitude.
    """
    best: tuple[float, Trial] | None = None
    target = tangent.target
    for beside, placed in product(values, tries):
        trial = Trial(placed, (), {}, beside, twist or {})
        try:
            moved, _ = residuals(trial.placed_in(tangent.fit.state), tangent.balance)
        except (ValueError, ArithmeticError):
            continue
        parts = tuple((m - e)[..., None] for m, e in zip(moved, tangent.fit.left, strict=True))
        if not all(np.isfinite(p).all() for p in parts):
            continue
        change = tangent.project(tangent.stack(parts)[:, 0])
        gain = float(target @ target - (target + change) @ (target + change))
        if scaled:
            entry = PLACED_CATALOGUE[placed[0].name]
            gain, (by,) = tangent.score(parts)
            if by < 0 and any(p.low >= 0 for p in entry.keep if p.name in entry.amplitudes):
                gain = by = 0.0
            sized = {k: v * float(by) if k in entry.amplitudes else v
                     for k, v in placed[0].values.items()}  # fmt: skip
            placed = tuple(p._replace(values=sized) for p in placed)
        if best is None or gain > best[0]:
            best = gain, replace(trial, placed=placed, columns=parts, gain=gain)
    return best[1] if best else None


# effects to try, values of declared quantities to try each beside, and twists per log
Structure = tuple[
    Sequence[tuple[Placed, ...]],
    Sequence[Mapping[str, float]],
    Mapping[str, Mapping[str, float]],
]


def _compliances(tangent: Tangent) -> Iterator[Structure]:
    """Springs in rigid links; of a drive without links, in its body."""
    model, balance = tangent.fit.model, tangent.balance
    if any(e.name == SPRING for e in model.effects):
        return
    low = max(5.0 / balance.longest, balance.bandwidth / 100.0)
    modes = 2 * np.pi * np.geomspace(low, balance.bandwidth, HIDDEN_MODES)
    for link in (k for k in model.rig.links if k.rigid):
        ends = ends_of(model, balance, link.name)
        if ends is None and any(balance.bursts):
            continue  # hidden bodies follow; how a spring moves them shows in runs only
        if ends is None:
            yield [(_spring(link.name, 0.5, float(w)),) for w in modes], [{}], {}
        else:
            spring = regress(balance, *ends)
            start = _spring(link.name, 0.5, spring.antiresonance, spring.damping_ratio)
            yield [(start,)], [unknown_inertias(model, link.name, spring)], {}
    for body in () if model.rig.links else model.rig.bodies:
        own = [p for p in balance.points if p.body == body.name]
        far = tuple(s for p in own[1:] for s in p.sensors)
        if far:
            ends_here = (own[0].name, 1.0), (own[1].name, 1.0)
            spring = regress(balance, *ends_here)
            share = spring.far / (spring.near + spring.far)
            start = _spring(body.name, share, spring.antiresonance, spring.damping_ratio, far)
            yield [(start,)], [{}], {}
            continue
        sides = [(), own[0].sensors]  # the sensor may be behind the spring
        yield [
            (_spring(body.name, share, float(w), 0.05, side),)
            for side in sides for w in modes for share in SHARES
        ], [{}], {}  # fmt: skip


def _spring(
    on: str, share: float, antiresonance: float, damping: float = 0.05, far: tuple[str, ...] = ()
) -> Placed:
    values = {"share": share, "antiresonance": antiresonance, "damping_ratio": damping}
    return Placed(SPRING, on, values, far)


def _gaps(tangent: Tangent, wanted: Callable[[str], bool]) -> Iterator[Structure]:
    """Gaps in links that are not rigid, where they are wanted: to search for one takes long."""
    model, balance = tangent.fit.model, tangent.balance
    declared = {k.name: k for k in model.rig.links}
    seen = balance.seen(model.layout)
    for link in model.layout.links:
        if link in declared and is_known(declared[link].half_gap):
            continue
        if not wanted(Placed(BACKLASH.name, link).key):
            continue
        if 0 not in seen:
            continue  # through a gap, the driven body's motion does not follow from the other's
        ends = ends_of(model, balance, link) if link in declared else None
        if ends is None:
            if (start := gap_start(model, balance, link, tangent.surprise)) is not None:
                yield [start[0]], [start[1]], {}
            continue
        if not all(p in m.angles for m in balance.motions for p, _ in ends):
            continue  # an integrated speed drifts by more than a gap
        for gap in regress_gaps(balance, *ends, MEASURED_GAPS):
            if gap.half_gap == 0:
                continue
            values = {**unknown_inertias(model, link, gap.spring)}
            values |= spring_values(model, link, gap.spring)
            ratio = model.value(f"link.{link}.ratio")
            twist = {log: {link: zero / ratio} for log, zero in gap.zero.items()}
            if same_twist(model, balance, link):
                twist = {ALL: {link: float(np.mean([t[link] for t in twist.values()]))}}
            yield [(Placed(BACKLASH.name, link, {"half_gap": gap.half_gap}),)], [values], twist
