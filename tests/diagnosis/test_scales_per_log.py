"""Each equation scatters by itself in each log; what is left beyond noise decides."""

import re
from dataclasses import replace

import numpy as np
import pytest
from tests.diagnosis.test_rig_evidence import SMALL, logs_of, prepared
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.candidate import differ
from dmptm_ctrl.diagnosis.measure import of_each_kind
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig, split
from dmptm_ctrl.diagnosis.rig_objections import _covariance, amplitudes_of, objection
from dmptm_ctrl.diagnosis.rig_state import RigState, rise
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.heavy_tails import FREEDOM, robust_scale
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.likelihood import Likelihood
from dmptm_ctrl.identify.rig_fit import fit_rig, residuals
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.simulate.rig_model import Placed, RigModel


@pytest.fixture(scope="module")
def plain():
    """One body, three logs, nothing missing."""
    bench = Bench(Machine(), **SMALL)
    rig = parse_rig(bench.rig(), "rig.toml")
    logs = balance_of(rig, logs_of(bench, rig))
    state = fit_rig(State(rough_start(RigModel(rig), logs)), logs, jobs=1).state
    return logs, state, residuals(state, logs)[0]


def test_rows_are_weighed_by_the_scatter_of_their_log(plain):
    logs, _, left = plain
    loud = [(1.0 + 9.0 * k) * part for k, part in enumerate(left)]
    like = Likelihood(logs, np.array([0.25]))
    expected = [
        np.hypot(np.sqrt(np.mean(part[0][use[0]] ** 2)), like.floor)
        for part, use in zip(loud, logs.counted, strict=True)
    ]
    np.testing.assert_allclose(like.scales(loud), [expected], rtol=1e-12)
    sizes = [int(use.sum()) for use in logs.counted]
    np.testing.assert_array_equal(like.rows, [sizes])
    weights = np.split(like.weights(loud), np.cumsum(sizes)[:-1])
    for own, scale in zip(weights, expected, strict=True):
        np.testing.assert_allclose(own, 0.5 / scale, rtol=1e-12)


def test_heavy_tails_are_each_logs_own(plain):
    logs, state, left = plain
    heavy = replace(logs, closed=frozenset({"none"}), known={}, noises={})
    assert heavy.bursts == (True,)
    like, expected = Likelihood(heavy, np.array([1.0])), 0.0
    for part, use in zip(left, heavy.counted, strict=True):
        rows = part[0][use[0]]
        s = np.hypot(robust_scale(rows), like.floor)
        expected += np.sum(2.0 * np.log(s) + (FREEDOM + 1) * np.log1p((rows / s) ** 2 / FREEDOM))
    assert like.surprise(left, state.model) == pytest.approx(expected, rel=1e-12)
    assert sum(map(np.sum, like.row_surprises(left))) == pytest.approx(expected, rel=1e-12)


def test_pieces_of_one_log_scatter_together(plain):
    logs, _, left = plain
    one = replace(logs, motions=tuple(replace(m, name="one") for m in logs.motions))
    like = Likelihood(one, np.array([1.0]))
    assert like.rows.shape == like.scales(left).shape == (1, 1)
    whole = np.concatenate([p[0][u[0]] for p, u in zip(left, one.counted, strict=True)])
    assert like.scales(left)[0, 0] == pytest.approx(np.hypot(whole.std(), like.floor), rel=1e-2)
    np.testing.assert_array_equal(like.stack(left), whole)


def test_a_quiet_log_shows_what_a_loud_one_hides(plain):
    """An error of one size in the quiet log alone: more evidence than with one scale for all."""
    logs, state, left = plain
    rng = np.random.default_rng(7)
    sizes = (0.002, 0.2, 0.2)
    noise = [s * rng.normal(size=part.shape) for s, part in zip(sizes, left, strict=True)]
    wrong = [noise[0] + 0.004, *noise[1:]]
    apart = Likelihood(logs, np.array([1.0]))
    one = replace(logs, motions=tuple(replace(m, name="one") for m in logs.motions))
    together = Likelihood(one, np.array([1.0]))
    seen, hidden = (
        like.surprise(wrong, state.model) - like.surprise(noise, state.model)
        for like in (apart, together)
    )
    assert seen > 100.0
    assert abs(hidden) < 10.0


def test_rise_is_over_what_is_left_beyond_noise(plain):
    """White noise of any size leaves nothing beyond it; what lasts does."""
    logs, state, left = plain
    rng = np.random.default_rng(3)
    like = Likelihood(logs, np.array([1.0]))

    def fitted(parts):
        fit = replace(fit_rig(state, logs, iterations=0, like=like, jobs=1), left=tuple(parts))
        one = RigState(fit, logs)
        one.__dict__["held_left"] = (tuple(parts), fit.drive)
        return one

    white = [0.01 * rng.normal(size=p.shape) for p in left]
    slow = [0.01 * np.sin(0.02 * np.arange(p.shape[1]))[None] for p in left]
    after = [w + s for w, s in zip(white, slow, strict=True)]
    before = [w + 2.0 * s for w, s in zip(white, slow, strict=True)]
    # twice the sine has three times its square more, whatever the noise
    assert rise(fitted(before), fitted(after)) == pytest.approx(3.0, rel=0.15)


def test_an_amplitude_is_tested_beside_its_shape():
    """A drift slower than the logs: its size and its time constant trade, yet it drifts."""
    evidence, base = prepared(Bench(Machine(fc=0.03), **SMALL))
    (drift,) = evidence.candidates(base, ["thermal_drift@motor"])
    _, fit = drift.fitted
    own = amplitudes_of(fit, "thermal_drift@motor")
    amplitudes = np.full(len(own), 2.5)
    # with this covariance, size and time constant trade fully, and the size alone is unknown
    slow = [f.label for f in fit.frees].index("thermal_drift@motor.time_constant")
    covariance = 1e-4 * np.eye(len(fit.frees))
    for j in own:
        covariance[j, j] = covariance[slow, slow] = 1.0
        covariance[j, slow] = covariance[slow, j] = 0.7
    fit.__dict__["covariance"] = covariance
    key = "thermal_drift@motor"
    given = _covariance(fit, key, own)
    assert differ(amplitudes, given)
    assert not differ(amplitudes, covariance[np.ix_(own, own)])
    a, b = covariance[np.ix_(own, own)], covariance[np.ix_(own, [slow])]
    np.testing.assert_allclose(given, a - b @ b.T / covariance[slow, slow], rtol=1e-9, atol=1e-12)


def test_an_absent_drift_is_still_refused():
    evidence, base = prepared(Bench(Machine(fc=0.0), **SMALL))
    there = State(base.fit.model.with_effect(Placed("thermal_drift", "motor", {
        "rise": 0.0, "time_constant": 20.0})), base.fit.state.logs)  # fmt: skip
    fit = fit_rig(there, evidence.logs, like=base.fit.likelihood, jobs=1)
    assert objection("thermal_drift@motor", fit, base.fit)


def test_one_log_of_each_kind_is_held_out():
    names = ["sine_1", "sine_2", "step_1", "step_2", "chirp"]
    assert of_each_kind(names) == ["sine_2", "step_1"]
    assert of_each_kind(["a", "b", "c"]) == []


def test_twins_are_held_out_where_they_are_a_third(plain):
    logs, _, _ = plain
    rig, motion = logs.rig, logs.motions[0]

    def held(names):
        balance = replace(logs, motions=tuple(replace(motion, name=n) for n in names))
        return split(rig, balance)[2]

    assert held(["a_1", "a_2", "b_1", "b_2", "c", "d"]) == ["a_2", "b_1"]
    assert held(["a_1", "a_2", "b", "c", "d", "e"]) == ["b", "e"]


@pytest.mark.long
@pytest.mark.parametrize("low", [0.5, 2.0])
def test_declared_values_do_not_hold_an_absent_effect(low):
    """A wrong inertia, one log of one frequency: a lag fits that log alone perfectly."""
    bench = Bench(Machine(), **SMALL)
    right = parse_rig(bench.rig(), "rig.toml").body("motor").inertia.value
    wrong = f'inertia = "{low * right:g} kg m^2 ± 5 %"'
    rig = parse_rig(re.sub(r'inertia = ".*"', wrong, bench.rig(), count=1), "rig.toml")
    found = diagnose_rig(logs_of(bench, rig), rig, jobs=1)
    assert found.effects == ()
    assert found.declared_values["body.motor.inertia"]["fitted"] == pytest.approx(right, rel=0.02)
