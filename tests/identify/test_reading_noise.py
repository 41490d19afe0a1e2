"""Noise of readings in a balance, against readings with more noise, and what it does to fits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import welch
from tests.diagnosis.test_rig_evidence import logs_of
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.rig_diagnose import split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of, points_of
from dmptm_ctrl.identify.measured_motion import rounding_noise
from dmptm_ctrl.identify.reading_noise import noise_in_balance
from dmptm_ctrl.identify.rig_fit import fit_rig, residuals
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import RigModel

J1, J2, RATIO, K = 2e-4, 0.013, 10.0, 40.0
DRAWS = 6
GEAR = f"""
[body.motor]
inertia = "{J1 * 1.05} kg m^2 ± 10 %"
viscous = "unknown"
coulomb = "unknown"
[body.load]
inertia = "{J2} kg m^2 ± 20 %"
viscous = "unknown"
coulomb = "unknown"
[mesh.gear]
between = ["motor", "load"]
ratio = {RATIO}
stiffness = "{K} N m/rad ± 20 %"
damping = "0.05 N m s/rad ± 50 %"
[input.drive]
column = "u"
unit = "N m"
body = "motor"
gain = 1
"""
SENSORS = {
    "q": '[sensor.q]\ncolumn = "q"\nunit = "rad"\nbody = "motor"\n',
    "w": '[sensor.w]\ncolumn = "w"\nunit = "rad/s"\nbody = "motor"\n',
    "q2": '[sensor.q2]\ncolumn = "q2"\nunit = "rad"\nbody = "load"\n',
}


def geared(sensors, counts=2**16):
    """Logs of a gear with rounded angles, and white noise on a speed."""
    machine = Machine(
        gain=1.0, emf=0.0, j1=J1, j2=J2, ratio=RATIO, k=K, c=0.05,
        fc=4e-3, fc2=0.05, b1=2e-4, b2=0.02,
    )  # fmt: skip
    kinds = (("sine", 0.3), ("steps", 0.2), ("square", 0.2))
    measured = ("position", "speed", "position2")
    bench = Bench(machine, kinds, 4.0, 1e-3, 0.02, counts, sensors=measured)
    rig = parse_rig(GEAR + "".join(SENSORS[s] for s in sensors), "rig.toml")
    channels = {"u": "in_drive"} | {s: f"out_{s}" for s in sensors}
    logs = [
        Log(name, columns["t"], {channels[k]: columns[k] for k in channels})
        for name, columns in bench.logs().items()
    ]
    return rig, logs


def noisier(balance, logs, rng):
    """The balance of the same logs with twice the noise of the readings."""
    noisy = []
    for log in logs:
        channels = dict(log.channels)
        for point in balance.points:
            size = np.sqrt(0.5 * point.sight.noise / log.sample_time)
            name = point.sight.sensor.channel
            channels[name] = log[name] + rng.normal(0.0, size, len(log))
        noisy.append(Log(log.name, log.time, channels))
    return balance_of(balance.rig, noisy, bandwidth=balance.bandwidth)


@pytest.mark.parametrize("sensors", [("q",), ("q2",), ("q", "q2"), ("w", "q2"), ("q", "w", "q2")])
def test_is_what_more_noise_adds(sensors):
    """Twice the readings' noise, against the variance that one such noise is said to give."""
    rig, logs = geared(sensors)
    balance = balance_of(rig, logs)
    state = State(rough_start(RigModel(rig), balance))
    before, _ = residuals(state, balance)
    rng, variances = np.random.default_rng(3), []
    for _ in range(DRAWS):
        after, _ = residuals(state, noisier(balance, logs, rng))
        variances += [np.var(a - b, axis=1) for a, b in zip(after, before, strict=True)]
    for e, noise in enumerate(noise_in_balance(state.model, balance)):
        seen, told = float(np.mean(variances, axis=0)[e]), float(noise @ noise)
        if told == 0.0:  # two readings of one motion: nothing that is fitted
            assert {"q", "w"} <= {*sensors}
            continue
        assert told == pytest.approx(seen, rel=0.25)


@pytest.fixture(scope="module")
def coarse():
    """The declared model, fitted to two coarse encoders of a gear."""
    rig, logs = geared(("q", "q2"))
    fitted, held, _, _ = split(rig, balance_of(rig, logs))
    return RigEvidence(fitted, held, 1).base(State(rough_start(RigModel(rig), fitted))).fit


def test_coarse_encoders_do_not_bend_inertias_and_springs(coarse):
    """Without their noise told apart, motor and load are wrong by half and by two thirds."""
    true = {"body.motor.inertia": J1, "body.load.inertia": J2, "link.gear.stiffness": K}
    for name, value in true.items():
        assert coarse.values[name] == pytest.approx(value, rel=0.3)
        assert abs(coarse.values[name] - value) < 3.0 * coarse.errors[name]
        assert coarse.errors[name] > 0.02 * value  # so coarse readings do not tell more


def test_ranges_weigh_as_much_as_the_scatter_of_the_score_leaves_them(coarse):
    """Against what rows without ranges say, and ranges without rows, added by their precision."""
    known = replace(coarse.likelihood, doubt=dict.fromkeys(coarse.doubt, 1e-6))
    rows = fit_rig(coarse.state, coarse.likelihood.balance, like=known, iterations=12, jobs=1)
    scale = np.array([f.scale for f in rows.frees])
    told = np.linalg.inv(rows.covariance * np.outer(scale, scale))
    centre, sigma = np.array([f.prior or (0.0, np.inf) for f in rows.frees]).T
    both = np.linalg.inv(told + np.diag(sigma**-2.0))
    values = both @ (told @ list(rows.values.values()) + centre * sigma**-2.0)
    for free, value, error in zip(coarse.frees, values, np.sqrt(np.diag(both)), strict=True):
        if free.prior is None:
            continue
        assert coarse.errors[free.label] == pytest.approx(error, rel=0.25)
        assert coarse.errors[free.label] < 0.85 * rows.errors[free.label]
        assert coarse.values[free.label] == pytest.approx(value, abs=0.8 * error)


def test_more_noise_than_is_left_makes_no_model_better(coarse):
    """Noise is told by a spectrum, which is not exact; a heavy load would turn it into more."""
    small, heavy = (coarse.model.with_values({"body.load.inertia": x * J2}) for x in (1.0, 3.0))
    like = coarse.likelihood.knowing(small, coarse.left).between(small, heavy)
    noises = np.array([like.noise_of(model) for model in (small, heavy)])
    assert noises[1, 0] > 2.0 * noises[0, 0]
    few = [0.1 * part for part in coarse.left]
    assert np.all(like.scales(few) ** 2 < noises[:, :, None])
    # worse by no more than so many rows tell a variance: by √(2/n) of it
    more = like.surprise(few, heavy) - like.surprise(few, small)
    added = np.sqrt(2.0 / like.counts) * ((noises[1] - noises[0]) / noises[0])[:, None]
    assert 0.0 < more < float(np.sum(like.counts * np.log1p(added)))
    much = [10.0 * part for part in coarse.left]  # here noise is a small part, and is taken out
    assert abs(like.surprise(much, heavy) - like.surprise(much, small)) > 1.0


@pytest.mark.parametrize(("speed", "white"), [(0.02, 3.6), (0.2, 0.8), (3.0, 0.6)])
def test_rounding_makes_more_noise_where_motion_is_slow(speed, white):
    """Against what rounding did to the true angles, which the readings do not show."""
    step, dt, reach = 1e-3, 1e-3, 25.0
    time = dt * np.arange(20_000)
    angle = speed * np.where(time < 12.0, np.sin(2.0 * time) + 0.3 * np.sin(7.1 * time), 0.0)
    errors = np.round((angle + step * np.arange(0.0, 1.0, 0.125)[:, None]) / step) * step
    errors -= angle + step * np.arange(0.0, 1.0, 0.125)[:, None]
    f, power = welch(errors, 1.0 / dt, nperseg=4096)
    low = (f <= reach) * f**4
    true = float(low @ power.mean(axis=0) / low.sum())
    assert true == pytest.approx(white * 2.0 * dt * step**2 / 12.0, rel=0.1)
    told = [
        rounding_noise(step * np.round((angle + step * k / 8.0) / step), step, 1.0 / dt, reach, 2)
        for k in range(8)
    ]
    assert np.mean(told) == pytest.approx(true, rel=0.3)


@pytest.mark.parametrize(("noise", "clearer"), [(1e-5, "speed"), (0.05, "position")])
def test_the_clearer_of_two_sensors_that_reach_as_far(noise, clearer):
    """Motion up to a tenth of the sample rate; then the noise of the acceleration decides."""
    machine = Machine(gain=1.0, emf=0.0, j1=2e-4, fc=5e-3, b1=1e-3)
    sensors = ("position", "speed")
    bench = Bench(machine, (("multisine", 0.2),), 4.0, 2e-3, noise, 2**16, sensors=sensors)
    rig = parse_rig(bench.rig(), "rig.toml")
    logs = logs_of(bench, rig)
    (point,) = points_of(rig, logs)
    assert point.sight.bandwidth == pytest.approx(0.1 / 2e-3)
    assert point.name == clearer
