"""The search for starting values of a gap, on landscapes whose lowest point is known."""

import numpy as np
import pytest
from tests.diagnosis.test_rig_contacts import geared
from tests.diagnosis.test_rig_evidence import logs_of
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.rig_diagnose import split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.gap_search import at_start, from_elsewhere, gap_start, lowest
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.rig_fit import fit_rig
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.rig_model import RigModel


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
    deepest = np.array([np.log(gap), np.log(0.5), np.log(1e-3), share])
    width = np.array([2.0, 1.0, 1.5, 0.3])

    def surprise(there):
        away = (numbers(there) - deepest) / width
        return float(np.sum(away**2 + 0.3 * (1.0 - np.cos(9.0 * away))))

    found = gap_start(model, balance, "coupling", surprise)
    away = (numbers(at_start(model, found)) - deepest) / width
    assert np.sqrt(np.mean(away**2)) < 0.5


def test_all_friction_stays_and_so_do_declared_inertias(hidden):
    balance, model = hidden
    total = model.value("body.motor.coulomb") + model.value("body.load.coulomb") / 10.0
    there = at_start(model, gap_start(model, balance, "coupling", lambda there: 0.0))
    now = there.value("body.motor.coulomb") + there.value("body.load.coulomb") / 10.0
    assert now == pytest.approx(total, rel=1e-12)
    declared = model.declared(lambda key: key.endswith(".inertia"))
    assert {k: there.value(k) for k in declared} == pytest.approx(declared)


def test_none_where_no_model_can_be_simulated(hidden):
    balance, model = hidden
    assert gap_start(model, balance, "coupling", lambda there: np.inf) is None


@pytest.mark.parametrize("numbers", [1, 3])
def test_the_lowest_of_many_minima(numbers):
    """Rastrigin's function: a descent from any point ends in the nearest of hundreds."""
    ends = np.full(numbers, -1.0), np.full(numbers, 1.0)
    before = np.random.get_state()[1].copy()  # noqa: NPY002

    def loss(x):
        away = 4.0 * (x - 0.4)
        return float(100.0 * np.sum(away**2 + 3.0 * (1.0 - np.cos(2.0 * np.pi * away))))

    found = lowest(loss, np.full(numbers, -0.5), ends, 1)
    assert found == pytest.approx(np.full(numbers, 0.4), abs=0.03)
    after = np.random.get_state()[1]  # noqa: NPY002
    np.testing.assert_array_equal(after, before)  # the user's own


@pytest.mark.long
def test_a_side_minimum_is_left():
    """Between bodies of one size teeth chatter: steps along slopes end near a start, beside it."""
    machine = Machine(
        gain=1.0, emf=0.0, j1=3.7e-4, j2=3.4e-4, ratio=1.0, k=2.65, c=2.2e-3, gap=0.022, fc=9e-3,
        b1=1.5e-3, b2=6.6e-4,
    )  # fmt: skip
    kinds = (("multisine", 0.15), ("steps", 0.1), ("chirp", 0.12))
    bench = Bench(machine, kinds, 4.0, 1e-3, counts=8192, sensors=("position",))
    text = bench.rig().replace('"unknown"', '"3.6e-4 kg m^2 ± 20 %"', 2)
    text = text.replace('viscous = "3.6e-4 kg m^2 ± 20 %"', 'viscous = "unknown"', 1)
    text = text.replace("viscous =", 'coulomb = "9.5e-3 N m ± 30 %"\nviscous =', 1)
    text = text.replace('stiffness = "unknown"', 'stiffness = "2.8 N m/rad ± 30 %"')
    rig = parse_rig(text, "rig.toml")
    logs, held, _, _ = split(rig, balance_of(rig, logs_of(bench, rig)))
    evidence = RigEvidence(logs, held, 1)
    base = evidence.base(State(rough_start(RigModel(rig), logs)))
    narrow = base.fit.model.with_effect("backlash", on="coupling", half_gap=0.012)
    near = fit_rig(State(narrow), logs, iterations=30)
    found = from_elsewhere(near, iterations=30, jobs=1)
    assert found.loss < near.loss - LEVEL
    assert found.values["backlash@coupling.half_gap"] == pytest.approx(0.022, rel=0.06)
    assert found.values["link.coupling.stiffness"] == pytest.approx(2.65, rel=0.06)
