"""Free run of a rig on a log: what the sensors would have read."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import ceil
from typing import NamedTuple

import numpy as np

from dmptm_ctrl.drive.rig import Sensor
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.model import Floats
from dmptm_ctrl.simulate.observer import NO_OBSERVER, Observer, observer_gains, rigid_observer
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import RigRun, march, most_substeps, substeps_for

START = 12  # samples from which the first position and speed are taken
MANY = 4  # samples or fewer show no speed; the start counts as at rest
SURE = 3.0  # standard errors; slower at the start is at rest
TWINS = 8  # drives beside a fitted one, whose scatter no fit can remove
# Standard deviation of how stiffness and damping of meshes, which decide when teeth leave their
# flank, and waves change; no fit knows them more finely.
SPREAD = 0.003
STEPS_PER_RADIAN = 4.0  # of the fastest mode; they miss 2e-4 of a speed, sensors far more
LANES_FROM = 3e5  # steps of all logs once; hundreds of such runs take longer than to compile lanes


def initial(model: RigModel, log: Log) -> tuple[dict[str, float], dict[str, float]]:
    """Return position and speed of every body at a log's first sample.

    Bodies without a sensor start in step with those that have one. A log that starts at rest,
    as most do, has speed 0.
    """
    layout, rig = model.layout, model.rig
    reach = untwisted(model.plant())
    position: dict[int, float] = {}
    speed: dict[int, float] = {}
    for sensor in (s for s in rig.sensors if s.channel in log):
        body = layout.sensor_body[sensor.name]
        group, r = layout.coordinate[body], layout.ratio[body]
        head = log[sensor.channel][:START]
        time = log.time[: head.size] - log.time[0]
        if sensor.measures == "position":
            position.setdefault(group, float(head[0]) / r)
            if group not in speed:
                speed[group] = _first(time, head, 1) / r
        else:
            speed[group] = _first(time, head, 0) / r
    known_q = next(iter(position.items()), (0, 0.0))
    known_v = next(iter(speed.items()), (0, 0.0))
    q0, v0 = {}, {}
    for body in layout.bodies:
        group, r = layout.coordinate[body], layout.ratio[body]
        q = position.get(group, known_q[1] * reach[group] / reach[known_q[0]])
        v = speed.get(group, known_v[1] * reach[group] / reach[known_v[0]])
        q0[body], v0[body] = r * q, r * v
    return q0, v0


def _first(time: Floats, head: Floats, order: int) -> float:
    """Derivative of readings at their first sample, 0 where their noise could be all of it.

    With a term more than it needs: a drive that starts from rest accelerates.
    """
    if time.size <= MANY:
        return 0.0
    terms = np.vander(time / time[-1], order + 2, increasing=True)
    found, left, *_ = np.linalg.lstsq(terms, head, rcond=None)
    variance = float(np.sum(left)) / (time.size - terms.shape[1])
    error = np.sqrt(variance * np.linalg.inv(terms.T @ terms)[order, order])
    return float(found[order] / time[-1] ** order) if abs(found[order]) > SURE * error else 0.0


class _Start(NamedTuple):
    """How a run along a log begins, and what leads it."""

    u: Floats
    position: dict[str, float]
    speed: dict[str, float]
    substeps: int
    observer: Observer
    measured: Floats | None


def free_run(model: RigModel, log: Log, *, lead_hz: float = 0.0) -> RigRun:
    """Run a rig on a log's inputs, from its first sample.

    Angles of bodies on both sides of a spring may have zeros of their own: such a spring
    starts untwisted. An observer of bandwidth `lead_hz` leads the run by the log's first position,
    or else speed.
    """
    start = _start(model, log, lead_hz)
    return march(
        model, start.u, log.sample_time, position=start.position, speed=start.speed,
        substeps=start.substeps, before=start.u[:, 0], observer=start.observer,
        measured=start.measured,
    )  # fmt: skip


def free_readings(
    models: Sequence[RigModel], log: Log, sensor: str, *, lead_hz: float = 0.0
) -> Floats:
    """Return what a sensor would read in :func:`free_run` of several models, (models, n).

    They run beside each other, as the lanes of one loop; rounding differs from that of one run.
    """
    first = _start(models[0], log, lead_hz)
    starts = [first, *(_start(model, log, lead_hz, first.speed) for model in models[1:])]
    dt, rig, none = log.sample_time, models[0].rig, np.zeros((1, 1))
    index = [s.name for s in rig.sensors].index(sensor)
    common = Common(
        dt, max(s.substeps for s in starts), len(log), first.u[None], none, none[:0],
        (f"reading{index}",), before=first.u[:, 0],
    )  # fmt: skip
    observers = None
    if lead_hz:
        observers = [s.observer for s in starts]
        common = common._replace(measured=np.array([[s.measured] for s in starts], float))
    coordinates = [
        (_by_coordinate(m, s.position), _by_coordinate(m, s.speed))
        for m, s in zip(models, starts, strict=True)
    ]
    found, _ = run_many(models, coordinates, common, observers=observers, switched=True)
    return np.array([_zeroed(log, rig.sensors[index], run[0]) for run in found])


def in_lanes(model: RigModel, logs: Iterable[Log]) -> bool:
    """Whether many runs along logs are worth lanes of their own."""
    plant = model.plant()
    steps = (len(log) * substeps_for(plant, log.sample_time, STEPS_PER_RADIAN) for log in logs)
    return sum(steps) > LANES_FROM


def _by_coordinate(model: RigModel, of_bodies: Mapping[str, float]) -> Floats:
    found = np.zeros(model.layout.coordinates)
    for body, value in of_bodies.items():
        found[model.layout.coordinate[body]] = value / model.layout.ratio[body]
    return found


def _start(
    model: RigModel, log: Log, lead_hz: float, speed: dict[str, float] | None = None
) -> _Start:
    """Return how a run begins; with the `speed` of bodies as another model has it, if given."""
    q0, v0 = initial(model, log)
    u = np.array([log[i.channel] for i in model.rig.inputs])
    layout = model.layout
    seen: dict[int, str] = {}
    for body in layout.bodies:
        seen.setdefault(layout.coordinate[body], body)
    # in step with the driven coordinate; readings get their own zero back
    reach = untwisted(model.plant())
    base = seen[0]
    q_base = q0[base] / layout.ratio[base]
    position = {b: layout.ratio[b] * q_base * reach[g] for g, b in seen.items()}
    # a log begins in the midst of things: earlier signals were as its first
    steps = substeps_for(model.plant(), log.sample_time, STEPS_PER_RADIAN)
    steps = min(max(steps, _steps_of_waves(model, log)), most_substeps(log.sample_time))
    run = partial(march, model, dt=log.sample_time, position=position, before=u[:, 0])
    run = partial(run, substeps=steps)
    if speed is None:
        moving = {b: v0[b] for b in seen.values()}
        speed = _likelier(run, log, u, [dict.fromkeys(moving, 0.0), moving])
    if lead_hz == 0.0:
        return _Start(u, position, speed, steps, NO_OBSERVER, None)
    rig = model.rig
    index = next((i for i, s in enumerate(rig.sensors) if s.measures == "position"), 0)
    sensor = rig.sensors[index]
    measured = log[sensor.channel]
    if sensor.measures == "position":
        body = layout.sensor_body[sensor.name]
        begun = layout.ratio[body] * q_base * reach[layout.coordinate[body]]
        if any(e.on == sensor.name for e in model.effects):  # it reads something else
            begun = run(u[:, :1], speed=speed).reading(sensor.name)[0]
        measured = measured - measured[0] + begun
    observer = rigid_observer(model.plant(), index, observer_gains(lead_hz, log.sample_time))
    return _Start(u, position, speed, steps, observer, measured)


def _steps_of_waves(model: RigModel, log: Log) -> int:
    """Steps per sample that follow the waves over the angle as fast as a log turns: one a radian.

    With fewer, a wave that passes in one step pushes one way all the time.
    """
    layout, reach = model.layout, untwisted(model.plant())
    fastest = 0.0  # of the driven coordinate [rad per sample]
    for sensor in (s for s in model.rig.sensors if s.channel in log):
        reading, body = log[sensor.channel], layout.sensor_body[sensor.name]
        if sensor.measures == "position":
            rate = np.abs(reading[START:] - reading[:-START]) / START
        else:
            rate = np.abs(reading) * log.sample_time
        by = abs(layout.ratio[body] * reach[layout.coordinate[body]])
        fastest = max(fastest, float(rate.max(initial=0.0)) / by)
    turns = [
        e.values.get("order", 0.0) * abs(layout.ratio[e.on] * reach[layout.coordinate[e.on]])
        for e in model.effects
        if e.on in layout.coordinate
    ]
    return ceil(fastest * max(turns, default=0.0))


def _likelier(
    run: Callable[..., RigRun], log: Log, u: Floats, starts: list[dict[str, float]]
) -> dict[str, float]:
    """Return the first speeds from which a run follows the first readings best.

    A few readings of a drive that starts from rest, of bodies that ring or by coarse encoders,
    look like a speed; by a model they do not.
    """
    if starts[0] == starts[1]:
        return starts[0]
    head = slice(0, START)
    missed = []
    for speed in starts:
        begun = run(u[:, head], speed=speed)
        seen = readings(begun.model, log, begun)
        own = [np.sum((seen[s.name] - log[s.channel][head]) ** 2)
               for s in begun.model.rig.sensors if s.channel in log]  # fmt: skip
        missed.append(float(np.sum(np.log(np.maximum(own, np.finfo(float).tiny)))))
    return starts[int(np.argmin(missed))]


def readings(model: RigModel, log: Log, run: RigRun) -> dict[str, Floats]:
    """What each sensor would read on a log, its own zero kept, without noise."""
    found = {}
    for sensor in model.rig.sensors:
        found[sensor.name] = _zeroed(log, sensor, run.reading(sensor.name))
    return found


def _zeroed(log: Log, sensor: Sensor, values: Floats) -> Floats:
    """What a sensor reads, its zero as on a log."""
    if sensor.measures == "position" and sensor.channel in log:
        return values - values[0] + log[sensor.channel][0]
    return values


def with_other_teeth(model: RigModel) -> list[RigModel]:
    """Return models that differ slightly where links have a gap, and in waves; else none.

    After impacts each run is chance, down to the last digit of the arithmetic, and so is which
    wave of cogging holds a body. A gap in a spring that was added to the declared model stays.
    """
    gaps = zip(model.layout.links, model.plant().link_gap, strict=True)
    keys = [f"link.{n}.{part}" for n, gap in gaps if gap > 0 for part in ("stiffness", "damping")]
    keys = [key for key in keys if key in model.quantities]
    waves = [e for e in model.effects if "order" in e.values and e.on in model.layout.coordinate]
    rng = np.random.default_rng(0)
    shares = 1.0 + SPREAD * rng.standard_normal((TWINS, len(keys) + len(waves)))
    found = []
    for row in shares.tolist() if keys or waves else ():
        near = model.with_values({k: s * model.value(k) for k, s in zip(keys, row, strict=False)})
        of = dict(zip((e.key for e in waves), row[len(keys) :], strict=True))
        found.append(
            replace(near, effects=tuple(_sized(e, of.get(e.key, 1.0)) for e in near.effects))
        )
    return found


def _sized(effect: Placed, by: float) -> Placed:
    """Return an effect with its wave so many times as high."""
    high = {n: by * v for n, v in effect.values.items() if n in ("cosine", "sine")}
    return effect._replace(values={**effect.values, **high})
