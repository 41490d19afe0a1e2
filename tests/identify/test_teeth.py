"""Links with a gap, measured at both ends: what teeth carry, and when they push."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.identify.test_reading_noise import noisier

import dmptm_ctrl
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.forces import forces_of
from dmptm_ctrl.identify.free_parameters import free_parameters, scales_of
from dmptm_ctrl.identify.inverse_dynamics import balance_of, residual
from dmptm_ctrl.identify.measured_motion import reading_variance
from dmptm_ctrl.identify.pushing_teeth import centred, in_contact, pushing
from dmptm_ctrl.identify.reading_noise import noise_in_balance
from dmptm_ctrl.identify.rig_fit import fit_rig, residuals
from dmptm_ctrl.identify.rig_simulate import initial
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT = 1e-3
COUNT = 2 * np.pi / 10_000
PAPER = (Path(dmptm_ctrl.__file__).parent / "data/paper_3dof.toml").read_text()
MOTORS = "".join(
    f'\n[sensor.motor_{side}]\ncolumn = "theta_{side}"\nunit = "rad"\nbody = "motor_{side}"\n'
    for side in ("left", "right")
)


@pytest.fixture(scope="module")
def rig():
    return parse_rig(PAPER + MOTORS)


def log_of(model: RigModel, name: str, speed: float, start: float = 0.0) -> tuple[Log, dict]:
    """A log of turns both ways, readings rounded to counts, and what the meshes carry."""
    rng = np.random.default_rng(round(100 * speed))
    time = DT * np.arange(6000)
    wave = 0.75 * np.sign(np.sin(2 * np.pi * speed * time))
    u = np.array([wave, wave])
    run = march(model, u, DT)
    rounded = COUNT * np.round(run.reading("motor_left") / COUNT)
    channels = {"in_left": u[0], "in_right": u[1], "out_motor_left": rounded + start}
    channels["out_motor_right"] = COUNT * np.round(run.reading("motor_right") / COUNT)
    channels["out_encoder"] = run.reading("encoder") + rng.normal(0.0, 7e-6, time.size)
    channels["out_gyro"] = run.reading("gyro") + rng.normal(0.0, 1e-3, time.size)
    return Log(name, time, channels), {k: run.link(k) for k in ("left", "right")}


def prepared(rig, model, logs):
    balance = balance_of(rig, logs)
    assert balance.teeth == {"left": 2, "right": 1}
    balance = pushing(centred(balance, RigModel(rig)), RigModel(rig), logs)
    forces = [forces_of(model, balance, m) for m in balance.motions]
    return balance, forces


def test_one_side_tells_what_teeth_carry_while_they_push(rig):
    model = RigModel(rig)
    pairs = [log_of(model, "slow", 0.25), log_of(model, "fast", 0.5)]
    balance, forces = prepared(rig, model, [log for log, _ in pairs])
    for k, (motion, (_, carried)) in enumerate(zip(balance.motions, pairs, strict=True)):
        for name, true in carried.items():
            use = balance.counted[k][balance.teeth[name]]
            told, truth = motion.reduce(forces[k].carried[name]), motion.reduce(true)
            assert np.std((told - truth)[use]) < 0.1 * np.std(truth)
            flight = motion.reduce((np.abs(true) < 0.2).astype(float))  # the damping of the gap
            calm = motion.reduce(motion.calm[name])
            assert use.sum() > 0.1 * motion.moving.sum()
            weight = np.where(use, calm, 0.0) ** 2
            away = flight > 0.1
            assert weight[away].sum() / weight.sum() < (use & away).sum() / use.sum() / 3.0
            # they bounce after a reversal, and not for long
            assert calm[use & (flight > 0.5)].mean() < 0.4
            assert calm[use & (flight < 0.01)].mean() > 0.85
            flank = motion.reduce(motion.flank[name])
            rest = use & (flight < 0.1)
            np.testing.assert_allclose(flank[rest], np.sign(truth[rest]), atol=0.2)


def test_gaps_and_stiffness_are_found_from_wherever_encoders_start(rig):
    true = {"link.left.half_gap": 3.8e-3, "link.right.half_gap": 3.1e-3}
    stiff = {f"link.{s}.stiffness": 3.3e4 for s in ("left", "right")}
    model = RigModel(rig).with_values({**true, **stiff})
    logs = [log_of(model, n, f, s)[0] for n, f, s in (("a", 0.25, 0.0), ("b", 0.35, 40.0))]
    balance, _ = prepared(rig, model, logs)
    fit = fit_rig(State(RigModel(rig)), balance)
    for key, value in true.items():
        assert fit.values[key] == pytest.approx(value, rel=0.01)
    key = "link.left.stiffness"
    assert abs(fit.values[key] - 3.3e4) < 4.0 * fit.errors[key] < 8e3
    # friction of a pinion is told from its gap by what is declared alone
    error = fit.errors["body.pinion_left.coulomb_plus"]
    assert 0.2 < error / (0.06 * 2.5) < 1.05


def test_an_error_of_teeth_larger_than_the_gap_leaves_the_flank(rig):
    off = {"cosine": 5e-3, "sine": 3e-3}
    model = RigModel(rig)
    for side in ("left", "right"):
        model = model.with_effect(Placed("ring_gear_eccentricity", side, off))
    log, carried = log_of(model, "turn", 0.1)
    balance, _ = prepared(rig, model, [log])
    (motion,) = balance.motions
    for name, true in carried.items():
        use = balance.counted[0][balance.teeth[name]]
        assert use.sum() > 0.3 * motion.moving.sum()
        flank = motion.reduce(motion.flank[name])
        seen = np.sign(motion.reduce(true[motion.samples]))
        np.testing.assert_allclose(flank[use], seen[use], atol=0.2)


def test_sizes_are_those_of_the_own_body(rig):
    logs = [log_of(RigModel(rig), "a", 0.25)[0]]
    balance = balance_of(rig, logs)
    model, scales = RigModel(rig), scales_of(balance)
    frees = {f.label: f for f in free_parameters(model, balance, scales)}
    motor, ring = (
        scales.at(model, "motor_left", "motor_left"),
        scales.at(model, "ring_gear", "motor_left"),
    )
    assert motor.force == scales.force
    assert ring.force == pytest.approx(206.25 * scales.force)
    assert ring.speed == pytest.approx(scales.speed / 206.25)
    assert frees["body.ring_gear.stribeck_speed_plus"].scale < 10 * np.deg2rad(1.0)


def test_a_drive_that_starts_from_rest_does(rig):
    model = RigModel(rig)
    log, _ = log_of(model, "a", 0.25)
    speeds = initial(model, log)[1]
    assert abs(speeds["motor_left"]) < 2.0  # in the gap it gains 1 rad/s each millisecond
    time = log.time
    steady = {**log.channels, "out_motor_left": 50.0 * time, "out_motor_right": 50.0 * time}
    steady |= {"out_encoder": 50.0 / 206.25 * time, "out_gyro": 0 * time + 50.0 / 206.25}
    speeds = initial(model, Log("steady", time, steady))[1]
    assert speeds["motor_left"] == pytest.approx(50.0)
    assert speeds["ring_gear"] == pytest.approx(50.0 / 206.25)


@pytest.mark.parametrize("size", [0.3, 20.0])
def test_readings_on_a_grid_show_it_however_fast_they_move(rig, size):
    sensor = rig.sensors[-1]
    time = DT * np.arange(5000)
    turn = size * np.sin(1.3 * time) + 0.1 * size * np.sin(0.31 * time)
    rounded = np.round(COUNT * np.round(turn / COUNT), 5)  # five digits of a text file
    assert reading_variance(sensor, rounded) == pytest.approx(COUNT**2 / 12, rel=0.1)
    assert reading_variance(sensor, turn) < 0.01 * COUNT**2 / 12
    noisy = turn + np.random.default_rng(1).normal(0.0, COUNT, time.size)
    assert reading_variance(sensor, noisy) == pytest.approx(COUNT**2, rel=0.1)


@pytest.mark.filterwarnings("error")
def test_where_teeth_never_push_the_whole_alone_counts(rig):
    model = RigModel(rig)
    logs = [log_of(model, name, f)[0] for name, f in (("a", 0.25), ("b", 0.4))]
    balance, _ = prepared(rig, model, logs)
    bounce = [{k: np.ones_like(x) for k, x in m.loose.items()} for m in balance.motions]
    motions = [replace(m, loose=x, known={}) for m, x in zip(balance.motions, bounce, strict=True)]
    first, other = (replace(balance, motions=(m,), noises={}) for m in motions)
    evidence = RigEvidence(first, other, 1)
    base = evidence.base(State(model))
    assert base.fit.likelihood.rows[0] > 500
    assert not base.fit.likelihood.rows[1:].any()
    (found,) = evidence.candidates(base, ["cogging@motor_left"])
    assert np.isfinite([found.gain, found.error, found.held_error]).all()
    assert not found.acceptable


def test_a_hidden_body_behind_a_spring_is_simulated_beside_teeth():
    rig = parse_rig(
        """
[body.motor]
inertia = "2e-4 kg m^2"
viscous = "1e-4 N m s/rad"
coulomb = "0.02 N m"
[body.gear]
inertia = "2e-3 kg m^2"
viscous = "1e-3 N m s/rad"
[body.load]
inertia = "4e-3 kg m^2"
viscous = "2e-3 N m s/rad"
[mesh.teeth]
between = ["motor", "gear"]
ratio = 2
stiffness = "200 N m/rad"
damping = "0.02 N m s/rad"
half_gap = "0.01 rad"
[shaft.spring]
between = ["gear", "load"]
ratio = 1
stiffness = "20 N m/rad"
damping = "0.01 N m s/rad"
[input.drive]
column = "u"
body = "motor"
gain = "1 N m/V"
unit = "V"
[sensor.motor]
column = "q1"
unit = "rad"
body = "motor"
[sensor.gear]
column = "q2"
unit = "rad"
body = "gear"
"""
    )
    model, time = RigModel(rig), DT * np.arange(8000)
    u = 0.3 * np.sin(2 * np.pi * 0.5 * time) + 0.1 * np.sin(2 * np.pi * 3.1 * time)
    run = march(model, u[None], DT)
    seen = {f"out_{name}": run.reading(name) for name in ("motor", "gear")}
    log = Log("a", time, {"in_drive": u, **seen})
    balance = balance_of(rig, [log])
    assert balance.teeth == {"teeth": 1}
    balance = pushing(centred(balance, model), model, [log])
    (motion,), (counted,) = balance.motions, balance.counted
    left, drive = residual(model, balance, motion)
    assert counted[0].sum() > 50
    assert counted[1].sum() > 20
    assert np.std(left[0][counted[0]]) < 0.03 * np.std(drive)
    soft = model.with_values({"link.spring.stiffness": 5.0})
    worse, _ = residual(soft, balance, motion)
    assert np.std(worse[0][counted[0]]) > 3.0 * np.std(left[0][counted[0]])


JOINT = """
name = "joint"
[body.motor]
inertia = "1.4e-4 kg m^2 ± 20 %"
viscous = "8e-4 N m s/rad ± 30 %"
coulomb = "6.5e-3 N m ± 30 %"
[body.table]
inertia = "0.165 kg m^2 ± 20 %"
viscous = "unknown"
[shaft.gear]
between = ["motor", "table"]
ratio = 35
stiffness = "unknown"
damping = "unknown"
half_gap = "0.02 rad ± 50 %"
[input.drive]
column = "u"
unit = "N m"
body = "motor"
gain = 1.0
[sensor.motor]
column = "q"
unit = "rad"
body = "motor"
resolution = "1.53398e-3 rad"
absolute = true
[sensor.table]
column = "p"
unit = "rad"
body = "table"
resolution = "9.6e-5 rad"
absolute = true
"""
SIZES = {
    "body.motor.inertia": 1.43e-4, "body.table.inertia": 0.16, "body.table.viscous": 0.44,
    "link.gear.stiffness": 10.0, "link.gear.damping": 3e-3, "link.gear.half_gap": 0.0194,
}  # fmt: skip


@pytest.fixture(scope="module")
def joint():
    """A geared joint with a coarse encoder on its motor: a count is 8 % of the half-gap."""
    return parse_rig(JOINT)


def joint_log(model: RigModel, name: str, wave: np.ndarray) -> Log:
    run = march(model, 0.04 * wave[None], DT)
    counts = {"motor": 1.53398e-3, "table": 9.6e-5}
    read = {f"out_{k}": c * np.round(run.reading(k) / c) for k, c in counts.items()}
    return Log(name, DT * np.arange(wave.size), {"in_drive": 0.04 * wave, **read})


def joint_logs(rig, effects):
    """Logs of the true joint, and their balance with teeth in contact by the declared model."""
    true = RigModel(rig, effects=effects).with_values(SIZES)
    time = DT * np.arange(8000)
    ramp = np.abs(2.0 * ((0.4 * time) % 1.0) - 1.0) * 2.0 - 1.0
    waves = {"steps": np.sign(np.sin(np.pi * time)), "trap": np.clip(2.0 * ramp, -0.8, 0.8)}
    waves["sine"] = np.sin(np.pi * time) + 0.4 * np.sin(7.0 * time)
    logs = [joint_log(true, *one) for one in waves.items()]
    balance = balance_of(rig, logs)
    assert balance.teeth == {"gear": 1}
    start = rough_start(RigModel(rig), balance)
    for _ in range(2):
        balance = in_contact(balance, start, logs)
        start = fit_rig(State(start), balance).model
    return logs, balance, start


def joint_fit(rig, effects):
    """The declared model with effects, fitted to logs of the true one."""
    _, balance, start = joint_logs(rig, effects)
    fit = fit_rig(State(replace(start, effects=effects)), balance, iterations=20)
    like = fit.likelihood.knowing(fit.model, fit.left)
    return fit_rig(fit.state, balance, iterations=20, like=like)


def test_a_count_as_large_as_the_wind_up_leaves_an_unknown_stiffness(joint):
    fit = joint_fit(joint, ())
    assert fit.values["link.gear.half_gap"] == pytest.approx(0.0194, rel=0.01)
    assert fit.values["link.gear.stiffness"] == pytest.approx(10.0, rel=0.15)
    for key in ("body.motor.inertia", "body.table.inertia"):
        assert fit.values[key] == pytest.approx(SIZES[key], rel=0.03)


RUBS = Placed("load_dependent_friction", "motor", {"coefficient": 0.16})


def test_noise_of_a_load_makes_friction_under_it_no_smaller(joint):
    fit = joint_fit(joint, (RUBS,))
    key = f"{RUBS.key}.coefficient"
    assert abs(fit.values[key] - 0.16) < 3.0 * fit.errors[key] < 0.04


def test_noise_of_a_load_is_what_more_noise_adds(joint):
    """Twice the readings' noise, against the variance that one such noise is said to give."""
    logs, balance, start = joint_logs(joint, (RUBS,))
    rubbing = replace(start.with_values(SIZES), effects=(RUBS,))
    rng, found = np.random.default_rng(5), {}
    for model in (rubbing, replace(rubbing, effects=())):
        before, _ = residuals(State(model), balance)
        variances = []
        for _ in range(8):
            again = noisier(balance, logs, rng)
            pairs = zip(again.motions, balance.motions, strict=True)
            marks = ("loose", "flank", "calm", "zero")
            same = [replace(a, **{k: getattr(b, k) for k in marks}) for a, b in pairs]
            after, _ = residuals(State(model), replace(again, motions=tuple(same)))
            rows = zip(after, before, balance.counted, strict=True)
            variances += [[np.var((a - b)[e, use[e]]) for e in (0, 1)] for a, b, use in rows]
        seen = np.mean(variances, axis=0)
        told = [float(noise @ noise) for noise in noise_in_balance(model, balance)]
        np.testing.assert_allclose(told, seen, rtol=0.25)
        found[bool(model.effects)] = told[0]
    assert found[True] > 1.1 * found[False]


def test_an_effect_that_turns_the_teeth_over_is_asked_for_their_flanks(joint):
    pulls = Placed("unbalance", "table", {"cosine": -0.42, "sine": -0.03})
    logs, balance, start = joint_logs(joint, (pulls,))
    true = RigModel(joint, effects=(pulls,)).with_values(SIZES)
    evidence = RigEvidence(balance, balance, 1, logs)
    state = evidence.closed(evidence.base(State(replace(start, effects=(pulls,)))))
    wrong = []
    for one in (balance, state.logs):
        off = []
        for log, motion in zip(logs, one.motions, strict=True):
            torque = march(true, log["in_drive"][None], DT).link("gear")
            use = (motion.loose["gear"] < 0.5) & (np.abs(torque) > 1e-3)
            off.append(np.sign(torque[use]) != motion.flank["gear"][use])
        wrong.append(np.mean(np.concatenate(off)))
    assert wrong[0] > 0.05
    assert wrong[1] < 0.01
    assert state.fit.values["link.gear.stiffness"] == pytest.approx(10.0, rel=0.3)


def test_a_spring_ends_where_samples_show_no_faster_motion(joint):
    _, balance, start = joint_logs(joint, ())
    frees = {f.label: f for f in free_parameters(start, balance, scales_of(balance))}
    near, far = (start.value(f"body.{b}.inertia") for b in ("motor", "table"))
    far /= 35.0**2
    reduced = near * far / (near + far)
    assert np.sqrt(frees["link.gear.stiffness"].high / reduced) == pytest.approx(np.pi / DT)
    assert frees["link.gear.damping"].high / reduced == pytest.approx(np.pi / DT)


def test_a_load_is_that_of_a_side_where_a_twist_is_coarse():
    """A count of the twist winds the spring up by more than the load does."""
    rig = parse_rig(JOINT.replace('half_gap = "0.02 rad ± 50 %"\n', ""))
    sizes = {k: v for k, v in SIZES.items() if "half_gap" not in k}
    true = RigModel(rig, effects=(RUBS,)).with_values(sizes)
    time = DT * np.arange(8000)
    log = joint_log(true, "sine", np.sin(np.pi * time) + 0.4 * np.sin(7.0 * time))
    balance = balance_of(rig, [log])
    (motion,) = balance.motions
    (left,), _ = residuals(State(true), balance)
    noise = noise_in_balance(true, balance)[0]
    assert np.std(left[0, motion.moving]) < 1.15 * np.sqrt(noise @ noise)
