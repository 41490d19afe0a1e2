"""Evidence of the dual drive's balances: rigs of another program, and statistics in closed form."""

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter
from scipy.stats import t as student

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.candidate import WEAKER
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState, key_of
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.select import select_effects
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.identify.balance import (
    FLOOR,
    FREEDOM,
    INDEPENDENT,
    correlation_lengths,
    robust_scale,
    scatter,
    surprise,
    surprises,
)
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_sine_0v75", "closed_sine_10", "closed_sine_15")
LAWS = {"friction": "karnopp", "contact": "eq21", "sensors": "all"}
COUNT = 40_000


def declared(effects):
    """Evidence of short logs of a rig, the declared drive fitted to them, and the rig's label."""
    rig = make_rig(3, effects, logs=LOGS, **LAWS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
    base = DualState(residual(measured, Model(paper_drive()), jobs=1))
    return DualEvidence(measured, (), 1), base, rig.label


def selected(effects):
    """Selection on short logs of a rig, and the rig's label."""
    evidence, base, label = declared(effects)
    return select_effects(evidence, base), label


def test_two_effects_are_named_with_their_sizes():
    found, label = selected((("unbalance", 3.0), ("cogging", 2.0)))
    assert {e.key for e in found.entries} == {key_of("unbalance"), key_of("cogging")}
    assert all(e.probability > 0.9 for e in found.entries)
    assert all(e.held_gain > 0.0 for e in found.entries)
    values = found.final.left.base.model.effects
    true = label["effect_parameters"]
    size = np.hypot(*(values["unbalance"][k] for k in ("cosine", "sine")))
    wanted = np.hypot(*(true["unbalance"][k] for k in ("cos_N_m", "sin_N_m")))
    assert size == pytest.approx(wanted, rel=0.25)
    side = true["cogging"]["location"]
    size = np.hypot(*(values["cogging"][f"{side}_{k}"] for k in ("cosine", "sine")))
    assert values["cogging"]["order"] == true["cogging"]["order"]
    assert size == pytest.approx(true["cogging"]["amplitude_N_m"], rel=0.25)


def test_nothing_is_named_where_nothing_lacks():
    found, _ = selected(())
    assert found.entries == []
    assert found.final is found.base


def test_what_is_not_fitted_could_not_be_chosen():
    """Beside the declared drive, where everything that is missing looks like many effects."""
    evidence, base, _ = declared((("thermal_drift", 3.0),))
    found = {c.keys[0]: c for c in evidence.candidates(base)}
    rough = [key for key, c in found.items() if c.error == 0.0]
    assert any(found[key].objection == WEAKER for key in rough)
    assert not any(found[key].acceptable for key in rough)
    best = max(c.evidence for c in found.values() if c.acceptable)
    every = evidence.candidates(base, [*found])
    assert len(every) == len(found)
    assert max(c.evidence for c in every if c.acceptable) == pytest.approx(best, rel=1e-6)
    assert all(c.evidence < best for c in every if c.keys[0] in rough)


def noise(seed, pole=0.0):
    """Gaussian noise of one, correlated from sample to sample."""
    white = np.random.default_rng(seed).standard_normal(COUNT)
    return np.sqrt(1.0 - pole**2) * lfilter([1.0], [1.0, -pole], white)


@pytest.mark.parametrize("kind", ["total", "left", "ripple"])
def test_white_noise_counts_in_full(kind):
    (length,) = correlation_lengths([noise(1)], [kind])
    assert 1.0 <= length < 1.05


@pytest.mark.parametrize("pole", [0.5, 0.8, 0.95])
def test_correlated_noise_counts_less(pole):
    """A first-order process has (1 + φ)/(1 − φ) samples to one; overlap is counted already."""
    alone, overlapped = correlation_lengths([noise(2, pole)] * 2, ["ripple", "total"])
    assert alone == pytest.approx((1.0 + pole) / (1.0 - pole), rel=0.2)
    assert overlapped == pytest.approx(max(1.0, INDEPENDENT["total"] * alone), rel=1e-2)


@pytest.mark.parametrize("size", [0.3, 4.0])
def test_scale_is_the_most_likely_one(size):
    """Of Student's t, found by another optimiser."""
    x = size * student.rvs(FREEDOM, size=2000, random_state=5)
    best = minimize_scalar(
        lambda s: -student.logpdf(x, FREEDOM, scale=s).sum(), bounds=(0.1, 10.0), method="bounded"
    )
    assert robust_scale(x) == pytest.approx(best.x, rel=1e-3)
    assert scatter([x], ["total"]) == [pytest.approx(np.hypot(best.x, FLOOR["total"]), rel=1e-3)]


@pytest.mark.parametrize("kind", ["total", "right", "ripple"])
def test_surprise_is_the_likelihood_of_students_t(kind):
    """Less a constant per row: SciPy's density, at the scale of the rows, relative to its top."""
    x = 2.0 * student.rvs(FREEDOM, size=500, random_state=6)
    (s,) = scatter([x], [kind])
    top = x.size * student.logpdf(0.0, FREEDOM)
    share = INDEPENDENT.get(kind, INDEPENDENT["side"])
    reported = 2.0 * share * (top - student.logpdf(x, FREEDOM, scale=s).sum())
    assert surprise([x], [kind]) == pytest.approx(reported, rel=1e-9)
    several = [x, 3.0 * x], [kind, "total"]
    assert surprises(*several).sum() == pytest.approx(surprise(*several), rel=1e-12)
