"""Starting values of quantities that are declared unknown."""

from collections.abc import Mapping
from math import isfinite
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.drive.rig import is_known
from dmptm_ctrl.identify.free_parameters import scales_of
from dmptm_ctrl.identify.inverse_dynamics import TAIL, Balance
from dmptm_ctrl.identify.rig_fit import fit_rig
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.rig_model import RigModel, link_inertias, link_sides

STIFF = 6  # antiresonances tried for a spring of which nothing is known
LOWEST_MODE = 0.03  # of the bandwidth
HIGHEST_MODE = 1.5
DAMPING_RATIO = 0.05
GAP_SHARES = tuple(np.linspace(0.05, 0.98, 32))  # of half the range of twists, tried
MODEST = 0.02, 0.98  # share of the inertia behind a spring


class Spring(NamedTuple):
    """A spring and what lies on both sides of it, seen from its near side.

    Attributes
    ----------
    antiresonance : float [rad/s]
    near, far : float
        Inertias [kg·m² or kg].
    """

    antiresonance: float
    damping_ratio: float
    near: float
    far: float

    @property
    def stiffness(self) -> float:
        """Stiffness at the near side [N·m/rad or N/m]."""
        return self.far * self.antiresonance**2

    @property
    def damping(self) -> float:
        """Damping at the near side [N·m·s/rad or N·s/m]."""
        return 2.0 * self.damping_ratio * self.antiresonance * self.far


def rough_start(model: RigModel, balance: Balance) -> RigModel:
    """Give every unknown quantity a value of the right order."""
    scales = scales_of(balance)
    values: dict[str, float] = {}
    parts = len(model.rig.bodies)
    for key, quantity in model.quantities.items():
        if isfinite(model.values.get(key, quantity.value)):
            continue
        name = key.rpartition(".")[2]
        size = scales.of(quantity.unit)
        values[key] = {
            "inertia": size / parts,
            "gain": 1.0,
            "stiffness": 100.0 * scales.force / scales.position,
            "damping": 0.1 * scales.force / scales.speed,
            "half_gap": 0.0,
            "gap_damping": 0.0,
            "delay": 0.0,
            "time_constant": 0.0,
        }.get(name, 0.1 * size)
    return _springs(model.with_values(values), balance)


def _springs(model: RigModel, balance: Balance) -> RigModel:
    """Start springs of unknown stiffness where the logs put them."""
    for link in model.rig.links:
        if link.stiffness is None or isfinite(link.stiffness.value):
            continue
        ends = ends_of(model, balance, link.name)
        if ends is not None:
            gap = link.half_gap.value if is_known(link.half_gap) else 0.0
            spring = regress(balance, *ends, gap)
            inertias = unknown_inertias(model, link.name, spring)
            model = model.with_values({**inertias, **spring_values(model, link.name, spring)})
            continue
        starts = map(model.with_values, springs_of(model, balance, link.name))
        fits = [fit_rig(State(start), balance, iterations=3) for start in starts]
        model = min(fits, key=lambda fit: fit.loss).model
    return model


def springs_of(model: RigModel, balance: Balance, link: str) -> list[dict[str, float]]:
    """Values of a link of unknown stiffness, soft to stiff, beside the declared inertias.

    A gap that is not in the model makes a spring look soft, and inertias wrong.
    """
    known = model.declared(lambda key: key.endswith(".inertia"))
    model = model.with_values(known)
    _, far = link_inertias(model, link)
    top = 2 * np.pi * balance.bandwidth
    found = [
        spring_values(model, link, Spring(float(w), DAMPING_RATIO, far, far))
        for w in np.geomspace(LOWEST_MODE * top, HIGHEST_MODE * top, STIFF)
    ]
    return [known | values for values in found if values]


def spring_values(model: RigModel, link: str, spring: Spring) -> dict[str, float]:
    """Stiffness and damping of a link, where they are declared unknown."""
    declared = model.quantities.get(f"link.{link}.stiffness")
    if declared is None or isfinite(declared.value):
        return {}
    values = {f"link.{link}.stiffness": spring.stiffness}
    damping = model.quantities.get(f"link.{link}.damping")
    if damping is not None and not isfinite(damping.value):
        values[f"link.{link}.damping"] = spring.damping
    return values


Ends = tuple[tuple[str, float], tuple[str, float]]  # point and factor of its motion, near and far


def ends_of(model: RigModel, balance: Balance, link: str) -> Ends | None:
    """Return the points that are measured on both sides of a link; None where one is missing.

    The factors turn a point's motion into that of the link's first body.
    """
    near_ratio, far_ratio = link_sides(model, link)
    ratio = model.value(f"link.{link}.ratio")
    near = next((p for p in balance.points if p.body in near_ratio), None)
    far = next((p for p in balance.points if p.body in far_ratio), None)
    if near is None or far is None:
        return None
    return (near.name, 1.0 / near_ratio[near.body]), (far.name, ratio / far_ratio[far.body])


class Gap(NamedTuple):
    """A gap between two measured points, as wide as the logs put it.

    Attributes
    ----------
    half_gap : float
        At the near side [rad or m].
    spring : Spring
        Of the teeth in contact.
    zero : dict of log to float
        Twist that the sensors show in the middle of the gap [rad or m].
    """

    half_gap: float
    spring: Spring
    zero: dict[str, float]


def regress_gaps(
    balance: Balance, near: tuple[str, float], far: tuple[str, float], most: int = 1
) -> list[Gap]:
    """Find gaps between two measured points: the half-widths whose contact fits best.

    As `regress`, with a2 = ω_a² (z − clip(z, ±Δ)) + 2 ζ ω_a ż in contact + …
    """
    zero, reach = _middle(balance, near, far)
    tried = [
        (*_regress(balance, near, far, share * reach, zero), share * reach)
        for share in (0.0, *GAP_SHARES)
    ]
    tried.sort(key=lambda t: t[0])
    return [Gap(half_gap, spring, zero) for _, spring, half_gap in tried[:most]]


def regress(
    balance: Balance, near: tuple[str, float], far: tuple[str, float], half_gap: float = 0.0
) -> Spring:
    """Find a spring between two measured points by two linear regressions.

    a2 = ω_a² z + 2 ζ ω_a ż + friction + const and F = J1 a1 + J2 a2 + friction + const. Of each
    point its name and the factor of its motion. A gap lies in the middle of all twists.
    """
    zero = _middle(balance, near, far)[0] if half_gap else {}
    return _regress(balance, near, far, half_gap, zero)[1]


def _middle(
    balance: Balance, near: tuple[str, float], far: tuple[str, float]
) -> tuple[dict[str, float], float]:
    """Middle of the twists of each log, and half of their widest range."""
    twist: dict[str, list[Floats]] = {}
    for m in balance.motions:
        twist.setdefault(m.name, []).append(near[1] * m.q[near[0]] - far[1] * m.q[far[0]])
    zero, reach = {}, 0.0
    for log, parts in twist.items():
        low, high = np.quantile(np.concatenate(parts), [TAIL, 1.0 - TAIL])
        zero[log], reach = float(0.5 * (low + high)), max(reach, float(0.5 * (high - low)))
    return zero, reach


def _regress(
    balance: Balance,
    near: tuple[str, float],
    far: tuple[str, float],
    half_gap: float,
    zero: Mapping[str, float],
) -> tuple[float, Spring]:
    """Return what the regression of the far side leaves, and the spring."""
    shaft, target, whole, push = [], [], [], []
    one, r1 = near
    two, r2 = far
    for k, m in enumerate(balance.motions):
        keep = m.moving
        own = np.zeros((int(keep.sum()), len(balance.motions)))
        own[:, k] = 1.0
        q1, v1, a1 = (r1 * part[one] for part in (m.q, m.v, m.a))
        q2, v2, a2 = (r2 * part[two] for part in (m.q, m.v, m.a))
        z = q1 - q2 - zero.get(m.name, 0.0)
        contact = np.abs(z) >= half_gap
        behind = (z - np.clip(z, -half_gap, half_gap), (v1 - v2) * contact, v2, np.sign(v2))
        shaft.append(np.column_stack([*(m.reduce(s)[keep] for s in behind), own]))
        target.append(m.reduce(a2)[keep])
        signals = (a1, a2, v1, np.sign(v1))
        whole.append(np.column_stack([*(m.reduce(s)[keep] for s in signals), own]))
        push.append(m.reduce(balance.push[k])[keep])
    found = _solve(shaft, target)
    left = float(np.linalg.norm(np.concatenate(target) - np.concatenate(shaft) @ found))
    square, damping = found[:2]
    inertias = _solve(whole, push)[:2]
    antiresonance = float(np.sqrt(max(square, 1.0)))
    total = max(float(np.sum(inertias)), 1e-300)
    share = float(np.clip(inertias[1] / total, *MODEST)) if np.sum(inertias) > 0 else 0.5
    ratio = float(np.clip(damping / (2 * antiresonance), 1e-3, 0.5))
    return left, Spring(antiresonance, ratio, (1 - share) * total, share * total)


def _solve(rows: list[Floats], target: list[Floats]) -> Floats:
    table = np.concatenate(rows)
    size = np.linalg.norm(table, axis=0)
    size[size == 0] = 1.0
    return np.linalg.lstsq(table / size, np.concatenate(target), rcond=None)[0] / size


def unknown_inertias(model: RigModel, link: str, spring: Spring) -> dict[str, float]:
    """Inertias on both sides of a link: as declared; the unknown ones as a spring says."""
    ratio = model.value(f"link.{link}.ratio")
    found: dict[str, float] = {}
    near, far = link_sides(model, link)
    for side, whole in ((near, spring.near), (far, spring.far * ratio**2)):
        found |= _shared(model, side, whole)
    return found


def _shared(model: RigModel, side: Mapping[str, float], whole: float) -> dict[str, float]:
    """Give what known inertias leave of a whole to the unknown ones, alike."""
    keys = {b: f"body.{b}.inertia" for b in side}
    free = [b for b in side if not isfinite(model.quantity(keys[b]).value)]
    declared = {b: model.quantity(keys[b]).value for b in side if b not in free}
    known = sum(side[b] ** 2 * value for b, value in declared.items())
    rest = max(whole - known, 0.05 * whole)
    found = {keys[b]: rest / len(free) / side[b] ** 2 for b in free}
    return found | {keys[b]: value for b, value in declared.items()}
