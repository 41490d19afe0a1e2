"""With which speeds a run begins on a log."""

import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.rig_simulate import free_run
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import RigModel

DT, MOTOR, TABLE, SPRING, PUSH = 2e-3, 2e-3, 2e-2, 40.0, 0.5
RIG = parse_rig(
    """
[body.motor]
inertia = "0.002 kg m^2"
[body.table]
inertia = "0.02 kg m^2"
[shaft.one]
between = ["motor", "table"]
stiffness = "40 N m/rad"
damping = "0 N m s/rad"
[input.u]
column = "u"
unit = "N m"
body = "motor"
[sensor.motor]
column = "q1"
unit = "rad"
body = "motor"
resolution = "0.0005 rad"
[sensor.table]
column = "q2"
unit = "rad"
body = "table"
resolution = "0.0005 rad"
""",
    "rig.toml",
)


def swinging(time):
    """Angles and speeds under a constant torque from rest, in closed form, (2, n) each."""
    whole = MOTOR + TABLE
    rigid = 0.5 * PUSH / whole * time**2
    fast = np.sqrt(SPRING * whole / (MOTOR * TABLE))
    twist = PUSH / MOTOR / fast**2 * (1.0 - np.cos(fast * time))
    rate = PUSH / MOTOR / fast * np.sin(fast * time)
    share = np.array([[TABLE], [-MOTOR]]) / whole
    return rigid + share * twist, PUSH / whole * time + share * rate


def log_from(start):
    """A log that begins at a time, read by coarse encoders."""
    time = start + DT * np.arange(500)
    angle, _ = swinging(time)
    read = np.round(angle / 5e-4) * 5e-4
    channels = {"in_u": np.full(time.size, PUSH), "out_motor": read[0], "out_table": read[1]}
    return Log("a", time - start, channels)


def test_a_drive_that_rings_from_rest_begins_at_rest():
    run = free_run(RigModel(RIG), log_from(0.0))
    assert run.speed("motor")[0] == run.speed("table")[0] == 0.0
    _, speeds = swinging(DT * np.arange(500))
    # what is left is that of the step
    np.testing.assert_allclose(run.speed("motor"), speeds[0], atol=0.01 * np.ptp(speeds[0]))


def test_a_log_that_begins_in_a_motion_is_followed():
    run = free_run(RigModel(RIG), log_from(0.5))
    _, speeds = swinging(np.array([0.5]))
    assert run.speed("table")[0] == pytest.approx(speeds[1, 0], rel=0.1)
