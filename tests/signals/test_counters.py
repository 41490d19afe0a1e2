"""Counters of few bits."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dmptm_ctrl import LogError
from dmptm_ctrl.drive.rigfile import parse_rig
from dmptm_ctrl.signals.counters import unwrapped_counts, with_sign, without_failures

T = 1e-3 * np.arange(4000)


def rig(sensor, unit_of_input="1"):
    return parse_rig(f"""
[body.a]
inertia = "unknown"
[input.u]
column = "u"
unit = "{unit_of_input}"
[sensor.q]
column = "q"
{sensor}
[data]
time = {{ column = "t", unit = "s" }}
""")


COUNTS = 'unit = "counts"\ncounts_per_rev = 10000'


@pytest.mark.parametrize("bits", [8, 12, 16, 24, 32])
@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("lacking", [0, 1])  # some counters jump by one less
def test_unwrapped(bits, signed, lacking):
    size = 2**bits
    true = np.round(1.7 * size * np.sin(2 * np.pi * 0.5 * T) + 0.3 * size)
    read = true % size
    if lacking:
        true = np.round(1.7 * size * T + 0.3 * size)
        read = true % (size - 1)
    if signed:
        read = np.where(read >= size // 2, read - size + lacking, read)
    values, note = unwrapped_counts("q", read)
    # one count less per turn cannot be separated from the counter's own size
    np.testing.assert_allclose(values - values[0], true - true[0], rtol=0, atol=7 * lacking)
    assert f"{bits} bit counter" in note


@pytest.mark.parametrize(
    ("size", "turn"),
    [(1000, 0), (3333, 0), (25000, 0), (360, 360), (7200, 3600), (500, 0), (1440, 0)],
)
@pytest.mark.parametrize("digits", [0, 3])
@pytest.mark.parametrize("low", [0.0, -0.5])
def test_any_modulus(size, turn, digits, low):
    """Also where the shaft turns by a seventh of it from one sample to the next."""
    true = np.round(20 * size * np.sin(4 * T) ** 3 + 300 * T, digits)
    fast = np.round(15 * size * np.sin(10 * T), digits) if turn else true
    for motion in (true, fast):
        values, note = unwrapped_counts("q", (motion / size - low) % 1.0 * size, turn)
        np.testing.assert_allclose(np.diff(values), np.diff(motion), atol=1.01 * 10.0**-digits)
        assert "unwrapped" in note


@given(st.integers(0, 2**16 - 1), st.integers(1, 20), st.integers(1, 6))
def test_any_start(start, speed, turns):
    true = start + np.cumsum(np.round(speed * 40 * np.sin(np.linspace(0, 2 * np.pi * turns, 3000))))
    values, _ = unwrapped_counts("q", true % 2**16)
    np.testing.assert_array_equal(np.diff(values), np.diff(true))


def test_what_is_no_counter_is_left_alone():
    square = np.where(np.sin(20 * T) > 0, 60000.0, 0.0)
    for values in (np.round(5e4 * T), square, np.sin(T), np.full(50, 3.0)):
        same, note = unwrapped_counts("q", values)
        assert same is values
        assert note == ""


@pytest.mark.parametrize("unit", ["counts", "rad"])
def test_one_jump_by_any_number_is_refused_unless_it_is_left_out(unit):
    values = np.round(300 * np.sin(T)) + np.where(T > 2.0005, 12345, 0)
    frame = pd.DataFrame({"t": T, "u": np.cos(T), "q": values * (1 if unit == "counts" else 0.01)})
    a_rig = rig(COUNTS if unit == "counts" else 'unit = "rad"')
    jump = "12345" if unit == "counts" else "123.45"
    with pytest.raises(LogError, match=rf"q jumps by {jump} after 2 s, .* \(start and stop"):
        a_rig.read(frame)
    cut = replace(a_rig, data=replace(a_rig.data, stop={"*": 1.9}))
    (log,) = cut.read(frame)
    assert len(log) == 1901


def test_a_reading_that_fails_once_is_no_jump():
    values = np.sin(T) + np.where(np.isin(np.arange(T.size), [700, 900, 901, 1600]), 9.0, 0)
    values[1200] = 0.0
    mended, note = without_failures("f", "q", values, T)
    np.testing.assert_allclose(mended, np.sin(T), atol=2e-6)  # of a chord over 3 ms
    assert note.startswith("q fails in 5 samples, first by 8.99")
    with pytest.raises(LogError, match="f: q jumps by 8.999"):
        without_failures("f", "q", np.sin(T) + np.where(T > 2, 9.0, 0), T)


@pytest.mark.parametrize("size", [2 * np.pi / 10000, 0.036, 0.005])  # rad, deg or mm per count
@pytest.mark.parametrize("digits", [6, 15])
def test_a_counter_that_was_scaled(size, digits):
    true = np.round(1e5 * np.sin(2 * T) + 2e4)
    values, note = unwrapped_counts("q", np.round(size * (true % 2**16), digits))
    np.testing.assert_allclose(values - values[0], size * (true - true[0]), atol=2 * 10.0**-digits)
    assert "16 bit counter that ran over" in note


def test_a_position_that_was_set_is_no_scaled_counter():
    true = 3.0 * np.sin(3 * T)
    for jump in (0.512, 0.655, 1.31, 2.62, 5.24):
        values = np.round(true, 5) + np.where(T > 2, jump, 0)
        assert unwrapped_counts("q", values)[1] == ""


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_signed_read_as_unsigned(bits):
    true = np.round(0.3 * 2**bits * np.sin(3 * T))
    values, note = with_sign("u", true % 2**bits)
    np.testing.assert_array_equal(values, true)
    assert f"{bits} bits with a sign" in note
    for good in (np.abs(true), np.round(2.0**bits * T / 4.1)):
        assert with_sign("u", good)[1] == ""
    scaled, note = with_sign("u", 0.5 * (true % 2**bits))
    if bits == 16:  # as drives log words; others might be anything
        np.testing.assert_array_equal(scaled, 0.5 * true)
    assert bool(note) == (bits == 16)


@pytest.mark.parametrize("bits", [16, 32])
def test_a_load_that_hangs_is_below_zero_all_the_time(bits):
    true = np.round(-900 + 500 * np.sin(3 * T))
    values, note = with_sign("u", true % 2**bits)
    np.testing.assert_array_equal(values, true)
    assert note == f"u holds negative numbers of {bits} bits, read without a sign: -1400 to -400"


def test_numbers_near_the_top_of_16_bits_may_be_what_they_are():
    far = np.round(60_000 + 300 * np.sin(3 * T))
    values, note = with_sign("u", far)
    np.testing.assert_array_equal(values, far)
    assert note.startswith("u is 59700 to 60300 in all rows: perhaps numbers of 16 bits")
    for other in (far - 20_000, 0.1 * far, far / 60_000 * 4000):
        assert with_sign("u", other)[1] == ""


def test_levels_that_only_look_like_a_sign():
    """A signal of three levels jumps as far, and not to the end of its word."""
    u = np.select([np.sin(9 * T) > 0.3, np.sin(9 * T) < -0.3], [200.0, 0.0], 50.0)
    assert with_sign("u", u)[1] == ""


def test_a_position_that_was_set_within_its_range_is_refused():
    position = 3.0 * np.sin(3 * T)
    without_failures("f", "q", position, T)
    with pytest.raises(LogError, match="q jumps by 1.00865 after 2 s"):
        without_failures("f", "q", position + np.where(T > 2, 1.0, 0), T)


def test_through_a_rig():
    true = np.round(1e5 * np.sin(2 * T))
    u = np.round(900 * np.cos(2 * T))
    frame = pd.DataFrame({"t": T, "u": u % 2**16, "q": true % 2**16})
    (log,) = rig(COUNTS).read(frame)
    np.testing.assert_allclose(log["out_q"] - log["out_q"][0], 2 * np.pi / 1e4 * (true - true[0]))
    np.testing.assert_array_equal(log["in_u"], u)
    assert len(log.warnings) >= 2


@pytest.mark.parametrize(
    ("unit", "per_second"), [("counts/s", 1.0), ("counts/ms", 1e3), ("inc / min", 1 / 60)]
)
def test_counts_per_second(unit, per_second):
    sensor = f'unit = "{unit}"\ncounts_per_rev = 8192'
    a_rig = rig(sensor, "percent")
    assert a_rig.sensors[0].measures == "speed"
    (log,) = a_rig.read(pd.DataFrame({"t": T, "u": 50 * np.sin(T), "q": 1000.5 * np.cos(T)}))
    expected = 1000.5 * np.cos(T) * per_second / 8192 * 2 * np.pi
    np.testing.assert_allclose(log["out_q"], expected, rtol=1e-12)
    assert log["in_u"].max() == pytest.approx(50.0, abs=0.1)


@pytest.mark.parametrize(
    ("unit", "gain"),
    [("percent", "0.5 N m/percent"), ("%", "0.5 N m/%"), ("pwm", "0.5 N m/pwm"), ("counts", "0.5"),
     ("1", "0.5 N m/count"), ("PWM", 0.5)],
)  # fmt: skip
def test_gain_of_inputs_that_are_numbers(unit, gain):
    text = gain if isinstance(gain, float) else f'"{gain}"'
    a_rig = parse_rig(f"""
[body.a]
inertia = "1 kg m^2"
[input.u]
column = "u"
unit = "{unit}"
gain = {text}
[sensor.q]
column = "q_rad"
""")
    assert a_rig.inputs[0].gain.value == 0.5
