"""Gains over frequency beside a compliance: those of free runs are the closed form's."""

from types import SimpleNamespace

import numpy as np
from scipy.signal import chirp

from dmptm_ctrl.diagnosis.rig_runs import Runs
from dmptm_ctrl.diagnosis.rig_spectrum import spectrum, spectrum_uri
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.identify.state import State
from dmptm_ctrl.signals import Log
from dmptm_ctrl.simulate.rig_model import RigModel
from dmptm_ctrl.simulate.rig_run import march

J1, J2, K, D, B = 0.002, 0.004, 20.0, 0.01, 0.02
DT, N = 1e-3, 20_000
RIG = f"""
name = "two inertias"
[body.motor]
inertia = {J1}
viscous = {B}
[body.load]
inertia = {J2}
[shaft.coupling]
between = ["motor", "load"]
stiffness = {{stiffness}}
damping = {D}
[input.drive]
column = "u_V"
unit = "V"
body = "motor"
gain = "0.5 N m/V"
[sensor.speed]
column = "w_rpm"
unit = "rpm"
body = "motor"
"""
MARKS = {"antiresonance": np.sqrt(K / J2) / (2 * np.pi),
         "resonance": np.sqrt(K / J1 + K / J2) / (2 * np.pi)}  # fmt: skip


def source(time, u):
    """What the picture asks of a diagnosis: a rig, a log of it, and a model that is too soft."""
    rig, soft = (parse_rig(RIG.format(stiffness=k), "rig.toml") for k in (K, 0.5 * K))
    model = RigModel(rig)
    seen = march(model, u[None], DT, substeps=8).reading("speed")
    (sensor,), (drive,) = rig.sensors, rig.inputs
    log = Log("chirp", time, {drive.channel: u, sensor.channel: seen})
    states = (SimpleNamespace(held_state=State(RigModel(r))) for r in (soft, rig))
    return SimpleNamespace(
        rig=rig,
        runs=Runs(0.0, sensor, 30.0, (log,), (), None, None, 0.0, 1),
        selection=SimpleNamespace(**dict(zip(("base", "final"), states, strict=True))),
    )


def closed_form(hz):
    """Speed of the motor in rpm per volt."""
    s = 2j * np.pi * hz
    spring = D + K / s
    load = spring * J2 * s / (spring + J2 * s)  # what the motor turns behind the spring
    return np.abs(0.5 / (J1 * s + B + load)) * 30.0 / np.pi


def test_gains_are_those_of_the_closed_form():
    time = DT * np.arange(N)
    found = spectrum(source(time, chirp(time, 2.0, time[-1], 60.0)), MARKS)
    hz, measured = found.curves["measured"]
    assert hz[0] < MARKS["antiresonance"] < MARKS["resonance"] < hz[-1]
    apart = np.abs(np.log(measured / closed_form(hz)))
    assert np.median(apart) < 0.02
    after = np.interp(hz, *found.curves["after"])
    np.testing.assert_allclose(after, measured, rtol=0.02)
    assert found.quantity == "speed over drive [rpm/V]"
    soft_hz, soft = found.curves["before"]
    near = soft_hz < 1.2 * MARKS["antiresonance"]
    assert soft_hz[near][np.argmin(soft[near])] < 0.8 * MARKS["antiresonance"]
    assert spectrum_uri(found).startswith("data:image")


def test_a_log_that_excites_little_has_no_curve():
    time = DT * np.arange(N)
    assert spectrum(source(time, np.sin(2 * np.pi * 1.0 * time)), MARKS) is None
