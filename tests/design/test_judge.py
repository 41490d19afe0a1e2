"""Impact, preload and Monte-Carlo of a controller, against what is known another way."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from scipy.stats import norm

from dmptm_ctrl.control.pi import sampled_drive
from dmptm_ctrl.control.tuning import assess_pi
from dmptm_ctrl.design.aims import Aims
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.design.duty import DEG, Duty, sine
from dmptm_ctrl.design.impact import SWEEP_HZ, _falls, impact, margins, swept_gains
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.design.montecarlo import CHUNK, MonteCarlo, monte_carlo
from dmptm_ctrl.design.preload import (
    SCHEDULES,
    assess_preload,
    boundary,
    common_volts_along,
    schedules,
)
from dmptm_ctrl.plots.control import plot_preload, plot_schedules
from dmptm_ctrl.simulate.compiled import close_loop
from dmptm_ctrl.simulate.model import Model

DRIVE = Model()
LOOP = Controller(10.0, 400.0, preload=0.5, inertia=1.0, friction=1.0, effects=1.0, lead=5e-4)
LATE = DRIVE.with_effect("drive_delay", delay=3e-3)
SHORT = Duty(np.concatenate([np.zeros(300), sine(8 * DEG, 1.0, 1.0)]), settling=0.3)


def test_a_delay_costs_the_phase_that_it_must():
    """ω_c T_d, at the crossover of either drive, which the delay hardly moves."""
    found = impact(LATE, LOOP, duty=SHORT)
    rows = found.table
    lost = rows.loc["phase margin at 15 deg/s, deg"]
    crossover = rows.loc["crossover at 15 deg/s, Hz", "augmented"]
    assert lost["nominal"] - lost["augmented"] == pytest.approx(360 * crossover * 3e-3, rel=0.06)
    error = rows.loc["tracking error rms, deg/s"]
    assert error["augmented"] > 1.2 * error["nominal"]
    panels = found.plot()
    assert len(panels) == 3
    plt.close(panels[0].figure)


def test_bandwidth_is_where_a_swept_gain_falls():
    """A first-order lag of 10 Hz; a gain that stays has none inside the sweep."""
    hz = np.geomspace(1.0, 100.0, 200)
    assert _falls(hz, 1.0 / np.sqrt(1.0 + (hz / 10.0) ** 2)) == pytest.approx(10.0, rel=1e-3)
    assert _falls(hz, np.ones(200)) == np.inf


def test_margins_are_those_of_the_linear_loop():
    plain = Controller(LOOP.kp, LOOP.ki)
    phase, gain, crossover = margins(DRIVE, plain, 10 * DEG)
    expected = assess_pi(linear_plant(DRIVE), plain.kp, plain.ki)
    assert phase == pytest.approx(expected.phase_margin_deg, abs=0.1)
    assert gain == pytest.approx(expected.gain_margin_db, abs=0.2)
    assert crossover == pytest.approx(expected.crossover_hz, rel=1e-3)


def test_swept_gains_of_a_linear_drive_against_python_control():
    """No gap, no dry friction: amplitude does not matter and the loop is known."""
    names = [n for n in DRIVE.drive if n[:2] in ("T3", "TL")]
    linear = DRIVE.with_values(gap_l=0.0, gap_r=0.0, **dict.fromkeys(names, 0.0))
    plain = Controller(LOOP.kp, LOOP.ki)
    held = sampled_drive(linear_plant(linear), 1e-3)
    loop = held(np.exp(2j * np.pi * SWEEP_HZ * 1e-3)) * plain.to_discrete()(
        np.exp(2j * np.pi * SWEEP_HZ * 1e-3)
    )
    expected = np.abs(loop / (1 + loop))
    for row in swept_gains(linear, plain):
        np.testing.assert_allclose(row, expected, rtol=0.02)


def test_preload_boundary():
    """At large accelerations the balance decides; below the boundary a mesh opens."""
    closed_form, simulated = boundary(DRIVE, LOOP, [3.0, 6.0])
    np.testing.assert_allclose(simulated, closed_form, rtol=0.06)
    speed = 6.0 / (2 * np.pi)
    duty = Duty(sine(speed, 1.0, 2.0), settling=1.0)
    tried = [assess_preload(DRIVE, replace(LOOP, preload=b), duty) for b in (0.2, 1.2)]
    assert tried[0].open_share > 0.1
    assert tried[1].open_share == 0.0
    assert tried[1].torque > tried[0].torque
    rubbing = DRIVE.with_effect("load_dependent_friction", coefficient=0.1)
    cost = assess_preload(rubbing, replace(LOOP, preload=1.2), duty).friction
    press = 1.2 * 25 * 0.39  # N·m in each mesh, N1 K_d K_M; the load adds to one what it takes
    assert cost == pytest.approx(2 * 0.1 * press, rel=0.15)
    panel = plot_preload([3.0, 6.0], closed_form, simulated)
    assert len(panel.lines) == 2
    plt.close(panel.figure)


def test_preload_that_gives_way_to_load():
    """The earlier a bias fades, the less torque and the more open meshes."""
    duty = Duty(sine(0.5, 1.0, 2.0), settling=1.0)
    found = schedules(DRIVE, LOOP, duty, [0.8])
    rows = {name: row for name, (row,) in found.items()}
    assert rows["fades early"].torque < rows["fades late"].torque < rows["constant"].torque
    assert rows["fades early"].open_share > rows["constant"].open_share
    assert rows["at reversals"].torque < rows["smooth"].torque < rows["constant"].torque
    assert rows["constant"].reversal_error > rows["constant"].error  # where friction turns round
    preloaded = assess_preload(DRIVE, replace(LOOP, preload=0.8), duty)
    np.testing.assert_allclose(rows["constant"], preloaded, rtol=1e-6)
    panels = plot_schedules([0.8], found)
    assert len(panels[0].lines) == len(SCHEDULES)
    plt.close(panels[0].figure)
    with pytest.raises(ValueError, match="above 0 V"):
        schedules(DRIVE, LOOP, duty, [0.0])


def test_schedules_are_their_formulas():
    volts, still = np.array([0.0, 0.5, -0.7, 3.0]), np.zeros(4)
    expected = {
        "constant": [1, 1, 1, 1],
        "fades late": [1, 1, 1, 0],
        "fades early": [1, 0.5 / 0.7, 0.3 / 0.7, 0],
        "switched": [1, 1, 1, 0],
    }
    for name, values in expected.items():
        np.testing.assert_allclose(SCHEDULES[name].bias(1.0, volts, still), values, atol=1e-12)
    smooth = SCHEDULES["smooth"].bias(2.0, np.array([3.0, 3.3]), still[:2])
    np.testing.assert_allclose(smooth, [1.0, 2.0 / (1.0 + np.e)])
    falling = SCHEDULES["at reversals"].bias(2.0, volts[:2], np.array([0.0, -5 * DEG]))
    np.testing.assert_allclose(falling, [2.0, 2.0 / np.e])


def test_common_voltage_is_what_the_loop_gives():
    """Along a smooth duty the closed loop settles on the model's own voltage."""
    duty = Duty(sine(0.3, 0.5, 2.0), settling=2.0)
    u, _ = close_loop(DRIVE, LOOP.law(), duty.reference, duty.sample_time)
    moving = np.abs(duty.reference) > 0.1
    moving[:2000] = False
    miss = u.mean(axis=0)[moving] - common_volts_along(DRIVE, duty)[moving]
    assert np.sqrt(np.mean(miss**2)) < 0.02 * np.abs(u).max()


def test_bounds_hold_as_often_as_they_say():
    """Known distribution: |normal|; the bounds cover the truth at their confidence."""
    rng = np.random.default_rng(4)
    inside, runs = 0, 400
    for _ in range(runs):
        found = MonteCarlo(np.abs(rng.standard_normal(200)), np.zeros(200))
        _, low, high = found.quantile(0.9)
        inside += low <= norm.ppf(0.95) <= high
    assert 0.93 < inside / runs < 0.995


@pytest.mark.long
def test_monte_carlo_resumes_and_does_not_depend_on_jobs(tmp_path):
    aims = Aims(duty=SHORT)
    others = [LATE]
    count = CHUNK + 10
    whole = monte_carlo(DRIVE, LOOP, count, effects=others, aims=aims)
    monte_carlo(DRIVE, LOOP, CHUNK, effects=others, aims=aims, folder=tmp_path)
    first = tmp_path / f"{0:06d}-{CHUNK:06d}.npy"
    stamp = first.stat().st_mtime_ns
    again = monte_carlo(DRIVE, LOOP, count, effects=others, aims=aims, jobs=2, folder=tmp_path)
    assert first.stat().st_mtime_ns == stamp
    np.testing.assert_array_equal(again.errors, whole.errors)
    late = monte_carlo(LATE, LOOP, count, aims=aims)
    np.testing.assert_allclose(whole.errors[1::2], late.errors[1::2], rtol=1e-9)  # in turn
    with pytest.raises(ValueError, match="another run"):
        monte_carlo(DRIVE, LOOP, count, aims=aims, folder=tmp_path)


def test_refusals():
    with pytest.raises(ValueError, match="no effects"):
        impact(DRIVE, LOOP)
    with pytest.raises(ValueError, match="at least one plant"):
        monte_carlo(DRIVE, LOOP, 0)
