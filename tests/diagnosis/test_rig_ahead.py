"""The last fit of a rig: short predictions beside the balance."""

import numpy as np
import pytest

from dmptm_ctrl.diagnosis import rig_ahead
from dmptm_ctrl.diagnosis.rig_ahead import DAMPED, Ahead, dampings
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_state import beside_torques
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.compared_signals import low_pass
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.observer_driven import BANDWIDTH_HZ
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.observer import observer_gains
from dmptm_ctrl.simulate.rig_model import RigModel

DT, FINE = 1e-3, 50
INERTIA, VISCOUS, COULOMB, STATIC, STRIBECK = 2e-3, 0.01, 0.02, 0.04, 0.3
AXIS = """
[body.axis]
inertia = "0.002 kg m^2 ± 20 %"
viscous = "0.01 N m s/rad ± 40 %"
[input.drive]
column = "u"
unit = "N m"
body = "axis"
[sensor.speed]
column = "w"
unit = "rad/s"
body = "axis"
noise = "0.1 rad/s"
"""
RUBBING = AXIS.replace(
    "[input",
    """coulomb = "0.018 N m ± 40 %"
static = "0.05 N m ± 50 %"
stribeck_speed = "0.4 rad/s ± 60 %"
stribeck_exponent = 1.0
[input""",
)
GEAR = """
[body.motor]
inertia = "0.002 kg m^2 ± 10 %"
viscous = "0.01 N m s/rad ± 40 %"
[body.table]
inertia = "0.02 kg m^2 ± 10 %"
viscous = "0.01 N m s/rad ± 40 %"
[shaft.gear]
between = ["motor", "table"]
stiffness = "40 N m/rad ± 20 %"
damping = "unknown"
half_gap = "0.02 rad ± 20 %"
[input.drive]
column = "u"
unit = "N m"
body = "motor"
""" + "".join(
    f"""[sensor.{body}]
column = "q_{body}"
unit = "rad"
body = "{body}"
resolution = "0.0005 rad"
absolute = true
"""
    for body in ("motor", "table")
)


def signal(seed, seconds, fastest):
    """A sum of sines, (n,)."""
    rng = np.random.default_rng(seed)
    time = DT * np.arange(round(seconds / DT))
    waves = 2 * np.pi * np.outer(time, rng.uniform(0.1, fastest, 10))
    return np.sin(waves + rng.uniform(0.0, 6.0, 10)).sum(1)


def rubbing(u):
    """Speed of the axis with friction that sticks (Karnopp), by short Euler steps, (n,)."""
    v, out, h = 0.0, np.empty(u.size), DT / FINE
    for k, push in enumerate(u):
        out[k] = v
        for _ in range(FINE):
            if v == 0.0 and abs(push) <= STATIC:
                continue
            way = np.sign(v or push)
            rubs = COULOMB + (STATIC - COULOMB) * np.exp(-abs(v) / STRIBECK)
            new = v + h / INERTIA * (push - way * rubs - VISCOUS * v)
            v = 0.0 if new * v < 0.0 else new
    return out


def geared(u, damping):
    """Angles of motor and table with a gap between them, (2, n), by short symplectic steps."""
    q, w, out, h = np.zeros(2), np.zeros(2), np.empty((2, u.size)), DT / 20
    masses = np.array([2e-3, 2e-2])
    for k, push in enumerate(u):
        out[:, k] = q
        for _ in range(20):
            twist, rate = q[0] - q[1], w[0] - w[1]
            wound = twist - np.clip(twist, -0.02, 0.02)
            through = 40.0 * wound + damping * rate * (wound != 0.0)
            w = w + h * (np.array([push - through, through]) - 0.01 * w) / masses
            q = q + h * w
    return out


def fitted(text, logs):
    """Fit by the balance, and what predicts the same logs."""
    rig = parse_rig(text, "rig.toml")
    balance = balance_of(rig, logs)
    start = rough_start(RigModel(rig), balance)
    base = RigEvidence(balance, balance, 1).base(State(start))
    return base, Ahead.of(rig, logs, balance, 10**6, 1)


def test_predictions_are_those_of_the_observer_written_out():
    u = 0.02 * signal(1, 10.0, 6.0)
    read = 5.0 * signal(2, 10.0, 3.0)
    log = Log("a", DT * np.arange(u.size), {"in_drive": u, "out_speed": read})
    rig = parse_rig(AXIS, "rig.toml")
    model = RigModel(rig)
    ahead = Ahead.of(rig, [log], balance_of(rig, [log]), 10**6, 1)
    decay, (follow, _) = np.exp(-VISCOUS / INERTIA * DT), observer_gains(BANDWIDTH_HZ, DT)
    run = np.zeros(u.size)
    run[0] = read[0]
    for k in range(u.size - 1):
        here = run[k] + follow * (read[k] - run[k])
        run[k + 1] = decay * here + (1.0 - decay) / VISCOUS * u[k]
    missing = low_pass(read - run, DT, ahead.runs.bandwidth)[:: ahead._step(log)]
    ours = ahead.missing(State(model))
    np.testing.assert_allclose(ours[20:], missing[20:], atol=0.01 * missing.std())
    short = Ahead.of(rig, [log], balance_of(rig, [log]), 4000, 1)
    assert [len(one) for one in short.runs.logs] == [4000]


def test_a_fit_that_takes_too_many_steps_is_left_as_it_is(monkeypatch):
    u = 0.03 * signal(1, 4.0, 3.0)
    log = Log("a", DT * np.arange(u.size), {"in_drive": u, "out_speed": rubbing(u)})
    base, ahead = fitted(RUBBING, [log])
    monkeypatch.setattr(rig_ahead, "MOST_STEPS", 1e3)
    assert ahead.fitted(base) is base


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_noise_hides_breakaway_from_the_balance_and_not_from_runs(seed):
    u = 0.03 * signal(seed, 20.0, 3.0)
    read = rubbing(u) + 0.1 * np.random.default_rng(seed).standard_normal(u.size)
    log = Log("a", DT * np.arange(u.size), {"in_drive": u, "out_speed": read})
    base, ahead = fitted(RUBBING, [log])
    last = ahead.fitted(base)
    assert last.keys == base.keys
    assert np.std(ahead.missing(last.fit.state)) < np.std(ahead.missing(base.fit.state))
    wrong = [abs(s.fit.model.value("body.axis.static") - STATIC) for s in (base, last)]
    assert wrong[1] < wrong[0]


@pytest.mark.long
@pytest.mark.parametrize("damping", [0.05, 0.3])
def test_a_spring_rings_by_its_damping(damping):
    u = 0.1 * signal(1, 20.0, 2.0)
    q = geared(u, damping)
    read = {
        f"out_{b}": np.round(x / 5e-4) * 5e-4 for b, x in zip(("motor", "table"), q, strict=True)
    }
    log = Log("a", DT * np.arange(u.size), {"in_drive": u, **read})
    base, ahead = fitted(GEAR, [log])
    last = ahead.fitted(base)
    before, after = (s.fit.model.value("link.gear.damping") / damping - 1.0 for s in (base, last))
    assert abs(after) < 0.05 < abs(before)
    fit = beside_torques(base, last).fit  # what a check needs, which has the balance alone
    assert fit.off_balance["link.gear.damping"] == pytest.approx(abs(after - before) * damping)
    assert fit.off_balance.keys() == fit.model.quantities.keys() & fit.values.keys()
    assert beside_torques(base, base).fit.off_balance == {}
    noise = 5e-4 / np.sqrt(12.0) * 2 * np.pi * ahead.runs.bandwidth  # of a rate, at most
    assert np.std(ahead.missing(last.fit.state)) < noise


def test_dampings_are_shares_of_the_critical_one():
    """Of the mode in which motor and table swing against each other, by its eigenvalue."""
    rig = parse_rig(GEAR.replace('"unknown"', '"0.1 N m s/rad"'), "rig.toml")
    model = RigModel(rig)
    for share, damping in zip(DAMPED, dampings(model, "link.gear"), strict=True):
        pull = np.array([[-1.0, 1.0], [1.0, -1.0]]) / np.array([[2e-3], [2e-2]])
        whole = np.block([[np.zeros((2, 2)), np.eye(2)], [40.0 * pull, damping * pull]])
        found = np.linalg.eigvals(whole)
        mode = found[np.argmax(np.abs(found))]
        if share < 1.0:
            assert -mode.real / abs(mode) == pytest.approx(share)
        else:
            assert abs(mode.imag) < 1e-3 * abs(mode)
