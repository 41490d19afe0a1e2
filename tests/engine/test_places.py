"""Every effect at every place where it may stand: it acts, and all runs of it agree."""

import numpy as np
import pytest

from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.simulate.many import Common, run_many
from dmptm_ctrl.simulate.placed_effects import PLACED_CATALOGUE
from dmptm_ctrl.simulate.reference import run_exactly
from dmptm_ctrl.simulate.rig_model import Placed, RigModel
from dmptm_ctrl.simulate.rig_run import march

DT, SUBSTEPS = 1e-3, 256
TIME = DT * np.arange(181)
SEEN = "reading0", "reading1", "torque0"
U = (1.4 * np.sin(2 * np.pi * 7.0 * TIME) + 0.2 * np.sin(2 * np.pi * 31.0 * TIME))[None]
RIG = parse_rig("""
name = "place"
[body.motor]
inertia = 0.002
coulomb = 0.05
static = 0.06
stribeck_speed = 0.5
viscous = 0.004
[body.arm]
inertia = 0.02
coulomb = 0.04
viscous = 0.03
[mesh.gear]
between = ["motor", "arm"]
ratio = 3
stiffness = 90
damping = 0.02
half_gap = 0.01
gap_damping = 0.002
[input.drive]
column = "u_V"
body = "motor"
gain = "0.5 N m/V"
limit = "1.5 V"
[sensor.near]
column = "w_rad_s"
body = "motor"
[sensor.far]
column = "q_rad"
body = "arm"
""")
# sizes that are clearly seen on this drive, where a tenth of the bound is not one
SIZES = {
    "drive_delay": {"delay": 0.0033},
    "current_lag": {"time_constant": 0.004},
    "sensor_delay": {"delay": 0.0033},
    "shaft_compliance": {"share": 0.4, "antiresonance": 150.0, "damping_ratio": 0.05},
    "backlash": {"half_gap": 0.02},
    "presliding": {"distance": 0.004},
    "friction_asymmetry": {"difference": 0.2},
    "cogging": {"cosine": 0.03, "sine": 0.02, "order": 6.0},
    "drive_saturation": {"inverse_limit": 1.0},
    "drive_offset": {"offset": 0.1},
}
PARTS = {
    "input": ["drive"],
    "body": ["motor", "arm"],
    "link": ["gear"],
    "sensor": ["near", "far"],
}


def visible(entry):
    if entry.name in SIZES:
        return SIZES[entry.name]
    return {
        p.name: d if p.bank else 0.1 * min(p.high, 1.0)
        for p, d in zip(entry.keep, entry.defaults, strict=True)
    }


def reads(entry, part):
    """An effect on the reading of an angle is none on that of a speed."""
    angle = part == "far"
    return not (entry.name == "encoder_eccentricity" and not angle) and not (
        entry.name == "sensor_gain" and angle
    )


CASES = {
    f"{entry.name}@{part}": Placed(entry.name, part, visible(entry))
    for entry in PLACED_CATALOGUE.values()
    for part in PARTS[entry.place]
    if reads(entry, part)
}


def model_of(case):
    return RigModel(RIG, (CASES[case],))


def seen(run):
    motor, arm = run.speed("motor"), run.speed("arm")
    return np.array([run.reading("near"), run.reading("far"), motor, arm, run.link("gear")])


def exact(model):
    plant, layout = model.plant(), model.layout
    zero = np.zeros(layout.coordinates)
    found = run_exactly(plant, U, zero, zero, DT)
    gear = found.links[:, layout.links.index("gear")]
    speeds = [layout.ratio[b] * found.v[:, layout.coordinate[b]] for b in ("motor", "arm")]
    return np.array([*found.readings.T, *speeds, gear])


@pytest.fixture(scope="module")
def plain():
    return seen(march(RigModel(RIG), U, DT, substeps=SUBSTEPS))


# Effects that change a drive's shape make lanes of their own, which are long to compile: here one
# does, at one place; `test_batch` has the others on the dual drive.
OF_SHAPE = ("current_lag", "presliding", "sensor_delay", "shaft_compliance")
IN_LANES = [c for c in CASES if CASES[c].name not in OF_SHAPE] + ["shaft_compliance@arm"]


@pytest.fixture(scope="module")
def lanes():
    """Cases in lanes, those of one shape beside each other."""
    models = [model_of(case) for case in IN_LANES]
    starts = [(np.zeros(m.layout.coordinates),) * 2 for m in models]
    none = np.zeros((0, 0))
    common = Common(DT, SUBSTEPS, TIME.size, U[None], none, none, SEEN)
    outputs, _ = run_many(models, starts, common)
    return dict(zip(IN_LANES, outputs, strict=True))


def apart(found, expected):
    return np.sqrt(np.mean((found - expected) ** 2, axis=1)) / np.ptp(expected, axis=1)


@pytest.mark.parametrize("case", CASES)
def test_acts_and_is_the_same_in_every_run(case, plain, lanes):
    model = model_of(case)
    found = seen(march(model, U, DT, substeps=SUBSTEPS))
    true = exact(model)
    error, moved = apart(found, true), apart(found, plain)
    assert moved.max() > 1e-3
    assert error.max() < min(2e-3, 0.1 * moved.max()), error
    if case in IN_LANES:
        side_by_side = np.array([found[0], found[1], found[4]])
        assert apart(lanes[case], side_by_side).max() < 1e-7


ADDITIVE = [c for c in CASES if CASES[c].name not in ("backlash", "shaft_compliance")]


@pytest.mark.parametrize("case", ADDITIVE)
def test_at_zero_amplitude_nothing_changes(case, plain):
    placed = CASES[case]
    entry = PLACED_CATALOGUE[placed.name]
    absent = dict(zip((p.name for p in entry.keep), entry.defaults, strict=True))
    model = RigModel(RIG, (placed._replace(values=absent),))
    run = seen(march(model, U, DT, substeps=SUBSTEPS))
    assert apart(run, plain).max() < 1e-9
