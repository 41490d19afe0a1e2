"""The augmented model as a program of its own: values written out, python-control at the end."""

from collections.abc import Mapping

from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model

HEAD = '''\
"""The drive as diagnosed, in python-control. Values in SI, angles in radians."""

import control as ct
import numpy as np

from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.blocks import initial_state
from dmptm_ctrl.simulate.compiled import rest
from dmptm_ctrl.simulate.model import Model

'''
TAIL = """\
model = Model(drive, effects)
plant = model.to_blocks()  # ct.InterconnectedSystem, the effects included

time = np.arange(0.0, 0.05, 1e-3)  # s
voltage = np.full((2, time.size), 0.6)  # V, left and right
start = initial_state(model, plant, rest(model, 0.0))
response = ct.input_output_response(
    plant, time, voltage, start, solve_ivp_kwargs={"max_step": 1e-3}
)
"""


def rebuilding_code(model: Model) -> str:
    """Return a program that builds a model, and runs it for 50 ms, without any file.

    Parameters
    ----------
    model : Model
        Numbers are written so that they come back to the last bit.
    """
    paper = paper_drive()
    values = {
        name: model.drive[name]
        for name in model.drive.quantities
        if name not in paper.quantities or model.drive[name] != paper[name]
    }
    lines = ["drive = paper_drive().with_values(", *_lines(values, "    {}={!r},"), ")"]
    if not values:
        lines = ["drive = paper_drive()"]
    lines.append("effects = {")
    for name, parameters in model.effects.items():
        lines += [f'    "{name}": {{', *_lines(parameters, '        "{}": {!r},'), "    },"]
    return HEAD + "\n".join([*lines, "}", TAIL])


def _lines(values: Mapping[str, float], form: str) -> list[str]:
    return [form.format(name, float(value)) for name, value in values.items()]
