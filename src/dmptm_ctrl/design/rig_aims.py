"""What the loop of a rig of any shape is to do, where its user does not say."""

import numpy as np

from dmptm_ctrl.design.aims import HIGHEST_HZ, Aims
from dmptm_ctrl.design.duty import usual_duty
from dmptm_ctrl.simulate.any_model import default_loop
from dmptm_ctrl.simulate.law import FAR
from dmptm_ctrl.simulate.plant import link_matrices, untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

SHARE = 0.3  # of the input's limit, for inertia along the duty, and for viscous friction
RESERVE = 10.0  # of the duty's acceleration; steps of the setpoint are fed forward with this
HIGHEST_SHARE = 0.06  # of the sample rate, of the bandwidth
ROUNDING = 12.0**-0.5  # rms over the step of a reading


def rig_aims(
    model: RigModel,
    input: str = "",
    sensor: str = "",
    *,
    limit: float | None = None,
    speed: float | None = None,
    sample_time: float = 1e-3,
) -> Aims:
    """Return aims for one input and one sensor of a rig, by default those of its loop.

    The `limit` of the input [SI] is by default the rig file's. `speed` is the largest setpoint of
    the sensor's speed [SI]; by default one at which the duty's acceleration takes :data:`SHARE` of
    the limit, and viscous friction no more. ValueError without a limit, and for an input that
    drives the sensor backwards.
    """
    source, seen = default_loop(model.rig, input, sensor)
    plant, layout = model.plant(), model.layout
    if limit is None and model.rig.inputs[layout.inputs.index(source)].limit is not None:
        limit = model.value(f"input.{source}.limit")
    if limit is None or (speed is None and not np.isfinite(limit)):
        raise ValueError(
            f"input {source} has no limit in the rig file; give the largest signal, "
            f"as limit in [input.{source}]"
        )
    driven, sensed = layout.input_body[source], layout.sensor_body[seen]
    reach = untwisted(plant, layout.coordinate[sensed])  # per motion of the sensor's group
    turn = layout.ratio[driven] * reach[layout.coordinate[driven]] / layout.ratio[sensed]
    torque = turn * float(plant.input_values[layout.inputs.index(source), 0])  # per signal
    if not torque > 0.0:
        raise ValueError(f"a positive signal of {source} moves {seen} backwards; declare a ratio "
                         "or gain of the other sign, and sign = -1 for the column")  # fmt: skip
    moved = reach / layout.ratio[sensed]
    inertia = float(moved**2 @ plant.inertia)
    viscous = float(moved**2 @ link_matrices(plant)[3])
    if speed is None:
        steepest = float(np.abs(usual_duty(sample_time, 1.0).acceleration).max())
        speed = SHARE * limit * torque / max(steepest * inertia, viscous)
    duty = usual_duty(sample_time, speed)
    most = RESERVE * float(np.abs(duty.acceleration).max())
    one = next(s for s in model.rig.sensors if s.name == seen)
    noise = 0.0 if one.noise is None else one.noise.value
    step = 0.0 if one.resolution is None else one.resolution.value
    return Aims(
        highest_hz=min(HIGHEST_HZ, HIGHEST_SHARE / sample_time),
        limit=limit,
        acceleration=min(most, FAR),
        duty=duty,
        noise=float(np.hypot(noise, ROUNDING * step)),
    )
