"""The page on rig files: its examples are rigs, and what it says they print they print."""

import re
from pathlib import Path

import numpy as np
import pytest

from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig

PAGE = (Path(__file__).parents[2] / "docs" / "rig_toml.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```toml\n(.*?)```", PAGE, flags=re.DOTALL)


@pytest.mark.parametrize("text", EXAMPLES, ids=lambda t: parse_rig(t).name)
def test_examples_are_rigs(text, tmp_path, capsys):
    file = tmp_path / "rig.toml"
    file.write_text(text)
    assert main(["rig", "check", str(file)]) == 0
    assert "modes:" in capsys.readouterr().out


def test_check_prints_what_the_page_says(tmp_path, capsys):
    file = tmp_path / "rig.toml"
    file.write_text(EXAMPLES[0])
    main(["rig", "check", str(file)])
    printed = capsys.readouterr().out.strip()
    assert f"```\n{printed}\n```" in PAGE


def test_mistake_is_named_as_the_page_says(tmp_path, capsys):
    file = tmp_path / "rig.toml"
    file.write_text(EXAMPLES[0].replace("2.1e-4 kg m^2", "2.1e-4 kg"))
    main(["rig", "check", str(file)])
    said = capsys.readouterr().err
    assert "rig.toml, line 4: [body.motor] inertia: 'kg' is of another quantity than kg·m²" in said


def test_linear_model_of_the_page(tmp_path, monkeypatch, capsys):
    """The program runs, on a hanging arm: J s² + B s + cos(0.5) at the angle it says."""
    rig = (
        '[body.arm]\ninertia = 0.02\nviscous = 0.05\n[input.m]\ncolumn = "T_Nm"\n'
        '[sensor.angle]\ncolumn = "q_rad"\n[effect.unbalance]\nsine = -1.0\n'
    )
    (tmp_path / "rig.toml").write_text(rig)
    monkeypatch.chdir(tmp_path)
    (program,) = re.findall(r"```python\n(.*?)```", PAGE, flags=re.DOTALL)
    names: dict = {}
    exec(program, names)
    assert np.sort_complex(names["plant"].poles()) == pytest.approx(
        np.sort_complex(np.roots([0.02, 0.05, np.cos(0.5)])), rel=1e-8
    )
    assert "SettlingTime" in capsys.readouterr().out


def test_declared_effect_of_the_page(tmp_path):
    part = re.search(r"```toml-part\n(.*?)```", PAGE, flags=re.DOTALL)[1]
    (effect,) = parse_rig(EXAMPLES[0] + part).effects
    assert (effect.name, effect.on, effect.values["delay"].value) == (
        "drive_delay",
        "voltage",
        0.002,
    )
