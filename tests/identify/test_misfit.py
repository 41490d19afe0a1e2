"""What several models miss on whole records, side by side."""

from dataclasses import replace

import numpy as np
import pytest

from dmptm_ctrl.identify.fit import AT_ONCE, Misfit, drive_unknowns, jogged, place, position
from dmptm_ctrl.identify.records import difference, predict, record
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.compiled import OUTPUTS, Loop, close_loop
from dmptm_ctrl.simulate.model import Model

DEG = np.pi / 180
DT = 1e-3
TIME = DT * np.arange(100)  # before bounces tell roundings apart
SETPOINTS = (4.0 * np.sin(1.3 * np.pi * TIME), 15.0 * np.sin(1.2 * np.pi * TIME))  # deg/s


@pytest.fixture(scope="module")
def plant():
    """A drive inside its declared ranges."""
    unknowns = drive_unknowns(Model())
    p = position(Model(), unknowns) + np.random.default_rng(5).uniform(-0.6, 0.6, len(unknowns))
    return place(Model(), unknowns, np.clip(p, -1.0, 1.0))


@pytest.fixture(scope="module")
def records(plant):
    """One without motor encoders, one with."""
    made = []
    for k, setpoint in enumerate(SETPOINTS):
        loop = Loop(0.08 / DEG, 1.5 / DEG, 10.0, 0.15, -0.15)
        u, out = close_loop(plant, loop, setpoint * DEG, DT)
        columns = {name: out[:, OUTPUTS.index(name)] for name in OUTPUTS[:2]}
        made.append(
            record(Log(f"log {k}", TIME, {"u_left": u[0], "u_right": u[1], **columns}), plant.drive)
        )
    return [made[0], replace(made[1], twist=np.zeros((TIME.size, 2)))]


@pytest.mark.parametrize("bandwidth_hz", [0.0, 6.0])
@pytest.mark.parametrize("several", [1, AT_ONCE + 3])
def test_models_side_by_side_miss_what_each_alone_does(plant, records, bandwidth_hz, several):
    """With encoders and without, led by the angle and free; rounding differs, no more."""
    models = [model for k in range(5) for model in jogged(plant, 0.01 * (k + 1))][:several]
    together = Misfit(records, bandwidth_hz).differences(models)
    for rec, rows in zip(records, together, strict=True):
        assert len(rows) == len(models)
        for model, row in zip(models, rows, strict=True):
            run = predict(rec, model.arrays(), bandwidth_hz)
            alone = difference(rec, run, model.drive["N_1"], model.drive["N_2"])
            np.testing.assert_allclose(row, alone, rtol=0.0, atol=1e-10)
