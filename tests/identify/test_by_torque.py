"""Derivatives by friction and load torques, against differences of the whole residual."""

import numpy as np
import pytest
from tests.diagnosis.test_rig_evidence import logs_of
from tests.identify.test_teeth import MOTORS, PAPER, log_of
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify import rig_fit
from dmptm_ctrl.identify.by_torque import friction_alone, torques_decide
from dmptm_ctrl.identify.free_parameters import free_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.pushing_teeth import in_contact
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.rig_model import Placed, RigModel


def paper():
    """The paper's drive with both motors measured: teeth that swing after reversals."""
    rig = parse_rig(PAPER + MOTORS, "rig.toml")
    model = RigModel(rig)
    logs = [log_of(model, name, speed)[0] for name, speed in (("a", 0.5), ("b", 1.0))]
    return model, in_contact(balance_of(rig, logs), model, logs)


def axis(effects=()):
    """One body, its speed measured: friction at rest holds it."""
    bench = Bench(Machine(fc=0.03), (("steps", 6.0), ("sine", 5.0)), 3.0, 2e-3)
    text = bench.rig().replace("viscous =", 'coulomb = "0.03 N m ± 50 %"\nviscous =')
    rig = parse_rig(text, "rig.toml")
    balance = balance_of(rig, logs_of(bench, rig))
    model = rough_start(RigModel(rig), balance)
    for effect in effects:
        model = model.with_effect(effect)
    return model, balance


EFFECTS = (
    Placed("unbalance", "motor", {"cosine": 0.01, "sine": -0.02}),
    Placed("position_dependent_friction", "motor", {"cosine": 0.2, "sine": 0.1, "order": 1.0}),
)
BRISTLES = (Placed("presliding", "motor", {"distance": 1e-3}),)


@pytest.mark.parametrize(
    "make", [paper, axis, lambda: axis(EFFECTS), lambda: axis(BRISTLES)],
    ids=["teeth", "axis", "effects", "bristles"],
)  # fmt: skip
def test_derivatives_are_those_of_the_whole_residual(make, monkeypatch):
    model, balance = make()
    assert torques_decide(model, balance)
    state = State(model)
    frees = free_parameters(model, balance, scales_of(balance))
    left, _ = rig_fit.residuals(state, balance)
    quick = rig_fit.jacobian(state, balance, frees, left, jobs=1)
    monkeypatch.setattr(rig_fit, "torques_decide", lambda model, balance: False)
    whole = rig_fit.jacobian(state, balance, frees, left, jobs=1)
    moved = 0
    for j, free in enumerate(frees):
        one, other = (np.concatenate([p[..., j].ravel() for p in t]) for t in (quick, whole))
        size = np.abs(other).max()
        # differences of a step of 1e-6 of the number round at 1e-9 of the torques
        np.testing.assert_allclose(one, other, rtol=0, atol=2e-6 * size, err_msg=free.label)
        moved += bool(size > 0)
    assert moved > 2


def test_what_is_more_than_friction_is_not_taken_for_it():
    model, balance = axis(EFFECTS)
    for key in ("body.motor.viscous", "body.motor.coulomb"):
        there = model.with_values({key: 1.1 * model.value(key)})
        assert friction_alone(model, there) == {0}
    heavier = model.with_values({"body.motor.inertia": 1.1 * model.value("body.motor.inertia")})
    assert friction_alone(model, heavier) is None
    late = model.with_effect(Placed("drive_delay", "drive", {"delay": 1e-3}))
    later = model.with_effect(Placed("drive_delay", "drive", {"delay": 2e-3}))
    assert friction_alone(late, later) is None
    assert friction_alone(model, model) == set()
    loaded = model.with_effect(Placed("load_dependent_friction", "motor", {"coefficient": 0.1}))
    assert not torques_decide(loaded, balance)
