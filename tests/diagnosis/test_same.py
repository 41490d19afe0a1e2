"""One set of logs has one verdict, to the bit, on any number of threads."""

import dmptm_ctrl
from dmptm_ctrl import data

NAMES = ("open_sine_0v60", "open_sine_0v75", "closed_sine_10", "closed_sine_15")


def test_threads_change_nothing():
    logs = dmptm_ctrl.load_logs([data.path("demo_rig") / f"{name}.csv.gz" for name in NAMES])
    one, two = (dmptm_ctrl.diagnose(logs, jobs=jobs).to_dict() for jobs in (1, 2))
    assert one["effects"]
    for found in (one, two):
        found["provenance"].pop("seconds")
    assert one == two
