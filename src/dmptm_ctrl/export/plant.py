"""An augmented model as a program: what the simulator runs, with the model's numbers put in.

The step is the simulator's own, :mod:`.simulate.core` or :mod:`.simulate.chain_core`; this file
alone knows how these loops are built.
"""

import ast
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from dmptm_ctrl.export.places import Latest, Ring, Row, Signals
from dmptm_ctrl.export.program import Item, Name, Port, Program, Store, make
from dmptm_ctrl.export.stepping import counter, finished
from dmptm_ctrl.export.trace import Scope, function_tree
from dmptm_ctrl.export.tracer import Tracer
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate import chain_compose
from dmptm_ctrl.simulate.chain import substeps_for
from dmptm_ctrl.simulate.chain_model import ChainModel
from dmptm_ctrl.simulate.compiled import OUTPUTS, SUBSTEPS, rest
from dmptm_ctrl.simulate.compose import engine
from dmptm_ctrl.simulate.model import Model

UNITS = ("rad", "rad/s", "rad", "rad", "N m", "N m", "rad", "rad")
TEXTS = (
    "reading of the ring gear's angle",
    "reading of the ring gear's speed",
    "angle of the left motor",
    "angle of the right motor",
    "torque of the left mesh",
    "torque of the right mesh",
    "relative angle of the left mesh",
    "relative angle of the right mesh",
)


def plant_program(
    model: Model | ChainModel,
    sample_time: float,
    *,
    name: str = "plant",
    notes: list[str] | None = None,
    start: float = 0.0,
) -> Program:
    """Return the step of a drive from one sample to the next.

    Parameters
    ----------
    model : Model or ChainModel
    sample_time : float [s]
        Inputs are held for so long.
    start : float
        Where the drive is at rest at first: of a dual-motor drive the ring gear's angle [rad];
        of another drive 0 is the only place.

    Returns
    -------
    Program
        Its outputs are the readings at the sample's beginning; the step then goes on to the
        next sample. Inputs and outputs are SI.
    """
    if isinstance(model, ChainModel):
        return _chain_program(model, sample_time, name, notes or [])
    return _dual_program(model, sample_time, name, notes or [], start)


class _March:
    """The loop over samples of an engine, followed for one sample."""

    def __init__(self, function: Any, loop_rings: tuple[str, ...] = ()) -> None:
        function = getattr(function, "py_func", function)
        tree = function_tree(function)
        self.parameters = [a.arg for a in tree.args.args]
        at = next(
            k
            for k, node in enumerate(tree.body)
            if isinstance(node, ast.For) and getattr(node.target, "id", "") == "i"
        )
        loop = tree.body[at]
        assert isinstance(loop, ast.For)
        self.before, self.body = tree.body[:at], loop.body
        self.tracer = Tracer(loop_rings)
        self.names = function.__globals__
        self.samples = counter(self.tracer)

    def signal(self, port: Name, late: float) -> tuple[Ring | Latest, list[Any]]:
        """Return an input of which samples up to `late` ago are read, and what keeps them."""
        if late <= 0.0:
            return Latest(port), []
        array = self.tracer.array(f"past_{port.id}", ceil(late) + 3)
        place = make("mod", self.samples, array.size)
        return Ring(array), [Store(array, place, port)]

    def follow(self, arguments: list[Any]) -> tuple[list[Any], list[Any], list[Any]]:
        """Return statements of the first sample, those of each, and what they carry on."""
        named = dict(zip(self.parameters, arguments, strict=True))
        scope = Scope(self.tracer, named, self.names, "march")
        once: list[Any] = []
        with self.tracer.collected(once):
            scope.run(self.before)
        scope.env["i"] = self.samples
        block: list[Any] = []
        carried, _ = scope.turning(block, lambda: self._one(scope), keep=True)
        return once, block, carried

    def _one(self, scope: Scope) -> None:
        scope.run(self.body)


def _dual_program(model: Model, dt: float, name: str, notes: list[str], start: float) -> Program:
    march = _March(engine().march, ("history",))
    tracer = march.tracer
    ports = [
        Port("u_left", "V", "voltage of the left motor, held until the next step"),
        Port("u_right", "V", "voltage of the right motor, held until the next step"),
    ]
    outputs = [
        Port(n.lower(), unit, text) for n, unit, text in zip(OUTPUTS, UNITS, TEXTS, strict=True)
    ]
    inputs = [tracer.fresh(p.name) for p in ports]
    for port in outputs:
        tracer.fresh(port.name)
    late = model.effects.get("drive_delay", {}).get("delay", 0.0) / dt
    signals, keeping = zip(*(march.signal(n, late) for n in inputs), strict=True)
    arrays = model.arrays()
    row = tracer.cells([0.0] * len(OUTPUTS))
    arguments = [
        *(Signals(signals), np.zeros(6), arrays, np.zeros(0), np.zeros(3), np.zeros(0)),
        *(np.zeros((0, 3)), rest(model, start), 0.0, dt, SUBSTEPS, *arrays),
        Row(row, len(OUTPUTS)),
    ]
    once, body, carried = march.follow(arguments)
    before = [s for part in keeping for s in part]
    results = [tracer.heap[id(row), k] for k in range(len(OUTPUTS))]
    program = Program(name, ports, outputs, results, [], body, [], notes=notes)
    return finished(tracer, program, march.samples, carried, before=before, once=once)


def _chain_program(model: ChainModel, dt: float, name: str, notes: list[str]) -> Program:
    march = _March(chain_compose.engine().march)
    tracer, plant, layout = march.tracer, model.plant(), model.layout
    rig = model.rig
    ports = [
        Port(f"in_{_word(i.name)}", _si(i.unit), f"{i.name}, held until the next step")
        for i in rig.inputs
    ]
    outputs = [
        Port(f"out_{_word(s.name)}", _unit(model, s.name), f"reading of {s.name}")
        for s in rig.sensors
    ]
    inputs = [tracer.fresh(p.name) for p in ports]
    ports = [replace(p, name=n.id) for p, n in zip(ports, inputs, strict=True)]
    outputs = [replace(p, name=tracer.fresh(p.name).id) for p in outputs]
    late = plant.input_values[:, 1] / dt
    signals, keeping = zip(
        *(march.signal(n, float(d)) for n, d in zip(inputs, late, strict=True)), strict=True
    )
    n = layout.coordinates
    row = tracer.cells([0.0] * (2 * n + len(layout.links)))
    none = np.zeros((1, 0))
    arguments = [
        *(plant, Signals(signals), dt, substeps_for(plant, dt), np.zeros(n), np.zeros(n)),
        *(none, none, np.zeros(7), np.zeros(0), np.zeros(0)),
        Row(row, row.size),
    ]
    once, body, carried = march.follow(arguments)
    before = [s for part in keeping for s in part]
    with tracer.collected(body):
        results = [
            _reading(model, tracer, march.samples, [tracer.heap[id(row), k] for k in range(2 * n)],
                     s.name, dt)
            for s in rig.sensors
        ]  # fmt: skip
    program = Program(name, ports, outputs, results, [], body, [], notes=notes)
    return finished(tracer, program, march.samples, carried, before=before, once=once)


def _reading(
    model: ChainModel, tracer: Tracer, samples: Name, motion: list[Any], sensor: str, dt: float
) -> Any:
    """What a sensor reads, as :meth:`.ChainRun.reading`; `motion` is coordinates and speeds."""
    layout = model.layout
    item = next(s for s in model.rig.sensors if s.name == sensor)
    body = layout.sensor_body[sensor]
    at, ratio = layout.coordinate[body], layout.ratio[body]
    angle = tracer.kept("angle", make("*", ratio, motion[at]))
    value = angle
    if item.measures != "position":
        value = make("*", ratio, motion[layout.coordinates + at])
    for effect in model.effects:
        if effect.on != sensor:
            continue
        if effect.name == "sensor_delay":
            late = effect.values["delay"] / dt
            value = _delayed(tracer, samples, tracer.kept("reading", value), late)
        if effect.name == "sensor_gain":
            value = make("*", value, 1.0 + effect.values["error"])
        if effect.name == "encoder_eccentricity":
            c, s = (effect.values[k] for k in ("cosine", "sine"))
            wave = make("+", make("*", c, make("cos", angle)), make("*", s, make("sin", angle)))
            value = make("+", value, wave)
    return value


def _delayed(tracer: Tracer, samples: Name, value: Any, late: float) -> Any:
    """Signal `late` samples ago, between two of them; before the run its first value."""
    back, share = int(late), late - int(late)
    array = tracer.array("past_reading", back + 2)
    tracer.block.append(Store(array, make("mod", samples, array.size), value))
    newer, older = (
        Item(array, make("mod", make("max", make("-", samples, k), 0), array.size))
        for k in (back, back + 1)
    )
    return make("+", newer, make("*", share, make("-", older, newer)))


def _word(name: str) -> str:
    """Name as a program has it."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in name).lower()


def _si(unit: str) -> str:
    """SI unit of a column's, as programs write it."""
    return parse_unit(unit).symbol.replace("·", " ") or "1"


def _unit(model: ChainModel, sensor: str) -> str:
    item = next(s for s in model.rig.sensors if s.name == sensor)
    unit = model.rig.body(item.body).angle_unit
    return unit if item.measures == "position" else f"{unit}/s"
