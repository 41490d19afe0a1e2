"""Hidden bodies behind gaps: their balance closes without a run, and a run says when it counts."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.stats import t

import dmptm_ctrl
from dmptm_ctrl.drive.rigfile import load_rig, parse_rig
from dmptm_ctrl.identify.following import touching
from dmptm_ctrl.identify.inverse_dynamics import balance_of, residual
from dmptm_ctrl.identify.likelihood import Likelihood
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT = 1e-3
PAPER = Path(dmptm_ctrl.__file__).parent / "data/paper_3dof.toml"


@pytest.fixture(scope="module")
def rig():
    return load_rig(PAPER)


TIME = DT * np.arange(8000)
TURNS = 0.9 + 0.25 * np.sin(2 * np.pi * 0.7 * TIME) + 0.1 * np.sin(2 * np.pi * 2.3 * TIME)
SWINGS = 0.9 * np.sin(2 * np.pi * 0.4 * TIME) + 0.4 * np.sin(2 * np.pi * 1.7 * TIME)


def log_of(model: RigModel, wave: np.ndarray = TURNS) -> tuple[Log, np.ndarray]:
    """A log of slow turns, or of another voltage, without noise; the torque of the left mesh."""
    u = np.array([wave, 0.8 * wave])
    run = march(model, u, DT)
    channels = {"in_left": u[0], "in_right": u[1]}
    channels |= {"out_encoder": run.reading("encoder"), "out_gyro": run.reading("gyro")}
    return Log("turns", TIME, channels), run.link("left")


def test_balance_closes_without_a_run_while_teeth_touch(rig):
    model = RigModel(rig)
    log, _ = log_of(model)
    balance = touching(balance_of(rig, [log]), model, [log])
    assert balance.closed == {"left", "right"}
    assert balance.bandwidth < 30.0  # the pinions ring at 60 Hz on their teeth
    (motion,) = balance.motions
    closed = RigModel(rig, closed=balance.closed)
    left, drive = residual(closed, balance, motion)
    use = motion.moving
    assert motion.open_links.any()  # where the drive starts through its gaps
    assert use.mean() > 0.3
    assert np.std(left[0, use]) < 0.01 * np.std(drive[use])
    heavy = closed.with_values({"body.ring_gear.inertia": 5.0})
    worse, _ = residual(heavy, balance, motion)
    assert np.std(worse[0, use]) > 3.0 * np.std(left[0, use])


def test_rows_do_not_hang_on_the_digits_of_a_gap(rig):
    model = RigModel(rig)
    log, _ = log_of(model, SWINGS)
    balance, found = balance_of(rig, [log]), []
    for digit in (0.0, 1e-9, -1e-9, 1e-8):
        gap = (1.0 + digit) * model.value("link.left.half_gap")
        near = model.with_values({"link.left.half_gap": gap})
        balance = touching(balance, near, [log])
        found.append(balance.motions[0].moving)
    some = np.any(found, axis=0)
    assert some.sum() > 50
    assert np.mean([np.mean(one[some]) for one in found]) > 0.95  # nearly the same rows


def test_friction_under_load_takes_the_load_of_closed_teeth(rig):
    rubs = Placed("load_dependent_friction", "pinion_left", {"coefficient": 0.3})
    model = RigModel(rig).with_effect(rubs)
    log, _ = log_of(model)
    balance = touching(balance_of(rig, [log]), model, [log])
    (motion,) = balance.motions
    use = motion.moving
    sizes = []
    for one in (model, RigModel(rig)):
        left, drive = residual(RigModel(rig, one.effects, closed=balance.closed), balance, motion)
        sizes.append(np.sqrt(np.mean(left[0, use] ** 2)))
    assert sizes[0] < 0.1 * sizes[1]
    assert sizes[0] < 0.02 * np.std(drive[use])


def test_rows_beside_impacts_count_as_those_of_students_t(rig):
    model = RigModel(rig)
    log, _ = log_of(model)
    balance = touching(balance_of(rig, [log]), model, [log])
    rng = np.random.default_rng(1)
    likelihood, told = Likelihood(balance, np.ones(1)), []
    for size in (0.02, 0.03):
        rows = size * rng.standard_t(4.0, (1, balance.motions[0].rows.size))
        rows[0, 40:43] += 5.0
        used = rows[0, balance.motions[0].moving]

        def doubled(scale, used=used):  # −2 log-likelihood
            return -2.0 * np.sum(t.logpdf(used, 4.0, scale=scale))

        told.append((likelihood.surprise([rows], model), minimize_scalar(
            doubled, bounds=(1e-3, 1.0), method="bounded").fun))  # fmt: skip
        assert likelihood.sizes([rows])[0] < 1.3 * size
        mass = np.square(likelihood.weights([rows])) * used**2
        assert mass.max() < 5.1  # of one row, however far off
    (one, true_one), (other, true_other) = told
    assert other - one == pytest.approx(true_other - true_one, rel=0.01)


def test_seen_or_unknown_bodies_are_not_closed(rig):
    more = rig.text
    for side in ("left", "right"):
        more += f'\n[sensor.motor_{side}]\ncolumn = "theta_{side}_deg"\nbody = "motor_{side}"\n'
    model = RigModel(rig)
    log, _ = log_of(model)
    motors = {f"out_motor_{s}": log["out_encoder"] * 206.25 for s in ("left", "right")}
    seen = Log(log.name, log.time, {**log.channels, **motors})
    assert not balance_of(parse_rig(more), [seen]).closed
    soft = rig.text.replace('stiffness = "3.6e4 N m/rad ± 10 %"', 'stiffness = "unknown"')
    assert not balance_of(parse_rig(soft), [log]).closed
