"""`dmptm rig init` and `dmptm rig check`."""

import matplotlib.image as image
import pytest

from dmptm_ctrl import data
from dmptm_ctrl.cli import main


def test_template_is_a_rig_that_checks(tmp_path, capsys):
    file = tmp_path / "rig.toml"
    assert main(["rig", "init", str(file)]) == 0
    assert main(["rig", "init", str(file)]) == 2
    assert "--force" in capsys.readouterr().err
    assert main(["rig", "check", str(file), "--figure", str(tmp_path / "rig.png")]) == 0
    said = capsys.readouterr().out
    for word in (
        "[motor]",
        "[load]",
        "mesh gear",
        "half-gap",
        "column phi",
        "modes: 0 (rigid body), ",
    ):
        assert word in said
    assert image.imread(tmp_path / "rig.png").std() > 0.05


def test_a_file_that_windows_marked(tmp_path, capsys):
    text = data.PAPER_RIG.read_text(encoding="utf-8").replace("\n", "\r\n")
    (tmp_path / "rig.toml").write_bytes(text.encode("utf-8-sig"))
    assert main(["rig", "check", str(tmp_path / "rig.toml")]) == 0
    assert "modes: 0 (rigid body), 60.4 Hz, 230.9 Hz" in capsys.readouterr().out


def test_modes_of_the_paper_rig(capsys):
    assert main(["rig", "check", str(data.PAPER_RIG)]) == 0
    assert "modes: 0 (rigid body), 60.4 Hz, 230.9 Hz" in capsys.readouterr().out


BAD = [
    ('inertia = "2.1e-4 kg m^2 ± 10 %"', 'inertia = "2.1e-4 kg ± 10 %"', ["line 7", "kg·m²"]),
    ('ratio = 10', 'ratio = "ten"', ["line 17", "ratio"]),
    ('between = ["motor", "load"]', 'between = ["motor", "lod"]', ["line 16", "'lod'", "load"]),
    ('viscous = "unknown"', 'viscus = "unknown"', ["line 8", "did you mean 'viscous'"]),
    ('unit = "rpm"', 'unit = "V"', ["speed", "load"]),
    ('stiffness = "40 N m/rad ± 50 %"', 'stiffness = "rigid"', ["line 18", "gap"]),
    ("[body.load]", "[body.load", ["not TOML", "line 11"]),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "words"), BAD)
def test_errors_name_line_key_and_remedy(tmp_path, capsys, old, new, words):
    text = data.RIG_TEMPLATE.read_text()
    assert old in text
    file = tmp_path / "rig.toml"
    file.write_text(text.replace(old, new, 1))
    assert main(["rig", "check", str(file)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    for word in ("rig.toml", *words):
        assert word in said, said


def test_modes_by_hand(tmp_path, capsys):
    """Two inertias: √(k (1/J1 + N²/J2)) / 2π; damping and friction need not be known."""
    file = tmp_path / "rig.toml"
    file.write_text(data.RIG_TEMPLATE.read_text())
    main(["rig", "check", str(file)])
    hertz = (40 * (1 / 2.1e-4 + 10**2 / 0.013)) ** 0.5 / (2 * 3.141592653589793)
    assert f"modes: 0 (rigid body), {hertz:.4g} Hz" in capsys.readouterr().out
    file.write_text(data.RIG_TEMPLATE.read_text().replace('"40 N m/rad ± 50 %"', '"unknown"'))
    main(["rig", "check", str(file)])
    assert "link.gear.stiffness is declared unknown" in capsys.readouterr().out
