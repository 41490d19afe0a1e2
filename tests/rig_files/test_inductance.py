"""An inductance delays the voltage alone: where that matters, it is said."""

import warnings

import pytest

from dmptm_ctrl.cli import main
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.linear import linearize

RIG = """[body.rotor]
inertia = {inertia}
viscous = 2e-5
[input.u]
column = "u_V"
torque_constant = "0.05 N m/A"
resistance = "1.2 ohm"
{inductance}
[sensor.n]
column = "n_rpm"
"""


def cautions(inductance, inertia=1.2e-5):
    return parse_rig(RIG.format(inductance=inductance, inertia=inertia)).cautions()


def test_an_inductance_that_is_not_small():
    """J R/(K_t K_e) is 5.76 ms."""
    (said,) = cautions('inductance = "1.5 mH"')
    assert said.startswith("input u: its inductance delays the voltage, but not the back-EMF; ")
    assert "L/R of 0.00125 s is not small beside J R/(K_t K_e) of 0.00576 s" in said


@pytest.mark.parametrize(
    ("inductance", "inertia"),
    [
        ("", 1.2e-5),
        ('inductance = "0.15 mH"', 1.2e-5),
        ('inductance = "1.5 mH"', 1e-3),
        ('inductance = "1.5 mH"', '"unknown"'),
        ('inductance = "1.5 mH"\nback_emf_constant = 0', 1.2e-5),
    ],
)
def test_an_inductance_that_is_small_or_cannot_be_judged(inductance, inertia):
    assert cautions(inductance, inertia) == []


def test_it_is_said_by_the_command_and_by_linearize(tmp_path, capsys):
    text = RIG.format(inductance='inductance = "1.5 mH"', inertia=1.2e-5)
    (tmp_path / "rig.toml").write_text(text)
    assert main(["rig", "check", str(tmp_path / "rig.toml")]) == 0
    assert "warning: input u: its inductance" in capsys.readouterr().err
    with pytest.warns(UserWarning, match="input u: its inductance"):
        linearize(parse_rig(text))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        linearize(parse_rig(text.replace("1.5 mH", "15 uH")))
