"""Section 4.2 on simulated rigs of known parameters, with sensors' noise and resolution.

Every estimate must lie within two of its standard errors in 95 % of seeds, and standard
errors must not be padded: the misses, in standard errors, have a mean square near 1.
"""

import numpy as np
import pytest
from benchmarks.parameter_experiments import DECLARED, rig, shaken, steady
from benchmarks.parameter_experiments import misses as campaign
from scipy.stats import chi2

from dmptm_ctrl.identify.experiments import Estimate, standard_error
from dmptm_ctrl.identify.experiments_breakaway import reducer_breakaway
from dmptm_ctrl.identify.experiments_contact import gap_damping
from dmptm_ctrl.identify.experiments_dynamic import shaken_turns
from dmptm_ctrl.identify.experiments_steady import (
    FrictionPoints,
    constant_speed,
    stribeck_fit,
)
from dmptm_ctrl.signals import Log

SEEDS = 6  # the whole campaign: benchmarks/parameter_experiments.py


@pytest.fixture(scope="module")
def misses():
    """Estimate minus truth in standard errors, by experiment and parameter."""
    return campaign(range(SEEDS))


@pytest.mark.long
def test_recovered_within_two_standard_errors_in_95_percent(misses):
    every = np.abs([z for family in misses.values() for zs in family.values() for z in zs])
    assert np.mean(every < 2) >= 0.95, f"{np.mean(every < 2):.1%} of {every.size} estimates"


@pytest.mark.long
@pytest.mark.parametrize("name", ["steady", "shaken", "flights"])
def test_standard_errors_are_neither_short_nor_padded(misses, name):
    families = list(misses[name].values())
    every = np.concatenate(families)
    assert np.mean(every**2) > 0.3
    # parameters of one fit are correlated: count the seeds, not the estimates
    assert np.mean(every**2) < chi2.ppf(0.999, SEEDS) / SEEDS


@pytest.mark.long
def test_breakaway_lies_within_its_lateness(misses):
    """Its error is no scatter but where in the lateness the motion began: at most √3 se."""
    every = np.concatenate(list(misses["breakaway"].values()))
    assert np.abs(every).max() < 2.0


def test_errors_are_small_enough_to_be_of_use():
    rng = np.random.default_rng(100)
    truth = rig(rng)
    found = {**steady(truth, rng), **shaken(truth, rng)}
    limits = {"gap_l": 2e-4, "gap_r": 3e-4, "k_m": 0.005, "J_L": 0.04, "J_2": 0.01, "c": 0.05}
    limits |= {"T3c_plus": 0.01, "TLc_plus": 0.02, "BL_minus": 0.03}
    for name, limit in limits.items():
        assert found[name].se < limit * truth[name], name


def test_estimates_by_hand():
    """Three chains of algebra without a simulator: z and u made from the equation itself."""
    k, gaps, t3, ring = 4e4, (4e-3, 3e-3), 2.0, 18.0
    pull, n1, n2 = 25 * 0.39, 25.0, 8.25
    logs = []
    for preload in (0.6, -0.6, 1.2, -1.2):
        for way in (1.0, -1.0):
            common = way * (ring / n2 + 2 * t3) / (2 * pull)
            volts = np.array([common + preload, common - preload])
            torque = pull * volts - way * t3
            z = np.sign(preload) * np.array([gaps[0], -gaps[1]]) + torque / k
            n = 2001
            turn = way * 0.1 * 1e-3 * np.arange(n)
            motors = n1 * (z[:, None] + n2 * turn)
            channels = {
                "u_left": np.full(n, volts[0]),
                "u_right": np.full(n, volts[1]),
                "theta_L": turn,
                "omega_L": np.full(n, way * 0.1),
                "theta_ml": motors[0] + 1e-9 * np.sin(np.arange(n)),
                "theta_mr": motors[1] + 1e-9 * np.cos(np.arange(n)),
                "ref": np.full(n, way * 0.1),
            }
            logs.append(Log(f"{preload}_{way}", 1e-3 * np.arange(n), channels))
    found = constant_speed(DECLARED, logs)
    assert found.estimates["gap_l"].value == pytest.approx(gaps[0], rel=1e-5)
    assert found.estimates["gap_r"].value == pytest.approx(gaps[1], rel=1e-5)
    assert found.estimates["k_m"].value == pytest.approx(k, rel=1e-4)
    np.testing.assert_allclose(found.reducer.torque, t3, rtol=1e-3)
    np.testing.assert_allclose(found.ring.torque, ring, rtol=1e-3)
    with pytest.raises(ValueError, match="one sign of preload"):
        constant_speed(DECLARED, [log for log in logs if not log.name.startswith("-")])
    with pytest.raises(ValueError, match="one size of preload"):
        constant_speed(DECLARED, [log for log in logs if "0.6" in log.name])


def test_refusals():
    n = 3000
    still = Log(
        "still",
        1e-3 * np.arange(n),
        {
            c: np.zeros(n)
            for c in ("u_left", "u_right", "theta_L", "omega_L", "theta_ml", "theta_mr", "ref")
        },
    )
    with pytest.raises(ValueError, match="no stretch of constant speed"):
        constant_speed(DECLARED, [still])
    with pytest.raises(ValueError, match="theta_ml does not move"):
        reducer_breakaway(DECLARED, [still])
    with pytest.raises(ValueError, match="0 flights"):
        gap_damping(DECLARED, still, {})
    with pytest.raises(ValueError, match="0 whole periods"):
        shaken_turns(DECLARED, [still], period=4.0, lines=[1.0])
    few = FrictionPoints("3", np.array([1.0, 2.0]), np.array([1.0, 1.0]), np.eye(2))
    with pytest.raises(ValueError, match="2 speeds in direction plus"):
        stribeck_fit(few)


def test_how_an_estimate_reads():
    assert str(Estimate(3.14159, 0.012, "N·m")) == "3.142 ± 0.012 N·m"
    assert str(Estimate(36012.3, 45.0, "N·m/rad")) == "36012 ± 45 N·m/rad"


def test_batch_means_see_slow_noise():
    """An AR(1) with a known long-run variance: plain s/√n would be four times too small."""
    rng, a = np.random.default_rng(3), 0.9
    white = rng.normal(size=(300, 4000))
    slow = np.zeros_like(white)
    for i in range(1, white.shape[1]):
        slow[:, i] = a * slow[:, i - 1] + white[:, i]
    expected = 1 / (1 - a) / np.sqrt(white.shape[1])
    assert np.sqrt(np.mean(standard_error(slow) ** 2)) == pytest.approx(expected, rel=0.1)
