"""A model or controller as a python-control program, its numbers written out."""

from pathlib import Path
from typing import Any

import numpy as np

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.export.controller import provenance
from dmptm_ctrl.export.stepping import origin
from dmptm_ctrl.simulate.model_file import model_text

_CONTROLLER = """\
import control as ct

feedback = ct.ss(
    {a!r},
    {b!r},
    {c!r},
    {d!r},
    {dt!r},  # s
    inputs=["error"],  # {rad}/s
    outputs=["u"],  # {volt}
    name="feedback",
)
"""
_PLANT = """\
import numpy as np

from dmptm_ctrl import simulate
from dmptm_ctrl.simulate.model_file import model_of

MODEL = r'''
{text}'''

model = model_of(MODEL, "MODEL")
plant = model.to_blocks()  # ct.InterconnectedSystem, the effects included

time = np.arange(0.0, 0.05, 1e-3)  # s
signals = np.full((plant.ninputs, time.size), 0.1)  # SI
response = simulate(model, time, signals)  # ct.TimeResponseData
"""


def python_program(model: Any, source: Path) -> str:
    """Return the text of a program that builds a model or controller without any file.

    Of a controller the feedback part, as it runs; what it feeds forward is in comments.
    """
    if not isinstance(model, Controller):
        head = "".join(f"# {line}\n" for line in origin(source))
        return head + "\n" + _PLANT.format(text=model_text(model))
    sys = model.to_discrete()
    a, b, c, d = (np.asarray(part, float).tolist() for part in (sys.A, sys.B, sys.C, sys.D))
    head = "".join(f"# {line}\n" for line in provenance(model, source))
    volt, rad = model.units
    numbers = {"a": a, "b": b, "c": c, "d": d, "dt": model.sample_time}
    return head + "\n" + _CONTROLLER.format(**numbers, volt=volt, rad=rad)
