"""Waves over the angle that pass faster than the samples: samples must not fold them."""

import numpy as np
import pytest
from scipy.signal import firwin
from tests.rig_files.truth import Machine

from dmptm_ctrl.diagnosis.rig_diagnose import split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_shapes import orders
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.forces import unfolded
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.rig_simulate import free_run
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.along import acting_of, torque_along
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT, ORDER = 1e-3, 72.0
RIG = """
[body.rotor]
inertia = "unknown"
viscous = "unknown"
[input.current]
column = "i"
unit = "N m"
[sensor.encoder]
column = "q"
unit = "rad"
[sensor.speed]
column = "w"
unit = "rad/s"
"""
MACHINE = Machine(gain=1.0, emf=0.0, j1=1.9e-4, fc=0.08, b1=1.5e-4, cog=0.2, order=ORDER)
UNITS = {"in_current": "N·m", "out_encoder": "rad", "out_speed": "rad/s"}


def log_of(push, speed):
    q, w, *_ = MACHINE.run(push, DT, start=(0.0, speed)).T
    channels = {"in_current": push, "out_encoder": q, "out_speed": w}
    return Log("run", DT * np.arange(push.size), channels, units=UNITS)


@pytest.mark.parametrize("speed", [3.0, 40.0, 87.0, 90.0, 150.0, 176.0])
def test_samples_fold_nothing_into_the_band(speed):
    """Against the same wave sampled 40 times as often, both through the filter of the balance."""
    log = log_of(np.zeros(4000), 0.0)
    (motion,) = balance_of(parse_rig(RIG), [log]).motions
    effect = Placed("cogging", "rotor", {"cosine": 0.7, "sine": -0.4, "order": ORDER})

    def torque(t):
        rows = np.zeros_like(t), speed * t + 0.1, np.full_like(t, speed), t
        return torque_along([acting_of(effect)], *rows)

    time = motion.time
    fine = DT / 40 * np.arange(40 * time.size)
    taps = firwin(2001, 2.0 * motion.bandwidth, fs=40 / DT)
    slow = np.convolve(torque(fine), taps, "same")[::40]
    share = unfolded(effect, np.full_like(time, speed), motion)
    inside = slice(60, -60)
    assert motion.reduce(share * torque(time))[inside] == pytest.approx(
        motion.reduce(slow)[inside], abs=4e-3
    )
    still = Placed("unbalance", "rotor", {"cosine": 0.7, "sine": -0.4})
    assert unfolded(still, time, motion) == 1.0


def test_a_run_takes_no_wave_for_a_push():
    """A rotor where one sample is one period of its teeth, against 20 µs steps."""
    speed = 2.0 * np.pi / (ORDER * DT)
    log = log_of(np.full(400, 0.08 + 1.5e-4 * speed), speed)
    model = RigModel(parse_rig(RIG)).with_values(
        {"body.rotor.inertia": 1.9e-4, "body.rotor.viscous": 1.5e-4}
    )
    effects = {
        "coulomb_friction": {"level": 0.08},
        "cogging": {"cosine": 0.0, "sine": -0.2, "order": ORDER},
    }
    for name, values in effects.items():
        model = model.with_effect(Placed(name, "rotor", values))
    missed = free_run(model, log).reading("speed") - log["out_speed"]
    start = {"position": {"rotor": 0.0}, "speed": {"rotor": speed}}
    once = march(model, log["in_current"][None, :], DT, substeps=1, **start).reading("speed")
    assert np.ptp(log["out_speed"]) < 0.5
    assert np.abs(missed).max() < 0.5
    assert np.abs(once - log["out_speed"]).max() > 5.0


def test_teeth_that_pass_unseen_most_of_the_time_are_found():
    """A sine of 2 Hz to 150 rad/s; the teeth pass the balance below 9 rad/s only."""
    t = DT * np.arange(8000)
    log = log_of(
        0.4 * np.sin(4 * np.pi * t) + 2e-3, -150.0
    )  # turns round at other angles each time
    rig = parse_rig(RIG)
    logs, held, _, _ = split(rig, balance_of(rig, [log]))
    evidence = RigEvidence(logs, held, 1)
    base = evidence.base(State(rough_start(RigModel(rig), logs)))
    (friction,) = evidence.candidates(base, ["coulomb_friction@rotor"])
    rubbing = evidence.adopt(base, friction)
    assert ORDER in orders(rubbing.tangent, "rotor")
    (teeth,) = evidence.candidates(rubbing, ["cogging@rotor"])
    assert teeth.acceptable
    fit = evidence.adopt(rubbing, teeth).fit
    found = fit.model.effect("cogging@rotor").values
    assert found["order"] == ORDER
    assert np.hypot(found["cosine"], found["sine"]) == pytest.approx(0.2, rel=0.1)
    assert fit.model.effect("coulomb_friction@rotor").values["level"] == pytest.approx(
        0.08, rel=0.1
    )
