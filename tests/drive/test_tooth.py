from math import log, pi

import pytest

from dmptm_ctrl.drive import (
    Tooth,
    cantilever_stiffness,
    iso_single_stiffness,
    pair_stiffness,
    tooth_stiffness,
)


def test_uniform_cantilever():
    """k = 3 E I / L³."""
    found = cantilever_stiffness(lambda x: 0.004, 0.005, 0.01, 2e11)
    assert found == pytest.approx(3 * 2e11 * 0.01 * 0.004**3 / 12 / 0.005**3, rel=1e-9)


def test_tapered_cantilever():
    """Closed form of ∫ x²/(E b s³/12) dx with s = s0 + a x, x from the load."""
    s0, s1, length, width, young = 0.002, 0.005, 0.006, 0.02, 2e11
    a = (s1 - s0) / length

    def primitive(u):
        return (log(u) + 2 * s0 / u - s0**2 / (2 * u**2)) / a**3

    expected = young * width / 12 / (primitive(s1) - primitive(s0))
    found = cantilever_stiffness(lambda x: s0 + a * x, length, width, young)
    assert found == pytest.approx(expected, rel=1e-8)


def test_thickness_on_the_pitch_circle():
    tooth = Tooth(0.002, 20, 0.01)
    arc = 2 * tooth.half_angle(tooth.pitch_radius) * tooth.pitch_radius
    assert arc == pytest.approx(pi * 0.002 / 2)  # half the pitch


@pytest.mark.parametrize(("z1", "z2"), [(20, 165), (20, 40), (30, 30), (50, 100), (25, 1000)])
def test_complete_pair_agrees_with_iso_6336(z1, z2):
    """ISO's fit to measured and computed gears, 14 to 19 N/(µm·mm), within 8 %."""
    pair = [Tooth(0.002, z, 0.01) for z in (z1, z2)]
    found = pair_stiffness(*pair, complete=True)
    assert found == pytest.approx(iso_single_stiffness(z1, z2, 0.01), rel=0.08)


def test_equation_22_keeps_only_bending():
    """It lacks shear, compression, foundation and contact: four to six times too stiff."""
    pair = [Tooth(0.002, z, 0.01) for z in (20, 165)]
    ratio = pair_stiffness(*pair) / iso_single_stiffness(20, 165, 0.01)
    assert 4.0 < ratio < 6.0


def test_stiffness_does_not_depend_on_module_and_goes_with_width():
    """Similar teeth: k scales with E b alone."""
    one = tooth_stiffness(Tooth(0.002, 20, 0.01))
    assert tooth_stiffness(Tooth(0.005, 20, 0.01)) == pytest.approx(one, rel=1e-7)
    assert tooth_stiffness(Tooth(0.002, 20, 0.03)) == pytest.approx(3 * one, rel=1e-7)


def test_teeth_that_do_not_mesh():
    with pytest.raises(ValueError, match="different module"):
        pair_stiffness(Tooth(0.002, 20, 0.01), Tooth(0.003, 40, 0.01))
