"""Effects put into rigs of another program are named, and none where there is none.

The rigs are those of benchmarks/rigs: another program than `dmptm_ctrl`, in fixed fine steps of
25 µs. A few short logs keep this in the time of a check; more of them are in `benchmarks/long`,
whole rigs are for `benchmarks/blind.py`.
"""

import sys

from dmptm_ctrl import diagnose, load_log
from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.select import select_effects
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

PAIRS = ("open_sine_0v60", "open_sine_0v75", "closed_sine_10", "closed_sine_15")
NULL_LOGS = ("open_sine_0v60", "open_sine_0v75", "closed_square_10", "closed_square_15")
TURN, MULTISINE = "closed_turn_20", "open_multisine_preload"
TURN_ENDS = 19.0  # s, of the turn only the way there
TWINS = {"current_lag": "drive_delay", "drive_delay": "current_lag"}


def logs_of(rig):
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    return [log.segment(0.0, TURN_ENDS) if log.name == TURN else log for log in logs]


def named_and_gone(name, strength, friction, sensors, more, left):
    """The error with it in the model is `left` times that without."""
    rig = make_rig(3, [(name, strength)], sensors=sensors, friction=friction, logs=(*PAIRS, more))
    found = diagnose(logs_of(rig))
    assert found.verdict == "explained"
    first = found.effects[0]
    if name in TWINS and first.name == TWINS[name]:
        assert name in first.confusable_with
    else:
        assert first.name == name
    assert [e.name for e in found.effects if e.material] == [first.name]
    for kind in ("speed", "torque"):
        before, after = (found.error[side][kind]["rmse"] for side in ("before", "after"))
        assert after < left * before, kind


def best_of_null(seed):
    """Most evidence of any effect on a rig that lacks nothing; none may be selected.

    Laws of friction and contact, sensors and parameters are drawn by the seed.
    """
    rig = make_rig(seed, (), logs=NULL_LOGS)
    measured = measure(logs_of(rig), paper_drive())
    base = DualState(residual(measured, Model(paper_drive())))
    selection = select_effects(DualEvidence(measured), base)
    assert not selection.entries, (seed, rig.label["laws"], selection.path)
    return max(candidate.evidence for candidate in selection.first)


def no_false_alarm(seeds, capsys):
    best = {seed: best_of_null(seed) for seed in seeds}
    with capsys.disabled():  # a figure to be read in the run's output
        sys.stdout.write(
            f"\nfalse alarms: 0 of {len(best)} nulls; best evidence {max(best.values()):.0f} "
            f"where {LEVEL:.0f} is needed\n"
        )


def test_no_false_alarm(capsys):
    no_false_alarm((4000,), capsys)
