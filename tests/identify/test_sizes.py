"""Sizes of effects in another program's rigs, as the balances with motor encoders tell them."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState, key_of
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.balance import surprise
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "open_multisine_preload")


def fitted(seed, effects, names, contact="eq21", logs=LOGS):
    """States with one effect more each, from the declared model on, and the label's values."""
    laws = {"friction": "karnopp", "contact": contact, "sensors": "all"}
    rig = make_rig(seed, effects, logs=logs, **laws)
    measured = measure([load_log(t, name=n) for n, t in rig.logs.items()], paper_drive())
    evidence = DualEvidence(measured)
    states = [DualState(residual(measured, Model(paper_drive())))]
    for name in names:
        (candidate,) = evidence.candidates(states[-1], [key_of(name)])
        assert candidate.acceptable
        states.append(evidence.closed(evidence.adopt(states[-1], candidate)))
    return states, rig.label["effect_parameters"]


def value(state, name):
    return state.left.base.model.effects[name]


def test_a_soft_reducer():
    """It carries what the motor gives, before the pinion's friction."""
    name = "reducer_compliance"
    (_, after), true = fitted(9400001, ((name, 1.0),), [name], "kelvin_voigt")
    stiffness = 1.0 / value(after, name)["compliance"]
    assert stiffness == pytest.approx(true[name]["stiffness_N_m_rad"], rel=0.2)


@pytest.mark.parametrize(
    ("name", "cosine", "sine"),
    [("mesh_error", "left_cosine", "left_sine"), ("ring_gear_eccentricity", "cosine", "sine")],
)
def test_errors_of_teeth_and_gears_as_large_as_the_gap(name, cosine, sine):
    """The flank is not where the angles have it."""
    (_, after), true = fitted(7050, ((name, 5.0),), [name])
    size = np.rad2deg(np.hypot(*(value(after, name)[k] for k in (cosine, sine)))) * 60.0
    assert size == pytest.approx(true[name]["amplitude_arcmin"], rel=0.02)


def test_no_log_objects_to_friction_that_grows_with_the_load():
    """What the mesh carries as the voltage steps decides: half a sample late, squares object."""
    name = "load_dependent_friction"
    logs = ("open_square_0v60", "open_square_0v75", "closed_sine_10", "open_multisine_preload")
    (before, after), true = fitted(9600001, ((name, 3.0),), [name], logs=logs)
    coefficient = value(after, name)["coefficient"]
    assert coefficient == pytest.approx(true[name]["coefficient"], rel=0.15)
    for balance in (after.left.balance, after.left.held):
        models = (before.left.base.model, after.left.base.model)
        for e, a, b in zip(balance.equations, *map(balance.missing, models), strict=True):
            where = balance.motions[e.motion].rec.name
            assert surprise([b], [e.kind]) < surprise([a], [e.kind]) + 3.0, (where, e.kind)
