"""Friction at a place of the turn: a bump is a local spot, a stretch with edges is none."""

from dataclasses import replace

import numpy as np
import pytest
from tests.diagnosis.test_rig_evidence import logs_of, prepared
from tests.rig_files.truth import Bench, Machine

from dmptm_ctrl.diagnosis.other_forms import other_form, stretch
from dmptm_ctrl.diagnosis.rig_diagnose import diagnose_rig
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.rig_model import Placed

TURNING = Machine(b1=5e-3, spot=0.02, place=2.0, half=0.4)
EDGED = replace(TURNING, form=60.0)
SLOW = (("sine", 1.5), ("steps", 1.8), ("multisine", 1.5))


def bench(machine):
    return Bench(machine, SLOW, 20.0, 2e-3)


@pytest.fixture(scope="module", params=[TURNING, EDGED], ids=["bump", "edges"])
def state(request):
    return request.param, prepared(bench(request.param))[1]


def test_a_stretch_is_where_friction_is_more(state):
    machine, base = state
    inside = stretch(base.tangent, "motor")
    theta = np.linspace(0.0, 4.0 * np.pi, 4001)
    found = theta[inside(theta) > 0.0]
    away = (found - machine.place + np.pi) % (2.0 * np.pi) - np.pi
    assert np.mean(away) == pytest.approx(0.0, abs=0.1)
    if machine is EDGED:
        assert np.abs(away).max() == pytest.approx(machine.half, rel=0.1)


def test_the_form_tells_a_spot_from_a_stretch(state):
    machine, base = state
    size = {"height": machine.spot, "place": machine.place, "width": machine.half}
    said = other_form(Placed("local_spot", "motor", size), base.fit)
    assert bool(said) == (machine is EDGED)


@pytest.mark.long
def test_edges_are_unknown_over_the_angle():
    own = bench(EDGED)
    rig = parse_rig(own.rig(), "rig.toml")
    found = diagnose_rig(logs_of(own, rig), rig, jobs=1)
    assert found.verdict == "unknown"
    assert "theta:motor" in found.depends_on
    assert not any(e.name == "local_spot" for e in found.effects)


@pytest.mark.long
def test_a_bump_is_named():
    own = bench(TURNING)
    rig = parse_rig(own.rig(), "rig.toml")
    found = diagnose_rig(logs_of(own, rig), rig, jobs=1)
    assert "local_spot" in [e.name for e in found.effects]
