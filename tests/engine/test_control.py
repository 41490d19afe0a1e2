"""Controllers of a user's own: compiled, in Python, of python-control; and runs that go on."""

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.closed import close_loop
from dmptm_ctrl.simulate.compiled import Loop
from dmptm_ctrl.simulate.control import sampled
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march, substeps_for
from dmptm_ctrl.simulate.run import Controller, compiled_controller

DT, KP, KI = 1e-3, 0.4, 3.0
RIG = parse_rig("""
name = "axis"
[body.motor]
inertia = 0.01
coulomb = 0.05
viscous = 0.02
[body.load]
inertia = 0.05
viscous = 0.02
[shaft.s]
between = ["motor", "load"]
stiffness = 400
damping = 0.05
[input.m]
column = "u_V"
body = "motor"
gain = "0.5 N m/V"
[sensor.speed]
column = "w_rad_s"
body = "motor"
""")
MODEL = RigModel(RIG, (Placed("drive_delay", "m", {"delay": 0.0025}),))
TARGET = 2.0 * np.sin(2 * np.pi * 1.5 * DT * np.arange(400))


def pi(i, t, dt, target, added, y, rule, memory, u):
    error = target - y[0]
    memory[0] += error * dt
    u[0] = rule[0] * error + rule[1] * memory[0]


class Pi:
    """The same in Python."""

    total = 0.0

    def __call__(self, t, target, y):
        error = target - y[0]
        self.total += error * DT
        return KP * error + KI * self.total


def under(law, target=TARGET, **options):
    nothing = np.zeros((1, target.size))
    return march(MODEL, nothing, DT, controller=law, reference=target, **options)


@pytest.fixture(scope="module")
def compiled():
    law = Controller(compiled_controller(pi), np.array([KP, KI]), 1)
    return under(law)


def test_python_is_compiled(compiled):
    run = under(Pi())
    np.testing.assert_allclose(run.u, compiled.u, rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(run.speed("load"), compiled.speed("load"), rtol=0.0, atol=1e-12)
    assert np.ptp(run.speed("load")) > 1.0


def test_python_control_s_system_is_compiled(compiled):
    """The integral with the sample's own error, as the function has it."""
    z = ct.tf("z")
    law = KP + KI * DT * z / (z - 1)
    law = ct.tf(law.num, law.den, DT)
    run = under(law)
    np.testing.assert_allclose(run.u, compiled.u, rtol=0.0, atol=1e-9)
    with pytest.raises(ValueError, match="the controller is continuous"):
        sampled(ct.tf([1.0], [1.0, 1.0]))


def test_a_system_of_more_inputs_takes_the_target_and_all_readings():
    both = ct.ss([], [], [], [[KP, -0.5 * KP]], DT)
    run = under(both)
    own = under(lambda t, target, y: KP * target - 0.5 * KP * y[0])
    np.testing.assert_allclose(run.u, own.u, rtol=0.0, atol=1e-12)


def test_a_run_goes_on_from_its_state(compiled):
    """Bit for bit: what dead times and the controller remember is in the state."""
    law = Controller(compiled_controller(pi), np.array([KP, KI]), 1)
    first = under(law, TARGET[:150])
    second = under(law, TARGET[150:], state=first.state)
    both = np.concatenate([first.speed("load"), second.speed("load")])
    np.testing.assert_array_equal(both, compiled.speed("load"))
    assert second.time[0] == pytest.approx(0.15)
    assert first.state["v0"] == second.speed("motor")[0]


def test_a_torque_on_any_body_is_an_input():
    """At constant speed friction carries it: viscous slope by hand."""
    n = 6000
    viscous = RigModel(RIG).with_values({"body.motor.coulomb": 0.0})
    run = march(viscous, np.zeros((1, n)), DT, push={"load": np.full(n, 0.2)})
    assert run.speed("motor")[-1] == pytest.approx(0.2 / 0.04, rel=0.05)
    both = march(
        viscous, np.zeros((1, n)), DT, push={"load": np.full(n, 0.2), "motor": np.full(n, -0.2)}
    )
    assert abs(both.speed("motor")[-1]) < 1e-3


def test_a_rig_under_its_loop_takes_the_substeps_that_it_is_told():
    """Its error falls with them, and by default they are what the fastest mode needs."""
    loop, time = Loop(KP, KI, 10.0), DT * np.arange(TARGET.size)
    runs = {
        n: close_loop(MODEL, loop, time, TARGET, substeps=n).outputs[0]
        for n in (None, 1, 4, 16, 256)
    }
    error = {n: np.abs(run - runs[256]).max() for n, run in runs.items()}
    assert error[1] > 2.0 * error[4] > 4.0 * error[16] > 0.0
    usual = close_loop(MODEL, loop, time, TARGET, substeps=substeps_for(MODEL.plant(), DT))
    np.testing.assert_array_equal(runs[None], usual.outputs[0])
