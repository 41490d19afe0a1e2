"""Curves without a name, too long for CI: ``python -m pytest benchmarks/long``."""

import numpy as np
import pytest
from tests.recovery.test_tables import GAIN, LOGS, decided, halved, left_by, table_of

from dmptm_ctrl.diagnosis.tables import HELD, TORQUE, tabulate
from dmptm_ctrl.drive import paper_drive
from dmptm_ctrl.effects.lookup import DRAG


def test_ripple_in_proportion_to_the_voltage():
    decision, true = decided(503, (("voltage_ripple", 1.0),), "load", "eq21")
    true = true["voltage_ripple"]
    assert decision.unexplained.variables[:2] == ("theta_L", "u")
    drive = paper_drive()
    ratio = drive["N_1"] * drive["N_2"]
    _, places, knots = table_of(decision.after)
    phase = true["order"] * places / ratio
    basis = np.column_stack([np.cos(phase), np.sin(phase)])
    size = np.hypot(*np.linalg.lstsq(basis, knots, rcond=None)[0])
    # of the mean voltage, at the ring gear, from both motors
    assert 2.0 * ratio * size == pytest.approx(true["N_m_per_V"], rel=0.3)
    assert halved(decision)


def test_brake_in_a_sector_of_the_turn():
    """Where it begins and ends, and that it grows with the speed; the next turn meets it again."""
    logs = (*LOGS, "open_square_0v60")
    left, true = left_by(506, (("sector_brake", 3.0),), "load", "eq21", logs=logs)
    true = true["sector_brake"]
    found = tabulate(left, ("theta_L",), 2)
    assert found.names == (TORQUE,)
    values, places, knots = table_of(found.left, TORQUE)
    assert values["variable"] == DRAG
    away = np.abs(np.rad2deg(places) - true["place_deg"])
    inside = knots[away < 0.8 * true["half_width_deg"]]
    # the drive's own viscous friction takes up what is everywhere
    outside = knots[away > 1.2 * true["half_width_deg"]]
    assert np.median(outside) - np.median(inside) == pytest.approx(true["N_m_s_rad"], rel=0.1)
    assert values["high"] - values["low"] < np.deg2rad(4.0 * true["half_width_deg"] + 60.0)


def test_motors_that_lose_torque_in_the_course_of_a_log():
    left, true = left_by(504, (("fading_motors", 1.0),), "all", "kelvin_voigt")
    share, tau = true["fading_motors"].values()
    found = tabulate(left, ("time", "u"), 2)
    _, places, knots = table_of(found.left)
    lost = -GAIN * share * (1.0 - np.exp(-places / tau))
    # a motor that is weaker all the time is friction and inertia as well: compare the course
    np.testing.assert_allclose(knots - knots[-1], lost - lost[-1], atol=0.05 * GAIN * share)
    assert found.held_gain > HELD
