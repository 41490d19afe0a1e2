"""A planned experiment ready to run: inside the rig's limits, as CSV, C or Structured Text."""

from dataclasses import dataclass, replace
from math import ceil, inf
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from dmptm_ctrl.export.program import Array, Assign, If, Item, Name, Port, Program, make
from dmptm_ctrl.export.stepping import counter, finished, origin, word
from dmptm_ctrl.export.tracer import Tracer
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.any_model import inputs_of
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march as march_rig

HALVINGS = 20  # of the factor that brings a signal inside its limits
FINE = 1e-3  # s, between simulated samples: a load may be fastest between those of the signal
# Behind the end the load coasts, until its speed is down to this share of the largest, or so long
RESTS, LONGEST = 1e-4, 300.0  # 1, s
TIME = "time_s"


@dataclass(frozen=True)
class Limits:
    """What a rig can take."""

    signal: float = inf  # largest magnitude of each input [V, or the input's SI unit]
    speed: float = inf  # largest of the load [rad/s or m/s]
    travel: float = inf  # largest of the load from where it starts [rad or m]


def read_signals(file: Path) -> pd.DataFrame:
    """Read a table of signals over even times, as next_experiment.csv."""
    try:
        table = pd.read_csv(file, comment="#")
        values = table.to_numpy(float)
    except (OSError, ValueError):
        raise LogError(f"{file.name}: no readable table of signals there") from None
    if TIME not in table.columns or table.shape[1] < 2 or len(table) < 2:
        raise LogError(f"{file.name}: needs a column {TIME}, one per signal, and two rows or more")
    if not np.isfinite(values).all():
        row = int(np.argmin(np.isfinite(values).all(axis=1)))
        raise LogError(f"{file.name}, row {row + 1}: a value that is no finite number")
    steps = np.diff(table[TIME].to_numpy(float))
    if steps.min() <= 0.0 or np.ptp(steps) > 1e-6 * steps.mean() + 1e-9:
        raise LogError(f"{file.name}: the times are not evenly spaced")
    return table


def within(
    table: pd.DataFrame,
    limits: Limits,
    *,
    model: Model | RigModel | None = None,
    sample_time: float | None = None,
) -> pd.DataFrame:
    """Return signals at a sample time [s], made smaller until a rig can take them.

    The table has a column time_s and one per input of the model, in its order; signals are held
    from sample to sample. Where speed or travel are limited, a model gives them by simulation from
    rest, and all signals shrink by one factor. LogError for limits that cannot be kept or computed.
    """
    time = table[TIME].to_numpy(float)
    dt = sample_time or float(time[1] - time[0])
    clock = np.arange(time[0], time[-1] + 0.5 * dt, dt)
    rows = np.clip(np.searchsorted(time, clock + 1e-9, side="right") - 1, 0, time.size - 1)
    names = [c for c in table.columns if c != TIME]
    if not min(limits.signal, limits.speed, limits.travel) > 0.0:
        raise LogError("a limit is not positive; no signal keeps it")
    signals = np.clip(table[names].to_numpy(float).T[:, rows], -limits.signal, limits.signal)
    if min(limits.speed, limits.travel) < inf:
        if model is None:
            raise LogError("limits of speed and travel need a model: give --model model.toml")
        signals = _smaller(signals, dt, limits, model)
    columns: dict[str, Floats] = {TIME: clock - clock[0]}
    columns |= dict(zip(names, signals, strict=True))
    return pd.DataFrame(columns)


def _smaller(signals: Floats, dt: float, limits: Limits, model: Model | RigModel) -> Floats:
    inputs = len(inputs_of(model))
    if len(signals) != inputs:
        raise LogError(f"{len(signals)} signals, and the model has {inputs} inputs")

    times = ceil(dt / FINE)
    fine, step = np.repeat(signals, times, axis=1), dt / times

    def keeps(factor: float) -> bool:
        coast = fine.shape[1]
        while True:
            whole = np.hstack([factor * fine, np.zeros((inputs, coast))])
            position, speed = _motion(model, whole, step)
            fast = float(np.abs(speed).max())
            far = float(np.abs(position - position[0]).max())
            if not (far <= limits.travel and fast <= limits.speed):
                return False
            if abs(speed[-1]) <= RESTS * fast or coast * step > LONGEST:
                return True
            coast *= 4

    if keeps(1.0):
        return signals
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    if low == 0.0:
        raise LogError("no signal of this shape keeps the limits; widen them")
    return low * signals


def _motion(model: Model | RigModel, signals: Floats, dt: float) -> tuple[Floats, Floats]:
    """Position and speed of the load."""
    if isinstance(model, RigModel):
        run = march_rig(model, np.ascontiguousarray(signals), dt)
        load = model.rig.bodies[-1].name
        return run.position(load), run.speed(load)
    out = march(model, np.ascontiguousarray(signals), rest(model, 0.0), dt, meshes=False)
    return out[:, 0], out[:, 1]


def experiment_program(table: pd.DataFrame, source: Path | None = None) -> Program:
    """Return a program that gives the signals one sample after the other, then 0.

    Its outputs are the signals, and ``running``, 1 while they last.
    """
    names = [c for c in table.columns if c != TIME]
    tracer = Tracer()
    ports = []
    for name in names:
        stem, _, unit = name.rpartition("_")
        ports.append(Port(word(stem or name), unit if stem else "1", f"signal {name}"))
    ports.append(Port("running", "1", "1 while the experiment lasts, then 0"))
    ports = [replace(p, name=tracer.fresh(p.name).id) for p in ports]
    samples = counter(tracer)
    running = make("<", samples, len(table))
    body: list[Any] = []

    def shown(name: str, value: Any) -> Name:
        """Return a name that has a value while the experiment lasts, then 0."""
        now = tracer.fresh(name)
        body.extend([Assign(now, 0.0), If(running, [Assign(now, value, declare=False)], [])])
        return now

    results = []
    for port, name in zip(ports, names, strict=False):
        values = tuple(float(v) for v in table[name])
        array = Array(tracer.fresh(f"{port.name}_table").id, len(values), values)
        results.append(shown(f"{port.name}_now", Item(array, samples)))
    results.append(shown("lasts", 1.0))
    dt = float(table[TIME].iloc[1] - table[TIME].iloc[0])
    notes = [
        "Experiment that separates effects. Call the step once per sample.",
        f"Sample time: {dt!r} s, {len(table)} samples.",
        *origin(source),
    ]
    program = Program("next_experiment", [], ports, results, [], body, [], notes=notes)
    return finished(tracer, program, samples, [])
