"""What cancels friction, load and motor torques, as tables over speed and angle."""

from collections.abc import Callable
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd

from dmptm_ctrl.design.preload import volt_at_pinion
from dmptm_ctrl.export.stepping import origin
from dmptm_ctrl.simulate.dual import MOTORS, RING
from dmptm_ctrl.simulate.model import Floats, Model
from dmptm_ctrl.simulate.parts import Parts
from dmptm_ctrl.simulate.rig_model import RigModel

SPEEDS = 101  # rows over speed, from backward to forward; the middle one is at rest
ANGLES = 361  # rows over a turn, both ends included
SPEED_RANGE = 2.0  # rad/s or m/s at the load, either way


def compensation_tables(model: Model | RigModel) -> dict[str, pd.DataFrame]:
    """Return what a drive must give to cancel friction and the torques of effects.

    ``friction`` over speed; ``load`` and ``motor`` over angle, where such effects are in the model.
    Units are in the columns' names, SI. Everything is at time 0 and without torque in the meshes.
    Of a dual-motor drive the voltages are those of each motor.
    """
    tables = _of_rig(model) if isinstance(model, RigModel) else _of_dual(model)
    return {name: table for name, table in tables.items() if not table.empty}


def _of_dual(model: Model) -> dict[str, pd.DataFrame]:
    parts, drive = Parts(model.plant()), model.drive
    n1, n2, gain = drive["N_1"], drive["N_2"], volt_at_pinion(drive)
    speed = np.linspace(-SPEED_RANGE, SPEED_RANGE, SPEEDS)

    def friction(body: int, factor: float) -> Floats:
        return _along(lambda w: _friction(parts, body, factor * w), speed)

    ring, left, right = friction(RING, 1.0), friction(0, n2), friction(1, n2)
    columns = {"speed_rad_s": speed, "ring_N_m": ring, "left_N_m": left, "right_N_m": right}
    for side, own in (("left", left), ("right", right)):
        columns[f"u_{side}_V"] = (ring / (2.0 * n2) + own) / gain
    tables = {"friction": pd.DataFrame(columns), "load": pd.DataFrame(), "motor": pd.DataFrame()}
    angle = np.linspace(0.0, 2 * pi, ANGLES)
    if "load" in model.sites:
        torque = _along(lambda q: -parts.torque(RING, 0.0, q, 0.0, 0.0), angle)
        tables["load"] = pd.DataFrame(
            {"theta_L_rad": angle, "torque_N_m": torque, "u_V": torque / (2.0 * n2 * gain)}
        )
    if "motor" in model.sites:
        columns = {"theta_m_rad": angle}
        for motor, name in zip(MOTORS, ("left", "right"), strict=True):
            torque = _along(lambda q, b=motor: -parts.torque(b, 0.0, q, 0.0, 0.0), angle)
            columns[f"torque_{name}_N_m"] = torque
            columns[f"u_{name}_V"] = n1 * torque / gain
        tables["motor"] = pd.DataFrame(columns)
    return tables


def _along(function: Callable[..., float], values: Floats) -> Floats:
    return np.array([function(float(x)) for x in values])


def _friction(parts: Parts, body: int, omega: float) -> float:
    if omega == 0.0:
        return 0.0
    way = 1.0 if omega > 0.0 else -1.0
    return way * float(parts.sliding(body, way, 0.0, omega, 0.0, 0.0, 0.0)[0])


def _of_rig(model: RigModel) -> dict[str, pd.DataFrame]:
    parts, layout = Parts(model.plant()), model.layout
    speed = np.linspace(-SPEED_RANGE, SPEED_RANGE, SPEEDS)
    angle = np.linspace(0.0, 2 * pi, ANGLES)
    friction, torques = {"speed_SI": speed}, {"position_SI": angle}
    for k, body in enumerate(layout.bodies):
        unit = "N" if any(b.name == body and b.linear for b in model.rig.bodies) else "N_m"
        friction[f"{body}_{unit}"] = _along(lambda w, b=k: _friction(parts, b, w), speed)
        torque = _along(lambda q, b=k: 0.0 - parts.torque(b, 0.0, q, 0.0, 0.0), angle)
        if torque.any():
            torques[f"{body}_{unit}"] = torque
    return {
        "friction": pd.DataFrame(friction),
        "load": pd.DataFrame(torques if len(torques) > 1 else {}),
    }


def write_tables(model: Model | RigModel, source: Path, folder: Path) -> None:
    """Write each table as a CSV, with what wrote it in comment lines ahead."""
    head = "".join(f"# {line}\n" for line in origin(source))
    for name, table in compensation_tables(model).items():
        text = head + table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
