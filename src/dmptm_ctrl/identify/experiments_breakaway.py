"""Static friction from slow voltage ramps.

A body at rest breaks away when what drives it exceeds Ts. In a gap the pinion is driven by
its motor alone: Ts = N1 K_d K_M u. With both pinions on the flanks the ring gear breaks away
when N2 Σ (N1 K_d K_M u − T3s) exceeds TLs.

The motion is seen some counts late; meanwhile the torque has grown. A body of inertia J under
a torque excess Ṫ t moves x = Ṫ t³/(6 J), so it is late by at most (6 J x/Ṫ)^{1/3}; falling
friction only shortens that. Half of the excess is taken off, its uniform spread is the error.
"""

from collections.abc import Iterable, Sequence

import numpy as np

from dmptm_ctrl.drive import Drive, pinion_inertia
from dmptm_ctrl.identify.experiments import Estimate
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.model import Floats

SEEN = 2.5  # counts; one and two can be rounding of a body that gives elastically


def reducer_breakaway(drive: Drive, logs: Iterable[Log]) -> dict[str, Estimate]:
    """Measure T3s from ramps that start with both pinions in their gaps.

    Parameters
    ----------
    drive : Drive
        K_d, K_M, N1 and the inertia J̄3 (a rough one will do) are used.
    logs : iterable of Log
        Ramps of the common voltage, up or down, with motor angles.

    Returns
    -------
    dict of str to Estimate
        ``T3s_plus`` and ``T3s_minus`` [N·m], for the directions that were run.

    Raises
    ------
    ValueError
        A log in which a motor does not move, or moves from the start.
    """
    pull = drive["N_1"] * drive["K_d"] * drive["K_M"]
    found: dict[str, list[tuple[float, float]]] = {}
    for log in logs:
        for u_name, angle_name in (("u_left", "theta_ml"), ("u_right", "theta_mr")):
            u, angle = log[u_name], log[angle_name] / drive["N_1"]
            at, moved = _first_motion(log, angle_name, angle)
            torque = pull * u[at]
            rate = pull * _ramp_rate(log, u_name, at)
            torque, se = _taken_off(torque, rate, moved, pinion_inertia(drive))
            label = "plus" if u[at] > 0.0 else "minus"
            found.setdefault(f"T3s_{label}", []).append((abs(torque), se))
    return {name: _combine(values) for name, values in found.items()}


def ring_breakaway(
    drive: Drive, logs: Iterable[Log], reducers: dict[str, Estimate]
) -> dict[str, Estimate]:
    """Measure TLs from ramps that start with both pinions on the flanks they push.

    Parameters
    ----------
    drive : Drive
        K_d, K_M, N1, N2 and the inertias are used.
    reducers : dict of str to Estimate
        Of :func:`reducer_breakaway`.

    Returns
    -------
    dict of str to Estimate
        ``TLs_plus`` and ``TLs_minus`` [N·m], for the directions that were run.

    Raises
    ------
    ValueError
        A log in which the ring gear does not move, or a direction whose T3s is not given.
    """
    pull, n2 = drive["N_1"] * drive["K_d"] * drive["K_M"], drive["N_2"]
    inertia = drive["J_L"] + 2.0 * n2**2 * pinion_inertia(drive)
    found: dict[str, list[tuple[float, float]]] = {}
    for log in logs:
        at, moved = _first_motion(log, "theta_L", log["theta_L"])
        both = log["u_left"][at] + log["u_right"][at]
        label = "plus" if both > 0.0 else "minus"
        if f"T3s_{label}" not in reducers:
            raise ValueError(f"{log.name}: T3s_{label} is needed for the ring gear's share")
        rate = sum(_ramp_rate(log, name, at) for name in ("u_left", "u_right"))
        total, se = _taken_off(n2 * pull * both, n2 * pull * rate, moved, inertia)
        torque = abs(total) - 2.0 * n2 * reducers[f"T3s_{label}"].value
        found.setdefault(f"TLs_{label}", []).append((torque, se))
    result = {}
    for name, values in found.items():
        direct = _combine(values)
        shared = 2.0 * n2 * reducers[name.replace("TL", "T3")].se  # the same in every ramp
        result[name] = Estimate(direct.value, float(np.hypot(direct.se, shared)), "N·m")
    return result


def _first_motion(log: Log, name: str, angle: Floats) -> tuple[int, float]:
    """Sample at which a body is seen to move, and how far it had come [rad]."""
    steps = np.abs(np.diff(angle))
    if not (steps > 0.0).any():
        raise ValueError(f"{log.name}: {name} does not move; ramp further")
    count = steps[steps > 0.0].min()
    away = np.flatnonzero(np.abs(angle - angle[0]) > SEEN * count)
    if away.size == 0 or away[0] < 10:
        when = "from the start" if away.size else "by too little"
        raise ValueError(f"{log.name}: {name} moves {when}; a ramp starts at rest and ends moving")
    return int(away[0]), float(abs(angle[away[0]] - angle[0]))


def _ramp_rate(log: Log, name: str, at: int) -> float:
    return float(log[name][at] - log[name][at // 2]) / ((at - at // 2) * log.sample_time)


def _taken_off(torque: float, rate: float, moved: float, inertia: float) -> tuple[float, float]:
    """Torque [N·m] at breakaway and its standard error, from that at detection."""
    late = (6.0 * inertia * moved / abs(rate)) ** (1.0 / 3.0)
    excess = rate * late
    return torque - 0.5 * excess, abs(excess) / np.sqrt(12.0)


def _combine(values: Sequence[tuple[float, float]]) -> Estimate:
    """Mean; the lateness is alike in all, so it does not average out, the scatter does."""
    torque = np.array([v for v, _ in values])
    late = float(np.mean([se for _, se in values]))
    scatter = float(torque.std(ddof=1) / np.sqrt(torque.size)) if torque.size > 1 else 0.0
    return Estimate(float(torque.mean()), float(np.hypot(late, scatter)), "N·m")
