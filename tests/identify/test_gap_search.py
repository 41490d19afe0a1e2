"""The search for starting values of a gap, on landscapes whose lowest point is known."""

import numpy as np
import pytest
from tests.diagnosis.test_rig_contacts import geared

from dmptm_ctrl.identify.gap_search import at_start, gap_starts
from dmptm_ctrl.identify.rig_start import rough_start


@pytest.fixture(scope="module")
def hidden():
    """A gear of unknown stiffness and friction before a load that nothing measures."""
    evidence, base = geared(0.03)
    return evidence.logs, rough_start(base.fit.model, evidence.logs)


def numbers(model, link="coupling"):
    """Logarithms of gap, stiffness and damping, and the load's share of the friction."""
    gap = next(e for e in model.effects if e.on == link).values["half_gap"]
    ratio = model.value(f"link.{link}.ratio")
    load = model.value("body.load.coulomb") / ratio
    share = load / (load + model.value("body.motor.coulomb"))
    stiff, damped = (model.value(f"link.{link}.{key}") for key in ("stiffness", "damping"))
    return np.array([np.log(gap), np.log(stiff), np.log(damped), share])


@pytest.mark.parametrize("gap", [3e-4, 0.03])
@pytest.mark.parametrize("share", [0.2, 0.7])
def test_finds_the_deepest_of_many_minima(hidden, gap, share):
    """A bowl with ripples: a descent from most points ends in one of hundreds of side minima."""
    balance, model = hidden
    lowest = np.array([np.log(gap), np.log(0.5), np.log(1e-3), share])
    width = np.array([2.0, 1.0, 1.5, 0.3])

    def surprise(there):
        away = (numbers(there) - lowest) / width
        return float(np.sum(away**2 + 0.3 * (1.0 - np.cos(9.0 * away))))

    found = [
        numbers(at_start(model, one)) for one in gap_starts(model, balance, "coupling", surprise)
    ]
    assert found
    away = (found[0] - lowest) / width
    assert np.sqrt(np.mean(away**2)) < 0.5


def test_all_friction_stays_and_so_do_declared_inertias(hidden):
    balance, model = hidden
    total = model.value("body.motor.coulomb") + model.value("body.load.coulomb") / 10.0
    for start in gap_starts(model, balance, "coupling", lambda there: 0.0):
        there = at_start(model, start)
        now = there.value("body.motor.coulomb") + there.value("body.load.coulomb") / 10.0
        assert now == pytest.approx(total, rel=1e-12)
        declared = model.declared(lambda key: key.endswith(".inertia"))
        assert {k: there.value(k) for k in declared} == pytest.approx(declared)


def test_none_where_no_model_can_be_simulated(hidden):
    balance, model = hidden
    assert gap_starts(model, balance, "coupling", lambda there: np.inf) == []
