"""Motions have as many samples as their band needs, and many models run beside each other."""

from pathlib import Path

import numpy as np
import pytest

import dmptm_ctrl
from dmptm_ctrl.drive.rigfile import load_rig, parse_rig
from dmptm_ctrl.identify.forces import effective_input
from dmptm_ctrl.identify.inverse_dynamics import balance_of, residual
from dmptm_ctrl.identify.rig_simulate import free_readings, free_run, readings, with_other_teeth
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT = 2e-4
TIME = DT * np.arange(40_000)
AXIS = """
[body.axis]
inertia = "0.02 kg m^2"
coulomb = "0.1 N m"
viscous = "0.05 N m s/rad"
[input.torque]
column = "T"
unit = "N m"
body = "axis"
[sensor.encoder]
column = "q"
unit = "rad"
body = "axis"
"""


@pytest.fixture(scope="module")
def axis():
    """A rig, its model with a clipped and late drive, a log of 5 kHz, and a chattering torque."""
    rig = parse_rig(AXIS, "rig.toml")
    late = Placed("drive_delay", "torque", {"delay": 7 * DT})
    model = RigModel(rig).with_effect(late).with_effect("drive_saturation", inverse_limit=2.0)
    chatter = 0.3 * np.sign(np.sin(2 * np.pi * 731.0 * TIME))
    u = 0.5 * np.sin(2 * np.pi * 0.7 * TIME) + 0.3 * np.sin(2 * np.pi * 3.1 * TIME) + chatter
    run = march(model, u[None], DT)
    channels = {"in_torque": u, "out_encoder": run.reading("encoder")}
    return rig, model, Log("fast", TIME, channels)


def test_a_thinned_balance_is_that_of_all_samples(axis):
    rig, model, log = axis
    whole = balance_of(rig, [log], bandwidth=300.0)
    thinned = balance_of(rig, [log], bandwidth=20.0)
    (fine,), (motion,) = whole.motions, thinned.motions
    assert (fine.thin, motion.thin) == (1, 11)
    assert motion.dt == pytest.approx(11 * DT)
    np.testing.assert_array_equal(motion.time, (log.time - log.time[0])[motion.samples])
    # a limit acts on each sample: of their means it would hardly be seen
    late = effective_input(model, motion, "torque")
    every = effective_input(model, fine, "torque")
    centred = np.convolve(every, np.ones(11) / 11, "same")[motion.samples]
    np.testing.assert_allclose(late[1:-1], centred[1:-1], atol=1e-12)
    for one, of in ((model, 1.0), (RigModel(rig), 0.0)):
        left, drive = residual(one, thinned, motion)
        share = np.std(left[0, motion.moving]) / np.std(drive[motion.moving])
        assert (share < 0.01) if of else (share > 0.05)


def test_pieces_of_a_thinned_log_hold_its_samples(axis):
    rig, _, log = axis
    (motion,) = balance_of(rig, [log], bandwidth=40.0).motions
    assert motion.thin > 1
    for piece in motion.pieces(4000):
        np.testing.assert_array_equal(piece.time, (log.time - log.time[0])[piece.samples])
        whole = log["in_torque"][piece.samples.start - piece.thin // 2 :]
        np.testing.assert_array_equal(piece.sent["torque"], whole[: piece.sent["torque"].size])


@pytest.mark.long
@pytest.mark.parametrize("lead", [0.0, 5.0])
def test_models_beside_each_other_read_what_each_does_alone(lead):
    rig = load_rig(Path(dmptm_ctrl.__file__).parent / "data/paper_3dof.toml")
    true = RigModel(rig).with_effect("cable_spring", "ring_gear", stiffness=200.0)
    time = 1e-3 * np.arange(1500)
    wave = 1.2 * np.sin(2 * np.pi * 1.3 * time)
    run = march(true, np.array([wave, 0.8 * wave]), 1e-3)
    channels = {"in_left": wave, "in_right": 0.8 * wave}
    channels |= {name: run.reading(name[4:]) for name in ("out_encoder", "out_gyro")}
    log = Log("turns", time, channels)
    late = RigModel(rig).with_effect("drive_delay", "left", delay=2.2e-3)
    slow = RigModel(rig).with_effect("sensor_delay", "gyro", delay=1.5e-3)
    models = [RigModel(rig), true, late, slow, *with_other_teeth(RigModel(rig))[:2]]
    together = free_readings(models, log, "gyro", lead_hz=lead)
    for model, seen in zip(models, together, strict=True):
        alone = readings(model, log, free_run(model, log, lead_hz=lead))["gyro"]
        # gaps make the last digits of a run visible, and an observer takes them back
        np.testing.assert_allclose(seen, alone, atol=1e-3 * np.ptp(alone))
