"""What cancels friction, load and motor torques, as tables over speed and angle."""

from collections.abc import Mapping
from math import pi
from pathlib import Path

import numpy as np
import pandas as pd

from dmptm_ctrl.design.preload import unloaded_friction, volt_at_pinion
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
    parts = Parts(model.plant())
    speed = np.linspace(-SPEED_RANGE, SPEED_RANGE, SPEEDS)
    angle = np.linspace(0.0, 2 * pi, ANGLES)

    def friction(body: int, factor: float = 1.0) -> Floats:
        return np.array([unloaded_friction(parts, body, factor * float(w)) for w in speed])

    def torque(body: int) -> Floats:
        return np.array([0.0 - parts.torque(body, 0.0, float(q), 0.0, 0.0) for q in angle])

    if isinstance(model, RigModel):
        linear = {b.name for b in model.rig.bodies if b.linear}
        names = [f"{b}_{'N' if b in linear else 'N_m'}" for b in model.layout.bodies]
        load = {name: torque(k) for k, name in enumerate(names)}
        load = {name: row for name, row in load.items() if row.any()}
        tables: dict[str, Mapping[str, Floats]] = {
            "friction": {"speed_SI": speed, **{n: friction(k) for k, n in enumerate(names)}},
            "load": {"position_SI": angle, **load},
        }
    else:
        n1, n2, gain = model.drive["N_1"], model.drive["N_2"], volt_at_pinion(model.drive)
        ring, *both = friction(RING), friction(0, n2), friction(1, n2)
        volts = [(ring / (2.0 * n2) + own) / gain for own in both]
        tables = {
            "friction": {
                "speed_rad_s": speed, "ring_N_m": ring, "left_N_m": both[0], "right_N_m": both[1],
                "u_left_V": volts[0], "u_right_V": volts[1],
            }
        }  # fmt: skip
        if "load" in model.sites:
            row = torque(RING)
            tables["load"] = {
                "theta_L_rad": angle, "torque_N_m": row, "u_V": row / (2.0 * n2 * gain)
            }  # fmt: skip
        if "motor" in model.sites:
            columns = {"theta_m_rad": angle}
            for motor, name in zip(MOTORS, ("left", "right"), strict=True):
                columns[f"torque_{name}_N_m"] = torque(motor)
                columns[f"u_{name}_V"] = n1 * columns[f"torque_{name}_N_m"] / gain
            tables["motor"] = columns
    return {name: pd.DataFrame(table) for name, table in tables.items() if len(table) > 1}


def write_tables(model: Model | RigModel, source: Path, folder: Path) -> None:
    """Write each table as a CSV, with what wrote it in comment lines ahead."""
    head = "".join(f"# {line}\n" for line in origin(source))
    for name, table in compensation_tables(model).items():
        text = head + table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
