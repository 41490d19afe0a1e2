"""What each part of a compensation gains on a machine of another program."""

from dataclasses import replace

import numpy as np
import pytest
from tests.rig_files.truth import Bench, Machine, integrate

from dmptm_ctrl.design.compensation import parts_of, without_part
from dmptm_ctrl.design.controller import Controller
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.rig_model import Placed, RigModel

DT, FINE, COUNT = 1e-3, 50, 2 * np.pi / 65536  # s, steps per sample, rad
TRUTH = Machine(
    b1=4e-4, fc=0.03, fs=0.03, cog=0.01, order=7.0, unb=0.02, delay=3e-3, emf=0.0, dead=0.1
)
OFF = 1.05  # the model's numbers over the machine's
EFFECTS = (
    Placed("coulomb_friction", "motor", {"level": OFF * TRUTH.fc}),
    Placed("cogging", "motor", {"cosine": OFF * TRUTH.cog, "sine": 0.0, "order": TRUTH.order}),
    Placed("unbalance", "motor", {"cosine": OFF * TRUTH.unb, "sine": 0.0}),
    Placed("drive_delay", "drive", {"delay": OFF * TRUTH.delay}),
    Placed("drive_dead_band", "drive", {"width": OFF * TRUTH.dead}),
)
TARGET = 6.0 * np.sin(2 * np.pi * 0.7 * DT * np.arange(3000))  # rad/s
PLAIN = {"limit": 12.0, "acceleration": 100.0}
KP, KI = 0.2, 4.0  # V/(rad/s), V/rad


def model_of(effects):
    rig = parse_rig(Bench(TRUTH, sensors=("position",)).rig(), "rig.toml")
    numbers = {"body.motor.inertia": OFF * TRUTH.j1, "body.motor.viscous": OFF * TRUTH.b1}
    return RigModel(rig, effects, numbers)


def error(controller, reading=lambda q: q):
    """RMS of the machine's true speed error after the first second [rad/s]."""
    step, state, row = controller.law().stepper(DT), TRUTH.at(), TRUTH.row()
    held, miss = np.zeros(round(TRUTH.delay / DT) + 1), np.empty(TARGET.size)
    row = replace(TRUTH, delay=0.0).row()
    for k, wanted in enumerate(TARGET):
        miss[k] = state[1] - wanted
        (u,) = step(wanted, COUNT * np.round(reading(state[0]) / COUNT))
        held = np.append(held[1:], u)
        integrate(held[:1], DT, FINE, row, state, 1.0)
    return float(np.sqrt(np.mean(miss[1000:] ** 2)))


@pytest.fixture(scope="module")
def full():
    return Controller(
        KP, KI, **PLAIN, inertia=1.0, friction=1.0, effects=1.0, invert=True,
        model=model_of(EFFECTS), lead=OFF * TRUTH.delay + 0.5 * DT, late=0.5 * DT,
    )  # fmt: skip


@pytest.mark.long
def test_each_part_pays_on_the_machine(full):
    """The model is off by 5 %: all of it takes off more than two fifths, and each part some."""
    plain = Controller(KP, KI, **PLAIN, model=model_of(()))
    best = error(full)
    assert best < 0.6 * error(plain)
    left_out = {part: error(without_part(full, part)) for part in parts_of(full)}
    # the dead time is in the look-ahead; the feed-forward of the model has no use for it
    assert left_out.pop("drive_delay@drive") == best
    assert set(left_out) == {
        "inertia", "friction", "look-ahead", "inverse of the drive", "coulomb_friction@motor",
        "cogging@motor", "unbalance@motor", "drive_dead_band@drive",
    }  # fmt: skip
    assert min(left_out.values()) > 1.1 * best


def test_a_wrong_reading_of_the_angle_is_put_right(full):
    """Of an encoder that sits 0.05 rad off its axis, a wave of the speed it shows."""

    def wrong(q):
        return q + 0.05 * np.cos(q)

    eccentric = Placed("encoder_eccentricity", "position", {"cosine": OFF * 0.05, "sine": 0.0})
    own = replace(full, model=full.model.with_effect(eccentric))
    assert error(own, wrong) < 0.6 * error(full, wrong)
