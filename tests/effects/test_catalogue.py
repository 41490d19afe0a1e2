"""What every entry of the catalogue inherits: its declaration fits its kernel and its site."""

import inspect

import pytest

from dmptm_ctrl.contract import SITES, Parameter
from dmptm_ctrl.effects import CATALOGUE, register
from dmptm_ctrl.effects.unbalance import UNBALANCE

ARGUMENTS = {
    "amplifier": ("u", "t", "side"),
    "delay": ("side",),
    "lag": ("u", "side"),
    "motor": ("u", "theta_m", "omega_m", "t", "side"),
    "shaft": ("inertia",),
    "mesh": ("theta_p", "omega_p", "theta_L", "omega_L", "side"),
    "friction": ("theta", "omega", "t", "mesh_torque", "body"),
    "presliding": ("body",),
    "dwell": ("age", "body"),
    "load": ("theta_L", "omega_L", "t"),
    "sensor": ("theta_L", "omega_L", "t"),
    "sensor_delay": (),
}
VARIABLES = {
    *("theta_L", "theta_m", "omega_L", "omega_m", "u", "du_dt"),
    *("mesh_torque", "time", "time_at_rest"),
}

each = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)


@each
def test_kernel_has_the_signature_of_its_site(effect):
    assert effect.site in SITES
    names = tuple(inspect.signature(effect.kernel.py_func).parameters)
    assert names == (*ARGUMENTS[effect.site], "p")


@each
def test_parameters_are_those_of_the_kernel(effect):
    assert tuple(p.name for p in effect.parameters) == effect.values._fields


@each
def test_bounds_hold_the_absent_effect_the_step_and_the_bank(effect):
    assert effect.amplitudes, "an effect needs an amplitude, zero when it is absent"
    for p, default in zip(effect.parameters, effect.defaults(), strict=True):
        assert isinstance(p, Parameter)
        assert p.low <= default <= p.high
        assert 0.0 < p.step < p.high - p.low
        assert all(p.low <= value <= p.high for value in p.bank)
        assert len(p.bank) == len(set(p.bank))
        if not p.bank:
            assert default == 0.0


@each
def test_says_where_and_what_it_is(effect):
    assert effect.location
    assert effect.source
    assert effect.reveals
    assert effect.depends_on
    assert set(effect.depends_on) <= VARIABLES


def test_register_refuses_a_taken_name_and_an_unknown_site():
    before = dict(CATALOGUE)
    with pytest.raises(ValueError, match="'unbalance' is in the catalogue already"):
        register(UNBALANCE)
    with pytest.raises(ValueError, match="no site 'axle'; sites are amplifier, delay"):
        register(UNBALANCE._replace(name="other", site="axle"))
    assert before == CATALOGUE


def test_an_effect_prints_its_parameters_with_their_units():
    assert str(UNBALANCE).splitlines() == [
        "unbalance @ ring gear", "  cosine  -60 to 60 N·m", "  sine    -60 to 60 N·m",
    ]  # fmt: skip
