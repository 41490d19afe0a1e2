"""Dead time and lag of an amplifier in the balance of torques, by closed forms."""

import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.inverse_dynamics import balance_of, residual
from dmptm_ctrl.identify.reading_noise import noise_in_balance
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

DT, INERTIA = 1e-3, 0.02
RIG = parse_rig(
    """
[body.rotor]
inertia = "0.02 kg m^2"
[input.drive]
column = "u"
unit = "N m"
body = "rotor"
[sensor.gyro]
column = "w"
unit = "rad/s"
body = "rotor"
""",
    "rig.toml",
)


def held(t, command, dt):
    """Value at `t` of a signal that is held from each sample to the next."""
    return command[np.clip(np.floor(t / dt).astype(int), 0, command.size - 1)]


def acted(command, delay, tau, fine=400):
    """Mean over each sample of what acts: exact, of a held command that comes late and relaxes."""
    t = (np.arange(command.size * fine) + 0.5) * DT / fine
    aim = held(np.maximum(t - delay, 0.0), command, DT)
    if tau == 0.0:
        return aim.reshape(-1, fine).mean(axis=1)
    now, decay, means = command[0], np.exp(-DT / tau), []
    for one in held(np.arange(command.size) * DT, command, DT):
        means.append(one + (now - one) * tau / DT * (1.0 - decay))
        now = one + (now - one) * decay
    return np.array(means)


@pytest.mark.parametrize(
    ("name", "number", "value"),
    [
        ("drive_delay", "delay", 3.4e-3),
        ("drive_delay", "delay", 0.5e-3),
        ("current_lag", "time_constant", 8e-3),
    ],
)
def test_nothing_is_left_of_a_late_drive(name, number, value):
    """Speeds are the exact sums of what acted; the command is rough up to 40 Hz."""
    rng = np.random.default_rng(4)
    command = np.repeat(rng.standard_normal(400), 12)
    delay, tau = (value, 0.0) if name == "drive_delay" else (0.0, value)
    torque = acted(command, delay, tau)
    speed = np.concatenate([[0.0], np.cumsum(torque[:-1])]) * DT / INERTIA
    balance = balance_of(RIG, [Log("run", DT * np.arange(command.size),
                                   {"in_drive": command, "out_gyro": speed})])  # fmt: skip
    (motion,) = balance.motions
    late = RigModel(RIG).with_effect(Placed(name, "drive", {number: value}))
    left, drive = residual(late, balance, motion)
    without, _ = residual(RigModel(RIG), balance, motion)
    size = np.sqrt(np.mean(drive**2))
    assert np.sqrt(np.mean(left**2)) < 0.01 * size
    assert np.sqrt(np.mean(without**2)) > 0.03 * size


def test_a_late_drive_makes_no_more_of_the_noise_of_readings():
    t = DT * np.arange(3000)
    log = Log("run", t, {"in_drive": np.sin(30 * t), "out_gyro": np.cos(30 * t)})
    balance = balance_of(RIG, [log])
    slow = RigModel(RIG).with_effect(Placed("current_lag", "drive", {"time_constant": 0.01}))
    bare, late = (noise_in_balance(model, balance)[0] for model in (RigModel(RIG), slow))
    assert np.array_equal(bare, late)
