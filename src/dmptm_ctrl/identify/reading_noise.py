"""What the noise of readings does to a balance of torques.

The readings stand in the balance with factors that are fitted: inertias, springs, dampers.
Least squares would make those factors small, only to turn less noise into torque. What a fit
lowers is therefore the mean square less the variance that noise gives it *with these factors*: it
estimates the mean square without noise (Fuller, Measurement Error Models, 1987, sec. 2.2;
Nakamura, Biometrika 77 (1990) 127).
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.plant import Plant, link_matrices, untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

if TYPE_CHECKING:
    from dmptm_ctrl.identify.inverse_dynamics import Balance

FREQUENCIES = 100  # at which noise is added up
ABOVE = 1.5  # of the bandwidth; the balance's filter passes no more
OPEN = 1e-12  # of the stiffness of teeth that do not touch
WALK = 3.0 / np.pi**2  # ∫ df/(2πf)² from here, over one second, is its mean square, 1/12
Complex = NDArray[np.complex128]


def noise_in_balance(model: RigModel, balance: "Balance") -> list[Floats]:
    """What the noise of readings makes of each equation: real and imaginary parts.

    One array per equation, over points and frequencies. The sum of its squares is the variance
    that noise gives the equation. Noise is white, at the density of each point's sensor.
    Friction counts by its slope far from rest, links with a gap as long as they are in contact.
    """
    s, size = balance.noise_spectrum
    plant = model.plant()
    found = [size * equation for equation in _equations(model, plant, balance, s)]
    if np.any(plant.link_gap):
        share = _contact(model, plant, balance)
        values = plant.link_values * np.where(plant.link_gap == 0, 1.0, OPEN)[:, None]
        values[:, 0] = plant.link_values[:, 0]
        opened = _equations(model, plant._replace(link_values=values), balance, s)
        found = [
            np.concatenate([np.sqrt(share) * one, np.sqrt(1.0 - share) * size * other])
            for one, other in zip(found, opened, strict=True)
        ]
    return [np.concatenate([part.real.ravel(), part.imag.ravel()]) for part in found]


def _contact(model: RigModel, plant: Plant, balance: "Balance") -> float:
    """Share of the time in which links with a gap touch; none where an end is not measured."""
    layout, shares = model.layout, []
    seen = {layout.coordinate[layout.sensor_body[p.name]]: p for p in reversed(balance.points)}
    for k in np.flatnonzero(plant.link_gap).tolist():
        row = link_matrices(plant)[0][k]
        ends = np.flatnonzero(row).tolist()
        if not {*ends} <= {*seen}:
            return 0.0
        factors = tuple(
            (seen[g].name, row[g] / layout.ratio[layout.sensor_body[seen[g].name]]) for g in ends
        )
        twists = balance.twists(factors)
        shares.append(1.0 - np.searchsorted(twists, plant.link_values[k, 4]) / len(twists))
    return float(np.mean(shares))


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


def _equations(model: RigModel, plant: Plant, balance: "Balance", s: Complex) -> list[Complex]:
    """Factors of the points' positions, (ω, points), as in :func:`.inverse_dynamics.residual`."""
    layout = model.layout
    bodies = [layout.sensor_body[p.name] for p in balance.points]
    seen = [layout.coordinate[b] for b in bodies]
    motion, stiffness = _moving(plant, s), _twisting(plant, s)
    need = motion + stiffness
    first = {g: seen.index(g) for g in seen}
    hidden = [g for g in range(len(plant.inertia)) if g not in first]
    rows = list(hidden)  # equations that say how hidden coordinates move
    ends = [np.flatnonzero(r).tolist() for r in link_matrices(plant)[0][plant.link_gap == 0]]
    beyond = [g for pair in ends if 0 in pair for g in pair if g in first]
    if 0 in hidden and beyond:
        rows[0] = beyond[0]
    position = np.zeros((s.size, len(plant.inertia), len(seen)), complex)
    for g, k in first.items():
        position[:, g, k] = 1.0 / layout.ratio[bodies[k]]
    if hidden:
        told = need[:, rows] @ position
        position[:, hidden] = -np.linalg.solve(need[:, rows][..., hidden], told)
    torque = need @ position
    reach = untwisted(plant)
    counted = [*first, 0] if rows != hidden else [*first]
    lag = plant.input_values[0, 2] if len(layout.inputs) == 1 else 0.0
    found = [(1.0 + lag * s)[:, None] * np.einsum("g,wgp->wp", reach[counted], torque[:, counted])]
    for k, g in enumerate(seen[1:], 1):
        # the difference of two readings of one coordinate has no factor that is fitted
        factor = 0.0 if g in seen[:k] else balance.heft / (reach[g] * plant.inertia[g])
        found.append(factor * torque[:, g])
    return found


def _moving(plant: Plant, s: Complex) -> Complex:
    """Torque that inertia and friction take per position, (ω, coordinates, coordinates)."""
    viscous = link_matrices(plant)[3]
    return (
        np.eye(len(plant.inertia))
        * (plant.inertia * s[:, None] ** 2 + viscous * s[:, None])[:, None]
    )


def _twisting(plant: Plant, s: Complex) -> Complex:
    """Torque of the links per position, (ω, coordinates, coordinates)."""
    rows, stiffness, dampers, _ = link_matrices(plant)
    return (rows.T * (stiffness + dampers * s[:, None])[:, None]) @ rows
