"""Effects too small for the balances, told by keeping step; on rigs of another program."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "identify"))

from test_ensemble import drawn, logged

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis import finish
from dmptm_ctrl.diagnosis.at_rest import softened
from dmptm_ctrl.diagnosis.augment import loosened
from dmptm_ctrl.diagnosis.decide import FAINT, FIRST
from dmptm_ctrl.diagnosis.finish import (
    KEEPS_SECONDS,
    LEAST,
    SMALLEST,
    Lap,
    Place,
    agree,
    behind,
    beyond_friction,
    faintly,
    lawfully,
    size,
    tells_for,
    told_from_friction,
)
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.race import BEHIND, SCATTER_SECONDS, Race
from dmptm_ctrl.diagnosis.rattle import rattled
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.runners import SCAN, beside, entrant, shaped
from dmptm_ctrl.diagnosis.trace import trace, unknowns_of
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects.torque_constant_mismatch import OPPOSITE
from dmptm_ctrl.identify.fit import declared, drive_unknowns, position
from dmptm_ctrl.identify.fit import place as placed
from dmptm_ctrl.identify.led import TWIST_UNIT
from dmptm_ctrl.identify.lock import DOUBTFUL, HORIZONS, LOST, UNEASY, Steps, cut, level
from dmptm_ctrl.identify.records import predict
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

LOGS = ("open_sine_0v60", "open_square_0v75", "closed_sine_10", "closed_square_15")
SOME = ("drive_offset", "unbalance")
GYRO = np.deg2rad(0.05)  # rad/s, noise of the speed


def measured_rig(
    effects, friction, seed=5500014, logs=LOGS, contact="kelvin_voigt", sensors="load"
):
    """A rig, what the declared drive leaves there, and its label."""
    laws = {"friction": friction, "contact": contact}
    rig = make_rig(seed, effects, sensors=sensors, logs=logs, **laws)
    drive = paper_drive()
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, drive)
    return measured, residual(measured, Model(drive)), rig.label["effect_parameters"]


def raced(effects, friction, only=SOME):
    """What the balances reach, and who wins."""
    measured, left, told = measured_rig(effects, friction)
    trials = trace(left, only=only)
    start = rattled(measured.fit, left.base, measured.drive, 2)
    return trials, Race(measured.fit, measured.held, start, trials).run(), told


def test_offset_that_hides_in_the_preload():
    """22 mV on one motor: common to both it is friction's to take up, the rest is preload."""
    trials, winner, told = raced((("drive_offset", 1.0),), "karnopp")
    assert max(trial.evidence for trial in trials) < FIRST
    assert winner.name == "drive_offset"
    assert winner.seconds >= 0.15
    values = winner.model.effects["drive_offset"]
    true = told["drive_offset"]
    assert true["location"] == "right"
    assert values["right"] - values["left"] == pytest.approx(true["offset_V"], rel=0.15)


def test_motors_that_differ_whichever_way():
    """One stronger, one weaker: the balances see the sum only, and take one motor for another."""
    effects, only = (("torque_constant_mismatch", 1.0),), ("torque_constant_mismatch", "cogging")
    trials, winner, told = raced(effects, "karnopp", only)
    assert max(trial.evidence for trial in trials) < FIRST
    assert winner.name == "torque_constant_mismatch"
    values = winner.model.effects["torque_constant_mismatch"]
    assert values["pattern"] == OPPOSITE
    assert values["error"] == pytest.approx(told[winner.name]["left_share"], rel=0.1)


def test_what_keeps_step_worse_than_noise_lets_it_lacks_something():
    """Friction that grows with the load, which others can play for 0.3 s of each log."""
    # friction that grows with time plays it for longer, on this rig: which is ahead, chance tells
    name, only = "load_dependent_friction", ("load_dependent_friction", "quadratic_drag")
    rig = ((name, 3.0),), "karnopp", 130100027, "paper", "eq21"
    measured, left, told = measured_rig(*rig)
    trials = trace(left, only=only)
    assert max(trial.evidence for trial in trials) < FIRST
    start = rattled(measured.fit, left.base, measured.drive, 2)
    assert level(start.model, measured.fit, 0.1, 2) > DOUBTFUL
    # whether it finds its way is chance, too; another one never wins
    several = [
        Race(measured.fit, measured.held, start, trials, seed=seed).run() for seed in range(3)
    ]
    won = [winner for winner in several if winner is not None]
    assert won
    assert {winner.name for winner in won} == {name}
    winner = max(won, key=lambda one: one.seconds)
    assert winner.seconds >= KEEPS_SECONDS
    # how large it is, other logs and a finer fit tell
    share = winner.model.effects[name]["coefficient"] / told[name]["coefficient"]
    assert 0.5 < share < 1.5


def test_faint_one_where_the_model_as_it_is_keeps_step_too():
    """Too little to lose step, but ahead of all others; without it no name is."""
    name = "load_dependent_friction"
    only = (name, "quadratic_drag", "torque_constant_mismatch")
    for effects in (((name, 1.0),), ()):
        measured, left, told = measured_rig(effects, "karnopp", 740100020, "paper", "eq21")
        trials = trace(left, only=only)
        assert max(trial.evidence for trial in trials) < FAINT
        start = rattled(measured.fit, left.base, measured.drive, 2)
        winner = Race(measured.fit, measured.held, start, trials).run()
        if not effects:
            assert winner is None
            continue
        assert winner.name == name
        assert winner.threshold < winner.evidence < LEAST
        found = winner.model.effects[name]["coefficient"]
        assert found == pytest.approx(told[name]["coefficient"], rel=0.25)


@pytest.mark.parametrize(
    ("seed", "friction", "contact", "longest"),
    [(5500014, "karnopp", "eq21", 0.6), (5500017, "lugre", "hunt_crossley", 0.15)],
)
def test_ends_where_no_one_can_win(seed, friction, contact, longest, monkeypatch):
    """Nothing lacks: the laws are the model's, which keeps step, or others that none meets.

    There some would begin anew: a race that pauses before goes on from where it was.
    """
    measured, left, _ = measured_rig((), friction, seed, contact=contact)
    seconds = []

    def noted(rec, horizon):
        seconds.append(horizon)
        return cut(rec, horizon)

    monkeypatch.setattr("dmptm_ctrl.diagnosis.race.cut", noted)
    start = rattled(measured.fit, left.base, measured.drive, 2)
    racing = Race(measured.fit, measured.held, start, trace(left, only=SOME))
    assert racing.run(pauses=True) is None
    assert racing.ended is (contact == "eq21")
    assert racing.run() is None
    assert racing.ended
    laps = [h for h in HORIZONS if h <= longest]
    assert seconds == [h for h in laps for _ in measured.fit]  # none is begun twice


def test_who_lost_the_way_goes_on_from_the_leader():
    """Nothing lacks here: with no drag beside it the leader's way is right for the drag, too."""
    measured, left, _ = measured_rig((), "karnopp", contact="eq21")
    start = rattled(measured.fit, left.base, measured.drive, 2)
    known, name = loosened(start), "quadratic_drag"
    records = [cut(rec, 0.1) for rec in measured.fit]
    leader = entrant(None, start.model, start.unknowns, known, ())
    for seconds in (0.05, 0.1):
        leader.go([cut(rec, seconds) for rec in measured.fit], 2)
    assert leader.level < UNEASY
    own = unknowns_of(name)
    model = start.model.with_effect(name, coefficient=0.0)
    lost = entrant(name, model, (*start.unknowns, *own), beside(known, model, own), ())
    lost.places = [np.concatenate([-leader.places[0], [20.0]])]  # steps: the way is far from there
    lost.steps = lost.prepared(records, 2, None)
    lost.level, lost.found = float(lost.steps.levels(lost.places)[0]), []
    lost.cost = float(lost.steps.costs(lost.steps.residuals(lost.places), lost.places)[0])
    assert lost.level > LOST
    lost.crosses([leader], len(start.unknowns))
    assert lost.level < UNEASY
    assert lost.cost < leader.cost + 1.0
    astray = entrant(None, start.model, start.unknowns, known, ())
    astray.places = [-leader.places[0]]
    kept = leader.places[0]
    leader.crosses([astray], len(start.unknowns))
    assert leader.places[0] is kept


def test_who_begins_anew_finds_the_way_into_the_first_landings():
    """10 mV on one motor, where friction may give as well: no step leads there."""
    name = "drive_offset"
    rig = ((name, 0.5),), "karnopp", 200100049, "paper", "eq21", "all"
    measured, left, told = measured_rig(*rig)
    (trial,) = trace(left, only=(name,))
    assert trial.evidence < FAINT
    behind = len(left.base.unknowns)
    start = softened(rattled(measured.fit, left.base, measured.drive, 2), behind)
    trial = replace(trial, fit=softened(trial.fit, behind))
    (one,) = shaped(trial, start, loosened(start), measured.fit, 2)
    for seconds in (0.03, SCATTER_SECONDS):
        records = [cut(rec, seconds) for rec in measured.fit]
        one.go(records, 2)
    # a rounding may have led there: put where no step leads back from
    astray = one.places[0].copy()
    astray[-len(unknowns_of(name)) :] = [10.0, -10.0]
    one.found = []
    one.pursue(astray)
    stuck = one.cost
    assert one.level > UNEASY
    one.scatters(records, 1)
    assert one.level < UNEASY
    assert one.cost < stuck - BEHIND
    values = one.there.effects[name]
    assert values["left"] - values["right"] == pytest.approx(told[name]["offset_V"], rel=0.3)


def test_a_limit_that_one_log_reaches_at_its_first_reversal():
    """It tells nothing for 0.5 s, nor by a small step from no limit, nor in any other log."""
    name, only = "drive_saturation", ("drive_saturation", "quadratic_drag")
    measured, left, told = measured_rig(((name, 1.0),), "karnopp", 3682345426, "paper", "eq21")
    trials = trace(left, only=only)
    start = rattled(measured.fit, left.base, measured.drive, 2)
    winner = Race(measured.fit, measured.held, start, trials).run()
    assert winner.name == name
    assert winner.seconds >= KEEPS_SECONDS
    limit = 1.0 / winner.model.effects[name]["inverse_limit"]
    assert limit == pytest.approx(told[name]["limit_V"], rel=0.01)


@pytest.mark.parametrize("true", [9.0, 29.0])
def test_an_order_that_the_balances_miss_goes_on_from_the_scan(true):
    """Of a drive that obeys the model's laws, and whose values balances know nearly."""
    measured, left, _ = measured_rig((), "karnopp", 90100001, sensors="all")
    start = rattled(measured.fit, left.base, measured.drive, 2)
    magnets = {"left_cosine": 0.02, "left_sine": 0.02, "right_cosine": 0.0, "right_sine": 0.03}
    rng = np.random.default_rng(5)
    off = 0.5 * np.linalg.cholesky(start.covariance) @ rng.standard_normal(start.p.size)
    plant = placed(start.model, start.unknowns, start.p + off)
    plant = plant.with_effect("cogging", **magnets, order=true)
    logged = [as_run(cut(rec, 0.2), plant, rng) for rec in measured.fit]
    (trial,) = trace(left, only=("cogging",))
    missed = trial.fit.model.with_effect("cogging", order=true - 1.0)
    trial = replace(trial, fit=replace(trial.fit, model=missed))
    entered = shaped(trial, start, loosened(start), logged, 2)
    tried = [one.model.effects["cogging"]["order"] for one in entered]
    assert tried[0] == true - 1.0
    assert true in tried[1:]
    assert len(tried) == 1 + SCAN[-1][-1]


def as_run(rec, plant, rng):
    """A record as a plant runs on it, with noise of its sensors."""
    run = predict(rec, plant.arrays())
    n1, n2 = plant.drive["N_1"], plant.drive["N_2"]
    omega = run[:, 1] + GYRO * rng.standard_normal(rec.omega.size)
    twist = run[:, 2:4] / n1 - n2 * run[:, :1]
    twist += n2 * TWIST_UNIT * rng.standard_normal(twist.shape)
    return replace(rec, omega=omega, twist=twist)


@pytest.mark.parametrize(
    ("laps", "told"),
    [
        # a rig that lacks nothing but friction and contact by the model's laws: level of the
        # offset that mends a part of it, and of the model as it is, from horizon to horizon
        (((0.32, 0.33), (0.37, 0.40), (0.44, 0.70), (0.40, 1.10)), False),
        # a rig of the same laws with an offset of half the size that shows
        (((0.27, 1.20), (0.34, 1.97), (0.43, 2.31), (0.44, 2.18)), True),
        # laws that are the model's, and a friction that grows with the load
        (((0.20, 0.24), (0.19, 0.40), (0.19, 0.56), (0.34, 0.65)), True),
    ],
)
def test_a_name_needs_bounces_met_as_well_as_noise_lets(laps, told):
    def place(name, level):
        return Place(name, None, np.zeros(0), 0.0, level)

    proven = [Lap(0.1, place(None, bare), (place("drive_offset", own),)) for own, bare in laps]
    assert set().union(*(lap.proven for lap in proven)) == ({"drive_offset"} if told else set())


@pytest.mark.parametrize(
    ("costs", "told"),
    [
        ({"drive_saturation": 0, "cogging": 140, None: 140}, True),  # a limit that is reached late
        ({"drive_saturation": 0, None: 140}, True),
        ({"drive_saturation": 0, "cogging": 50, None: 50}, False),
        ({"thermal_drift": 0, "unbalance": 35, None: 110}, False),  # several find a part of the way
    ],
)
def test_who_alone_goes_on(costs, told, monkeypatch):
    places = {name: Place(name, None, np.zeros(0), cost, 0.2) for name, cost in costs.items()}
    lap = Lap(0.6, places[None], tuple(places.values()))
    monkeypatch.setattr(finish, "agreed", lambda lap, *_: lap.field[0].name)
    assert lawfully(lap, (), 1) == (next(iter(costs)) if told else None)


@pytest.mark.parametrize(
    ("gains", "told"),
    [
        ((2.9, 2.9, 3.5, 1.0, 5.0, 1.3), True),  # friction that grows with the load, a little
        ((0.8, -0.2, 32.5, 0.2, 2.0, 0.0), False),  # a bounce that one of two models missed
    ],
)
def test_a_faint_one_is_told_by_more_than_one_log(gains, told, monkeypatch):
    name = "load_dependent_friction"
    places = [Place(n, None, np.zeros(0), c, 0.2) for n, c in ((name, 0.0), (None, sum(gains)))]
    monkeypatch.setattr(finish, "gained", lambda *_: (np.array(gains), np.array([11, 19, 2, 1])))
    monkeypatch.setattr(finish, "large_enough", lambda _: True)
    monkeypatch.setattr(Place, "model", None)
    won = faintly(Lap(0.6, places[1], tuple(places)), (), 1)
    assert (won is not None) == told


@pytest.mark.parametrize(
    ("winner", "bare", "told"),
    [
        (0.25, 0.54, True),  # beside a drag: out of step from 0.15 to 0.6 s, not over 0.9 s
        (0.38, 0.54, False),
        (0.38, 0.70, True),
        (0.43, 0.70, False),
        (0.43, 1.20, True),
    ],
)
def test_who_lost_step_before_is_behind_who_meets_all(winner, bare, told):
    assert behind(bare, winner) == told


@pytest.mark.parametrize(
    ("gains", "held", "told"),
    [
        ((0, 0, -58, -1, 1928, -2), (-40, -2, 24, -35), True),  # a limit that one log reaches
        ((0, 0, -58, -1, 1928, -2), (-40, -2, -60, -35), False),
        ((80, 90, 100, 110, 90, 120), (30, 30, 30, 30), True),  # what all show
        ((80, 90, 100, 110, 90, 120), (30, 30, 20, 20), False),
        ((80, 90, 100, 110, 90, 120), (-2, -2, 0, 0), False),
    ],
)
def test_held_out_logs_gain_what_is_common(gains, held, told):
    assert agree(np.array(gains), np.array(held)) == told


@pytest.mark.parametrize(("off", "seconds"), [(0.02, 0.2), (0.05, 0.07)])
def test_held_out_logs_tell_for_as_long_as_one_keeps_step(off, seconds):
    """Not beyond: a limit was there on one log, and values moved for it met others by chance."""
    plant = drawn(2)
    model, records = plant[0], logged(plant, 3)
    unknowns = drive_unknowns(model)
    known, right = declared(unknowns), position(model, unknowns)

    def at(p):
        return Place(None, Steps(records, model, unknowns, known, 1), p, 0.0, 0.0)

    there, beside = at(right), at(right + off)
    assert tells_for((beside, there), records, 0.9, 1) == 0.9
    assert tells_for((beside, beside), records, 0.9, 1) == seconds
    assert tells_for((beside, beside), records, 0.05, 1) == 0.05
    others = [replace(rec, omega=rec.omega + 0.1) for rec in records]
    assert tells_for((beside, there), others, 0.9, 1) == 0.9  # no one ever keeps step


@pytest.mark.parametrize(
    ("left", "right", "told"),
    [
        # winners on two rigs that lack nothing, with a tanh for friction
        (-0.0174, -0.0170, False),
        (0.01857, 0.01852, False),
        (-0.0270, -0.0184, True),  # -8.7 mV on the left motor, beside what friction takes up
        (-0.0067, 0.0019, True),
    ],
)
def test_what_is_common_to_both_motors_is_friction_s(left, right, told):
    model = Model().with_effect("drive_offset", left=left, right=right)
    assert told_from_friction(model, "drive_offset") is told
    assert told_from_friction(model.with_effect("cogging", left_cosine=0.01), "cogging")


def test_an_offset_of_both_motors_is_told_by_all_bounces_of_long_runs():
    """Friction may differ both ways by as much; here by more than its tolerance lets it."""
    measured, left, told = measured_rig(
        (("drive_offset", 1.0),), "karnopp", 550100033, logs="paper", contact="eq21"
    )
    start = rattled(measured.fit, left.base, measured.drive, 2)
    winner = Race(measured.fit, measured.held, start, trace(left, only=SOME)).run()
    assert winner.name == "drive_offset"
    assert winner.seconds >= 0.6
    assert not told_from_friction(winner.model, winner.name)
    true = told["drive_offset"]
    assert true["location"] == "both"
    values = winner.model.effects["drive_offset"]
    both = 0.5 * (values["left"] + values["right"])
    assert both == pytest.approx(true["offset_V"], rel=0.2)


@pytest.mark.parametrize(
    ("offset", "told"),
    [
        # keeps step for 0.9 s on a rig that lacks nothing, with a tanh for friction
        (0.0135, False),
        (-0.0185, False),
        (0.0241, True),
        (-0.0241, True),
    ],
)
def test_an_offset_beyond_what_friction_can_differ_both_ways(offset, told):
    """0.0222 V at 9.75 N·m/V of a pinion: 12 % of 1.8 N·m."""
    model = Model().with_effect("drive_offset", left=offset - 0.001, right=offset + 0.001)
    assert beyond_friction(model, drive_unknowns(Model())) is told


@pytest.mark.parametrize(
    ("name", "values", "shows"),
    [
        # winners on rigs that lack nothing
        ("torque_constant_mismatch", {"pattern": 2.0, "error": -0.0010}, False),
        ("cogging", {"left_cosine": 0.0008, "left_sine": -0.0005, "right_cosine": 0.0009}, False),
        # the smallest ones that were there
        ("drive_offset", {"left": -0.0067, "right": 0.0019}, True),
        ("reducer_compliance", {"compliance": 2.8e-5}, True),
    ],
)
def test_a_winner_is_of_a_size_that_logs_show(name, values, shows):
    assert (size(Model().with_effect(name, **values), name) > SMALLEST) is shows


def test_nobody_wins_on_a_rig_of_another_friction_law():
    assert raced((), "tanh")[1] is None
