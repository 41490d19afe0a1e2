"""The engine's own exp, log, power, sin and cos against the library's in extended precision."""

import math

import numpy as np
import pytest
from numba import njit

from dmptm_ctrl.simulate import elementary

UNIT = np.finfo(float).eps


@njit
def exps(x):
    return np.array([elementary.exp(v) for v in x])


@njit
def logs(x):
    return np.array([elementary.log(v) for v in x])


@njit
def powers(x, exponent):
    return np.array([elementary.power(v, exponent) for v in x])


@njit
def sines(x):
    return np.array([elementary.sin(v) for v in x])


@njit
def cosines(x):
    return np.array([elementary.cos(v) for v in x])


def arguments(size):
    drawn = np.random.default_rng(5).uniform(-size, size, 100_000)
    return np.concatenate([drawn, [0.0, -0.0, 5e-324, -size, size]])


@pytest.mark.parametrize("size", [1e-3, 1.0, 30.0, 700.0])
def test_exp_to_two_units(size):
    x = arguments(size)
    exact = np.exp(x.astype(np.longdouble))
    assert np.max(np.abs(exps(x) / exact - 1.0)) < 2 * UNIT


@pytest.mark.parametrize("decades", [1e-6, 0.3, 3.0, 300.0])
def test_log_to_two_units(decades):
    x = 10.0 ** np.random.default_rng(6).uniform(-decades, decades, 100_000)
    exact = np.log(x.astype(np.longdouble))
    assert np.max(np.abs(logs(x) - exact) / np.maximum(np.abs(exact), UNIT)) < 2 * UNIT


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.7, 3.0])
def test_power_by_its_logarithm(exponent):
    """An error of the logarithm counts as many times as the result has units of it."""
    x = np.append(10.0 ** np.random.default_rng(7).uniform(-12.0, 12.0, 100_000), 1.0)
    exact = x.astype(np.longdouble) ** exponent
    units = 2.0 + 2.0 * np.abs(np.log(exact.astype(float)))
    assert np.all(np.abs(powers(x, exponent) / exact - 1.0) < units * UNIT)
    nothing = powers(np.array([0.0, -0.0]), exponent)
    assert np.all((nothing >= 0.0) & (nothing < 1e-150))


@pytest.mark.parametrize("size", [1e-3, 1.0, 100.0, 1e6, 1e8])
@pytest.mark.parametrize(("own", "library"), [(sines, np.sin), (cosines, np.cos)])
def test_sin_and_cos_to_one_unit_of_the_amplitude(own, library, size):
    x = arguments(size)
    exact = library(x.astype(np.longdouble))
    assert np.max(np.abs(own(x) - exact)) < UNIT


def test_exp_beyond_the_range_of_a_double():
    """Held, neither subnormal nor infinite; what is not a number stays so."""
    low, high, not_a_number = exps(np.array([-1e4, 1e4, math.nan]))
    assert low == pytest.approx(math.exp(-708.0))
    assert high == pytest.approx(math.exp(709.0))
    assert math.isnan(not_a_number)


def test_hosted_kernel_uses_them_and_is_the_same_kernel():
    from dmptm_ctrl.effects.backlash import Backlash, gap_position, mesh_region

    hosted = elementary.hosted(mesh_region)
    assert hosted is elementary.hosted(mesh_region)
    inner = hosted.py_func.__globals__["gap_position"]
    assert inner.py_func.__code__ is gap_position.py_func.__code__
    assert inner.py_func.__globals__["exp"] is elementary.exp
    mesh = Backlash(3.6e4, 3.0, 0.05, 4e-3)

    @njit
    def regions(z, mesh):  # compiled code alone can call a hosted kernel
        return np.array([hosted(value, 0.2, mesh) for value in z])

    z = np.linspace(-6e-3, 6e-3, 101)
    np.testing.assert_array_equal(regions(z, mesh), [mesh_region(v, 0.2, mesh) for v in z])
