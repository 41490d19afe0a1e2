"""What has moved: by hand, and against a fit by another method."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from dmptm_ctrl.check.evidence import Evidence, Parameter, only_own
from dmptm_ctrl.check.moved import (
    FALSE_ALARMS,
    entries_of,
    find_moved,
    information_of,
    threshold,
)

KEYS = ("TLc_plus", "TLc_minus", "J_L", "unbalance.cosine", "unbalance.sine")
VALUES = (20.0, 17.0, 20.0, 3.0, 4.0)


def parameters(own=True):
    return tuple(
        Parameter(key, "N·m", value, 1.0, np.inf, own)
        for key, value in zip(KEYS, VALUES, strict=True)
    )


def evidence(rng, change, model_error=0.0, rows=400):
    """Residual of a machine that differs by `change`, of a model that is off by `model_error`."""
    derivatives = rng.standard_normal((rows, len(KEYS)))
    left = rng.standard_normal(rows) - derivatives @ (np.asarray(change) + model_error)
    return Evidence(left, derivatives, parameters(), np.arange(rows), 1.0, "N·m")


def test_change_and_error_are_those_of_least_squares():
    """A model that is known exactly: each entry alone by the textbook's formula."""
    rng = np.random.default_rng(1)
    found = evidence(rng, (0, 0, 3.0, 0, 0))
    information = information_of(found, dict.fromkeys(KEYS, 1e-9))
    entry = next(e for e in entries_of(found.parameters) if e.name == "J_L")
    change = information.change(entry)
    column = found.derivatives[:, 2] * VALUES[2]
    expected, *_ = np.linalg.lstsq(column[:, None], -found.left, rcond=None)
    assert change.change == pytest.approx(expected[0], rel=1e-6)
    assert change.se == pytest.approx(1.0 / np.linalg.norm(column), rel=1e-6)
    assert abs(change.change - 3.0 / VALUES[2]) < 4 * change.se


def test_the_model_s_own_errors_widen_it_as_the_whole_covariance_says():
    """Against generalised least squares with the covariance written out."""
    rng = np.random.default_rng(2)
    found = evidence(rng, (0, 0, 0, 0, 0), rows=60)
    square = found.derivatives.T @ found.derivatives
    own = np.linalg.inv(square)  # as logs like these leave it
    whole = np.eye(60) + found.derivatives @ own @ found.derivatives.T
    entry = next(e for e in entries_of(found.parameters) if e.name == "unbalance")
    column = found.derivatives @ np.array([0, 0, 0, 3.0, 4.0])
    told = column @ np.linalg.solve(whole, column)
    expected = -column @ np.linalg.solve(whole, found.left) / told
    information = information_of(found, {})
    change = replace(information, scores=0.0 * information.scores).change(entry)
    assert change.change == pytest.approx(expected, rel=1e-6)
    assert change.se == pytest.approx(told**-0.5, rel=1e-6)


def test_errors_are_as_large_as_said():
    """Over draws of model and noise, changes in standard errors scatter by one."""
    rng = np.random.default_rng(3)
    sizes = []
    for _ in range(400):
        error = 0.3 * rng.standard_normal(len(KEYS))
        found = evidence(rng, np.zeros(len(KEYS)), error, rows=80)
        errors = dict.fromkeys(KEYS, 0.3)
        information = information_of(found, errors)
        sizes.append([information.change(e).errors for e in entries_of(found.parameters)])
    scatter = np.std(sizes, axis=0)
    np.testing.assert_allclose(scatter, 1.0, atol=0.2)


def test_rows_that_are_wrong_alike_count_once():
    """Ten equal rows a stretch: errors that took them for ten would be a third of the scatter."""
    rng = np.random.default_rng(8)
    sizes = []
    for _ in range(300):
        one = evidence(rng, np.zeros(len(KEYS)), rows=60)
        rows, left = np.repeat(one.derivatives, 10, axis=0), np.repeat(one.left, 10)
        found = replace(one, derivatives=rows, left=left, stretch=np.repeat(np.arange(60), 10))
        information = information_of(found, dict.fromkeys(KEYS, 1e-9))
        sizes.append([information.change(e).errors for e in entries_of(found.parameters)])
    np.testing.assert_allclose(np.std(sizes, axis=0), 1.0, atol=0.25)


def test_false_alarms_are_shared_among_the_entries():
    for count, stretches in ((1, 10), (12, 40)):
        tail = student.sf(threshold(count, stretches), stretches - 1)
        assert 2 * count * tail == pytest.approx(FALSE_ALARMS)


def test_names_one_change_and_then_another():
    rng = np.random.default_rng(4)
    found = evidence(rng, (4.0, 3.4, 0, 0, 4.0))
    moved, alone = find_moved(information_of(found, {}), entries_of(found.parameters))
    assert {c.entry.name for c in moved} == {"friction of the ring gear", "unbalance.sine"}
    first = next(c for c in moved if c.entry.name == "friction of the ring gear")
    assert first.change == pytest.approx(0.2, abs=4 * first.se)
    assert "friction of the ring gear: +" in first.text()
    assert len(alone) == len(entries_of(found.parameters))


def test_a_change_within_the_tolerance_is_none():
    rng = np.random.default_rng(5)
    found = evidence(rng, (0.6, 0.51, 0, 0, 0))  # 3 %, which the logs show clearly
    information, entries = information_of(found, {}), entries_of(found.parameters)
    assert find_moved(information, entries)[0] == []
    assert [c.entry.name for c in find_moved(information, entries, 0.01)[0]] == [
        "friction of the ring gear"
    ]


def test_a_change_that_another_hides_within_its_tolerance_is_found():
    """J_L grows by 20 %, and k_m falls by 2 %, which hides most of it: alone neither shows."""
    rng = np.random.default_rng(7)
    own, other = np.linalg.qr(rng.standard_normal((400, 2)))[0].T
    slopes = np.column_stack([60.0 * own, 1000.0 * (0.5 * own + 0.75**0.5 * other)])
    left = rng.standard_normal(400) - slopes @ (0.2, -0.02)
    known = tuple(Parameter(key, "N·m", 1.0, 1.0, np.inf) for key in ("J_L", "k_m"))
    information = information_of(
        Evidence(left, slopes, known, np.arange(400), 1.0, "N·m"), {"J_L": 1e-9, "k_m": 1e-9}
    )
    entries = entries_of(known)
    assert all(abs(information.change(entry).change) < 0.1 for entry in entries)  # the premise
    assert [c.entry.name for c in find_moved(information, entries)[0]] == ["J_L"]


def test_what_belongs_to_a_log_is_no_change():
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((300, 2))
    left = rng.standard_normal(300) - 5.0 * columns[:, 1]
    of_log = Parameter("log.zero", "", 0.0, 1.0, np.inf, own=False)
    found = only_own(Evidence(left, columns, (parameters()[2], of_log), np.arange(300), 1.0, "N·m"))
    assert [p.key for p in found.parameters] == ["J_L"]
    assert find_moved(information_of(found, {}), entries_of(found.parameters))[0] == []
    assert np.std(found.left) == pytest.approx(1.0, abs=0.1)


def test_a_slide_has_a_mass():
    table, rotor = (
        Parameter(f"body.{name}.inertia", unit, 2.0, 1.0, np.inf)
        for name, unit in (("table", "kg"), ("rotor", "kg·m²"))
    )
    assert [e.name for e in entries_of([table, rotor])] == ["mass of table", "body.rotor.inertia"]
