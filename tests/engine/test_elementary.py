"""The engine's own exp, sin and cos against the library's in extended precision."""

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
