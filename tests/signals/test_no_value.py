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


@pytest.mark.parametrize(
    "given",
    [
        *("-32768", "32767.0", "65535", "-8888", "1E+10", "-1e20", "1e30", "9.91E+37", "9.9E37"),
        *("3.4028235E+38", "-3.4028234663852886e+38", "1.7976931348623157e308", "3276.7"),
    ],
)
@pytest.mark.parametrize("column", [1, 2])
def test_single_samples_that_stand_for_no_value(tmp_path, given, column):
    """In an input as in a position; of limits of 16 bits only single samples far from all else."""
    lines = [line.split(",") for line in table().splitlines()]
    for row in (100, 101, 102, 200):
        lines[row][column] = given
    log = read(tmp_path, "\n".join(map(",".join, lines)) + "\n")
    name = "uq"[column - 1]
    assert f"{name} is {float(given):.6g} at times, far from all else" in log.warnings[0]
    channel = next(c for c in log.channels if c.endswith(f"_{name}"))
    right = read(tmp_path, table())[channel]
    assert np.abs(log[channel] - right).max() < 0.05 * np.ptp(right)


@pytest.mark.parametrize("kind", ["clipped", "pulses", "levels", "a step beyond"])
def test_an_amplifier_that_clips_at_16_bits_is_a_signal(tmp_path, kind):
    u = {
        "clipped": np.clip(50_000 * np.sin(20 * T), -32768, 32767),
        "pulses": np.where(np.sin(20 * T) > 0.9, 32767, 1000 * np.sin(T)),
        "levels": np.where(np.arange(ROWS) % 100 < 2, 32767, 0),
        "a step beyond": np.where(np.arange(ROWS) == 50, 32767, 20_000 * np.sin(20 * T)),
    }[kind].round()
    log = read(tmp_path, "t,u,q\n" + rows(",", T, u, Q, digits=5))
    assert not any("no value" in note for note in log.warnings)
    assert log[next(c for c in log.channels if c.endswith("_u"))].max() > 0


def test_a_small_signal_below_zero_in_16_bits_is_one(tmp_path):
    u = np.where(np.arange(ROWS) % 80 == 7, -1, np.round(2 + 2 * np.sin(9 * T))) % 65536
    log = read(tmp_path, "t,u,q\n" + rows(",", T, u, Q, digits=5))
    assert any("16 bits with a sign" in note for note in log.warnings)
