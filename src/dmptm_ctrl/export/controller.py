"""A tuned controller as a program of its own: C, or Structured Text.

The equations are those that the simulated loop runs, :mod:`.simulate.control_core`, with the
controller's numbers put in.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.export.plant import rig_ports
from dmptm_ctrl.export.program import REAL, WIDE, Port, Program, make
from dmptm_ctrl.export.stepping import counter, finished, origin
from dmptm_ctrl.export.trace import Scope, follow
from dmptm_ctrl.export.tracer import Tracer
from dmptm_ctrl.simulate import control_core as core
from dmptm_ctrl.simulate.law_text import Wiring
from dmptm_ctrl.simulate.rig_model import RigModel

MOST_COORDINATES = 32
READINGS = (
    Port("theta_load", "rad", "reading of the ring gear's angle", WIDE),
    Port("omega_load", "rad/s", "reading of the ring gear's speed"),
    Port("theta_left", "rad", "reading of the left motor's angle", WIDE),
    Port("theta_right", "rad", "reading of the right motor's angle", WIDE),
)
OUTPUTS = (
    Port("u_left", "V", "voltage of the left motor"),
    Port("u_right", "V", "voltage of the right motor"),
)
KEPT = {
    core.M_INTEGRAL: "integral",
    **{core.M_DELAYS + k: f"section_{k + 1}" for k in range(4)},
    core.M_LAST: "last_reference",
    core.M_STARTED: "started",
    core.M_LEFT: "left",
    core.M_RIGHT: "right",
    core.M_ANGLE: "last_angle",
    **{core.M_BRISTLES + k: f"friction_{k}" for k in range(MOST_COORDINATES)},
}


def controller_program(
    controller: Controller, name: str = "controller", notes: list[str] | None = None
) -> Program:
    """Return the difference equations of a controller, and only what this controller uses.

    `notes` are comment lines for the head of the file; by default what :func:`provenance` gives.
    """
    law, dt = controller.law(), controller.sample_time
    wired = law.wired
    if not wired.design[1].any():
        law = replace(law, invert=False)  # there is no drive to undo
    tracer = Tracer()
    given, outputs = _ports(controller, wired.wiring)
    names = [tracer.fresh(p.name, p.kind) for p in given]
    outputs = [replace(p, name=tracer.fresh(p.name).id) for p in outputs]
    inputs = [replace(p, name=n.id) for p, n in zip(given, names, strict=True)]
    samples = counter(tracer)
    memory = tracer.cells([0.0] * wired.memory, KEPT)
    tracer.wide.add((id(memory), core.M_INTEGRAL))
    results: list[Any] = []

    def step() -> None:
        t = make("*", make("real", samples), dt)
        args = [*names, t, dt, law.numbers(), memory, wired.design]
        follow(tracer, wired.module.command, args)
        results[:] = [tracer.heap[id(memory), core.M_LEFT + k] for k in range(len(outputs))]

    body: list[Any] = []
    scope = Scope(tracer, {}, {})
    carried, _ = scope.turning(body, step, keep=True)
    notes = provenance(controller) if notes is None else notes
    program = Program(name, inputs, outputs, results, [], body, [], notes=notes)
    return finished(tracer, program, samples, carried)


def _ports(controller: Controller, wiring: Wiring) -> tuple[list[Port], list[Port]]:
    """Setpoint and readings, and signals, named as those of the exported plant are."""
    if not isinstance(controller.model, RigModel):
        speed = Port("setpoint", "rad/s", "wanted value of the ring gear's speed")
        return [speed, *READINGS], list(OUTPUTS)
    signals, seen = rig_ports(controller.model)
    name = controller.model.rig.sensors[wiring.heard].name
    speed = Port("setpoint", f"{controller.units[1]}/s", f"wanted value of the speed at {name}")
    angles = ("rad", "m")
    readings = [
        replace(seen[i], kind=WIDE if seen[i].unit in angles else REAL) for i in wiring.sensors
    ]
    return [speed, *readings], [signals[j] for j in wiring.inputs]


def provenance(controller: Controller, source: Path | None = None) -> list[str]:
    """Return the comment lines at the head of an exported controller, read from `source`."""
    model, drive = controller.model, "a drive with two motors on one ring gear"
    if isinstance(model, RigModel):
        drive = f"the rig {model.rig.name}"
    return [
        f"Speed controller of {drive}.",
        f"Sample time: {controller.sample_time!r} s. Call the step once per sample.",
        "Units: SI, angles in rad; of each signal beside it.",
        *origin(source),
        "Difference equations:",
        *(f"  {line}" for line in controller.equations().splitlines()),
    ]
