"""What every effect of the catalogue inherits; a new one is tested by being in it."""

from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.simulate import compiled, simulate
from dmptm_ctrl.simulate.blocks import initial_state, to_blocks
from dmptm_ctrl.simulate.compiled import OUTPUTS, march, rest
from dmptm_ctrl.simulate.dual import catalogue
from dmptm_ctrl.simulate.plant import structure_of

each = pytest.mark.parametrize("name", CATALOGUE)


def rms(a, b):
    return np.sqrt(np.mean((a - b) ** 2, axis=1))


@pytest.fixture(scope="module")
def without(paper, lively):
    time, u, x0 = lively
    return simulate(paper, time, u, x0).outputs


@pytest.fixture(scope="module")
def unused(paper, lively):
    """The loop with all chains, of which none is in use."""
    time, u, x0 = lively
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "structure_for", partial(structure_of, switched=True, either=True))
        return march(paper, u, x0, time[1]).T


@each
def test_zero_parameters_change_nothing_bit_for_bit(name, paper, lively, without, unused):
    """Absent, and forced to be evaluated at its neutral parameters."""
    time, u, x0 = lively
    absent = paper.with_effect(name)
    np.testing.assert_array_equal(simulate(absent, time, u, x0).outputs, without)
    plant = absent.plant()
    assert not plant.on.any()
    on = np.array([flag == catalogue().slots[name][0] for flag in range(plant.on.size)], np.uint8)
    forced = march(SimpleNamespace(plant=lambda: plant._replace(on=on)), u, x0, time[1])
    np.testing.assert_array_equal(forced.T, unused)


def test_the_loop_without_chains_is_the_loop_with_none_in_use(without, unused):
    """To rounding, multiplied by the impacts."""
    scale = np.ptp(without, axis=1)[:, None]
    assert np.max(np.abs(unused - without) / scale) < 1e-11


def test_compiled_is_the_reference(visible, paper, lively):
    """Through contacts and stick–slip; the effect itself is far above the difference."""
    time, u, x0 = lively
    exact = simulate(visible, time, u, x0, method="reference").outputs
    plain = simulate(paper, time, u, x0, substeps=256).outputs
    coarse, fine = (simulate(visible, time, u, x0, substeps=s).outputs for s in (32, 256))
    scale = np.ptp(exact, axis=1)
    error = rms(fine, exact) / scale
    assert np.all(error < 2e-4), dict(zip(OUTPUTS, error, strict=True))
    assert np.sum(error) < 0.1 * np.sum(rms(coarse, exact) / scale)  # order 2 gives 1/64
    assert np.max(rms(exact, plain) / scale) > 100 * np.max(error)


@pytest.mark.long
def test_all_effects_together_are_second_order(paper, lively, visible_values):
    """Every site at once, in the order in which the runners chain them."""
    model = paper
    for name, effect in CATALOGUE.items():
        model = model.with_effect(name, **visible_values(effect))
    time, u, x0 = lively
    steps, last, logs = 2 ** np.arange(3, 11), [], []
    for volts in (1.6, 2.4):
        exact = simulate(model, time, volts * u, x0, method="reference").outputs
        scale = np.ptp(exact, axis=1)
        assert np.all(scale > 1e-4)
        errors = [
            rms(simulate(model, time, volts * u, x0, substeps=int(s)).outputs, exact) / scale
            for s in steps
        ]
        last.append(errors[-1])
        logs.append(np.log(np.sum(errors, axis=1)))
    # of all outputs, many steps and runs: errors scatter with where a step meets a contact, so that
    # single runs have 1.4 to 1.9; first order would have 1
    order = -np.polyfit(np.log(steps), np.mean(logs, axis=0), 1)[0]
    assert order > 1.6
    assert np.all(np.array(last) < 2e-4)  # as each effect alone


def test_blocks_are_compiled(visible, smooth):
    """Closed meshes, everything sliding, where an ODE solver is at its best.

    A drive or sensor delay is exact in the compiled loop and a Padé approximation in the
    blocks; what that leaves is 0.2 % of the range.
    """
    (name,) = visible.effects
    site = CATALOGUE[name].site
    n = 61 if site in ("delay", "lag", "sensor_delay") else 31
    time, u, x0 = smooth[0][:n], smooth[1][:, :n], smooth[2]
    found = simulate(visible, time, u, x0, method="blocks", rtol=1e-7, atol=1e-10).outputs
    compiled = simulate(visible, time, u, x0, substeps=256).outputs
    error = rms(found, compiled) / np.ptp(compiled, axis=1)
    limit = 2e-3 if site in ("delay", "sensor_delay") else 2e-4
    assert np.all(error < limit), dict(zip(OUTPUTS, error, strict=True))


PARAMETERS = [(name, p.name) for name, effect in CATALOGUE.items() for p in effect.parameters]


@pytest.mark.parametrize(("name", "parameter"), PARAMETERS)
def test_every_parameter_moves_some_output(name, parameter, paper, lively, visible_values):
    """By its own step, from where the effect is visible."""
    time, u, x0 = lively
    visible = visible_values(CATALOGUE[name])
    (step,) = (p.step for p in CATALOGUE[name].parameters if p.name == parameter)
    before = simulate(paper.with_effect(name, **visible), time, u, x0).outputs
    visible[parameter] += step
    after = simulate(paper.with_effect(name, **visible), time, u, x0).outputs
    moved = rms(after, before) / np.ptp(before, axis=1)
    assert moved.max() > 1e-5


def test_finite_at_rest_and_at_zero(visible):
    """python-control evaluates blocks at zero, again and again: finite, pure, same."""
    time = 1e-3 * np.arange(20)
    nothing = np.zeros((2, time.size))
    x0 = rest(visible, 0.0)
    for method in ("compiled", "reference"):
        assert np.all(np.isfinite(simulate(visible, time, nothing, x0, method=method).outputs))
    sys = to_blocks(visible)
    state, u = initial_state(visible, sys, x0), np.zeros(2)
    kept = state.copy()
    first = sys.dynamics(0.0, state, u), sys.output(0.0, state, u)
    second = sys.dynamics(0.0, state, u), sys.output(0.0, state, u)
    for a, b in zip(first, second, strict=True):
        assert np.all(np.isfinite(a))
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(state, kept)
    np.testing.assert_array_equal(u, np.zeros(2))
    zero = np.zeros(sys.nstates)
    assert np.all(np.isfinite(sys.dynamics(0.0, zero, u)))
    assert np.all(np.isfinite(sys.output(0.0, zero, u)))
