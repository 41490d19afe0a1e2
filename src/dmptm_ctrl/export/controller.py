"""A tuned controller as a program of its own: C, or Structured Text.

The equations are those that the simulated loop runs, :mod:`.simulate.control_core`, with the
controller's numbers put in.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.export.program import WIDE, Port, Program, make
from dmptm_ctrl.export.stepping import counter, finished, origin
from dmptm_ctrl.export.trace import Scope, follow
from dmptm_ctrl.export.tracer import Tracer
from dmptm_ctrl.simulate import control_core as core
from dmptm_ctrl.simulate.law import law_engine

INPUTS = (
    Port("setpoint", "rad/s", "wanted value of the ring gear's speed"),
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
    **{core.M_BRISTLES + k: f"friction_{b}" for k, b in enumerate(("left", "right", "ring"))},
}


def controller_program(
    controller: Controller, name: str = "controller", notes: list[str] | None = None
) -> Program:
    """Return the difference equations of a controller, and only what this controller uses.

    `notes` are comment lines for the head of the file; by default what :func:`provenance` gives.
    """
    law, dt = controller.law(), controller.sample_time
    design = law.model.arrays()
    if not any(design[1]):
        law = replace(law, invert=False)  # there is no drive to undo
    tracer = Tracer()
    ports = [tracer.fresh(p.name, p.kind) for p in INPUTS]
    for port in OUTPUTS:
        tracer.fresh(port.name)
    samples = counter(tracer)
    memory = tracer.cells([0.0] * core.MEMORY, KEPT)
    tracer.wide.add((id(memory), core.M_INTEGRAL))
    results: list[Any] = []

    def step() -> None:
        t = make("*", make("real", samples), dt)
        args = [*ports, t, dt, law.numbers(), memory, design]
        follow(tracer, law_engine().command, args)
        results[:] = [tracer.heap[id(memory), at] for at in (core.M_LEFT, core.M_RIGHT)]

    body: list[Any] = []
    scope = Scope(tracer, {}, {})
    carried, _ = scope.turning(body, step, keep=True)
    notes = provenance(controller) if notes is None else notes
    program = Program(name, list(INPUTS), list(OUTPUTS), results, [], body, [], notes=notes)
    return finished(tracer, program, samples, carried)


def provenance(controller: Controller, source: Path | None = None) -> list[str]:
    """Return the comment lines at the head of an exported controller, read from `source`."""
    lines = [
        "Speed controller of a drive with two motors on one ring gear.",
        f"Sample time: {controller.sample_time!r} s. Call the step once per sample.",
        "Units: SI, angles in rad, voltages in V.",
        *origin(source),
        "Difference equations:",
        *(f"  {line}" for line in controller.equations().splitlines()),
    ]
    return lines
