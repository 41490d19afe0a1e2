"""An augmented model as a program: what the simulator runs, with the model's numbers put in.

The loop over samples is the simulator's own, :mod:`.simulate.loops`; this file alone knows how
that loop is called.
"""

import ast
from dataclasses import replace
from math import ceil
from typing import Any

import numpy as np

from dmptm_ctrl.drive.rig import Input, Sensor
from dmptm_ctrl.export.program import Name, Port, Program, Store, make
from dmptm_ctrl.export.stepping import counter, finished, word
from dmptm_ctrl.export.trace import Scope, function_tree
from dmptm_ctrl.export.tracer import Latest, Ring, Row, Signals, Tracer
from dmptm_ctrl.signals.units import parse_unit
from dmptm_ctrl.simulate.any_model import at_rest, steps_of
from dmptm_ctrl.simulate.compiled import OUTPUTS, rest
from dmptm_ctrl.simulate.dual import outputs
from dmptm_ctrl.simulate.dual import start as start_of
from dmptm_ctrl.simulate.loading import loops
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.plant import Plant, numbers, structure_of
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.run import late_parts, start_state
from dmptm_ctrl.simulate.scalar import scalar_engine

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
    model: Model | RigModel,
    sample_time: float,
    *,
    name: str = "plant",
    notes: list[str] | None = None,
    start: float = 0.0,
) -> Program:
    """Return the step of a drive from one sample to the next, `sample_time` [s] later.

    Outputs are the readings at the sample's beginning; inputs are held. All is SI. The drive is at
    rest at first; at `start`, of a dual-motor drive, stands the ring gear [rad]; of another drive
    0 is the only place. NotScalar for a kernel that is more than scalar arithmetic, branches and
    loops.
    """
    plant, steps, (q, v) = model.plant(), steps_of(model, sample_time), at_rest(model)
    if isinstance(model, RigModel):
        inputs, seen = rig_ports(model)
        columns = list(range(len(seen)))
    else:
        said = "voltage of the {} motor, held until the next step"
        inputs = [Port(f"u_{s}", "V", said.format(s)) for s in ("left", "right")]
        named = zip(OUTPUTS, UNITS, TEXTS, strict=True)
        seen = [Port(n.lower(), unit, text) for n, unit, text in named]
        q, v = start_of(plant, rest(model, start))
        count, _, links, _, sensors = plant.size
        every = np.arange(sensors + 2.0 * links + 2.0 * count)[None]
        columns = [int(k) for k in outputs(plant, every)[0, : len(seen)]]
    return _program(plant, q, v, sample_time, steps, inputs, seen, columns, name, notes or [])


def _program(
    plant: Plant, q: Any, v: Any, dt: float, steps: int, inputs: list[Port], seen: list[Port],
    columns: list[int], name: str, notes: list[str],
) -> Program:  # fmt: skip
    """Follow the loop over samples for one sample; `columns` are those of the ports seen."""
    tracer = Tracer()
    names = [tracer.fresh(p.name) for p in inputs]
    inputs = [replace(p, name=n.id) for p, n in zip(inputs, names, strict=True)]
    seen = [replace(p, name=tracer.fresh(p.name).id) for p in seen]
    samples = counter(tracer)
    dead = plant.input_values[:, 1] / dt
    signals: list[Ring | Latest] = []
    keeping: list[Any] = []
    for port, late in zip(names, dead.tolist(), strict=True):
        signals.append(_signal(tracer, samples, port, late, keeping))

    structure = structure_of(plant, switched=False)
    engine = scalar_engine(structure)
    delays = plant.sensor_delay[plant.sensor_delay > 0.0]
    back = int(delays.max(initial=0.0) / (dt / steps)) + 2
    # a reading that is late is that of a body at rest where angles are 0, or of a speed
    ring = Signals(tuple(tracer.array("past_reading", back) for _ in delays), back)
    state = start_state(structure, q, v)
    count, _, links, _, sensors = plant.size
    row = tracer.cells([0.0] * (sensors + 2 * links + 2 * count))
    width, own = len(engine.names.signals), numbers(plant, engine.names.numbers, dt / steps)
    x = tracer.cells(state.values, dict(enumerate(state.names)))
    late, y = tracer.cells([0.0] * delays.size), tracer.cells([0.0] * (sensors + 2 * links))
    # what differs from step to step stands in arrays
    at_once = tracer.array("signal", steps * width) if dead.any() else tracer.cells([0.0] * width)
    latest = tracer.array("reading", steps * delays.size) if delays.size else None
    none = np.zeros(0)
    late_of, late_ratio = late_parts(plant, structure)
    given = {
        "advance": engine.module.advance, "x": x, "count": count,
        "drive": (x, own, plant.on, plant.values, none, none, none, none, at_once, late, latest, y),
        "signals": at_once, "stride": width if dead.any() else 0, "late": late, "latest": latest,
        "kept": delays.size, "sensors": sensors, "y": y, "again": True,
        "u": Signals(tuple(signals)), "first": 0, "before": np.zeros(len(names)), "dead": dead,
        "push": np.zeros((0, 0)), "given": none, "ring": ring, "delays": delays,
        "late_of": late_of, "late_ratio": late_ratio, "step0": 0, "begin": 0.0,
        "dt": dt, "substeps": steps, "closed": False, "watched": none,
        "out": Row(row, row.size),
    }  # fmt: skip

    march = loops().march
    tree = function_tree(getattr(march, "py_func", march))
    loop = next(n for n in tree.body if isinstance(n, ast.For))
    env = {a.arg: given.get(a.arg) for a in tree.args.args}
    scope = Scope(tracer, env, vars(loops()), "march")
    scope.run(tree.body[: tree.body.index(loop)])
    scope.env["i"] = samples
    body: list[Any] = []

    def one() -> None:
        scope.run(loop.body)

    carried, _ = scope.turning(body, one, keep=True)
    # steps are counted for the place in the ring alone
    carried = [(n, a, make("mod", b, back) if n.id == "done" else b) for n, a, b in carried]
    results = [tracer.heap[id(row), k] for k in columns]
    program = Program(name, inputs, seen, results, [], body, [], notes=notes)
    return finished(tracer, program, samples, carried, before=keeping)


def _signal(
    tracer: Tracer, samples: Name, port: Name, late: float, keeping: list[Any]
) -> Ring | Latest:
    """Return an input of which samples up to `late` ago are read; what keeps them is added."""
    if late <= 0.0:
        return Latest(port)
    array = tracer.array(f"past_{port.id}", ceil(late) + 3)
    keeping.append(Store(array, make("mod", samples, array.size), port))
    return Ring(array)


def rig_ports(model: RigModel) -> tuple[list[Port], list[Port]]:
    """Return the ports of a rig: its inputs, and the readings of its sensors."""
    inputs, seen = [], []
    for i in model.rig.inputs:
        unit = parse_unit(i.unit).symbol.replace("·", " ") or "1"
        text = f"{i.name}, held until the next step; {_column(i)}"
        inputs.append(Port(f"in_{word(i.name)}", unit, text))
    for s in model.rig.sensors:
        unit = model.rig.body(s.body).angle_unit + ("/s" if s.measures != "position" else "")
        seen.append(Port(f"out_{word(s.name)}", unit, f"reading of {s.name}; {_column(s)}"))
    return inputs, seen


def _column(part: Input | Sensor) -> str:
    """What a signal is in the logs' own unit, sign and counts."""
    return f"column {part.column} of the logs times {part.sign * parse_unit(part.unit).factor:.9g}"
