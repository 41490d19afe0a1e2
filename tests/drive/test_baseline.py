import numpy as np
import pytest

from dmptm_ctrl.drive import baseline_drive, paper_drive
from dmptm_ctrl.simulate.compiled import march, rest
from dmptm_ctrl.simulate.model import Model


def run(drive, u, *, motors=None):
    model = Model(drive)
    return march(model, u, rest(model, 0.0, motors=motors), 1e-3)


def test_no_torque_in_the_gap():
    drive = baseline_drive()
    u = np.full((2, 60), 0.02)  # too little to cross the gap in 60 ms
    out = run(drive, u)
    assert (out[:, 4:6] == 0.0).all()
    assert out[-1, 2] > 0.0
    # a free pinion: J̄3 ω̇ = N1 K u − D3 ω
    time, d3 = 0.059, drive["B3_plus"]
    pull = 25 * 0.39 * 0.02
    angle = pull / d3 * (time - 0.25 / d3 * (1 - np.exp(-time * d3 / 0.25)))
    assert out[-1, 2] / 25 == pytest.approx(angle, rel=1e-4)


def test_moves_where_dry_friction_holds():
    u = np.full((2, 500), 0.1)  # 0.98 N·m at a pinion, breakaway is 2.8
    assert run(paper_drive(), u)[-1, 2] == 0.0
    assert run(baseline_drive(), u)[-1, 2] > 0.1


def test_declaration():
    drive = baseline_drive()
    assert all(drive[name] == 0.0 for name in drive if name.startswith("T"))
    assert {"B3_plus", "B3_minus", "BL_plus", "BL_minus"} < set(drive.free)
    assert "c_f" not in drive.free
    assert paper_drive()["T3s_plus"] == 2.8  # the original is untouched
