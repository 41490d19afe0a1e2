"""``dmptm resonances``: the numbers, what is written, what is refused."""

import csv

import matplotlib.pyplot as plt
import numpy as np
import pytest

from dmptm_ctrl.cli import main
from dmptm_ctrl.drive import paper_drive, solve_modes, three_dof_train
from dmptm_ctrl.drive.rig_dual import paper_rig
from dmptm_ctrl.plots.modes import mode_plot
from dmptm_ctrl.reproduce.resonances import overridden
from dmptm_ctrl.simulate.linear import modes as modes_of


def cells(text, title):
    """Rows of a printed table."""
    lines = text.split(title)[1].splitlines()[2:]
    return [line.split() for line in lines[: [line.strip() for line in lines].index("")]]


def test_printed_numbers(capsys):
    """Closed forms √(k/J̄3), √(k/J̄3 + 2 k N2²/J_L); symmetric shape J_L θL + 2 N2 J̄3 θ3 = 0."""
    assert main(["resonances"]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    beside = cells(out, "J_2 beside")
    assert [row[:2] for row in beside[:3]] == [
        ["0.00", "rigid"],
        ["60.40", "antisymmetric"],
        ["230.87", "symmetric"],
    ]
    assert [float(x) for x in beside[1][3:]] == [1, -1, 0]
    pinion = -2.5 / (2 * 8.25**2 * 0.25)  # over the rigid turn θ3 = N2 θL
    assert [float(x) for x in beside[2][3:]] == pytest.approx([pinion, pinion, 1], abs=1e-3)
    other = cells(out, "J_2 is N1² J_m")
    assert [row[0] for row in other[:3]] == ["0.00", "85.41", "238.64"]
    nine = cells(out, "9-DOF, our defaults\n")
    assert [row[1] for row in nine[:9]].count("antisymmetric") == 4
    change = {row[0]: [float(x) for x in row[1:]] for row in cells(out, "Sensitivities, 3-DOF")[:6]}
    assert change["k_m"] == [0.5, 0.5]
    ring = 2 * 8.25**2 / 2.5  # share of the ring gear in ω²/k
    assert change["J_L"][1] == pytest.approx(-0.5 * ring / (ring + 4), abs=1e-3)
    assert "…" not in out  # no number is cut


def test_values_and_files(capsys, tmp_path):
    """Four times the mesh stiffness: twice the 3-DOF frequencies."""
    out = tmp_path / "res"
    assert main(["resonances", "--set", "k_m=144e3", "--set", "K_01=1e5", "--out", str(out)]) == 0
    assert cells(capsys.readouterr().out, "J_2 beside")[1][0] == "120.79"
    names = {p.name for p in out.iterdir()}
    assert {"modes_3dof.png", "modes_9dof.png", "sensitivities.png"} < names
    with (out / "modes_3dof_beside.csv").open(encoding="utf-8") as stream:
        rows = list(csv.reader(stream))
    assert rows[0][:2] == ["Hz", "class"]
    assert rows[3][:2] == ["461.74", "symmetric"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("K_99=1", "no parameter 'K_99'; there are k_m"),
        ("K_01=-1", "K_01 is -1, it must be more than zero"),
        ("k_m=0", "k_m is 0, it must be more than zero"),
        ("J_L=many", "J_L is 'many', it must be a number"),
        ("J_L", "'J_L' is not NAME=VALUE"),
    ],
)
def test_refusals(capsys, tmp_path, text, message):
    out = tmp_path / "res"
    assert main(["resonances", "--set", text, "--out", str(out)]) == 2
    printed, err = capsys.readouterr()
    assert printed == ""
    assert message in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_overrides_reach_the_right_model():
    drive, extra = overridden({"J_L": 3.0, "D_12": 0.0})
    assert drive["J_L"] == 3.0
    assert extra == {"D_12": 0.0}
    assert paper_drive()["J_L"] == 2.5


def test_picture_of_the_modes():
    """Left chain, ring gear, right chain; titles carry class and frequency."""
    modes = solve_modes(three_dof_train())
    panels = mode_plot(modes)
    assert [p.get_title() for p in panels] == [
        "rigid, 0 Hz",
        "antisymmetric, 60.4 Hz",
        "symmetric, 230.9 Hz",
    ]
    drawn = panels[1].lines[-1].get_ydata()
    np.testing.assert_allclose(drawn, [1.0, 0.0, -1.0], atol=1e-9)
    (hands,) = panels[1].collections[1:]  # of the wheels; the first are the stems
    turned = np.arctan2(hands.U, hands.V) / (np.pi / 3)  # from upright
    np.testing.assert_allclose(turned, [1.0, 0.0, -1.0], atol=1e-9)
    plt.close("all")


def test_picture_of_the_modes_of_a_rig():
    """Bodies in the order of the file, by their own names."""
    panels = mode_plot(modes_of(paper_rig()))
    assert [p.get_title() for p in panels] == [
        "rigid, 0 Hz",
        "elastic, 60.4 Hz",
        "elastic, 230.9 Hz",
    ]
    names = [label.get_text() for label in panels[0].get_xticklabels()]
    assert names == ["motor_left", "motor_right", "ring_gear"]
    plt.close("all")
