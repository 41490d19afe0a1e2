"""Before the diagnosis of any rig: which logs can be used, and which mistakes show at once."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.diagnosis.screen import LEAN, STRANGE, VAGUE, mistakes_near
from dmptm_ctrl.drive.rig import Rig, Sensor, is_known
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.signals.campaign import without_duplicates
from dmptm_ctrl.signals.plausible import (
    MISTAKES,
    NAMED,
    SAME_UNIT,
    lean,
    motion_ratio,
    refuse_factor,
    travelled,
)
from dmptm_ctrl.signals.plausible import SURE as SURE_PAIR
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.model import Floats

SURE = 10.0  # standard errors of an inertia that contradicts its declaration
KINEMATIC = 0.99  # correlation above which one position follows another through a soft link
INVERSE = 0.25  # of a ratio's error in logarithms, below which its inverse fits far better
SCALED = 1.05  # factor between two sensors of one motion that a good pair does not have
TWIST = 10.0  # times more than a wrong ratio leaves, a soft link would have to twist
HIDDEN = 20.0  # times less: behind a soft shaft, a load hides that much of the inertia, not more


def screen_rig(rig: Rig, logs: Sequence[Log]) -> tuple[tuple[Log, ...], tuple[str, ...]]:
    """Choose the logs of a rig of any shape that can be diagnosed; LogError where none is left.

    And warnings: what was left out or looks wrong; each log has its own besides. Sensors of one
    body that contradict each other are refused by a LogError, too.
    """
    distinct, warnings = without_duplicates(tuple(logs))
    kept, useless = [], []
    seen: set[str] = set()  # factors that all logs show are said once
    for log in distinct:
        notes = refuse_other_units(rig, log)
        if why := nothing_in(rig, log):
            useless.append(f"{log.name} {why}")
            continue
        kept.append(log)
        notes = [note for note in notes if note.partition(" times ")[2] not in seen]
        seen |= {note.partition(" times ")[2] for note in notes}
        warnings += [f"{log.name}: {note}" for note in (*notes, *generates(rig, log))]
    if not kept:
        raise LogError(f"nothing to diagnose: {'; '.join(useless)}")
    return tuple(kept), (*warnings, *(f"left out: {text}" for text in useless))


def nothing_in(rig: Rig, log: Log) -> str:
    """Return why a log cannot show anything; empty if it can."""
    constant = [i for i in rig.inputs if np.ptp(log[i.channel]) == 0]
    if len(constant) == len(rig.inputs) and (
        len(rig.inputs) == 1 or not any(np.any(log[i.channel]) for i in rig.inputs)
    ):
        columns = " and ".join(i.column for i in constant)
        return f"has no excitation: {columns} never changes"
    still = [s for s in rig.sensors if np.ptp(log[s.channel]) == 0]
    if len(still) == len(rig.sensors):
        return f"has no motion: {' and '.join(s.column for s in still)} never changes"
    for sensor in still:
        others = [s for s in rig.sensors if s.body == sensor.body and s not in still]
        if others:
            return (
                f"has a stuck sensor: {sensor.column} stays where it is while "
                f"{others[0].column} changes"
            )
    return ""


def refuse_other_units(rig: Rig, log: Log) -> list[str]:
    """Refuse sensors of one body, or across links, that differ in unit, sign or ratio.

    Factors that a sensor's gain may have are reported, not refused.
    """
    notes = []
    for one, other, path in _pairs(rig):
        y, x = _travel(log, one), path.ratio * _travel(log, other)
        slope, correlation = motion_ratio(log, y, x)
        if abs(correlation) < (SURE_PAIR if path.rigid else KINEMATIC):
            continue
        what = "adds up to" if other.measures == "speed" else "does"
        if not path.links:
            this = f"{one.column} ({one.unit}) changes"
            expected = f"{other.column} ({other.unit}) {what}"
            refuse_factor(log, y, x, this, expected, detrend=True)
        elif not SAME_UNIT[0] <= slope <= SAME_UNIT[1] or _inverted(path, slope):
            raise LogError(f"{log.name}: {_other_ratio(one, other, path, slope)}")
        # the twist of a soft link is no multiple of the motion
        scaled = path.rigid or np.std(y - x) > TWIST * np.std(y - slope * x)
        if scaled and not 1 / SCALED < abs(slope) < SCALED and abs(correlation) > KINEMATIC:
            notes.append(
                f"{one.column} moves {slope * path.ratio:.4g} times what {other.column} {what}, "
                f"where {path.ratio:.4g} is declared: one of the two has another scale"
                + ", or the ratio is wrong"
                * bool(path.links)
            )
    return notes


class _Path(NamedTuple):
    """How one body moves with another."""

    ratio: float  # turns of the first per turn of the second
    links: tuple[str, ...]
    rigid: bool


def _inverted(path: _Path, slope: float) -> bool:
    """Whether the inverse of a ratio fits the logs far better than the ratio itself."""
    off = abs(np.log(abs(slope)))
    return off > np.log(SCALED) and abs(np.log(abs(slope * path.ratio**2))) < INVERSE * off


def _other_ratio(one: Sensor, other: Sensor, path: _Path, slope: float) -> str:
    """Sentence about a ratio that the logs contradict."""
    shown = slope * path.ratio
    turned = (
        "the ratio is the wrong way round; it is turns of the first body per turn of the second"
        + "; and one of the two counts the other way (sign = -1)" * bool(shown < 0)
    )
    other_way = "one of the two counts the other way (sign = -1), or the ratio is negative"
    causes = [(abs(shown * path.ratio), turned), (abs(slope), other_way)]
    causes += [(slope / f, text) for f, text in MISTAKES.items() if slope / f > 0]
    offs = [abs(np.log(factor)) for factor, _ in causes]
    best = int(np.argmax(np.isclose(offs, min(offs))))  # the first of those that fit alike
    why = causes[best][1] if offs[best] < np.log(NAMED) else "a wrong ratio or unit"
    said = " and ".join(path.links)
    return (
        f"{one.column} moves {shown:.3g} times what {other.column} does, where {said} "
        f"say{'s' * (len(path.links) == 1)} {path.ratio:.3g}: {why}"
    )


def _travel(log: Log, sensor: Sensor) -> Floats:
    if sensor.measures == "speed":
        return travelled(log, sensor.channel)
    return log[sensor.channel]


def _pairs(rig: Rig) -> Iterator[tuple[Sensor, Sensor, _Path]]:
    """Sensors that must agree, a position before a speed."""
    ordered = sorted(rig.sensors, key=lambda s: s.measures != "position")
    for i, one in enumerate(ordered):
        for other in ordered[i + 1 :]:
            yield one, other, _path(rig, one.body, other.body)


def _path(rig: Rig, body: str, to: str) -> _Path:
    """Way from one body to another, through links."""
    paths = {body: _Path(1.0, (), True)}
    for _ in rig.links:
        for link in rig.links:
            for here, there, step in (
                (link.first, link.second, link.ratio.value),
                (link.second, link.first, 1 / link.ratio.value),
            ):
                if here in paths and there not in paths:
                    before = paths[here]
                    name = f"[{'mesh' if link.mesh else 'shaft'}.{link.name}]"
                    links, rigid = (*before.links, name), before.rigid and link.rigid
                    paths[there] = _Path(before.ratio * step, links, rigid)
    return paths[to]


def generates(rig: Rig, log: Log) -> list[str]:
    """Warn of an input against which its body turns over the whole log.

    With means and without: a load that is held, as a weight is, does not count, nor does friction
    that falls with speed.
    """
    notes = []
    for source in rig.inputs:
        for sensor in rig.sensors:
            if sensor.body != source.body:
                continue
            way = -1.0 if is_known(source.gain) and source.gain.value < 0 else 1.0
            u, v = way * log[source.channel], log[sensor.channel]
            if sensor.measures == "position":
                v = np.gradient(v)
            if max(lean(u, v), lean(u - u.mean(), v - v.mean())) < -LEAN:
                notes.append(
                    f"{sensor.column} goes against {source.column} over the whole log: one of "
                    "them may count the other way (sign = -1 in the rig file)"
                )
                break
    return notes


def refuse_reversed(rig: Rig, balance: Balance) -> str:
    """Refuse inputs that count against the motion: a negative inertia, and energy that comes out.

    Return a warning where the inertia is negative but the drive puts energy in, or where a spring
    lies between drive and sensor, as resonances make it; empty if nothing is wrong.
    """
    point = balance.points[0]
    turns = rig.turns(point.body)
    if len(rig.inputs) > 1 and not all(is_known(i.gain) for i in rig.inputs):
        return ""
    columns = " and ".join(i.column for i in rig.inputs)
    each = {log: _inertia(rig, balance.only([log]), turns) for log in balance.logs}
    wrong = [name for name, (found, se, out) in each.items() if found < -SURE * se and out < 0]
    inertia, se, energy = _inertia(rig, balance, turns)
    if wrong and any(found > SURE * se for found, se, _ in each.values()):
        raise LogError(
            f"{', '.join(wrong)}: {columns} or {_column(rig, point.name)} counts the other way "
            f"than in the other logs: {_mass(rig, point.body, True)} of {each[wrong[0]][0]:.3g} "
            f"{_inertia_unit(rig, point.body)} at {point.body}"
        )
    if inertia > -SURE * se:
        return ""
    shown = f"{_inertia_unit(rig, point.body)} at {point.body}"
    if is_known(rig.inputs[0].gain):
        said = (
            f"the logs show {_mass(rig, point.body, True)} of {inertia:.3g} {shown}: {columns} or "
            f"{_column(rig, point.name)} counts the other way (sign = -1 in the rig file)"
        )
    else:  # then the direction is not declared, either
        said = (
            f"[input.{rig.inputs[0].name}] has no gain that would say which way {columns} pushes, "
            f"and the logs show that it pushes against {_column(rig, point.name)}: with sign = -1 "
            f"there the {_mass(rig, point.body)} is {-inertia:.3g} {shown}"
        )
    ways = [_path(rig, point.body, i.body) for i in rig.inputs]
    if (energy < 0 or wrong) and all(way.rigid for way in ways):
        raise LogError(said)
    return said


def _column(rig: Rig, sensor: str) -> str:
    return next(s.column for s in rig.sensors if s.name == sensor)


def _mass(rig: Rig, body: str, article: bool = False) -> str:
    """What accelerates slower: the inertia of a body that turns, the mass of one that slides."""
    what = "mass" if rig.body(body).linear else "inertia"
    return f"{'a' if what == 'mass' else 'an'} {what}" if article else what


def _inertia_unit(rig: Rig, body: str) -> str:
    """Unit of an inertia; per unit of the input where its gain is not known."""
    linear = rig.body(body).linear
    if all(is_known(i.gain) for i in rig.inputs):
        return "kg" if linear else "kg·m²"
    source = rig.inputs[0]
    unit = parse_unit(source.unit).symbol or "per unit"
    return f"({unit} of {source.column})/({'m' if linear else 'rad'}/s²)"


def refuse_no_gain(rig: Rig, balance: Balance) -> None:
    """Refuse an inertia in kg·m² that the logs contradict, beside an input of unknown gain."""
    source = rig.inputs[0]
    point = balance.points[0]
    turns = rig.turns(point.body)
    known = all(is_known(b.inertia) for b in rig.bodies)
    if len(rig.inputs) > 1 or is_known(source.gain) or not known:
        return
    inertia, se, _ = _inertia(rig, balance, turns)
    low, value, high = _declared(rig, turns)
    if inertia < SURE * se or low / VAGUE < inertia < VAGUE * high:
        return
    body, what = rig.body(point.body), _mass(rig, point.body)
    raise LogError(
        f"[input.{source.name}] has no gain, so that torques count in the unit of {source.column}; "
        f"in it the logs show {_mass(rig, body.name, True)} of {inertia:.3g} at {point.body}, "
        f"where the rig file declares {value:.3g} {'kg' if body.linear else 'kg·m²'}: give the "
        f"gain (with this {what} {value / inertia:.3g} {body.force_unit} per "
        f"{parse_unit(source.unit).symbol or 'unit'}), or write that the {what} is unknown"
    )


def other_scale(rig: Rig, balance: Balance) -> str:
    """Return how the logs contradict the declared inertia by a factor; empty if they do not.

    Units that all columns share contradict nothing inside a log. Where inertias, ratios and
    gains are declared, the torque per acceleration of the first measured body does:
    Σ gain u = J a + b v + c sign(v) + k q, by least squares.
    """
    point = balance.points[0]
    turns = rig.turns(point.body)
    known = [b.inertia for b in rig.bodies] + [i.gain for i in rig.inputs]
    if not all(is_known(q) for q in known):
        return ""
    inertia, se, _ = _inertia(rig, balance, turns)
    low, value, high = _declared(rig, turns)
    if inertia < SURE * se or low / HIDDEN < inertia < STRANGE * high:
        return ""
    ratio = inertia / value
    near = mistakes_near(1.0 / ratio)
    for link in rig.links:
        other = replace(link, ratio=replace(link.ratio, value=1 / link.ratio.value))
        inverted = replace(rig, links=tuple(other if k is link else k for k in rig.links))
        if 1.0 / VAGUE < inertia / _declared(inverted, inverted.turns(point.body))[1] < VAGUE:
            near = [f"the ratio of {link.name} is the wrong way round", *near]
    perhaps = f": perhaps {near[0]}" if near else ""
    return (
        f"the logs show {_mass(rig, point.body, True)} of {inertia:.3g} "
        f"{_inertia_unit(rig, point.body)} at {point.body}, {ratio:.3g} times what the rig file "
        f"declares{perhaps}; mend units and gains in the rig file, or the {_mass(rig, point.body)}"
    )


def _declared(rig: Rig, turns: dict[str, float]) -> tuple[float, float, float]:
    """Least, declared and greatest inertia of all bodies, as the first point feels it."""
    low, value, high = (
        sum(turns[b.name] ** 2 * x for b, x in zip(rig.bodies, ends, strict=True))
        for ends in zip(*((b.inertia.range[0], b.inertia.value, b.inertia.range[1])
                          for b in rig.bodies), strict=True)
    )  # fmt: skip
    return low, value, high


def _inertia(rig: Rig, balance: Balance, turns: dict[str, float]) -> tuple[float, float, float]:
    """Inertia at the first point, its standard error, and the energy that goes in.

    A gain that is not known counts as 1. Energy with and without the mean torque, the lesser:
    a weight that is let down gives energy, too.
    """
    name = balance.points[0].name
    rows, target = [], []
    energy, without = 0.0, 0.0
    for motion in balance.motions:
        keep = motion.moving
        q, v, a = (part[name] for part in (motion.q, motion.v, motion.a))
        gains = {i.name: i.gain.value if is_known(i.gain) else 1.0 for i in rig.inputs}
        torque = np.sum([gains[i.name] * turns[i.body] * motion.u[i.name] for i in rig.inputs], 0)
        energy += float(torque @ v)
        without += float((torque - torque.mean()) @ v)
        signals = (a, v, np.sign(v), q - q.mean(), *_weights(rig, turns, q))
        rows.append(np.column_stack([motion.reduce(s)[keep] for s in signals]))
        target.append(motion.reduce(torque)[keep])
    table, push = np.concatenate(rows), np.concatenate(target)
    size = np.linalg.norm(table, axis=0)
    if len(push) <= table.shape[1] or np.any(size == 0):
        return 0.0, np.inf, 0.0
    inverse = np.linalg.pinv((table / size).T @ (table / size))
    found = inverse @ ((table / size).T @ push)
    left = push - table / size @ found
    se = float(np.sqrt(inverse[0, 0] * np.mean(left**2)) / size[0])
    return float(found[0] / size[0]), se, min(energy, without)


def _weights(rig: Rig, turns: dict[str, float], q: Floats) -> list[Floats]:
    """Sine and cosine of the angles of bodies that turn: what weights on them may do."""
    ratios = {turns[b.name] for b in rig.bodies if not b.linear}
    return [wave(r * q) for r in ratios for wave in (np.sin, np.cos)]
