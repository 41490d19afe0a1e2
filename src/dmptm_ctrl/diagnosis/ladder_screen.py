"""Before the ladder of any rig: which logs can be used, and which mistakes show at once."""

from collections.abc import Iterator, Sequence

import numpy as np

from dmptm_ctrl.diagnosis.screen import MAX_ROWS, STRANGE, VAGUE, cut
from dmptm_ctrl.drive.rig import Rig, Sensor, is_known
from dmptm_ctrl.identify.chain_free import Floats
from dmptm_ctrl.identify.inverse_dynamics import Balance
from dmptm_ctrl.signals import Log, LogError
from dmptm_ctrl.signals.campaign import without_duplicates
from dmptm_ctrl.signals.plausible import MISTAKES, refuse_factor, travelled

LEAN = 0.3  # correlation of drive and speed that tells the sign of the motors' power
SURE = 10.0  # standard errors of an inertia that contradicts its declaration
HIDDEN = 20.0  # times less: behind a soft shaft, a load hides that much of the inertia, not more


def screen_chain(rig: Rig, logs: Sequence[Log]) -> tuple[tuple[Log, ...], tuple[str, ...]]:
    """Choose the logs of a rig of any shape that can be diagnosed.

    Parameters
    ----------
    rig : Rig
    logs : sequence of Log
        As the rig reads them.

    Returns
    -------
    logs : tuple of Log
    warnings : tuple of str
        What was left out, shortened or looks wrong; each log has its own besides.

    Raises
    ------
    LogError
        No log is left, or the sensors of one body contradict each other.
    """
    distinct, warnings = without_duplicates(tuple(logs))
    kept, useless = [], []
    for log in distinct:
        refuse_other_units(rig, log)
        if why := nothing_in(rig, log):
            useless.append(f"{log.name} {why}")
            continue
        short, notes = cut(log, MAX_ROWS)
        kept.append(short)
        warnings += [f"{log.name}: {note}" for note in (*notes, *generates(rig, log))]
    if not kept:
        raise LogError(f"nothing to diagnose: {'; '.join(useless)}")
    return tuple(kept), (*warnings, *(f"left out: {text}" for text in useless))


def nothing_in(rig: Rig, log: Log) -> str:
    """Return why a log cannot tell anything; empty if it can."""
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


def refuse_other_units(rig: Rig, log: Log) -> None:
    """Refuse position and speed sensors of one body that differ in unit or sign."""
    for speed, angle in _pairs(rig):
        refuse_factor(
            log,
            log[angle.channel],
            travelled(log, speed.channel),
            f"{angle.column} ({angle.unit}) changes",
            f"{speed.column} ({speed.unit}) adds up to",
            detrend=True,
        )


def _pairs(rig: Rig) -> Iterator[tuple[Sensor, Sensor]]:
    for speed in rig.sensors:
        for angle in rig.sensors:
            if (speed.measures, angle.measures) == ("speed", "position") and (
                speed.body == angle.body
            ):
                yield speed, angle


def generates(rig: Rig, log: Log) -> list[str]:
    """Warn of an input against which its body turns over the whole log.

    With means and without: a load that is held, as a weight is, does not count, nor does friction
    that falls with speed.
    """
    notes = []
    for source in rig.inputs:
        for sensor in rig.sensors:
            if sensor.body != source.body or sensor.measures != "speed":
                continue
            u, v = log[source.channel], log[sensor.channel]
            if max(lean(u, v), lean(u - u.mean(), v - v.mean())) < -LEAN:
                notes.append(
                    f"{sensor.column} goes against {source.column} over the whole log: one of "
                    "them may count the other way (sign = -1 in the rig file)"
                )
    return notes


def lean(u: Floats, v: Floats) -> float:
    """Return the cosine between two signals, 0 where one is zero."""
    size = np.sqrt(float(u @ u) * float(v @ v))
    return float(u @ v) / size if size > 0 else 0.0


def other_scale(rig: Rig, balance: Balance) -> str:
    """Return how the logs contradict the declared inertia by a factor; empty if they do not.

    Units that all columns share contradict nothing inside a log. Where inertias, ratios and
    gains are declared, the torque per acceleration of the first measured body does:
    Σ gain u = J a + b v + c sign(v) + k q, by least squares.
    """
    point = balance.points[0]
    turns = _turns(rig, point.body)
    known = [b.inertia for b in rig.bodies] + [i.gain for i in rig.inputs]
    if len(turns) < len(rig.bodies) or not all(is_known(q) for q in known):
        return ""
    inertia, se = _inertia(rig, balance, turns)
    low, value, high = (
        sum(turns[b.name] ** 2 * x for b, x in zip(rig.bodies, ends, strict=True))
        for ends in zip(*((b.inertia.range[0], b.inertia.value, b.inertia.range[1])
                          for b in rig.bodies), strict=True)
    )  # fmt: skip
    if inertia < SURE * se or low / HIDDEN < inertia < STRANGE * high:
        return ""
    ratio = inertia / value
    near = [why for f, why in MISTAKES.items() if 1.0 / VAGUE < ratio * f < VAGUE]
    perhaps = f": perhaps {near[0]}" if near else ""  # the commonest first
    unit = "kg" if rig.body(point.body).linear else "kg·m²"
    return (
        f"the logs show an inertia of {inertia:.3g} {unit} at {point.body}, {ratio:.3g} times what "
        f"the rig file declares{perhaps}; mend units and gains in the rig file, or the inertia"
    )


def _inertia(rig: Rig, balance: Balance, turns: dict[str, float]) -> tuple[float, float]:
    """Inertia at the first point, and its standard error."""
    name = balance.points[0].name
    rows, target = [], []
    for motion in balance.motions:
        keep = motion.moving
        q, v, a = (part[name] for part in (motion.q, motion.v, motion.a))
        torque = np.sum([i.gain.value * turns[i.body] * motion.u[i.name] for i in rig.inputs], 0)
        signals = (a, v, np.sign(v), q - q.mean())
        rows.append(np.column_stack([motion.reduce(s)[keep] for s in signals]))
        target.append(motion.reduce(torque)[keep])
    table, push = np.concatenate(rows), np.concatenate(target)
    size = np.linalg.norm(table, axis=0)
    if len(push) <= table.shape[1] or np.any(size == 0):
        return 0.0, np.inf
    inverse = np.linalg.pinv((table / size).T @ (table / size))
    found = inverse @ ((table / size).T @ push)
    left = push - table / size @ found
    return float(found[0] / size[0]), float(np.sqrt(inverse[0, 0] * np.mean(left**2)) / size[0])


def _turns(rig: Rig, body: str) -> dict[str, float]:
    """Turns of each body per turn of one of them, through links of known ratio."""
    turns = {body: 1.0}
    for _ in rig.links:
        for link in rig.links:
            if not is_known(link.ratio):
                continue
            if link.first in turns:  # q_first = ratio · q_second
                turns.setdefault(link.second, turns[link.first] / link.ratio.value)
            elif link.second in turns:
                turns[link.first] = turns[link.second] * link.ratio.value
    return turns
