"""The error budget adds up, and the verdict follows from it."""

from dataclasses import dataclass

import numpy as np
import pytest

from dmptm_ctrl.diagnosis.budget import (
    EXPLAINED,
    MATERIAL,
    NONE,
    Errors,
    Row,
    Squares,
    closed_rows,
    error_entry,
    table_lines,
    verdict_of,
)
from dmptm_ctrl.diagnosis.negligible import material_together
from dmptm_ctrl.diagnosis.select import Entry, Selection
from dmptm_ctrl.diagnosis.summary import parameter_lines

UNITS = ("deg/s", "N·m")
SPEED, TORQUE = (0.2, 0.1), (3.0, 1.0)  # deg/s and N·m: not explained, floor


def row(name, share, torque=1.0):
    return Row(name, "ring gear", 0.5, torque, share, ("theta_L",))


def closed(rows, errors):
    left, floor = zip(SPEED, TORQUE, strict=True)
    return closed_rows(rows, errors, left, floor, ("u",))


def share_of(rows, name):
    (found,) = (r.share for r in rows if r.name == name)
    return found


@pytest.mark.parametrize("seed", range(20))
def test_shares_add_up_to_one(seed):
    """Whatever the errors are, and however much the effects overlap or hide each other."""
    rng = np.random.default_rng(seed)
    before, after, floor = rng.uniform(0.0, 4.0, 3)
    shares = rng.uniform(0.0, 1.5, seed % 5) * (seed % 3)
    errors = Errors(max(before, after) if shares.size else after, after, min(floor, after))
    rows = closed([row(f"e{i}", s) for i, s in enumerate(shares)], errors)
    assert sum(r.share for r in rows) == pytest.approx(1.0, abs=1e-12)
    assert all(0.0 <= r.share <= 1.0 for r in rows)
    assert [r.name for r in rows[-2:]] == ["not explained", "floor"]
    effects = [r.share for r in rows[:-2]]
    assert effects == sorted(effects, reverse=True)


def test_an_effect_alone_takes_all_that_its_model_takes():
    """Mean squares 10 → 4 with a floor of 1: 60 % named, 30 % not explained, 10 % floor."""
    rows = closed([row("cogging", 0.3)], Errors(10.0, 4.0, 1.0))
    assert [r.share for r in rows] == pytest.approx([0.6, 0.3, 0.1])
    assert (rows[1].speed_rms, rows[1].torque_rms) == (SPEED[0], TORQUE[0])
    assert (rows[2].speed_rms, rows[2].torque_rms) == (SPEED[1], TORQUE[1])
    assert rows[1].depends_on == ("u",)


def test_effects_that_hide_each_other_share_the_rest():
    """Left out one by one they cost 20 and 10 % of what is removable, together all of it."""
    rows = closed([row("a", 0.1), row("b", 0.2)], Errors(11.0, 1.0, 1.0))
    whole = 10.0 / 11.0
    assert share_of(rows, "b") == pytest.approx(0.2 * whole)
    assert share_of(rows, "a") == pytest.approx(0.1 * whole)
    assert share_of(rows, "shared") == pytest.approx(0.7 * whole)


def test_effects_that_overlap_are_scaled_alike():
    """Each of them alone takes most of the same."""
    rows = closed([row("a", 0.9), row("b", 0.6)], Errors(11.0, 1.0, 1.0))
    assert {r.name for r in rows} == {"a", "b", "not explained", "floor"}
    assert share_of(rows, "a") == pytest.approx(1.5 * share_of(rows, "b"))


def test_without_effects_the_error_is_unexplained_or_floor():
    rows = closed([], Errors(4.0, 4.0, 1.0))
    assert [(r.name, r.share) for r in rows] == [("not explained", 0.75), ("floor", 0.25)]


@pytest.mark.parametrize("worse", [0.0, 1e-300])
def test_logs_without_any_error(worse):
    rows = closed([], Errors(worse, worse, worse))
    assert all(np.isfinite(r.share) for r in rows)


def test_a_model_that_got_worse_explains_nothing():
    errors = Errors(1.0, 2.0, 0.5)
    assert errors.explained == 0.0
    rows = closed([row("a", 0.5)], errors)
    assert share_of(rows, "a") == 0.0
    assert share_of(rows, "not explained") == pytest.approx(0.75)


def test_none_only_near_the_floor():
    """1.5 times the floor as root mean square is 2.25 times as mean square."""
    near, far = Errors(NONE**2 * 0.999, 1.0, 1.0), Errors(NONE**2 * 1.001, 1.0, 1.0)
    assert verdict_of(near, False, False) == "none"
    assert verdict_of(near, False, True) == "unknown"  # a curve is needed
    assert verdict_of(far, False, False) == "unknown"  # small effects do not explain it


def test_explained_from_four_fifths():
    """Removable is 10 − 1."""
    enough, little = (Errors(10.0, 10.0 - 9.0 * (EXPLAINED + x), 1.0) for x in (0.001, -0.001))
    assert enough.explained == pytest.approx(EXPLAINED + 0.001)
    assert verdict_of(enough, True, False) == "explained"
    assert verdict_of(enough, False, False) == "unknown"
    assert verdict_of(little, True, True) == "unknown"


def test_what_is_near_its_floor_cannot_show_what_is_explained():
    """Mean squares of runs fall from 100 to 50 floors; the balance was at its floor before."""
    runs = Squares(100.0, 50.0, 1.0)
    at_floor, above = Errors(1.0, 1.0, 1.0, runs), Errors(10.0, 1.0, 1.0, runs)
    assert at_floor.explained == above.explained == pytest.approx(50.0 / 99.0)
    assert Errors(10.0, 1.0, 1.0, Squares(1.0, 1.0, 1.0)).explained == 1.0
    assert verdict_of(at_floor, True, False) == "unknown"


def test_entries_are_plain():
    reported = row("cogging", 0.3, None).to_dict()
    assert reported == {
        "name": "cogging", "location": "ring gear", "speed_rms": 0.5, "torque_rms": None,
        "share": 0.3, "depends_on": ["theta_L"],
    }  # fmt: skip


def test_lines_of_text():
    rows = closed([row("drive_offset", 1.0, None)], Errors(10.0, 1.0, 1.0))
    lines = table_lines(rows, UNITS)
    assert len(lines) == 1 + len(rows)
    assert " ".join(lines[0].split()) == "effect @ place speed torque share depends on"
    ends = [lines[0].index(word) + len(word) for word in ("speed", "torque", "share")]
    assert [lines[1][end - 1] for end in ends] == ["s", " ", "%"]
    assert "drive offset @ ring gear" in lines[1]
    assert "90.0 %" in lines[1]
    assert "–" in lines[1]  # it does not act on the torque
    bare = table_lines(rows, ("", "N·m"))
    assert "speed" not in bare[0]
    assert "deg/s" not in bare[1]
    assert MATERIAL < EXPLAINED < 1.0 < NONE


def test_a_run_that_is_no_worse_without_an_effect_says_so():
    one = Row("cogging", "ring gear", 0.0, 0.5, 1.0, ("theta_L",))
    lines = table_lines(closed_rows([one], Errors(10.0, 1.0, 1.0), (0, 0), (1, 1), ()), UNITS)
    assert "no rise" in lines[1]
    assert not any("no rise" in line for line in lines[2:])
    assert len({line.index("%") for line in lines[1:]}) == 1


def test_the_error_is_the_speeds_where_there_is_one_else_the_torques():
    sides = ("before", "after", "floor")
    speed = {k: {"rmse": 3.0, "unit": "rpm", "bandwidth_hz": 20.0} for k in sides}
    torque = {k: {"rmse": 0.5, "unit": "N", "percent": 4.0} for k in sides}
    both = error_entry("held-out logs", speed, torque, None)
    assert (both["unit"], both["bandwidth_hz"]) == ("rpm", 20.0)
    assert both["after"]["rmse"] == both["after"]["speed"]["rmse"] == 3.0
    assert both["after"]["torque"]["rmse"] == 0.5
    assert "horizon" not in both["after"]
    alone = error_entry("held-out logs", None, torque, None)
    assert alone["unit"] == alone["floor"]["unit"] == "N"
    assert alone["floor"]["rmse"] == 0.5
    assert "speed" not in alone["floor"]


@dataclass(frozen=True)
class Kept:
    """A model by what it keeps."""

    keys: tuple[str, ...]


class Stub:
    """Refits nothing."""

    def without(self, state, key):
        return Kept(tuple(k for k in state.keys if k != key))


@pytest.mark.parametrize(
    ("pair", "single", "found"),
    [
        (0.5, 0.001, {"motor"}),  # either friction stands for the other: one is needed
        (0.0, 0.01, {"motor"}),  # 0.1 % and 1 % can go, 1.5 % not as well
        (0.0, 0.001, set()),  # none is
    ],
)
def test_what_stands_for_each_other_is_not_immaterial(pair, single, found):
    """Shares by hand: 0.1 % and 1.5 % alone, `pair` more without both."""

    def share(state):
        gone = {"load": 0.001, "motor": 0.015, "single": single, "delay": 0.3}
        missing = [k for k in gone if k not in state.keys]
        return sum(gone[k] for k in missing) + pair * ({"load", "motor"} <= {*missing})

    final = Kept(("load", "motor", "single", "delay"))
    entries = [Entry(k, 100.0, 100.0, (), Stub().without(final, k)) for k in final.keys]
    selection = Selection(Kept(()), final, entries)
    assert material_together(Stub(), selection, share) == found


def test_a_large_error_of_a_parameter_is_a_plain_percentage():
    free = {"unit": "N", "range": None, "outside": False}
    declared = {"a": {"fitted": 0.05, "se": 0.15, **free}, "b": {"fitted": 2.0, "se": 0.05, **free}}
    _, large, small = parameter_lines(declared)
    assert "(300 %)" in large
    assert "(2.5 %)" in small


@pytest.mark.parametrize(
    ("unit", "shown"),
    [("kg", "mass"), ("A·s²/m", "mass"), ("kg·m²", "inertia"), ("A·s²/rad", "inertia")],
)
def test_what_slides_has_a_mass(unit, shown):
    one = {"fitted": 2.0, "se": 0.1, "unit": unit, "range": None, "outside": False}
    (_, line) = parameter_lines({"body.table.inertia": one})
    assert line.strip().startswith(f"body.table.{shown} = 2")
