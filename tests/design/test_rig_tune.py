"""A controller for a rig file: its feed-forward by hand, its tuning, its file, its C."""

import json
from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from tests.export.native import needs_compiler
from tests.export.test_plant import RIG

from dmptm_ctrl import close_loop
from dmptm_ctrl.cli import main
from dmptm_ctrl.design.aims import tracking
from dmptm_ctrl.design.controller import Controller, read_controller
from dmptm_ctrl.design.draws import draw_plants
from dmptm_ctrl.design.duty import usual_duty
from dmptm_ctrl.design.impact import impact
from dmptm_ctrl.design.rig_aims import rig_aims
from dmptm_ctrl.design.tune import to_be_homed, tune_controller
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.plots.control import plot_tuning
from dmptm_ctrl.simulate.model import Model
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.testing import assert_tracks

DT = 1e-3
LIMITED = RIG.replace('delay = "1.7 ms"', 'delay = "1.7 ms"\nlimit = "12 V"')
HOMED = RIG.replace('"theta_deg"\n', '"theta_deg"\nabsolute = true\n')
MODEL = RigModel(
    parse_rig(HOMED, "rig.toml"),
    (
        Placed("cogging", "motor", {"cosine": 0.02, "sine": 0.01, "order": 8.0}),
        Placed("unbalance", "load", {"cosine": 0.3, "sine": -0.1}),
    ),
)
FORWARD = {"inertia": 1.0, "friction": 1.0, "effects": 1.0}


def by_hand(speed, rate, load_angle, motor_angle):
    """Signal for the load's motion: torques of the two bodies, written out."""
    way = np.sign(speed)
    load = 0.05 * rate + way * (0.1 + 0.05 * np.exp(-abs(speed) / 0.1)) + 0.01 * speed
    load -= 0.3 * np.cos(load_angle) - 0.1 * np.sin(load_angle)
    motor = load / 5 + 0.002 * 5 * rate + way * 0.02 + 0.002 * 5 * speed
    motor -= 0.02 * np.cos(8 * motor_angle) + 0.01 * np.sin(8 * motor_angle)
    return motor / 0.1


@pytest.mark.long
@pytest.mark.parametrize("sensor", ["speed", "angle"])
def test_feed_forward_by_hand(sensor):
    """Of the load's speed, and of the motor's, which turns five times as fast."""
    lead, times = 2e-3, 1 if sensor == "speed" else 5
    controller = Controller(0.0, 0.0, lead=lead, model=MODEL, sensor=sensor, **FORWARD)
    step = controller.law().stepper(DT)
    readings = (0.7, 0.3)[: 2 if sensor == "speed" else 1]
    step(times * 0.28, *readings)
    (found,) = step(times * 0.3, *readings)
    rate = 0.02 / DT
    speed = 0.3 + lead * rate
    expected = by_hand(speed, rate, 0.7 / 5 + lead * speed, 0.7 + 5 * lead * speed)
    assert found == pytest.approx(expected, rel=1e-12)


def test_without_a_speed_sensor_the_angle_s_difference_is_the_speed():
    """Exact 1e6 rad from zero."""
    step = Controller(2.0, 0.0, model=RigModel(MODEL.rig), sensor="angle").law().stepper(DT)
    angles = 2.0**20 + 2.0**-10 * np.array([0, 1, 3, 2])
    found = [step(0.5, angle)[0] for angle in angles]
    speeds = np.array([0.0, 1.0, 2.0, -1.0]) * 2.0**-10 / DT
    np.testing.assert_allclose(found, 2.0 * (0.5 - speeds), rtol=1e-12)


@pytest.fixture(scope="module")
def tuned():
    aims = rig_aims(MODEL, limit=12.0)
    duty = aims.duty._replace(reference=aims.duty.reference[3400:4800])
    return tune_controller(
        MODEL, aims.__class__(**{**vars(aims), "duty": duty}), uncertainty=0.25, plants=16, jobs=1
    )


def test_tuning_pays_and_keeps_its_limits(tuned):
    assert np.median(tuned.gains) > 0.4
    assert tuned.linear.phase_margin_deg > 54
    errors = {row["stage"]: row["rmse_quantile"] for row in tuned.stages}
    assert errors["optimised"] <= errors["PI, optimised"]
    assert max(row["voltage_max"] for row in tuned.stages) <= 12.0
    assert "friction" in tuned.parts.index
    assert {"cogging@motor", "unbalance@load"} <= {*tuned.parts.index}
    assert "rms error [rad/s]" in tuned.summary()
    assert tuned.to_dict()["unit"] == "rad/s"
    assert plot_tuning(tuned).get_xlabel() == "rms tracking error [rad/s]"
    plt.close("all")


def test_error_is_that_of_one_plain_run(tuned):
    """Without lanes and threads; the drawn plant is the model itself."""
    c, aims = tuned.controller, tuned.aims
    quiet = aims.__class__(**{**vars(aims), "noise": 0.0})
    found, signals = tracking(c, [MODEL], quiet, jobs=1)
    run = close_loop(MODEL, c, aims.duty.time, aims.duty.reference)
    speed, u = (run.outputs[run.output_labels.index(n)] for n in ("speed", "voltage"))
    miss = (speed - aims.duty.reference)[::4][100:]
    assert found[0] == pytest.approx(np.sqrt(np.mean(miss**2)), rel=1e-6)
    assert signals[0] == pytest.approx(np.abs(u).max(), rel=1e-6)
    every = assert_tracks(MODEL, c, aims.duty.reference, rms=0.5)
    miss = speed - aims.duty.reference
    assert every == pytest.approx(np.sqrt(np.mean(miss**2)), rel=1e-6)
    with pytest.raises(AssertionError, match="rad/s rms"):
        assert_tracks(MODEL, c, aims.duty.reference, rms=0.5 * every)


def test_file_keeps_everything(tuned, tmp_path):
    tuned.controller.save(tmp_path / "controller.toml")
    again = read_controller(tmp_path / "controller.toml")
    np.testing.assert_array_equal(again.law().numbers(), tuned.controller.law().numbers())
    assert again.model.effects == tuned.controller.model.effects
    assert "# V/(rad/s)" in (tmp_path / "controller.toml").read_text("utf-8")


@needs_compiler
def test_the_compiled_controller_closes_the_loop_around_the_compiled_rig(tuned):
    from dmptm_ctrl.export.controller import controller_program
    from dmptm_ctrl.export.native import Compiled
    from dmptm_ctrl.export.plant import plant_program

    duty = tuned.aims.duty
    drive = Compiled(plant_program(MODEL, DT))
    step = Compiled(controller_program(tuned.controller))
    rows = []
    for target in duty.reference:
        readings = drive.peek(0.0)
        (u,) = step(target, *readings)
        drive(u)
        rows.append([*readings, u])
    true = close_loop(MODEL, tuned.controller, duty.time, duty.reference).outputs
    assert np.abs(true[1]).max() > 1.0
    np.testing.assert_allclose(np.transpose(rows), true, rtol=0, atol=1e-9 * np.abs(true).max())


def test_waves_over_an_angle_without_a_lasting_zero_are_named(tuned):
    """A run may begin anywhere on them; what has no phase is not named."""
    spring = Placed("cable_spring", "load", {"stiffness": 0.1})
    started = RigModel(parse_rig(RIG, "rig.toml"), (*MODEL.effects, spring))
    assert to_be_homed(started) == ("cogging@motor", "unbalance@load")
    assert to_be_homed(MODEL) == ()
    assert to_be_homed(Model().with_effect("unbalance", cosine=4.0)) == ()
    words = "needs the encoder at the zero of the model's first log: cogging@motor, unbalance@load;"
    assert words not in tuned.summary()
    other = replace(tuned, controller=replace(tuned.controller, model=started))
    assert words in other.summary()


def test_command(tmp_path, capsys, monkeypatch, tuned):
    asked = {}

    def remembered(model, aims=None, **options):
        asked.update(options, aims=aims)
        return tuned

    monkeypatch.setattr("dmptm_ctrl.design.run.tune_controller", remembered)
    file, out = tmp_path / "rig.toml", tmp_path / "out"
    file.write_text(RIG, encoding="utf-8")
    tune = ["tune", str(file), "--out", str(out)]
    assert main([*tune, "--limit", "9", "--speed", "2", "--sample-time", "0.002"]) == 0
    assert asked["aims"].limit == 9.0
    assert asked["aims"].duty.sample_time == 2e-3
    assert asked["aims"].duty.reference.max() == pytest.approx(2.0, rel=1e-3)
    assert json.loads((out / "tuning.json").read_text("utf-8"))["unit"] == "rad/s"
    bad = [
        ([], "rig.toml: input voltage has no limit in the rig file; give the largest signal"),
        (["--limit", "9", "--input", "brake"], "has no input 'brake'; it has voltage"),
        (["--limit", "inf"], "has no limit in the rig file"),
        (["--limit", "-3"], "--limit -3: must be positive"),
        (["--limit", "9", "--speed", "0"], "--speed 0: must be positive"),
        (["--limit", "9", "--logs", str(tmp_path)], "no logs"),
    ]
    for options, message in bad:
        again = ["tune", str(file), "--out", str(tmp_path / "no"), *options]
        assert main(again) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "no").exists()


def test_aims_follow_from_limit_and_inertia():
    aims = rig_aims(RigModel(parse_rig(LIMITED, "rig.toml")))
    inertia = 0.05 / 5 + 5 * 0.002  # at the motor, per acceleration of the load
    steepest = np.abs(usual_duty(DT, aims.duty.reference.max()).acceleration).max()
    assert steepest * inertia == pytest.approx(0.3 * 12.0 * 0.1, rel=1e-6)
    assert aims.limit == 12.0


def test_a_motor_that_moves_its_sensor_backwards_is_refused():
    model = RigModel(parse_rig(LIMITED.replace("ratio = 5", "ratio = -5"), "rig.toml"))
    with pytest.raises(ValueError, match="a positive signal of voltage moves speed backwards"):
        rig_aims(model)


def test_drawn_rigs_are_inside_their_ranges():
    plants = draw_plants(MODEL, 20, uncertainty=0.5, seed=3)
    inertia = [p.value("body.load.inertia") for p in plants]
    low, high = MODEL.quantities["body.load.inertia"].range
    assert np.ptp(inertia) > 0.25 * (high - low)
    assert all(0.05 - 0.25 * (high - low) <= x <= 0.05 + 0.25 * (high - low) for x in inertia)
    ratio = [p.effects[0].values["cosine"] / p.effects[0].values["sine"] for p in plants]
    np.testing.assert_allclose(ratio, 2.0)  # phases stay
    assert all(p.value("body.load.static") >= p.value("body.load.coulomb") for p in plants)
    assert draw_plants(MODEL, 1, uncertainty=0.0)[0].effects == MODEL.effects


def test_impact_of_effects_on_a_rig():
    """A dead time costs ω_c T of phase; without it the other effects are compared."""
    model = RigModel(parse_rig(LIMITED, "rig.toml")).with_effect(
        Placed("drive_delay", "voltage", {"delay": 4e-3})
    )
    aims = rig_aims(model)
    duty = aims.duty._replace(reference=aims.duty.reference[3400:4800])
    controller = Controller(0.4, 2.0, limit=12.0, model=RigModel(model.rig))
    found = impact(model, controller, duty=duty)
    assert found.effects == ("drive_delay@voltage",)
    lost = found.table.loc["phase margin, deg"]
    crossover = found.table.loc["crossover, Hz", "augmented"]
    assert lost["nominal"] - lost["augmented"] == pytest.approx(360 * crossover * 4e-3, rel=0.06)
    error = found.table.loc["tracking error rms, rad/s"]
    run = close_loop(model, controller, duty.time, duty.reference)
    late = run.outputs[run.output_labels.index("speed")]
    miss = (late - duty.reference)[round(duty.settling / duty.sample_time) :]
    assert error["augmented"] == pytest.approx(np.sqrt(np.mean(miss**2)), rel=0.02)
    assert error["augmented"] != error["nominal"]
    panels = found.plot()
    assert "rad/s" in panels[0].get_ylabel()
    plt.close(panels[0].figure)
