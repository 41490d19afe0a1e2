"""Controllers at the sample rate: of rig files, of python-control, and in plain Python."""

from collections.abc import Callable
from functools import partial
from typing import Any

import control as ct
import numpy as np

from dmptm_ctrl.drive.rig import Controller
from dmptm_ctrl.simulate.plant import Floats
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.run import Controller as RunController
from dmptm_ctrl.simulate.run import compiled_controller

Law = Callable[[float, float, Floats], Any]


@partial(compiled_controller, cache=True)
def pi_speed(i, t, dt, target, added, y, rule, memory, u):
    """Drive one input by the error of a speed; rule: sensor, input, limit, kp, ki."""
    error = target - y[int(rule[0])]
    memory[0] += error * dt
    command = rule[3] * error + rule[4] * memory[0] + added
    u[int(rule[1])] = min(max(command, -rule[2]), rule[2])


@partial(compiled_controller, cache=True)
def cascade(i, t, dt, target, added, y, rule, memory, u):
    """Drive one input by position and speed; rule: sensor, input, limit, kp, kv."""
    here = y[int(rule[0])]
    if memory[2] == 0.0:
        memory[0], memory[1], memory[2] = here, here, 1.0
    speed = (here - memory[1]) / (2.0 * dt)  # 2-sample mean, then difference
    memory[1], memory[0] = memory[0], here
    command = rule[4] * (rule[3] * (target - here) - speed) + added
    u[int(rule[1])] = min(max(command, -rule[2]), rule[2])


def controller_of(model: RigModel, controller: Controller) -> RunController:
    """Return a rig's controller for the compiled loop."""
    gains = controller.gains
    sensor = [s.name for s in model.rig.sensors].index(controller.sensor)
    source = model.layout.inputs.index(controller.input)
    last = "ki" if controller.kind == "pi_speed" else "kv"
    rule = [sensor, source, controller.limit, gains.get("kp", 0.0), gains.get(last, 0.0)]
    numbers: Floats = np.array(rule, float)
    return RunController(pi_speed if last == "ki" else cascade, numbers, 3)


def sampled(system: ct.LTI) -> Law:
    """Return a discrete system of python-control as a law ``(t, target, y) -> u``.

    Its input is the target less the first reading; or its inputs are the target and all readings.
    ValueError for a continuous system.
    """
    state_space = ct.ss(system)
    if not state_space.isdtime(strict=True):
        raise ValueError("the controller is continuous; give one with a sample time, as by c2d")
    state = np.zeros(state_space.nstates)

    def law(t: float, target: float, y: Floats) -> Floats:
        nonlocal state
        one = state_space.ninputs == 1
        given = np.array([target - y[0]]) if one else np.append(target, y)
        u: Floats = state_space.C @ state + state_space.D @ given
        state = state_space.A @ state + state_space.B @ given
        return u

    return law
