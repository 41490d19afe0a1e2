"""Numbers in a log that are no readings."""

import numpy as np
import pytest
from tests.signals.test_programs import ROWS, Q, T, U, read, rows, table

from dmptm_ctrl.signals import LogError


@pytest.mark.parametrize(
    "sentinel", ["-9999", "9999", "-999.25", "-2147483648", "-3.4028234663852886e+38"]
)
def test_numbers_that_stand_for_no_value(tmp_path, sentinel):
    """At an end such rows go; between others they are bridged; a motion that gets there stays."""
    lines = table().splitlines()
    lost = {1, 100}
    slow = [f"{t:.5f},{u:.5f},{0.02 * q:.5f}" for t, u, q in zip(T, U, Q, strict=True)]
    for row in lost:
        slow[row - 1] = slow[row - 1].rpartition(",")[0] + f",{sentinel}"
    log = read(tmp_path, "\n".join([lines[0], *slow]) + "\n")
    assert any(f"q is {float(sentinel):.6g} at times" in note for note in log.warnings)
    assert log.time.size == ROWS - 1
    assert log[next(c for c in log.channels if c.endswith("_q"))][0] == float(f"{0.02 * Q[1]:.5f}")
    assert np.abs(log[next(c for c in log.channels if c.endswith("_q"))]).max() <= 30.0


def test_a_motion_that_passes_through_nines(tmp_path):
    far = np.round(-9999.0 * T / T[-1], 5)
    log = read(tmp_path, "t,u,q\n" + rows(",", T, U, far))
    assert not log.warnings
    assert log[next(c for c in log.channels if c.endswith("_q"))].min() == -9999.0


def test_a_long_stretch_without_value_is_refused_with_the_number_that_the_file_has(tmp_path):
    slow = [f"{t:.5f},{u:.5f},{'9999' if 50 <= i < 90 else q / 100:}" for i, (t, u, q) in
            enumerate(zip(T, U, Q, strict=True))]  # fmt: skip
    with pytest.raises(LogError, match=r"q, where 9999 stands for no value, is missing .* row 51 "):
        read(tmp_path, "t,u,q\n" + "\n".join(slow) + "\n")


def test_a_small_counter_below_zero_is_no_missing_value(tmp_path):
    counts = np.round(3 * np.sin(2.1 * T)).astype(int) % 65536
    log = read(tmp_path, "t,u,q\n" + rows(",", T, U, counts, digits=3))
    assert not any("no value" in note for note in log.warnings)


def test_milliseconds_taken_for_seconds_are_suspected(tmp_path):
    log = read(tmp_path, "t,u,q\n" + rows(",", 1e3 * T, U, Q))
    assert any("10 s are long; perhaps the clock is in ms" in note for note in log.warnings)
    assert not any("perhaps" in note for note in read(tmp_path, table()).warnings)
