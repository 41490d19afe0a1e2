"""A response has its numbers before python-control is there, and is python-control's after."""

import subprocess
import sys

import numpy as np
import pytest

PROGRAM = """
import pickle, sys
import numpy as np
from dmptm_ctrl.simulate import simulate
from dmptm_ctrl.simulate.model import Model

def run():
    return simulate(Model(), 1e-3 * np.arange(50), np.full((2, 50), 5.0))

early, kept, asked = run(), pickle.dumps(run()), [run() for _ in range(6)]
numbers = {k: np.array(getattr(early, k)) for k in ("time", "t", "outputs", "y", "inputs", "u")}
assert "control" not in sys.modules
import control
late = run()
assert type(late) is control.TimeResponseData
assert all(isinstance(one, control.TimeResponseData) for one in asked)
time, outputs = asked[0]
assert len(asked[1]) == len(late)
np.testing.assert_array_equal(asked[2][1], late[1])
asked[3](squeeze=True)
assert "TimeResponseData" in repr(asked[4])
asked[5].title = "mine"
assert asked[5].title == "mine"
for one in (*asked, late, early, pickle.loads(kept)):
    for name, there in numbers.items():
        np.testing.assert_array_equal(getattr(one, name), there)
    assert one.output_labels == late.output_labels
    assert one.sysname == late.sysname
    assert type(one) is control.TimeResponseData
assert control.combine_time_responses([early, late]).ntraces == 2
"""


def test_a_response_becomes_what_it_stands_for():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


def test_what_it_does_not_have_it_says_as_python_control_does():
    from dmptm_ctrl.simulate.response import response

    import control  # isort: skip

    one = response(np.arange(3.0), np.ones((1, 3)), inputs=np.ones((1, 3)))
    assert type(one) is control.TimeResponseData
    with pytest.raises(AttributeError, match="nothing"):
        one.nothing  # noqa: B018
