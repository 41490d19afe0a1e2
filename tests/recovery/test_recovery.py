"""No effect is named on a rig of another program that lacks nothing.

The rigs are those of benchmarks/rigs: another program than `dmptm_ctrl`, in fixed fine steps of
25 µs. More of them, and whole diagnoses of what was put in, are in `benchmarks/long`.
"""

import sys

from dmptm_ctrl import load_log
from dmptm_ctrl.diagnosis.candidate import LEVEL
from dmptm_ctrl.diagnosis.dual import DualEvidence, DualState
from dmptm_ctrl.diagnosis.measure import measure
from dmptm_ctrl.diagnosis.residual import residual
from dmptm_ctrl.diagnosis.select import select_effects
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.simulate.model import Model
from rigs import make_rig

NULL_LOGS = ("open_sine_0v60", "open_sine_0v75", "closed_square_10", "closed_square_15")


def best_of_null(seed):
    """Most evidence of any effect on a rig that lacks nothing; none may be selected.

    Laws of friction and contact, sensors and parameters are drawn by the seed.
    """
    rig = make_rig(seed, (), logs=NULL_LOGS)
    logs = [load_log(table, name=name) for name, table in rig.logs.items()]
    measured = measure(logs, paper_drive())
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
