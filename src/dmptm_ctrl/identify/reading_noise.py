"""What the noise of readings does to a balance of torques.

The readings stand in the balance with factors that are fitted: inertias, springs, dampers.
Least squares would make those factors small, only to turn less noise into torque. What a fit
lowers is therefore the mean square less the variance that noise gives it *with these factors*: it
estimates the mean square without noise (Fuller, Measurement Error Models, 1987, sec. 2.2;
Nakamura, Biometrika 77 (1990) 127).
"""

from collections.abc import Mapping
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.identify.measured_motion import coordinates_of, recent
from dmptm_ctrl.identify.teeth import carried, in_twist, shares_of
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.plant import Plant, link_matrices, untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

if TYPE_CHECKING:
    from dmptm_ctrl.identify.inverse_dynamics import Balance

RECENT = 64  # models whose noise is kept
FREQUENCIES = 100  # at which noise is added up
ABOVE = 1.5  # of the bandwidth; the balance's filter passes no more
WALK = 3.0 / np.pi**2  # ∫ df/(2πf)² from here, over one second, is its mean square, 1/12
Complex = NDArray[np.complex128]


def noise_in_balance(model: RigModel, balance: "Balance") -> list[Floats]:
    """What the noise of readings makes of each equation: real and imaginary parts.

    One array per equation, over points and frequencies. The sum of its squares is the variance
    that noise gives the equation. Noise is white, at the density of each point's sensor.
    Friction counts by its slope far from rest, links with a gap as long as they are in contact.
    """
    plant = model.plant()
    numbers = plant.inertia, plant.link_values, plant.law[:, 3], plant.law[:, 7]
    shape = model.layout.bodies, model.layout.links, plant.link_gap.tobytes(), *_rubbing(model)
    key = shape, *(np.ascontiguousarray(x).tobytes() for x in numbers)
    found: list[Floats] = recent(balance.noises, key, lambda: _noise(model, plant, balance), RECENT)
    return found


def _noise(model: RigModel, plant: Plant, balance: "Balance") -> list[Floats]:
    """The same; most of what a fit moves changes none of it."""
    s, size = balance.noise_spectrum
    rows, springs, dampers, viscous = link_matrices(plant)
    motion = plant.inertia * s[:, None] ** 2 + viscous * s[:, None]
    pull = springs + dampers * s[:, None]
    gaps = plant.link_gap > 0
    ways = [(1.0, np.ones(gaps.size))]  # share of the time, and which links are in contact
    if gaps.any():
        share = _contact(model, plant, rows, balance)
        ways = [(share, np.ones(gaps.size)), (1.0 - share, np.where(gaps, 0.0, 1.0))]
    parts = []
    for (share, touching), (half, sign) in product(ways, _driving(model, balance)):
        need = np.eye(plant.inertia.size) * motion[:, None]
        need = need + (rows.T * (pull * touching)[:, None]) @ rows
        found = _equations(model, plant, rows, need, balance, s, sign)
        parts.append([np.sqrt(share * half) * size * equation for equation in found])
    both = [np.concatenate(each) for each in zip(*parts, strict=True)]
    return [np.concatenate([part.real.ravel(), part.imag.ravel()]) for part in both]


def _contact(model: RigModel, plant: Plant, rows: Floats, balance: "Balance") -> float:
    """Share of the time in which links with a gap touch; none where an end is not measured."""
    layout, shares = model.layout, []
    names = [p.name for p in balance.points]
    seen = coordinates_of(layout, names)
    for k in np.flatnonzero(plant.link_gap).tolist():
        ends = np.flatnonzero(rows[k]).tolist()
        if not {*ends} <= {*seen}:
            return 0.0
        first = [names[seen.index(g)] for g in ends]
        factors = tuple(
            (name, rows[k, g] / layout.ratio[layout.sensor_body[name]])
            for name, g in zip(first, ends, strict=True)
        )
        twists = balance.twists(factors)
        shares.append(1.0 - np.searchsorted(twists, plant.link_values[k, 4]) / len(twists))
    return float(np.mean(shares))


def _rubbing(model: RigModel) -> list[tuple[str, float]]:
    """Bodies whose friction follows a load, and by what share of it."""
    return [
        (e.on, e.values[entry.amplitudes[0]])
        for e in model.effects
        if (entry := PLACED_CATALOGUE[e.name]).by_load
    ]


def _driving(model: RigModel, balance: "Balance") -> list[tuple[float, float]]:
    """Shares of the time in which friction under load has the sign of the load, or the other."""
    if not balance.teeth or not _rubbing(model):
        return [(1.0, 0.0)]
    name, first = next(iter(balance.teeth)), balance.points[0].name
    signs = [np.sign(m.v[first]) * m.flank[name] for m in balance.motions if name in m.flank]
    mean = float(np.mean(np.concatenate(signs))) if signs else 0.0
    return [(0.5 * (1.0 + mean), 1.0), (0.5 * (1.0 - mean), -1.0)]


def spectrum(balance: "Balance") -> tuple[Complex, Floats]:
    """Return s = jω, and the noise of each point's position around each ω, (ω, points)."""
    longest = max(m.dt * m.time.size for m in balance.motions)
    # a speed's noise makes the angle drift: a random walk lies that far off its mean
    edges = np.geomspace(WALK / longest, ABOVE * balance.bandwidth, FREQUENCIES + 1)
    omega = np.pi * (edges[1:] + edges[:-1])
    passed = np.sqrt(np.diff(edges)) * np.abs(balance.motions[0].response(omega))
    sights = [p.sight for p in balance.points]
    size = [
        np.sqrt(k.noise) * (passed / omega if k.sensor.measures == "speed" else passed)
        for k in sights
    ]
    return np.asarray(1j * omega, np.complex128), np.array(size).T


def _equations(
    model: RigModel,
    plant: Plant,
    rows: Floats,
    need: Complex,
    balance: "Balance",
    s: Complex,
    sign: float,
) -> list[Complex]:
    """Factors of the points' positions, (ω, points), as in :func:`.inverse_dynamics.residual`.

    `rows` are the twists of links over the coordinates, `need` is the torque of each coordinate
    per position, (ω, coordinates, coordinates), `sign` that of friction under load.
    """
    layout = model.layout
    bodies = [layout.sensor_body[p.name] for p in balance.points]
    seen = [layout.coordinate[b] for b in bodies]
    first = {g: seen.index(g) for g in seen}
    hidden = [g for g in range(plant.inertia.size) if g not in first]
    equations_used = list(hidden)  # equations that say how hidden coordinates move
    ends = [np.flatnonzero(r).tolist() for r in rows[plant.link_gap == 0]]
    beyond = [g for pair in ends if 0 in pair for g in pair if g in first]
    if 0 in hidden and beyond:
        equations_used[0] = beyond[0]
    position = np.zeros((s.size, plant.inertia.size, len(seen)), complex)
    for g, k in first.items():
        position[:, g, k] = 1.0 / layout.ratio[bodies[k]]
    if hidden:
        known = need[:, equations_used] @ position
        position[:, hidden] = -np.linalg.solve(need[:, equations_used][..., hidden], known)
    torque = need @ position
    takes = plant.inertia * s[:, None] ** 2
    own = {g: -takes[:, g, None] * position[:, g] for g in range(plant.inertia.size)}
    for body, coefficient in _rubbing(model):
        g = layout.coordinate[body]
        for name, load in carried(model, balance.teeth, own).items():
            share = shares_of(model, name).get(body, 0.0)
            rubs = sign * coefficient * layout.ratio[body] * share * load
            own[g], torque[:, g] = own[g] - rubs, torque[:, g] + rubs
    reach = untwisted(plant)
    counted = [*first, 0] if equations_used != hidden else [*first]
    found = [np.einsum("g,wgp->wp", reach[counted], torque[:, counted])]
    through = _through_teeth(model, rows, position, own, s, balance)
    for k, g in enumerate(seen[1:], 1):
        if k in balance.link_of:
            found.append(through[balance.link_of[k]])
            continue
        # the difference of two readings of one coordinate has no factor that is fitted
        factor = 0.0 if g in seen[:k] else balance.heft / (reach[g] * plant.inertia[g])
        found.append(factor * torque[:, g])
    return found


def _through_teeth(
    model: RigModel,
    rows: Floats,
    position: Complex,
    left: Mapping[int, Complex],
    s: Complex,
    balance: "Balance",
) -> dict[str, Complex]:
    """The same of toothed links, in contact, by what coordinates leave."""
    plant, found = model.plant(), {}
    for name, torque in carried(model, balance.teeth, left).items():
        k = model.layout.links.index(name)
        twist = np.einsum("g,wgp->wp", rows[k], position)
        with np.errstate(divide="ignore", invalid="ignore"):  # a trial without a spring
            found[name] = balance.calm[name] * in_twist(
                model, balance, name, twist, s[:, None] * twist, torque, plant.link_values[k, 1]
            )
    return found
