"""Drives of other shapes: each law of the machine against a closed form or a finer step."""

import numpy as np
import pytest
from rigs.machine import (
    FRICTION,
    LUGRE,
    OPEN,
    POSITION_LOOP,
    SLIP,
    SPEED_LOOP,
    Loop,
    Machine,
    simulate,
)

from rigs import shapes

DT = 1e-3


def run(machine, u, start=0.0, step=2e-5, loop=None):
    """Columns u, first angle, second angle, speed sensor, true speed."""
    return simulate(machine, loop or Loop(OPEN), np.asarray(u, float), DT, start, step).T


def constant(value, seconds):
    return np.full(round(seconds / DT), value)


def test_a_step_of_torque_ends_exponentially():
    speed = run(Machine(j1=0.02, b1=0.05), constant(1.0, 2))[4]
    t = DT * np.arange(speed.size)
    np.testing.assert_allclose(speed, 20 * (1 - np.exp(-2.5 * t)), atol=1e-3)


def test_the_error_halves_with_the_step():
    p = Machine(j1=0.02, b1=0.05, coulomb=0.3, smooth=1.0, unbalance_cos=0.3, cogging=0.1,
                cogging_order=7)  # fmt: skip
    u = 1.5 * np.sin(2 * np.pi * np.arange(1000) * DT)
    ends = [run(p, u, step=step)[1, -1] for step in (2e-5, 1e-5, 5e-6)]
    assert (ends[0] - ends[1]) / (ends[1] - ends[2]) == pytest.approx(2, rel=0.1)


@pytest.mark.parametrize("law", range(len(FRICTION)))
def test_dry_friction_by_every_law(law):
    """Final speed (T - T_c)/b on both sides; below breakaway the body stays."""
    p = Machine(j1=0.02, b1=0.05, coulomb=0.3, law=law, smooth=1e-3, bristle=5e-5, asymmetry=0.1)
    for way in (1, -1):
        share = 1 + 0.1 * way
        end = run(p, constant(way * 1.0, 4))[4, -1]
        assert end == pytest.approx(way * (1.0 - share * 0.3) / (share * 0.05), rel=1e-3)
    held = run(p, constant(0.2, 2))[1]
    assert np.ptp(held[500:]) < 2e-3  # tanh creeps with 1 mrad/s
    static = run(p._replace(rise_at_rest=0.2, stribeck_speed=0.5), constant(0.4, 2))
    assert np.abs(static[4, 500:]).max() < 2e-3


def test_slip_elements_spring_back():
    """No element slips yet: four springs, 0.3/4 (1 + 1/2 + 1/3 + 1/4) N m per mrad."""
    p = Machine(j1=0.02, b1=5.0, coulomb=0.3, law=SLIP, bristle=1e-3)
    held = run(p, np.concatenate([constant(0.06, 2), constant(0.0, 2)]))[1]
    bend = 0.06 / (0.3 / 4 * (1 + 1 / 2 + 1 / 3 + 1 / 4)) * 1e-3
    assert held[1990] == pytest.approx(bend, rel=1e-3)
    assert abs(held[-1]) < 1e-3 * bend


def test_bristles_bend_by_their_law():
    """dz = v - |v| z/b: b ln(1/0.8) on the way to a fifth of the level, b ln(1.2) back."""
    p = Machine(j1=0.02, b1=5.0, coulomb=0.3, law=LUGRE, bristle=1e-3)
    held = run(p, np.concatenate([constant(0.06, 2), constant(0.0, 2)]))[1]
    assert held[1990] == pytest.approx(-1e-3 * np.log(0.8), rel=1e-3)
    assert held[-1] == pytest.approx(-1e-3 * (np.log(0.8) + np.log(1.2)), rel=1e-2)


def test_a_shaft_rings_at_its_frequency():
    """sqrt(k (1/J1 + N^2/J2)), by the spectrum of the twist."""
    ratio, k = 3.0, 20.0
    p = Machine(j1=1e-3, j2=9e-3, ratio=ratio, stiffness=k, damping=1e-3)
    out = run(p, np.concatenate([constant(1.0, 0.01), constant(0.0, 8)]), step=1e-5)
    twist = out[1] - ratio * out[2]
    spectrum = np.abs(np.fft.rfft(twist * np.hanning(twist.size)))
    found = np.fft.rfftfreq(twist.size, DT)[np.argmax(spectrum)]
    assert 2 * np.pi * found == pytest.approx(np.sqrt(k * (1 / 1e-3 + ratio**2 / 9e-3)), rel=5e-3)
    momentum = p.j1 * np.gradient(out[1], DT) + p.j2 / ratio * np.gradient(out[2], DT)
    assert momentum[-5] == pytest.approx(0.01 * 1.0, rel=1e-3)


def test_in_the_gap_the_motor_is_alone():
    p = Machine(j1=1e-3, j2=1e-3, stiffness=100.0, damping=0.01, half_gap=0.05)
    out = run(p, constant(0.1, 0.2))
    touch = np.sqrt(2 * 0.05 * 1e-3 / 0.1)
    before = DT * np.arange(200) < touch
    np.testing.assert_array_equal(out[2, before], 0.0)
    t = DT * np.arange(200)[before]
    np.testing.assert_allclose(out[1, before], 0.5 * 100 * t**2, atol=1e-4)
    assert out[2, -1] > 0


def test_springs_weights_and_drag():
    """Frequency of a cable spring and of a small pendulum, final speed against drag."""
    for p in (Machine(j1=0.1, cable=4.0), Machine(j1=0.1, unbalance_sin=-4.0)):
        angle = run(p, constant(0.0, 10), start=0.02)[1]
        crossings = np.flatnonzero(np.diff(np.sign(angle)))
        period = 2 * DT * (crossings[-1] - crossings[0]) / (crossings.size - 1)
        assert period == pytest.approx(2 * np.pi * np.sqrt(0.1 / 4), rel=1e-3)
    end = run(Machine(j1=0.01, quadratic=0.05), constant(0.2, 5))[4, -1]
    assert end == pytest.approx(2.0, rel=1e-3)


def test_a_shaken_base():
    p = Machine(j1=0.5, vibration=2.0, vibration_rate=30.0)
    speed = run(p, constant(0.0, 4))[4]
    t = DT * np.arange(speed.size)
    np.testing.assert_allclose(speed, 2 / (0.5 * 30) * np.sin(30 * t), atol=5e-4)


def test_what_the_drive_does():
    """Torque on an inertia without friction: its speed is the integral of the signal."""
    u = 2.0 * np.sin(2 * np.pi * np.arange(3000) * DT)

    def speed(**fields):
        return run(Machine(j1=1.0, **fields), u)[4]

    def sums(signal):
        return np.concatenate([[0], np.cumsum(signal)[:-1]]) * DT

    np.testing.assert_allclose(speed(limit=1.0), sums(np.clip(u, -1, 1)), atol=1e-9)
    band = np.sign(u) * np.maximum(0, np.abs(u) - 0.3)
    np.testing.assert_allclose(speed(dead_band=0.3), sums(band), atol=1e-9)
    np.testing.assert_allclose(speed(offset=0.1), sums(u + 0.1), atol=1e-9)
    np.testing.assert_allclose(speed(delay=0.02)[20:], speed()[:-20], atol=1e-9)
    scheduled = np.where(np.arange(3000) * DT > 1.5 - 1e-9, 0.7, 1.0) * u
    np.testing.assert_allclose(speed(schedule=0.3, schedule_time=1.5), sums(scheduled), atol=1e-4)
    kept = (np.arange(3000) * DT) % 0.5 >= 0.1 - 1e-9
    found = speed(dropout=0.1, dropout_period=0.5)
    np.testing.assert_allclose(found, sums(kept * u), atol=4e-3)
    lagging = run(Machine(j1=1.0, lag=0.05), constant(1.0, 1))[4]
    t = DT * np.arange(1000)
    np.testing.assert_allclose(lagging, t - 0.05 * (1 - np.exp(-t / 0.05)), atol=1e-4)
    followed, last = np.empty(u.size), 0.0
    for i, command in enumerate(u):
        followed[i] = last = np.clip(last, command - 0.5, command + 0.5)
    np.testing.assert_allclose(speed(command_play=0.5), sums(followed), atol=1e-9)


def test_what_friction_depends_on():
    p, torque = Machine(j1=0.01, b1=0.1, coulomb=0.5, smooth=1e-3), constant(2.0, 6)
    plain, t = run(p, torque)[4], DT * np.arange(6000)
    warm = run(p._replace(warm=0.3, warm_time=1.0), torque)[4]
    share = 1 + 0.3 * np.exp(-t)
    np.testing.assert_allclose(warm[1000:], ((2 - share * 0.5) / (share * 0.1))[1000:], rtol=0.02)
    assert plain[-1] == pytest.approx(15.0, rel=1e-3)
    slow = p._replace(b1=10.0)  # quasi-static: speed tells friction
    angle, speed = run(slow._replace(position_friction=0.2, position_order=2.0), 60 * torque)[
        [1, 4]
    ]
    level = 0.5 + 0.2 * np.cos(2 * angle)
    np.testing.assert_allclose(speed[100:], ((120 - level) / 10)[100:], atol=1e-3)
    spot = slow._replace(spot=0.3, spot_place=1.0, spot_width=0.1)
    angle, speed = run(spot, 60 * torque)[[1, 4]]
    x = (angle - 1.0 + np.pi) % (2 * np.pi) - np.pi
    level = 0.5 + 0.3 * np.exp(-50 * x**2)
    np.testing.assert_allclose(speed[100:], ((120 - level) / 10)[100:], atol=4e-3)
    sector = run(slow._replace(sector=0.4, sector_place=0.5, sector_half=0.3), 60 * torque)
    inside = np.abs((sector[1] - 0.5 + np.pi) % (2 * np.pi) - np.pi) < 0.3
    off = np.abs(sector[4] - (11.95 - 0.04 * inside))[100:]
    assert np.quantile(off, 0.98) < 1e-3  # the rest: steps in which the edge is crossed
    geared = Machine(j1=1e-3, j2=1e-3, b2=0.1, stiffness=100.0, damping=0.05, coulomb=0.1,
                     load_friction=0.2, smooth=1e-3)  # fmt: skip
    end = run(geared, constant(1.0, 2))[4, -1]
    assert end == pytest.approx((1.0 - 0.1) / (0.1 * 1.2), rel=1e-3)


def test_what_sensors_do():
    u = 0.5 * np.sin(np.arange(3000) * DT * 5)
    p = Machine(j1=0.02, b1=0.05)
    true = run(p, u)
    gain = run(p._replace(gain_error=0.05), u)[3]
    np.testing.assert_allclose(gain, 1.05 * true[4], atol=1e-9)
    late = run(p._replace(sensor_delay=0.008), u)[3]
    np.testing.assert_allclose(late[8:], true[4, :-8], atol=1e-9)
    ecc = run(p._replace(eccentricity=0.02), u)
    np.testing.assert_allclose(ecc[1], true[1] + 0.02 * np.cos(true[1]), atol=1e-12)
    play = run(p._replace(sensor_play=0.1), u)[1]
    assert np.abs(play - true[1]).max() == pytest.approx(0.1, rel=1e-6)
    assert np.ptp(play) == pytest.approx(np.ptp(true[1]) - 0.2, abs=0.11)


@pytest.mark.parametrize("mode", [SPEED_LOOP, POSITION_LOOP])
def test_loops_reach_their_setpoints(mode):
    p = Machine(j1=0.02, b1=0.05, coulomb=0.1, smooth=1e-3)
    loop = Loop(mode, *((1.0, 5.0, 0.0) if mode == SPEED_LOOP else (20.0, 0.0, 2.0)), 20.0, 1e-5)
    out = run(p, constant(3.0, 3), loop=loop)
    reached = out[4 if mode == SPEED_LOOP else 1, -1]
    assert reached == pytest.approx(3.0, rel=0.02)


@pytest.mark.parametrize("name", [*shapes.EFFECTS, *shapes.UNKNOWN])
def test_every_effect_can_be_left_out(name):
    """Without it nothing of it is left, and the machine is otherwise the same."""
    drive = shapes.draw(5, [name])
    clean = shapes.without(drive, [name])
    changed = {f for f in Machine._fields if getattr(clean, f) != getattr(drive.machine, f)}
    assert changed
    if drive.lacking[name]:
        assert changed <= set(drive.lacking[name])
        grown = shapes.draw(5, [name], {name: 2.0})
        assert shapes.without(grown, [name]) == clean


@pytest.mark.parametrize("seed", [1, 2])
def test_files_and_labels(seed, tmp_path):
    names = [["coulomb_friction", "cable_spring"], ["dropout"]][seed - 1]
    label = shapes.make(seed, names, tmp_path / "b1")
    fit = sorted(p.name for p in (tmp_path / "b1").glob("*.csv.gz"))
    held = sorted(p.name for p in (tmp_path / "b1.held").glob("*.csv.gz"))
    assert (len(fit), len(held)) == (6, 2)
    assert label["truth"] == (names if seed == 1 else [])
    assert set(label["things"]) == set(names)
    error = label["held_error_percent"]
    for thing in label["things"].values():
        assert thing["material"] == (thing["rise_percent"] >= error["floor"])
    if seed == 1:
        text = (tmp_path / "b1" / "rig.toml").read_text()
        assert "coulomb" not in text
        assert "viscous" in text
    else:
        assert label["on_no_list"] == "dropout"
        assert label["things"]["dropout"]["name"] is None


@pytest.mark.parametrize("shape", shapes.SHAPES)
def test_rig_files_are_rig_files(shape, tmp_path, capsys):
    """Read by the command; what is declared is within its tolerance of the truth."""
    from dmptm_ctrl.cli import main

    seed = next(s for s in range(99) if shapes.draw(s, []).shape == shape)
    drive = shapes.draw(seed, [])
    path = tmp_path / "rig.toml"
    path.write_text(shapes.rig_file(np.random.default_rng(0), drive, shape), encoding="utf-8")
    assert main(["rig", "check", str(path)]) in (0, None)
    assert shape in capsys.readouterr().out
