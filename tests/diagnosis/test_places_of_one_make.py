"""Effects that two motors of one make have together."""

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.rig_candidates import makes, trials
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence, numbers_of
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.free_parameters import free_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.rig_model import RigModel, placed_at

DT, INERTIA, LOAD, SPRING, DAMPING = 2e-3, 2e-3, 2e-2, 40.0, 0.02
RIG = parse_rig(
    """
[body.left]
inertia = "0.002 kg m^2 ± 10 %"
viscous = "0.01 N m s/rad ± 50 %"
[body.right]
like = "left"
[body.table]
inertia = "0.02 kg m^2 ± 10 %"
viscous = "0.01 N m s/rad ± 50 %"
[shaft.one]
between = ["left", "table"]
stiffness = "40 N m/rad ± 10 %"
damping = "0.02 N m s/rad ± 50 %"
[shaft.two]
like = "one"
between = ["right", "table"]
[input.u_left]
column = "u1"
unit = "N m"
body = "left"
[input.u_right]
column = "u2"
unit = "N m"
body = "right"
"""
    + "".join(
        f'[sensor.q_{body}]\ncolumn = "q{k}"\nunit = "rad"\nbody = "{body}"\nabsolute = true\n'
        for k, body in enumerate(("left", "right", "table"))
    ),
    "rig.toml",
)


def truth(seed, seconds, cogging):
    """Angles of both motors and the table, (3, n), by the implicit midpoint rule, and torques.

    `cogging` are complex amplitudes of the sixth order on each motor.
    """
    rng = np.random.default_rng(seed)
    n = round(seconds / DT)
    t = DT * np.arange(n)
    waves = rng.uniform(0.1, 5.0, (2, 8)), rng.uniform(0, 2 * np.pi, (2, 8))
    u = np.stack(
        [np.sin(2 * np.pi * np.outer(t, f) + p).sum(1) for f, p in zip(*waves, strict=True)]
    )
    u *= 0.4
    masses = np.array([INERTIA, INERTIA, LOAD])
    q, w, out = np.zeros(3), np.zeros(3), np.empty((3, n))
    fine = 4
    for k in range(n):
        out[:, k] = q
        for _ in range(fine):
            h, q1, w1 = DT / fine, q, w
            for _ in range(3):
                qm, wm = (q + q1) / 2, (w + w1) / 2
                twist, rate = qm[:2] - qm[2], wm[:2] - wm[2]
                through = SPRING * twist + DAMPING * rate
                own = u[:, k] - through + np.real(cogging * np.exp(6j * qm[:2]))
                pull = np.array([*own, through.sum()]) - 0.01 * wm
                q1, w1 = q + h * wm, w + h * pull / masses
            q, w = q1, w1
    return t, u, out


def logs(cogging):
    """Two logs of the same drive."""
    for seed in (1, 2):
        t, u, q = truth(seed, 12.0, cogging)
        rng = np.random.default_rng(seed)
        read = q + 2e-6 * rng.standard_normal(q.shape)
        named = {f"out_q_{b}": r for b, r in zip(("left", "right", "table"), read, strict=True)}
        yield Log(f"log{seed}", t, {"in_u_left": u[0], "in_u_right": u[1], **named})


def test_places_of_one_make_are_those_that_the_file_calls_alike():
    """Bodies and links by `like`, inputs by their gain and bodies."""
    assert RIG.alike("right") == ("left", "right")
    assert RIG.alike("table") == ("table",)
    assert RIG.alike("two") == ("one", "two")
    assert RIG.alike("u_right") == ("u_left", "u_right")


def test_wear_and_chance_are_of_one_place():
    """A spot, an offset, a weaker magnet: no make has them. All bearings may warm together."""
    model = RigModel(RIG)
    for name, places, alike in [
        ("cogging", ("left", "right", "table"), [("left", "right")]),
        ("current_lag", ("u_left", "u_right"), [("u_left", "u_right")]),
        ("thermal_drift", ("left", "table"), [("left", "right", "table")]),
        ("local_spot", ("left", "right"), []),
        ("drive_offset", ("u_left", "u_right"), []),
        ("torque_constant_mismatch", ("u_left", "u_right"), []),
    ]:
        assert [*makes(model, PLACED_CATALOGUE[name], places)] == alike


def test_signs_and_phases_are_each_ones_own():
    """An order is a whole number; a time is one for both; each motor has its cosine and sine."""
    cogging = placed_at("cogging", ("left", "right"), {"cosine": 0.1, "sine": 0.0, "order": 6.0})
    lag = placed_at("current_lag", ("u_left", "u_right"), {"time_constant": 2e-3})
    model = RigModel(RIG, effects=(*cogging, *lag))
    balance = balance_of(RIG, [*logs(np.zeros(2))])
    frees = free_parameters(model, balance, scales_of(balance))
    labels = [f.label for f in frees if f.kind == "effect"]
    assert labels == [
        *(f"cogging@left.{k}" for k in ("cosine", "sine")),
        *(f"cogging@right.{k}" for k in ("cosine", "sine")),
        "current_lag@u_left.time_constant",
    ]
    assert numbers_of("cogging@left + right") == 5
    assert numbers_of("current_lag@u_left + u_right") == 1
    assert numbers_of("thermal_drift@left + right + table") == 2
    own = [f for f in frees if f.kind == "effect"]
    moved = State(model).moved(own, [0.2, 0.3, 0.4, 0.5, 3e-3]).model
    there = {e.key: dict(e.values) for e in moved.effects}
    assert there["cogging@right"] == {"cosine": 0.4, "sine": 0.5, "order": 6.0}
    assert there["current_lag@u_right"] == {"time_constant": 3e-3}
    assert model.effects[1].values["cosine"] == 0.1


@pytest.mark.long
def test_cogging_of_both_motors_is_one_effect():
    """Amplitudes and phases of each, by another program's law."""
    cogging = np.array([0.04 - 0.02j, -0.01 - 0.05j])  # C cos + S sin is Re (C - iS) e^(i 6 θ)
    balance = balance_of(RIG, [*logs(cogging)])
    evidence = RigEvidence(balance.part("fit"), balance.part("held-out"), 1)
    base = evidence.base(State(RigModel(RIG)))
    tried = {t.key for t in trials(base.tangent)}
    key = "cogging@left + right"
    assert {"cogging@left", "cogging@right", key} <= tried
    (found,) = evidence.candidates(base, [key])
    alone = evidence.candidates(base, ["cogging@left", "cogging@right"])
    assert found.acceptable
    assert found.evidence > max(one.evidence for one in alone) + 10.0 * LEVEL
    state = evidence.adopt(base, found)
    values = {e.key: e.values for e in state.fit.model.effects}
    for name, true in zip(("left", "right"), cogging, strict=True):
        own = values[f"cogging@{name}"]
        assert own["cosine"] - 1j * own["sine"] == pytest.approx(true, abs=1e-3)
        assert own["order"] == 6.0
    without = evidence.without(state, key)
    assert without.fit.model.effects == without.keys == ()


@pytest.mark.long
def test_the_report_names_both_places():
    """One row of the budget, and the numbers of each."""
    found = diagnose_rig([*logs(np.array([0.04, 0.03j]))], RIG, jobs=2)
    assert found.verdict == "explained"
    (effect,) = found.effects
    assert (effect.name, effect.location) == ("cogging", "left + right")
    assert effect.parameters["amplitude"]["value"] == pytest.approx(0.04, rel=0.05)
    assert effect.parameters["right.amplitude"]["value"] == pytest.approx(0.03, rel=0.05)
    assert "right.order" not in effect.parameters
    assert "cogging @ left + right" in found.summary()
