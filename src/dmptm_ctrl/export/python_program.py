"""A model or controller as a python-control program, its numbers written out."""

from pathlib import Path
from typing import Any

import numpy as np

from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.diagnosis.code import rebuilding_code
from dmptm_ctrl.export.controller import provenance
from dmptm_ctrl.export.stepping import origin
from dmptm_ctrl.simulate.rig_model import RigModel

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
_RIG = """\
import control as ct
import numpy as np

from dmptm_ctrl import simulate
from dmptm_ctrl.simulate.model_file import rig_model_from_toml

MODEL = r'''
{text}'''

model = rig_model_from_toml(MODEL)
time = np.arange(0.0, 0.05, 1e-3)  # s
signals = np.full((len(model.layout.inputs), time.size), 0.1)  # SI
response = simulate(model, time, signals)  # ct.TimeResponseData
assert isinstance(response, ct.TimeResponseData)
"""


def python_program(model: Any, source: Path) -> str:
    """Return the text of a program that builds a model or controller without any file.

    Of a controller the feedback part, as it runs; what it feeds forward is in comments.
    """
    if isinstance(model, Controller):
        sys = model.to_discrete()
        a, b, c, d = (np.asarray(part, float).tolist() for part in (sys.A, sys.B, sys.C, sys.D))
        head = "".join(f"# {line}\n" for line in provenance(model, source))
        volt, rad = model.units
        numbers = {"a": a, "b": b, "c": c, "d": d, "dt": model.sample_time}
        return head + "\n" + _CONTROLLER.format(**numbers, volt=volt, rad=rad)
    head = "".join(f"# {line}\n" for line in origin(source))
    if isinstance(model, RigModel):
        return head + "\n" + _RIG.format(text=source.read_text(encoding="utf-8"))
    return head + rebuilding_code(model)
