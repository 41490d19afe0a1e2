"""What models of both kinds have: the dual-motor drive, and rigs of any shape."""

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from dmptm_ctrl.contract import Effect
from dmptm_ctrl.drive.parameters import Quantity
from dmptm_ctrl.drive.rig import Rig
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate.compiled import INPUTS, SEEN, rest, steps_in
from dmptm_ctrl.simulate.dual import start
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE, PlacedEffect
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import substeps_for

AnyModel = Model | RigModel
Values = Mapping[str, float]


def effects_of(model: AnyModel) -> dict[str, Effect | PlacedEffect]:
    """Return the effects of a model by what names them, as `without` takes it."""
    if isinstance(model, RigModel):
        return {e.key: PLACED_CATALOGUE[e.name] for e in model.effects}
    return {name: CATALOGUE[name] for name in model.effects}


def with_numbers(
    model: AnyModel,
    values: Values,
    change: Callable[[Effect | PlacedEffect, Values], Values],
) -> AnyModel:
    """Return a model with declared values replaced, and the numbers of each effect changed."""
    if isinstance(model, RigModel):
        placed = [
            e._replace(values=change(PLACED_CATALOGUE[e.name], e.values)) for e in model.effects
        ]
        return replace(model.with_values(values), effects=tuple(placed))
    found = {name: change(CATALOGUE[name], own) for name, own in model.effects.items()}
    return Model(model.drive.with_values(**values), found)


def declared_in(model: AnyModel) -> tuple[Mapping[str, Quantity], dict[str, float]]:
    """Return what a model declares, and its values of what is known."""
    if not isinstance(model, RigModel):
        return model.drive.quantities, dict(model.drive)
    known = [k for k, quantity in model.quantities.items() if np.isfinite(quantity.value)]
    return model.quantities, {k: model.value(k) for k in known}


def inputs_of(model: AnyModel) -> tuple[str, ...]:
    """Return the names of a model's inputs."""
    return tuple(i.name for i in model.rig.inputs) if isinstance(model, RigModel) else INPUTS


def seen_of(model: AnyModel) -> dict[str, str]:
    """Return what runs of many drives call a model's outputs and then its inputs, by name."""
    own = SEEN
    if isinstance(model, RigModel):
        own = {sensor.name: f"reading{i}" for i, sensor in enumerate(model.rig.sensors)}
    return own | {name: f"signal{j}" for j, name in enumerate(inputs_of(model))}


def at_rest(model: AnyModel) -> tuple[Floats, Floats]:
    """Return coordinates and speeds of a drive at rest at angle 0."""
    plant = model.plant()
    if isinstance(model, RigModel):
        return np.zeros(plant.inertia.size), np.zeros(plant.inertia.size)
    return start(plant, rest(model, 0.0))


def steps_of(model: AnyModel, dt: float) -> int:
    """Return how many steps the simulator takes per sample."""
    return substeps_for(model.plant(), dt) if isinstance(model, RigModel) else steps_in(dt)


def speed_read(model: AnyModel, reading: Floats, dt: float, sensor: int) -> Floats:
    """Return the true speed by readings of a sensor, of a speed or an angle, by its number.

    One with a wrong gain is put right: a loop is to move the load, not the sensor.
    """
    plant, parts = model.plant(), Parts(model.plant())
    if plant.sensor_speed[sensor]:
        return np.asarray(reading / parts.reading(sensor, 0.0, 1.0, 0.0))
    gain = parts.reading(sensor, 1.0, 0.0, 0.0) - parts.reading(sensor, 0.0, 0.0, 0.0)
    return np.asarray(np.gradient(reading, dt) / gain)


def loop_parts(model: AnyModel, source: str = "", sensor: str = "") -> tuple[tuple[int, ...], int]:
    """Return the numbers of a loop's inputs and of its sensor, by the names of a rig's."""
    if not isinstance(model, RigModel):
        return (0, 1), 1
    source, sensor = default_loop(model.rig, source, sensor)
    names = [one.name for one in model.rig.sensors]
    return (model.layout.inputs.index(source),), names.index(sensor)


def default_loop(rig: Rig, source: str = "", sensor: str = "") -> tuple[str, str]:
    """Return the names of input and sensor of a rig's loop: those given, its controller's, firsts.

    A speed sensor comes before a position. ValueError for names that the rig does not have.
    """
    own = rig.controller
    source = source or (own.input if own else rig.inputs[0].name)
    sensor = sensor or (own.sensor if own else rig.speed_sensor.name)
    for kind, name, parts in (("input", source, rig.inputs), ("sensor", sensor, rig.sensors)):
        names = [part.name for part in parts]
        if name not in names:
            raise ValueError(f"{rig.name} has no {kind} {name!r}; it has {', '.join(names)}")
    return source, sensor
