"""Evidence for drives by rig.toml, on small machines that are simulated by other means."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from tests.export.test_plant import RIG
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.html import error_rows
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig, explaining, split
from dmptm_ctrl.diagnosis.rig_evidence import RigEvidence
from dmptm_ctrl.diagnosis.rig_objections import _harmonic, objection
from dmptm_ctrl.diagnosis.sensors import put_right, sensor_faults
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.compared_signals import correlation_length
from dmptm_ctrl.identify.gap_search import friction_shared
from dmptm_ctrl.identify.inverse_dynamics import balance_of
from dmptm_ctrl.identify.likelihood import Likelihood
from dmptm_ctrl.identify.rig_fit import fit_rig, residuals
from dmptm_ctrl.identify.rig_start import rough_start
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

SMALL = {"seconds": 4.0, "dt": 2e-3, "kinds": (("steps", 6.0), ("sine", 5.0), ("chirp", 4.0))}


def logs_of(bench, rig, change=lambda name, y: y):
    channels = {i.column: i.channel for i in rig.inputs} | {
        s.column: s.channel for s in rig.sensors
    }
    return [
        Log(name, columns["t"], {channels[k]: change(k, v) for k, v in columns.items() if k != "t"})
        for name, columns in bench.logs().items()
    ]


def prepared(bench):
    rig = parse_rig(bench.rig(), "rig.toml")
    logs, held, _, _ = split(rig, balance_of(rig, logs_of(bench, rig)))
    evidence = RigEvidence(logs, held, 1)
    return evidence, evidence.base(State(rough_start(RigModel(rig), logs)))


@pytest.fixture(scope="module")
def rubbing():
    return prepared(Bench(Machine(fc=0.03), **SMALL))


def test_what_is_missing_has_more_evidence_than_the_level(rubbing):
    evidence, base = rubbing
    found = {c.keys[0]: c for c in evidence.candidates(base)}
    friction = found["coulomb_friction@motor"]
    assert friction.acceptable
    assert friction.evidence > 10 * LEVEL
    assert friction.evidence == max(c.evidence for c in found.values() if c.acceptable)


def test_an_effect_is_taken_out_again_at_the_cost_of_putting_it_in(rubbing):
    evidence, base = rubbing
    (friction,) = evidence.candidates(base, ["coulomb_friction@motor"])
    state = evidence.adopt(base, friction)
    back = evidence.without(state, "coulomb_friction@motor")
    assert back.keys == ()
    assert back.fit.loss == pytest.approx(base.fit.loss, abs=1.0)
    # to second order, the square in standard errors is the evidence; no block is far from normal
    assert evidence.wald(state, "coulomb_friction@motor") > LEVEL
    assert state.fit.errors["coulomb_friction@motor.level"] < 1e-3


@dataclass(frozen=True, eq=False)
class Held:
    """A model as predictions ask for it."""

    held_state: State
    keys: tuple[str, ...]
    fit: Any = None


def test_predictions_explain_friction_and_no_delay(rubbing):
    evidence, base = rubbing
    (friction,) = evidence.candidates(base, ["coulomb_friction@motor"])
    state = evidence.adopt(base, friction)
    held, rig = state.held_state, state.fit.model.rig
    delay = Placed("drive_delay", rig.inputs[0].name, {"delay": 0.02})
    late = Held(
        State(held.model.with_effect(delay), held.logs), (*state.keys, delay.key), state.fit
    )
    logs = logs_of(Bench(Machine(fc=0.03), **SMALL), rig)
    explains = explaining(rig, logs, evidence.held, lambda state: state, 1)
    assert explains(base, state)  # it explains what they miss without it
    assert not explains(state, late)


@pytest.mark.long
def test_a_wrong_inertia_is_in_the_sentence():
    bench = Bench(Machine(), **SMALL)
    right = parse_rig(bench.rig(), "rig.toml")
    declared = right.body("motor").inertia
    low = f'inertia = "{0.5 * declared.value:g} kg m^2 ± 5 %"'
    rig = parse_rig(re.sub(r'inertia = ".*"', low, bench.rig(), count=1), "rig.toml")
    found = diagnose_rig(logs_of(bench, rig), rig, jobs=1)
    assert found.effects == ()
    # as it is declared the model is wrong, and "none" is said of that model
    assert found.verdict == "unknown"
    assert found.error["before"]["torque"]["rmse"] > 2.0 * found.error["after"]["torque"]["rmse"]
    assert "leave their declared ranges: body.motor.inertia" in found.sentence()


def test_a_value_does_not_leave_its_range_for_what_an_effect_does():
    """A dead band of the amplifier takes as much torque as the friction."""
    bench = Bench(Machine(fc=0.03, dead=0.6), **SMALL)
    text = bench.rig().replace("viscous =", 'coulomb = "0.03 N m ± 5 %"\nviscous =')
    rig = parse_rig(text, "rig.toml")
    logs, held, _, _ = split(rig, balance_of(rig, logs_of(bench, rig)))
    evidence = RigEvidence(logs, held, 1)
    base = evidence.base(State(rough_start(RigModel(rig, ranged=True), logs)))
    loose = evidence.free(base)
    (kept, free) = (one.fit.model.value("body.motor.coulomb") for one in (base, loose))
    assert kept <= 0.03 * 1.05 < free
    for one in (base, loose):
        (band,) = evidence.candidates(one, ["drive_dead_band@drive"])
        assert band.acceptable
        assert band.evidence > 10.0 * sum(evidence.gains(base, loose))
    found = diagnose_rig(logs_of(bench, rig), rig, jobs=1)
    assert [e.name for e in found.effects] == ["drive_dead_band"]
    assert not found.declared_values["body.motor.coulomb"]["outside"]


@pytest.mark.long
def test_a_sensor_with_play_is_not_none():
    """A motor's encoder that slips by far more than the gear winds up: no spring fits."""
    machine = Machine(
        gain=0.01, emf=0.0, j1=1.3e-4, j2=0.1, ratio=36.0, k=30.0, c=2e-3, fc=6e-3, b1=3e-4, b2=0.1,
        bristle=1e-3,
    )  # fmt: skip
    kinds = (("steps", 6.0), ("sine", 4.0), ("steps", 5.0))
    bench = Bench(machine, kinds, 8.0, 2e-3, counts=4096, sensors=("position", "position2"))
    text = bench.rig().replace('inertia = "unknown"', 'inertia = "0.1 kg m^2 ± 20 %"')
    text = text.replace("viscous =", 'coulomb = "6e-3 N m ± 30 %"\nviscous =', 1)
    rig = parse_rig(text, "rig.toml")

    def read(name, y):  # the sensor of the motor follows it with a play of 0.15 rad
        if name != "q":
            return y
        out = np.empty_like(y)
        last = y[0]
        for k, x in enumerate(y):
            last = out[k] = min(max(last, x - 0.15), x + 0.15)
        return out

    found = diagnose_rig(logs_of(bench, rig, read), rig, jobs=1)
    assert found.verdict == "unknown"
    torn = found.declared_values["link.coupling.stiffness"]["fitted"] < 0.1
    assert torn == any("no stiffness fits" in w for w in found.warnings)


@pytest.mark.parametrize("share", [0.5, 0.2])
def test_friction_beyond_a_gap_is_a_share_of_all(share):
    text = re.sub('(viscous|coulomb) = ".*"', r'\1 = "unknown"', RIG)  # the load turns 5 times less
    own = {"body.motor.coulomb": 3.0, "body.load.coulomb": 10.0}
    own |= {"body.motor.viscous": 2.0, "body.load.viscous": 100.0}
    model = RigModel(parse_rig(text, "rig.toml")).with_values(own)
    coulomb, viscous = (friction_shared(model, "belt", k, share) for k in ("coulomb", "viscous"))
    # seen at the motor: 3 + 10/5 = 5, 2 + 100/5² = 6
    assert coulomb == pytest.approx(
        {"body.motor.coulomb": (1 - share) * 5.0, "body.load.coulomb": share * 5.0 * 5.0}
    )
    assert viscous == pytest.approx(
        {"body.motor.viscous": (1 - share) * 6.0, "body.load.viscous": share * 6.0 * 25.0}
    )


def test_share_is_what_the_effect_changes(rubbing):
    evidence, base = rubbing
    (friction,) = evidence.candidates(base, ["coulomb_friction@motor"])
    state = evidence.adopt(base, friction)
    share = evidence.share(base, state, "coulomb_friction@motor")
    alike = share @ base.target / (np.linalg.norm(share) * np.linalg.norm(base.target))
    assert abs(alike) > 0.9


def test_loss_is_that_of_a_normal_distribution(rubbing):
    evidence, base = rubbing
    likelihood = Likelihood(evidence.logs, np.array([0.5]))
    left, _ = residuals(base.fit.state, evidence.logs)
    expected = 0.0
    for part, use in zip(left, evidence.logs.counted, strict=True):
        rows = part[0][use[0]]
        s = np.hypot(np.sqrt(np.mean(rows**2)), likelihood.floor)
        expected += 0.5 * np.sum(2 * np.log(s) + (rows / s) ** 2)
    assert likelihood.surprise(left, base.fit.model) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8])
def test_independent_rows_of_a_correlated_series(rho):
    """AR(1): (1 + ρ)/(1 − ρ) rows count as one."""
    noise = np.random.default_rng(1).normal(size=40_000)
    x = np.empty_like(noise)
    x[0] = noise[0]
    for k in range(1, x.size):
        x[k] = rho * x[k - 1] + noise[k]
    assert correlation_length(x) == pytest.approx((1 + rho) / (1 - rho), rel=0.1)


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        (Placed("cable_spring", "motor", {"stiffness": 0.0, "offset": 0.01}), "standard errors"),
        (Placed("drive_delay", "drive", {"delay": 1e-5}), "tenth of a sample"),
        (Placed("base_vibration", "motor", {"cosine": 0.0, "sine": 1.0, "frequency": 0.5}), "few"),
    ],
)
def test_objections(rubbing, effect, words):
    evidence, base = rubbing
    state = State(base.fit.model.with_effect(effect))
    fit = fit_rig(state, evidence.logs, iterations=0)
    if effect.name == "cable_spring":
        assert words in objection(effect.key, fit, base.fit)
    else:
        firm = fit.covariance * 1e-12  # as if it were certain
        object.__setattr__(fit, "covariance", firm)
        assert words in objection(effect.key, fit, base.fit)


def test_a_vibration_at_a_harmonic_of_the_input_is_the_input():
    bench = Bench(Machine(), kinds=(("sine", 5.0),), seconds=12.0, dt=2e-3)
    evidence, base = prepared(bench)
    for frequency, own in ((1.5, True), (1.72, False)):  # the sine has 0.5 Hz
        effect = Placed(
            "base_vibration", "motor", {"cosine": 1.0, "sine": 1.0, "frequency": frequency}
        )
        fit = fit_rig(State(base.fit.model.with_effect(effect)), evidence.logs, iterations=0)
        object.__setattr__(fit, "covariance", fit.covariance * 1e-12)
        assert ("harmonic" in objection(effect.key, fit, base.fit)) == own


def test_a_vibration_is_not_the_input_because_a_slow_one_has_harmonics_everywhere():
    """Of a wave as long as the log, every frequency is a harmonic, within what the log tells."""
    dt = 2e-3
    time = dt * np.arange(5000)
    slow = np.sign(np.sin(2.0 * np.pi * time / 10.0))
    assert _harmonic(0.3, 0.0, slow, dt)
    # by chance alone within three standard errors of a multiple: 6 %
    assert np.mean([_harmonic(f, 1e-3, slow, dt) for f in np.arange(1.5, 30.0, 0.37)]) < 0.15


def test_a_vibration_exactly_at_a_high_harmonic_is_the_input():
    """The 31st of 2 Hz: teeth at which each cycle turns round. Beside it, it is a vibration."""
    dt = 1e-3
    wave = 0.4 * np.sin(2.0 * np.pi * 2.0 * dt * np.arange(13_500) + 0.3)
    assert _harmonic(62.0018, 0.0026, wave, dt)
    assert not _harmonic(62.3, 0.0026, wave, dt)
    assert not _harmonic(62.02, 0.0026, wave, dt)
    assert not _harmonic(62.0, 0.0026, np.full(13_500, 0.4), dt)


@pytest.mark.parametrize(("level", "pushes"), [(0.0, True), (0.01, True), (0.06, False)])
def test_friction_that_would_push_is_impossible(level, pushes):
    """Friction of 0.05 cos θ N·m beside a constant one, over a part of a turn where it brakes."""
    bench = Bench(Machine(), **SMALL)
    evidence, base = prepared(bench)
    body = base.fit.model.layout.bodies[0]
    model = base.fit.model
    if level:
        model = model.with_effect(Placed("coulomb_friction", body, {"level": level}))
    effect = Placed(
        "position_dependent_friction", body, {"cosine": 0.05, "sine": 0.0, "order": 1.0}
    )
    fit = fit_rig(State(model.with_effect(effect)), evidence.logs, iterations=0)
    object.__setattr__(fit, "covariance", fit.covariance * 1e-12)  # as if it were certain
    assert ("push" in objection(effect.key, fit, base.fit)) == pushes


def test_sensors_of_one_motion_are_judged_before_any_dynamics():
    bench = Bench(Machine(), sensors=("speed", "position"), counts=65536, **SMALL)
    rig = parse_rig(bench.rig(), "rig.toml")
    assert not sensor_faults(rig, logs_of(bench, rig))
    wrong = logs_of(bench, rig, lambda k, y: 1.03 * y if k == "w" else y)
    (fault,) = sensor_faults(rig, wrong)
    assert fault.placed.key == "sensor_gain@speed"
    assert fault.placed.values["error"] == pytest.approx(0.03, abs=3e-3)
    right = put_right(rig, wrong[0], [fault.placed])
    assert np.std(right["out_speed"]) == pytest.approx(
        np.std(wrong[0]["out_speed"]) / 1.03, rel=3e-3
    )


def test_two_effects_and_their_budget():
    bench = Bench(Machine(fc=0.03, offset=0.6), **SMALL)
    rig = parse_rig(bench.rig(), "rig.toml")
    found = diagnose_rig(logs_of(bench, rig), rig, jobs=1)
    assert {e.name for e in found.effects} == {"coulomb_friction", "drive_offset"}
    content = found.to_dict()
    assert content["schema"] == 2
    assert found.verdict == "explained"
    shares = [row["share"] for row in content["budget"]]
    assert sum(shares) == pytest.approx(1.0, abs=0.02)
    assert [row["name"] for row in content["budget"][-2:]] == ["not explained", "floor"]
    offset = next(e for e in found.effects if e.name == "drive_offset")
    assert offset.parameters["offset"]["value"] == pytest.approx(0.6, rel=0.05)  # V
    assert "coulomb friction" in found.sentence()
    # whose speed an error is, where a drive has several
    speed = found.error["after"]["speed"]
    assert f"{speed['unit']} of {speed['sensor']} (fit" in found.summary()
    assert error_rows(found.error)[0]["name"].startswith(f"free run of {speed['sensor']}, below")


def test_nothing_is_named_where_nothing_is_missing():
    bench = Bench(Machine(), **SMALL)
    rig = parse_rig(bench.rig(), "rig.toml")
    found = diagnose_rig(logs_of(bench, rig), rig, jobs=1)
    assert found.verdict == "none"
    assert not found.effects
    assert found.error["before"]["rmse"] <= 1.5 * found.error["floor"]["rmse"]
    assert found.error["before"]["speed"] == found.error["after"]["speed"]
    assert not found.depends_on


def test_what_is_on_no_list_is_unknown_with_its_variable():
    """A torque by the speed that no effect has: a resonance of the mounting, say."""
    bench = Bench(Machine(), **SMALL)
    rig = parse_rig(bench.rig(), "rig.toml")
    logs = []
    for log in logs_of(bench, rig):
        speed = log["out_speed"]
        extra = 1.5 * np.exp(-(((np.abs(speed) - 60) / 15) ** 2))  # V, one way always
        channels = {**log.channels, "in_drive": log["in_drive"] + extra}
        logs.append(Log(log.name, log.time, channels))
    found = diagnose_rig(logs, rig, jobs=1)
    assert found.verdict == "unknown"
    assert "omega:motor" in found.depends_on
    assert "nothing is missing" not in found.summary()


def test_every_effect_can_be_fitted(rubbing):
    evidence, base = rubbing
    (friction,) = evidence.candidates(base, ["coulomb_friction@motor"])
    state = evidence.adopt(base, friction)
    for trial in state.trials:
        fit = fit_rig(trial.placed_in(state.fit.state), evidence.logs, iterations=1, jobs=1)
        assert all(np.isfinite(part).all() for part in fit.derivatives), trial.key
        assert np.isfinite([fit.state.get(f) for f in fit.frees]).all(), trial.key


def test_friction_that_falls_while_the_drive_runs_is_named():
    bench = Bench(Machine(fc=0.05, emf=0.0, b1=0.002), **SMALL)
    rig = parse_rig(bench.rig(), "rig.toml")
    cold = [Log(log.name, log.time, warmed(bench.machine, rig, log)) for log in logs_of(bench, rig)]
    found = diagnose_rig(cold, rig, jobs=1)
    assert {e.name for e in found.effects} >= {"coulomb_friction", "thermal_drift"}
    (drift,) = (e for e in found.effects if e.name == "thermal_drift")
    assert drift.parameters["rise"]["value"] == pytest.approx(0.6, rel=0.1)
    assert drift.parameters["time_constant"]["value"] == pytest.approx(2.0, rel=0.15)


def warmed(machine, rig, log):
    """Add what friction takes that is larger by 0.6 exp(−t/2 s), as torque that the drive gives."""
    (source,) = rig.inputs
    (sensor,) = rig.sensors
    speed = log[sensor.channel]
    friction = machine.fc * np.sign(speed) + machine.b1 * speed
    more = 0.6 * np.exp(-log.time / 2.0) * friction
    return {**log.channels, source.channel: log[source.channel] + more / source.gain.value}


def test_a_late_sensor_is_the_sentence():
    """The balance of mended readings lacks nothing; that is not said to be small effects."""
    bench = Bench(Machine(fc=0.02, emf=0.0), **SMALL, counts=65536, sensors=("position", "speed"))
    text = bench.rig().replace("viscous =", 'coulomb = "unknown"\nviscous =')
    rig = parse_rig(text, "rig.toml")
    late = {"w": 3}  # samples

    def read(name, y):
        return np.concatenate([np.full(k, y[0]), y[:-k]]) if (k := late.get(name)) else y

    said = diagnose_rig(logs_of(bench, rig, read), rig, jobs=1)
    assert said.sentence().startswith("Sensors of one motion disagree: sensor delay of speed;")
    (effect,) = said.effects
    assert effect.parameters["delay"]["value"] == pytest.approx(3 * bench.dt, rel=0.02)
