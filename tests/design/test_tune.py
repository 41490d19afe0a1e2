"""Tuning on the nonlinear drive, the controller's file, the command."""

import json
from dataclasses import replace

import control as ct
import numpy as np
import pytest

from dmptm_ctrl.cli import main
from dmptm_ctrl.control.sections import sampled_notch
from dmptm_ctrl.control.shaping import SampledPlant, fastest_pi, notched_pi
from dmptm_ctrl.data import path
from dmptm_ctrl.design.aims import Aims, tracking
from dmptm_ctrl.design.controller import Controller, Notch, read_controller
from dmptm_ctrl.design.draws import HIDDEN_DISTANCE, draw_plants
from dmptm_ctrl.design.duty import DEG, usual_duty
from dmptm_ctrl.design.linear import linear_plant
from dmptm_ctrl.design.preload import load_torque_along, smallest_preload
from dmptm_ctrl.design.tune import feed_forward_start, tune_controller
from dmptm_ctrl.signals import LogError
from dmptm_ctrl.simulate.linear import turning
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.model_file import to_toml

DT = 1e-3
MODEL = Model().with_effect("drive_offset", left=0.05, right=-0.02)
BOTH = Controller(
    12.0, 300.0, 8.0, 0.2, notches=(Notch(60.0, 0.2, 0.4),), friction=0.9, invert=True, model=MODEL
)
# the end of the usual duty: a slow trapezoid, a rest and a start
END = np.concatenate([np.zeros(400), usual_duty().reference[5400:]])
AIMS = Aims(duty=usual_duty()._replace(reference=END))


@pytest.fixture(scope="module")
def tuned():
    return tune_controller(MODEL, AIMS, uncertainty=0.5, plants=24, jobs=1)


@pytest.mark.long
def test_tuning_is_better_over_the_plants_and_stays_in_the_margins(tuned):
    errors = {row["stage"]: row["rmse_quantile"] for row in tuned.stages}
    assert errors["optimised"] < 0.3 * errors["PI, linear design"]
    assert errors["optimised"] <= 1.02 * errors["both"]
    assert errors["optimised"] < 0.6 * errors["PI, optimised"]
    assert np.median(tuned.gains) > 0.4
    assert "the compensation takes off" in str(tuned)
    assert tuned.to_dict()["compensation"]["sure"] == pytest.approx(np.quantile(tuned.gains, 0.1))
    assert tuned.parts["median"].idxmax() == "friction"
    assert tuned.linear.phase_margin_deg > 54
    assert tuned.controller.kp <= 1.05 * tuned.linear.kp
    # judged anew: other noise, other plants
    again, volts = tracking(tuned.controller, draw_plants(MODEL, 24, seed=99), AIMS, seed=5)
    assert np.median(again) < 2 * np.median(tuned.errors) + 0.1
    assert volts.max() < Aims().limit


@pytest.mark.long
def test_strong_cogging_leaves_a_linear_start():
    """At one angle it pushes away, and no PI keeps the margins; over a turn it is a disturbance."""
    model = Model().with_effect("cogging", left_sine=-0.04, right_sine=-0.04, order=27.0)
    with pytest.raises(ValueError, match="no PI keeps"):
        fastest_pi(linear_plant(model), 55.0, 9.0)
    duty = usual_duty()
    aims = Aims(duty=duty._replace(reference=duty.reference[:900]))
    found = tune_controller(model, aims, uncertainty=0.25, plants=1, jobs=1)
    assert found.linear.crossover_hz > 10.0
    assert np.isfinite(found.errors).all()


@pytest.mark.long
def test_a_notch_pays_on_the_papers_drive():
    """Behind it the loop is four times as stiff; without it these gains hammer."""
    model, aims, share = Model(), Aims(), 0.63  # of the linear design's crossover
    plant = linear_plant(model)
    alone = fastest_pi(plant, aims.phase_margin_deg, aims.gain_margin_db)
    found = notched_pi(plant, alone, aims.phase_margin_deg, aims.gain_margin_db)
    assert found.hz == pytest.approx(230.9, rel=0.02)  # det(K − ω²M) = 0
    part = Notch(found.hz, found.depth, found.width)
    begin = replace(feed_forward_start(model, alone, aims), distance=1.7e-5, preload=0.54)

    def gains(crossover, sections=()):
        sampled = SampledPlant(plant, DT, sections)
        return sampled.gains(share * crossover, aims.phase_margin_deg)

    def error(controller):
        return np.quantile(tracking(controller, plants, aims, jobs=1)[0], 0.9)

    plants = draw_plants(model, 8, seed=11)
    kp, ki = gains(alone.crossover_hz)
    section = sampled_notch(part.hz, part.depth, part.width, DT)
    stiff, stiff_ki = gains(found.gains.crossover_hz, [section])
    assert stiff > 4.0 * kp
    plain = error(replace(begin, kp=kp, ki=ki))
    notched = replace(begin, kp=stiff, ki=stiff_ki, notches=(part,))
    assert error(notched) < 0.9 * plain
    assert error(replace(notched, kp=1.6 * stiff, ki=1.6 * stiff_ki)) < plain
    assert error(replace(notched, notches=())) > 30.0 * plain


def test_feedback_as_python_control():
    """Continuous and discrete agree far below the sample rate; both are the PI and the notch."""
    for hz in (0.1, 1.0, 10.0):
        s = 2j * np.pi * hz
        expected = (12.0 + 300.0 / s) * ct.tf(*_notch(60.0, 0.2, 0.4))(s)
        assert BOTH.to_ss()(s) == pytest.approx(expected, rel=1e-9)
        assert BOTH.to_discrete()(np.exp(s * 1e-3)) == pytest.approx(expected, rel=0.02)


def _notch(hz, depth, width):
    w = 2 * np.pi * hz
    return [1, 2 * depth * width * w, w**2], [1, 2 * width * w, w**2]


def test_file_keeps_everything(tmp_path):
    BOTH.save(tmp_path / "controller.toml")
    again = read_controller(tmp_path / "controller.toml")
    np.testing.assert_array_equal(again.law().numbers(), BOTH.law().numbers())
    assert again.model.effects == MODEL.effects
    assert dict(again.model.drive) == dict(MODEL.drive)
    assert "w[k] = " in BOTH.equations()


@pytest.mark.parametrize("text", ["", "x = [", 'kind = "speed controller"\nschema = 1'])
def test_bad_files(tmp_path, text):
    file = tmp_path / "c.toml"
    file.write_text(text)
    with pytest.raises(LogError, match=r"c\.toml"):
        read_controller(file)


def test_draws_are_inside_the_ranges_and_the_same_for_every_count():
    few, many = draw_plants(MODEL, 3), draw_plants(MODEL, 40)
    for one, other in zip(few, many, strict=False):
        assert dict(one.drive) == dict(other.drive)
    for name, quantity in MODEL.drive.quantities.items():
        low, high = quantity.range
        values = [plant.drive[name] for plant in many]
        assert min(values) >= low - 1e-12 * abs(low)
        if not name.startswith("T"):  # breakaway may be lifted to sliding
            assert max(values) <= high + 1e-12 * abs(high)
        if quantity.is_free:
            assert np.ptp(values) > 0.7 * (high - low) * (1.0 if name not in ("c", "c_f") else 0.3)
    assert draw_plants(MODEL, 1, uncertainty=0.0)[0].drive["J_L"] == MODEL.drive["J_L"]


def distances(model):
    """Drawn distances over which friction builds up, (40, 2): reducers, ring gear."""
    drawn = [p.effects.get("presliding", {}) for p in draw_plants(model, 40, uncertainty=0.25)]
    names = ("reducer_distance", "ring_distance")
    return np.array([[one.get(name, 0.0) for name in names] for one in drawn])


def test_friction_may_build_up_later_than_the_model_says():
    """A distance that logs tell is as uncertain as one of which they tell nothing."""
    none = Model().with_effect("presliding", reducer_distance=0.0, ring_distance=0.0)
    named = Model().with_effect("presliding", reducer_distance=1e-3, ring_distance=1e-4)
    for model in (Model(), none):
        reducer, ring = distances(model).T
        assert 0.2 < np.mean(ring == 0.0) < 0.5
        assert 0.8 * HIDDEN_DISTANCE < ring.max() <= HIDDEN_DISTANCE
        np.testing.assert_allclose(reducer, 8.25 * ring, rtol=1e-12)
    reducer, ring = distances(named).T
    assert ring.min() < 1e-4 - 0.4 * HIDDEN_DISTANCE
    assert ring.max() > 1e-4 + 0.8 * HIDDEN_DISTANCE
    assert np.ptp(reducer) > 8.25 * HIDDEN_DISTANCE
    assert draw_plants(named, 1, uncertainty=0.0)[0].effects == named.effects


def test_distance_of_a_controller_adds_to_that_of_its_model():
    named = {"reducer_distance": 1e-3, "ring_distance": 1e-4}
    by_model = replace(BOTH, distance=0.0, model=Model().with_effect("presliding", **named))
    longer = {"reducer_distance": 1e-3 + 8.25 * 2e-5, "ring_distance": 1.2e-4}
    found = replace(by_model, distance=2e-5).law().model.effects["presliding"]
    assert {k: found[k] for k in longer} == pytest.approx(longer, rel=1e-12)
    assert by_model.law().model.effects == by_model.model.effects


def test_preload_against_the_balance_of_a_turn():
    """A steady turn: the preload at which the root search loses a mesh."""
    speed = 15 * DEG
    duty = usual_duty()._replace(reference=np.full(100, speed))
    least = smallest_preload(Model(), duty)
    z, _ = turning(Model(), speed=speed, preload=1.15 * least)
    n2 = Model().drive["N_2"]
    assert z[0] - n2 * z[2] > 0 > z[1] - n2 * z[2]  # on opposite flanks: both closed
    z, _ = turning(Model(), speed=speed, preload=0.85 * least)
    assert np.sign(z[0] - n2 * z[2]) == np.sign(z[1] - n2 * z[2])  # both push the same way
    drive = Model().drive
    by_hand = drive["TLc_plus"] + drive["BL_plus"] * speed
    assert load_torque_along(Model(), duty)[-1] == pytest.approx(by_hand, rel=1e-4)


@pytest.mark.long
def test_command(tmp_path, capsys, monkeypatch, tuned):
    asked = {}

    def remembered(model, aims=None, **options):
        asked.update(options, model=model)
        return tuned

    monkeypatch.setattr("dmptm_ctrl.design.run.tune_controller", remembered)
    (tmp_path / "model.toml").write_text(to_toml(MODEL))
    out = tmp_path / "tuning"
    assert main(["tune", str(tmp_path / "model.toml"), "--out", str(out), "--plants", "16"]) == 0
    assert "optimised" in capsys.readouterr().out
    assert asked["plants"] == 16
    assert asked["model"].effects == MODEL.effects
    assert json.loads((out / "tuning.json").read_text())["plants"] == tuned.errors.size
    assert read_controller(out / "controller.toml").friction > 0.5
    assert (out / "tuning.png").stat().st_size > 10_000
    bad = [["none.toml"], ["model.toml", "--logs", str(tmp_path / "nowhere")]]
    for name, *more in bad:
        assert main(["tune", str(tmp_path / name), "--out", str(tmp_path / "no"), *more]) == 2
        assert not (tmp_path / "no").exists()
    # logs tell how far friction builds up
    logs = path("demo_rig") / "closed_sine_10.csv.gz"
    again = ["--out", str(out), "--plants", "16", "--logs", str(logs)]
    assert main(["tune", str(tmp_path / "model.toml"), *again]) == 0
    assert set(asked["model"].effects) == {*MODEL.effects, "presliding"}
