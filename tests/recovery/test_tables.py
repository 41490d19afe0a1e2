"""What has no name goes into the model as a curve, on rigs of another program."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.bursts import interval
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.predict import speed_error
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.select import select_effects
from dmptm_ctrl.diagnosis.slip import WANDERS, wandered
from dmptm_ctrl.diagnosis.tables import KNOTS, MOTOR, in_tables, narrowed, tabulate
from dmptm_ctrl.diagnosis.unknown import unexplained
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects import CATALOGUE
from dmptm_ctrl.effects.lookup import CLOCK
from dmptm_ctrl.effects.unknown_motor import BOTH, LEFT, RIGHT
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

GAIN = paper_drive()["K_d"] * paper_drive()["K_M"]  # N·m/V on the motor's shaft
TURN, TURN_ENDS = "closed_turn_20", 19.0  # s, of the turn only the way there
LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_15", "closed_square_10", TURN)


def left_by(seed, effects, sensors, contact, logs=LOGS):
    laws = {"friction": "karnopp", "contact": contact}
    rig = make_rig(seed, effects, sensors=sensors, logs=logs, **laws)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    logs = [log.segment(0.0, TURN_ENDS) if log.name == TURN else log for log in logs]
    drive = paper_drive()
    return residual(measure(logs, drive), Model(drive)), rig.label["effect_parameters"]


class Decided(NamedTuple):
    """What the diagnosis finds in the balances of a rig."""

    entries: list
    unexplained: Any
    before: Any
    after: Any


def decided(*rig):
    left, true = left_by(*rig)
    selection = select_effects(DualEvidence(left.measured), DualState(left))
    named, evidence = selection.final.left, sum(e.evidence for e in selection.entries)
    rest = unexplained(left, named, evidence)
    rest, tables = in_tables(named, rest, 2) if rest is not None else (None, None)
    return Decided(selection.entries, rest, left, tables.left if tables else named), true


def table_of(left, name=MOTOR):
    values = left.base.model.effects[name]
    places = np.linspace(values["low"], values["high"], KNOTS)
    return values, places, np.array([values[f"k{i}"] for i in range(KNOTS)])


def halved(decision):
    """Whether the free runs of the held-out logs miss less than half as much, not refitted."""
    held = decision.before.measured.held_logs
    before, after = (
        speed_error(left.base.model, held)["rmse"] for left in (decision.before, decision.after)
    )
    return after < 0.5 * before


@pytest.mark.long
def test_motor_without_power_at_fixed_intervals():
    """Which motor, how often, for how long, and that all of its torque is lost."""
    decision, true = decided(501, (("unpowered_motor", 1.0),), "all", "eq21")
    true = true["unpowered_motor"]
    assert decision.unexplained.variables == ("time", "u")
    values, places, knots = table_of(decision.after)
    assert values["motors"] == {"left": LEFT, "right": RIGHT}[true["motor"]]
    assert values["period"] == pytest.approx(true["period_s"], rel=1e-3)
    area = np.sum(0.5 * (knots[1:] + knots[:-1]) * np.diff(places))
    assert area == pytest.approx(-GAIN * true["length_s"], rel=0.2)
    assert halved(decision)


def test_both_motors_ripple_alike_each_at_its_own_angle():
    """A table of the whole turn would have a few knots per wave, and one angle for both."""
    left, true = left_by(505, (("torque_ripple", 3.0),), "all", "eq21")
    true = true["torque_ripple"]
    found = tabulate(left, ("theta_m", "u"), 2)
    values, places, knots = table_of(found.left)
    assert values["motors"] == BOTH
    assert 2.0 * np.pi / (values["high"] - values["low"]) == pytest.approx(true["order"])
    phase = true["order"] * places
    size = np.hypot(*np.linalg.lstsq(np.column_stack([np.cos(phase), np.sin(phase)]), knots)[0])
    assert size == pytest.approx(true["share"] * GAIN, rel=0.1)
    assert set(values) == {p.name for p in CATALOGUE[MOTOR].parameters}  # the report shows all


@pytest.mark.long
def test_an_order_of_the_ring_gear_at_one_speed():
    """A curve over the angle knows no speed, and one over the speed no angle."""
    decision, true = decided(511, (("howl", 1.0),), "load", "eq21")
    true = true["howl"]
    assert not decision.entries
    assert decision.unexplained.variables[:2] == ("theta_L", "omega_L")
    values, _, knots = table_of(decision.after, "unknown_torque")
    assert 2.0 * np.pi / values["period"] == pytest.approx(true["order"])
    cosines, sines = np.split(knots, 2)
    speeds = values["high"] / (KNOTS - 1) * np.arange(cosines.size)
    sizes = np.hypot(cosines, sines)
    assert np.rad2deg(speeds[np.argmax(sizes)]) == pytest.approx(true["speed_deg_s"], rel=0.25)
    assert sizes.max() == pytest.approx(true["N_m"], rel=0.25)
    assert halved(decision)


@pytest.mark.parametrize("period", [0.3, 0.725, 1.37, 4.2])
def test_interval(period):
    """The whole interval, not a part of it, from times that are rounded to a window's hop."""
    rng = np.random.default_rng(1)
    logs = [np.arange(0.2, seconds, period) for seconds in (5.0, 8.0, 40.0)]
    times = [np.round((t + rng.normal(0.0, 0.01, t.size)) / 0.02) * 0.02 for t in logs]
    assert interval(times) == pytest.approx(period, rel=2e-3)


def test_interval_of_excitations_that_differ_is_none():
    """Reversals come by each log's own clock."""
    assert interval([np.arange(0.5, 10.0, 1.0), np.arange(0.6, 10.0, 1.25)]) == 0.0
    assert interval([np.sort(np.random.default_rng(2).uniform(0.0, 40.0, 40))]) == 0.0
    assert interval([np.array([1.0, 2.0])]) == 0.0


def test_narrowed_across_the_end_of_a_period():
    """Something happens from 2.9 s of a period of 3.1 s to 0.2 s of the next."""
    knots = {f"k{i}": 0.3 if i < 3 or i > 28 else 0.0 for i in range(KNOTS)}
    shape = {"variable": CLOCK, "low": 0.0, "high": 3.1, "motors": LEFT, "period": 3.1}
    model = Model(paper_drive()).with_effect(MOTOR, **shape, **knots)
    values = narrowed(model)[MOTOR]
    assert (values["low"] + 3.1) % 3.1 == pytest.approx(2.8)
    assert values["high"] - values["low"] == pytest.approx(0.6)
    assert (values["motors"], values["period"]) == (LEFT, 3.1)


def test_narrowed_where_nothing_happens():
    """A table of zeros stays over the whole period."""
    knots = {f"k{i}": 0.0 for i in range(KNOTS)}
    shape = {"variable": CLOCK, "low": 0.0, "high": 3.1, "motors": LEFT, "period": 3.1}
    values = narrowed(Model(paper_drive()).with_effect(MOTOR, **shape, **knots))[MOTOR]
    assert (values["low"], values["high"]) == (0.0, pytest.approx(3.1))


def test_what_slips_moves_the_flanks_for_good():
    """Neither an angle nor a static load brings them back; what lacks nothing keeps them."""
    slips, keeps = (
        left_by(560100013, effects, "all", "eq21")[0] for effects in ((("slipping_hub", 2.0),), ())
    )
    assert wandered(keeps) < WANDERS / 2 < WANDERS < wandered(slips)
