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
from dmptm_ctrl.simulate.plant import untwisted
from dmptm_ctrl.simulate.rig_model import RigModel

SPEEDS = 101  # rows over speed, from backward to forward; the middle one is at rest
ANGLES = 361  # rows over a turn or a metre, both ends included, and more where curves need them
MOST_ANGLES = 20_000
STRAIGHT = 0.01  # of its largest value: what a curve leaves of straight lines between rows
BETWEEN = 0.382  # of the way from row to row, where that is looked at; no wave repeats there
SPEED_RANGE = 2.0  # rad/s or m/s at the load, either way


def compensation_tables(model: Model | RigModel) -> dict[str, pd.DataFrame]:
    """Return what a drive must give to cancel friction and the torques of effects.

    ``friction`` over speed; ``load`` and ``motor`` over angle, where such effects are in the model.
    Units are in the columns' names, SI. Everything is at time 0 and without torque in the meshes.
    Of a dual-motor drive the voltages are those of each motor. Of a rig speed is that of its last
    body; ``load`` has its turning bodies, ``slide`` its sliding ones.
    """
    plant = model.plant()
    parts = Parts(plant)
    speed = np.linspace(-SPEED_RANGE, SPEED_RANGE, SPEEDS)

    def friction(body: int, factor: float = 1.0) -> Floats:
        return np.array([unloaded_friction(parts, body, factor * float(w)) for w in speed])

    def torques(bodies: Mapping[str, int], over: str, reach: float) -> dict[str, Floats]:
        """Columns of bodies that effects push, over the place; empty where they push none."""
        rows = ANGLES
        while True:
            angles = np.linspace(0.0, reach, rows)
            between = angles[:-1] + BETWEEN * angles[1]
            found = {name: torque(body, angles) for name, body in bodies.items()}
            straight = all(
                np.abs(np.interp(between, angles, row) - torque(bodies[name], between)).max()
                <= STRAIGHT * np.abs(row).max()
                for name, row in found.items()
            )
            if straight or rows > MOST_ANGLES:
                pushed = {name: row for name, row in found.items() if row.any()}
                return {over: angles, **pushed} if pushed else {}
            rows = 2 * rows - 1

    def torque(body: int, angles: Floats) -> Floats:
        return np.array([0.0 - parts.torque(body, 0.0, float(q), 0.0, 0.0) for q in angles])

    if isinstance(model, RigModel):
        last = model.rig.bodies[-1]
        linear = {b.name: b.linear for b in model.rig.bodies}
        sides: dict[bool, dict[str, int]] = {False: {}, True: {}}
        for k, name in enumerate(model.layout.bodies):
            sides[linear[name]][f"{name}_{'N' if linear[name] else 'N_m'}"] = k
        load = model.layout.bodies.index(last.name)
        reach = untwisted(plant, int(plant.body_coordinate[load])) / plant.body_ratio[load]
        turns = plant.body_ratio * reach[plant.body_coordinate]  # of each body per turn of the load
        own = {name: friction(k, turns[k]) for side in sides.values() for name, k in side.items()}
        tables: dict[str, Mapping[str, Floats]] = {
            "friction": {f"speed_{'m' if last.linear else 'rad'}_s": speed, **own},
            "load": torques(sides[False], "position_rad", 2 * pi),
            "slide": torques(sides[True], "position_m", 1.0),
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
        ring_gear = torques({"torque_N_m": RING}, "theta_L_rad", 2 * pi)
        if ring_gear:
            volt = ring_gear["torque_N_m"] / (2.0 * n2 * gain)
            tables["load"] = {**ring_gear, "u_V": volt}
        both_motors = zip(("torque_left_N_m", "torque_right_N_m"), MOTORS, strict=True)
        motor = torques(dict(both_motors), "theta_m_rad", 2 * pi)
        tables["motor"] = motor | {
            name.replace("torque", "u").replace("N_m", "V"): n1 * row / gain
            for name, row in motor.items()
            if name.startswith("torque")
        }
    return {name: pd.DataFrame(table) for name, table in tables.items() if table}


def write_tables(model: Model | RigModel, source: Path, folder: Path) -> None:
    """Write each table as a CSV, with what wrote it in comment lines ahead."""
    head = "".join(f"# {line}\n" for line in origin(source))
    for name, table in compensation_tables(model).items():
        text = head + table.to_csv(index=False, float_format="%.9g", lineterminator="\n")
        (folder / f"{name}.csv").write_text(text, encoding="utf-8")
