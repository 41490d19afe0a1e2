"""The linear plant that a design starts from."""

from contextlib import suppress
from typing import Any

import control as ct

from dmptm_ctrl.simulate.any_model import AnyModel, default_loop, effects_of
from dmptm_ctrl.simulate.linear import linearize, turning
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import RigModel

PRELOADS = (0.3, 0.5, 0.8, 1.2)  # V; the least of them that keeps the meshes closed
DERIVATIVE = 0.5  # samples by which the difference of an angle is late


def linear_plant(model: Model, **turn: float) -> Any:
    """Linearise a model about a steady turn, the slowest usual one, under the least preload."""
    *less, most = PRELOADS
    for preload in less:
        with suppress(ValueError):
            return linearize(model, *turning(model, preload=preload, **turn))
    return linearize(model, *turning(model, preload=most, **turn))


def linear_rig(model: RigModel, source: str, sensor: str, sample_time: float) -> ct.StateSpace:
    """Return a rig from one input to the speed that a sensor measures, named as of a dual drive."""
    source, sensor = default_loop(model.rig, source, sensor)
    one = next(s for s in model.rig.sensors if s.name == sensor)
    column = model.layout.inputs.index(source)
    name, late = sensor, 0.0
    if one.measures == "position":
        name, late = f"v_{model.layout.sensor_body[sensor]}", DERIVATIVE * sample_time
        late += float(model.plant().sensor_delay[model.rig.sensors.index(one)])
    sys = linearize(model, outputs=[name])
    sys = ct.ss(sys.A, sys.B[:, [column]], sys.C, sys.D[:, [column]])
    if late:
        sys = ct.ss(ct.tf(*ct.pade(late, 2))) * sys
    return ct.ss(sys.A, sys.B, sys.C, sys.D, inputs=["u"], outputs=["omega_L"], name="rig")


def level(model: AnyModel) -> Any:
    """The model without what depends on an angle.

    Linearised at one place such torques are a spring, or push away: no plant whose speed an
    integrator can hold. Over a turn they are a disturbance.
    """
    acts: Any = {k: getattr(e, "effect", e) for k, e in effects_of(model).items()}
    return model.without([k for k, e in acts.items() if any("theta" in x for x in e.depends_on)])
