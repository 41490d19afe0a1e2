"""Runners against motions that are known in closed form, with nothing of theirs in common."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq

from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.compiled import OUTPUTS
from dmptm_ctrl.simulate.model import Model

DT = 1e-3
SPEED = OUTPUTS.index("omega_L")


def two_body(a, b, ratio, size):
    """Row that takes the twist of a joint, θ_a − ratio θ_b, out of the angles."""
    row = np.zeros(size)
    row[a], row[b] = 1.0, -ratio
    return row


def assembled(drive, compliance=0.0):
    """M, D, K and the torque input of the linear drive, joint by joint.

    Bodies: pinions, ring gear, and where the reducers are compliant the motors, seen at
    the pinion.
    """
    n1, n2 = drive["N_1"], drive["N_2"]
    motor = n1**2 * drive["J_m"]
    size = 5 if compliance else 3
    pinion = drive["J_2"] + (0.0 if compliance else motor)
    M = np.diag([pinion, pinion, drive["J_L"], motor, motor][:size])
    D, K = np.zeros((size, size)), np.zeros((size, size))
    for side in (0, 1):
        row = two_body(side, 2, n2, size)
        D += drive["c"] * np.outer(row, row)
        K += drive["k_m"] * np.outer(row, row)
        if compliance:
            reduced = motor * drive["J_2"] / (motor + drive["J_2"])
            row = two_body(3 + side, side, 1.0, size)
            D += 2 * 0.03 * np.sqrt(reduced / compliance) * np.outer(row, row)
            K += np.outer(row, row) / compliance
    E = np.zeros((size, 2))
    E[size - 2 if compliance else 0, 0] = E[size - 1 if compliance else 1, 1] = 1.0
    return M, D, K, E * n1 * drive["K_d"] * drive["K_M"]


def linear_run(matrices, x0, u, dt):
    """Angles and speeds at the samples, by matrix exponentials."""
    M, D, K, E = matrices
    n = len(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(M, K), -np.linalg.solve(M, D)]])
    B = np.vstack([np.zeros((n, 2)), np.linalg.solve(M, E)])
    whole = expm(dt * np.block([[A, B], [np.zeros((2, 2 * n + 2))]]))
    states = [np.asarray(x0, float)]
    for volts in u.T[:-1]:
        states.append((whole @ np.append(states[-1], volts))[: 2 * n])
    return np.array(states).T


@pytest.mark.parametrize("compliance", [0.0, 1e-5])
@pytest.mark.parametrize(
    ("method", "options", "tolerance"),
    [
        ("compiled", {"substeps": 1000}, 1e-6),
        ("reference", {"rtol": 1e-12}, 5e-9),
        ("blocks", {"rtol": 1e-10, "atol": 1e-13}, 1e-7),
    ],
)
def test_linear_drive_by_matrix_exponential(frictionless, compliance, method, options, tolerance):
    """No friction, no gap, a preload that keeps the flanks: K, D and M are all there is."""
    model = frictionless.with_values(gap_l=0.0, gap_r=0.0)
    if compliance:
        model = model.with_effect("reducer_compliance", compliance=compliance)
    matrices = assembled(model.drive, compliance)
    size = len(matrices[0])
    time = DT * np.arange(13 if method == "blocks" else 61)  # blocks are slow
    preload = np.array([0.5, -0.5])
    wave = 0.05 * np.sin(2 * np.pi * 40.0 * time)
    u = preload[:, None] + np.array([[1.0], [0.5]]) * wave
    # from the preloaded balance, so that no flank is left
    start = np.zeros(2 * size)
    torque = model.drive["N_1"] * model.drive["K_d"] * model.drive["K_M"] * preload
    start[:2] = torque / model.drive["k_m"]
    if size == 5:
        start[3:5] = start[:2]  # motors turn with their pinions at the start
    expected = linear_run(matrices, start, u, DT)
    x0 = np.array([*start[:3], 0.0, 0.0, 0.0])
    found = simulate(model, time, u, x0, method=method, **options).outputs
    n1 = model.drive["N_1"]
    motor = 3 if size == 5 else 0
    rows = {
        "theta_L": expected[2],
        "omega_L": expected[size + 2],
        "theta_ml": n1 * expected[motor],
        "theta_mr": n1 * expected[motor + 1],
        "z_l": expected[0] - model.drive["N_2"] * expected[2],
        "z_r": expected[1] - model.drive["N_2"] * expected[2],
    }
    for name, row in rows.items():
        error = np.abs(found[OUTPUTS.index(name)] - row).max() / np.ptp(row)
        assert error < tolerance, name


@pytest.fixture(scope="module")
def coulomb(paper):
    """Pinion chains alone, in a gap that they never cross, dry and viscous friction."""
    free = {"gap_l": 100.0, "gap_r": 100.0, "c_f": 0.0}
    dry = {f"T3{kind}_{way}": 2.0 for kind in "sc" for way in ("plus", "minus")}
    viscous = {"B3_plus": 0.5, "B3_minus": 0.5}
    return paper.with_values(**free, **dry, **viscous)


METHODS = [
    ("compiled", {"substeps": 64}, 1e-5),
    ("reference", {"rtol": 1e-12}, 5e-9),
    ("blocks", {"rtol": 1e-9, "atol": 1e-12}, 1e-6),
]


@pytest.mark.parametrize(("method", "options", "tolerance"), METHODS)
def test_start_and_stop_of_a_body_with_dry_friction(coulomb, method, options, tolerance):
    """u drives the chain with T = g u − Tc over time constant J/B, then it runs down and stays."""
    drive = coulomb.drive
    gain = drive["N_1"] * drive["K_d"] * drive["K_M"]
    inertia = drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]
    pushed, total = 0.1, 0.5
    time = DT * np.arange(round(total / DT) + 1)
    volts = 0.5
    u = np.where(time < pushed - DT / 2, volts, 0.0) * np.array([[1.0], [-1.0]])
    found = simulate(coulomb, time, u, np.zeros(6), method=method, **options).outputs
    tau = inertia / 0.5
    final = (gain * volts - 2.0) / 0.5
    peak = final * (1.0 - np.exp(-pushed / tau))
    reached = final * (pushed - tau * (1.0 - np.exp(-pushed / tau)))
    running_down = tau * np.log(1.0 + peak * 0.5 / 2.0)
    coasted = tau * peak - 2.0 / 0.5 * running_down
    angle = drive["N_1"] * (reached + coasted)
    rest = time > pushed + running_down + DT
    assert rest.sum() > 50
    left, right = found[OUTPUTS.index("theta_ml")], found[OUTPUTS.index("theta_mr")]
    assert np.abs(left[rest] - angle).max() / angle < tolerance
    np.testing.assert_allclose(right, -left, rtol=1e-9, atol=1e-12)
    assert np.ptp(left[rest]) == 0.0  # it stays, not nearly


@pytest.mark.parametrize(("method", "options", "tolerance"), METHODS)
def test_presliding_is_dahls_curve(coulomb, method, options, tolerance):
    """Pushed below breakaway, energy gives the turning point: ∫F dx of F = Fs (1 − e^(−x/x0))."""
    model = coulomb.with_values(B3_plus=0.0, B3_minus=0.0).with_effect(
        "presliding", reducer_distance=2e-3
    )
    drive = model.drive
    torque = drive["N_1"] * drive["K_d"] * drive["K_M"] * 0.12
    inertia = drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]
    time = DT * np.arange(41)
    u = np.full((2, time.size), 0.12)
    found = simulate(model, time, u, np.zeros(6), method=method, **options).outputs
    x = found[OUTPUTS.index("theta_ml")] / drive["N_1"]
    first = slice(1, int(np.argmax(x)))
    # energy: ½ J ω² = T x − Fs (x − x0 (1 − e^(−x/x0))), time by quadrature of dx/ω
    grid = np.linspace(0.0, np.sqrt(x[first.stop - 1]), 200_001)[1:] ** 2
    kinetic = torque * grid - 2.0 * (grid - 2e-3 * (1.0 - np.exp(-grid / 2e-3)))
    speed = np.sqrt(2.0 * kinetic / inertia)
    root = np.sqrt(grid)
    integrand = 2.0 * root / speed  # smooth in √x
    start = 2.0 * np.sqrt(inertia / (2.0 * torque))  # limit at x = 0
    integrand = np.append(start, integrand)
    root = np.append(0.0, root)
    passed = np.append(0.0, np.cumsum(0.5 * np.diff(root) * (integrand[1:] + integrand[:-1])))
    when = np.interp(x[first], np.append(0.0, grid), passed)
    np.testing.assert_allclose(when, time[first], atol=max(tolerance * time[-1], 1e-8))


@pytest.mark.parametrize(("method", "options", "tolerance"), METHODS)
def test_bristles_ring_with_their_damping_ratio(coulomb, method, options, tolerance):
    """Pushed a little, the body swings on a spring Tc/x0: step response of ω0 and ζ.

    How much else it does goes with the push: half of it is half as far from the linear one.
    """
    ratio, distance = 0.3, 2e-3
    model = coulomb.with_values(B3_plus=0.0, B3_minus=0.0).with_effect(
        "presliding", reducer_distance=distance, damping=ratio
    )
    drive = model.drive
    inertia = drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]
    natural = np.sqrt(drive["T3c_plus"] / distance / inertia)
    damped = natural * np.sqrt(1.0 - ratio**2)
    time = DT * np.arange(121)
    decay = np.exp(-ratio * natural * time)
    swing = np.cos(damped * time) + ratio * natural / damped * np.sin(damped * time)
    assert damped * time[-1] > 2.0 * np.pi

    def off(volts):
        u = np.full((2, time.size), volts)
        found = simulate(model, time, u, np.zeros(6), method=method, **options).outputs
        x = found[OUTPUTS.index("theta_ml")] / drive["N_1"]
        force = volts * drive["N_1"] * drive["K_d"] * drive["K_M"]
        return np.abs(x * drive["T3c_plus"] / (force * distance) - (1.0 - decay * swing)).max()

    far, near = off(2e-3), off(1e-3)
    assert far < 0.02
    assert near == pytest.approx(0.5 * far, rel=0.05)


@pytest.mark.parametrize(("method", "options", "tolerance"), METHODS)
def test_viscous_friction_that_acts_at_once_needs_no_distance(coulomb, method, options, tolerance):
    """Without dry friction, ω = T/B (1 − e^(−Bt/J)); built up over a distance it comes later."""
    damping = 4.0
    dry = {f"T3{kind}_{way}": 0.0 for kind in "sc" for way in ("plus", "minus")}
    model = coulomb.with_values(B3_plus=damping, B3_minus=damping, **dry)
    drive = model.drive
    torque = drive["N_1"] * drive["K_d"] * drive["K_M"] * 0.05
    inertia = drive["J_2"] + drive["N_1"] ** 2 * drive["J_m"]
    time = DT * np.arange(41)
    u = np.full((2, time.size), 0.05)

    def angle(share):
        values = {"reducer_distance": 2e-3, "viscous_at_once": share}
        there = model.with_effect("presliding", **values)
        found = simulate(there, time, u, np.zeros(6), method=method, **options).outputs
        return found[OUTPUTS.index("theta_ml")] / drive["N_1"]

    tau = inertia / damping
    expected = torque / damping * (time - tau * (1.0 - np.exp(-time / tau)))
    assert expected[-1] < 0.9 * drive["gap_r"]
    np.testing.assert_allclose(angle(1.0), expected, atol=max(tolerance * expected[-1], 1e-10))
    assert angle(0.0)[-1] > 1.1 * expected[-1]


@pytest.mark.parametrize(("method", "options", "tolerance"), METHODS)
def test_a_rest_makes_breaking_away_harder(method, options, tolerance):
    """A ramp from rest breaks away when it meets Ts + rise log(1 + t/time)."""
    rise, time_constant, ramp = 8.0, 0.02, 400.0  # N·m, s, N·m/s at the ring gear
    model = Model().with_effect("unknown_breakaway", rise=rise, time=time_constant, slip=2e-4)
    drive = model.drive
    per_volt = drive["N_1"] * drive["K_d"] * drive["K_M"]
    # both pinions rest on their flanks and push; reducers without friction hand all torque on
    free = {f"T3{short}_{way}": 0.0 for short in "sc" for way in ("plus", "minus")}
    model = model.with_values(**free, B3_plus=0.0, B3_minus=0.0)
    time = DT * np.arange(round(0.12 / DT) + 1)
    volts = ramp * time / (2.0 * drive["N_2"] * per_volt)
    start = np.array([drive["gap_l"], drive["gap_r"], 0.0, 0.0, 0.0, 0.0])
    u = np.array([volts, volts])
    if method == "blocks":
        options = {}  # to a sample is enough
    found = simulate(model, time, u, start, method=method, **options).outputs
    moved = np.abs(found[OUTPUTS.index("theta_L")]) > 1e-7
    when = time[int(np.argmax(moved))]

    def short(t):
        return ramp * t - drive["TLs_plus"] - rise * np.log1p(t / time_constant)

    wanted = brentq(short, 1e-3, 0.12)
    plain = drive["TLs_plus"] / ramp
    assert wanted > 1.3 * plain
    # held from sample to sample, and a moment to move
    assert wanted - 2.0 * DT < when < wanted + 6.0 * DT
